"""What the dwells of a run give together, from four positions at three temperatures."""

import math
from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.bias.bins import BIAS_BINS_TABLE
from gyrobench.bench.bias.joint_solution import solve_jointly
from gyrobench.bench.dwells.dwell_output import ALIGNED_AGAIN
from gyrobench.bench.dwells.measure_dwell import lack_of_fit_text
from gyrobench.bench.dwells.measurement_setup import measurement_setup
from gyrobench.bench.dwells.run_results import RunResults, evaluate, planned_dwells, write_results
from gyrobench.bench.foundations.arrays import RADPS_TO_DPH
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.procedure.plan import expand
from gyrobench.bench.procedure.procedure_file import load_procedure
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.tables.budget_table import BUDGET_TABLE
from gyrobench.bench.runs.tables.joint_table import (
    JOINT_BIASES_TABLE,
    JOINT_PLATEAUS_TABLE,
    joint_bias_rows,
    joint_plateau_rows,
)
from gyrobench.bench.runs.tables.noise_file import read_noise
from gyrobench.bench.station.station import Station

PROCEDURE = """procedure: three_temperatures
steps:
  - power_on: {settle_s: 20}
  - repeat:
      over: {temperature_c: [57, 22, -13]}
      steps:
        - chamber: {temperature_c: $temperature_c, ramp_c_per_min: 10}
        - soak: {for_s: 120}
        - repeat:
            over: {position: [z_up, z_down, y_up, y_down]}
            steps:
              - go_to: {position: $position, rate_dps: 30}
              - align: {duration_s: 60}
              - navigate: {duration_s: 300}
              - turn: {angle_deg: 180, rate_dps: 10, settle_s: 5}
              - navigate: {duration_s: 300}
  - power_off
  - chamber_off
"""


@pytest.fixture(scope="module")
def measured(run_procedure, tmp_path_factory):
    """The dwells of a run on the quick bench, and the set-up that they were measured with."""
    place = tmp_path_factory.mktemp("three-temperatures")
    (place / "procedure.yaml").write_text(PROCEDURE)
    folder, outcome, _ = run_procedure(place / "procedure.yaml", place / "run", "quick", station="quick")
    return outcome.dwells, measurement_setup(Station(folder.station))


@pytest.fixture(scope="module")
def results(measured):
    dwells, setup = measured
    return evaluate(dwells, setup, 5.0)


def flagged(dwell):
    return dwell.with_flag("door opened")


def counted(bins):
    return sum(each.count for each in bins)


def test_each_plateau_of_the_chamber_is_solved_by_itself(results):
    assert [[dwell.number for dwell in each.dwells] for each in results.joint] == [
        [1, 2, 3, 4],
        [5, 6, 7, 8],
        [9, 10, 11, 12],
    ]
    assert [each.dwells[0].chamber_set_c for each in results.joint] == [57.0, 22.0, -13.0]


def test_the_joint_solution_starts_from_the_dwells_own_estimates(measured, results):
    dwells, _ = measured
    singles = np.vstack([each.single.bias_radps for each in results.joint])
    scale = [dwell.estimate.sigma_dph for dwell in dwells]
    errors = (np.degrees(singles) * 3600.0 - [dwell.estimate.bias_dph for dwell in dwells]) / scale
    assert np.abs(errors).max() < 0.2  # misalignments of accelerometers are known here, and no more


def test_every_dwell_counts_once_for_each_gyro(results):
    assert counted(results.bins) == 3 * 12
    assert results.noise.duration_s == pytest.approx(24 * 300.0, abs=30.0)
    assert set(results.up_rate.weights) == set(range(1, 13))


def test_dwells_with_flags_are_left_out(measured, results):
    dwells, setup = measured
    without = evaluate([flagged(dwells[0]), *dwells[1:]], setup, 5.0)
    assert counted(without.bins) == 3 * 11
    assert [dwell.number for dwell in without.joint[0].dwells] == [2, 3, 4]
    assert without.noise.duration_s == pytest.approx(22 * 300.0, abs=30.0)
    assert 1 not in without.up_rate.weights
    # The plateaus that lost nothing are as they were.
    np.testing.assert_array_equal(without.joint[2].together.bias_radps, results.joint[2].together.bias_radps)


def with_heading_held(motion, time_constant_s):
    """A window of an unbiased vertical gyro whose heading an aid holds where it was at the start."""
    rotation, heading = motion.rotation_enu.copy(), 0.0
    steps = np.diff(motion.rotation_enu[:, 2], prepend=0.0) - motion.rotation_enu[-1, 2] / len(rotation)
    for index, (step, interval_s) in enumerate(zip(steps, np.diff(motion.time_s, prepend=0.0), strict=True)):
        heading = (heading + step) * math.exp(-interval_s / time_constant_s)
        rotation[index, 2] = heading
    return replace(motion, rotation_enu=rotation)


@pytest.mark.parametrize("time_constant_s", [1.0, 5.0, 20.0])
def test_a_heading_that_the_ins_holds_flags_all_dwells(measured, results, time_constant_s):
    dwells, setup = measured
    held = [
        replace(dwell, windows=tuple(with_heading_held(each, time_constant_s) for each in dwell.windows))
        for dwell in dwells
    ]
    flags = [dwell.flags for dwell in evaluate(held, setup, 5.0).dwells]
    assert all("the INS holds its heading" in str(each) for each in flags)
    assert not any(dwell.flags for dwell in results.dwells)


def test_biases_that_alignments_remove_flag_all_dwells(measured):
    dwells, setup = measured
    bias_dph = np.array([0.2, -0.3, 0.4])
    removing = []
    for dwell in dwells:
        C_nb = POSITIONS[dwell.row.position].C_nb(math.radians(dwell.row.azimuth_deg))
        left_dph = C_nb.T @ ([1.0, 0.0, 1.0] * (C_nb @ bias_dph))
        removing.append(replace(dwell, row=replace(dwell.row, bias_dph=tuple(left_dph))))
    flags = [dwell.flags for dwell in evaluate(removing, setup, 5.0).dwells]
    assert all("the INS seems to remove in its alignment" in str(each) for each in flags)


@pytest.mark.parametrize(("contradicting", "are_flagged"), [(0.5, False), (0.75, True)])
@pytest.mark.parametrize("fault", ["wrong latitude", f"{ALIGNED_AGAIN} before window 2"])
def test_a_dwell_that_fits_by_chance_is_flagged_where_most_have_a_fault_of_the_set_up(
    measured, contradicting, are_flagged, fault
):
    dwells, setup = measured
    count = round(contradicting * len(dwells))
    setup_fault = "" if ALIGNED_AGAIN in fault else fault
    wrong = [replace(dwell.with_flag(fault), setup_fault=setup_fault) for dwell in dwells[:count]]
    others = evaluate([*wrong, *dwells[count:]], setup, 5.0).dwells[count:]
    assert [any(fault in flag for flag in dwell.flags) for dwell in others] == [are_flagged] * len(others)


def test_dwells_allow_for_gyro_errors_larger_than_declared(measured, results, monkeypatch):
    def solve(*arguments):
        return replace(solve_jointly(*arguments), gyro_error_factor=3.0, scale_factor_ratio=2.0)

    monkeypatch.setattr("gyrobench.bench.dwells.run_results.solve_jointly", solve)
    for dwell, wide in zip(results.dwells, evaluate(*measured, 5.0).dwells, strict=True):
        added = np.zeros(3)
        for name, factor in (("gyro_misalignment", 3.0), ("gyro_scale_factor", 6.0)):
            part = dwell.estimate.parts[name].columns
            np.testing.assert_allclose(wide.estimate.parts[name].columns, factor * part)
            added += (RADPS_TO_DPH**2 * (factor**2 - 1.0) * part**2).sum(axis=1)
        np.testing.assert_allclose(np.square(wide.row.sigma_dph), np.square(dwell.row.sigma_dph) + added)
        assert wide.row.bias_dph == dwell.row.bias_dph
        assert wide.row.accelerometer_sigma_ug == dwell.row.accelerometer_sigma_ug
        common = np.square(dwell.row.common_sigma_dph) + added
        np.testing.assert_allclose(np.square(wide.row.common_sigma_dph), common)


def test_common_sigmas_are_those_of_latitude_misalignments_and_scale_factors(results):
    for dwell in results.dwells:
        common = dwell.row.common_sigma_dph
        names = ("gyro_misalignment", "gyro_scale_factor", "latitude")
        columns = np.hstack([dwell.estimate.parts[name].columns for name in names])
        np.testing.assert_allclose(common, RADPS_TO_DPH * np.linalg.norm(columns, axis=1))
        assert (np.array(common) < dwell.row.sigma_dph).all()


def test_dwells_without_a_result_are_left_out(measured):
    dwells, setup = measured
    lost = replace(
        flagged(dwells[0]), estimate=None, windows=(),
    )  # fmt: skip
    assert counted(evaluate([lost, *dwells[1:]], setup, 5.0).bins) == 3 * 11


def test_a_run_whose_dwells_are_all_flagged_has_no_results(measured):
    dwells, setup = measured
    nothing = evaluate([flagged(dwell) for dwell in dwells], setup, 5.0)
    assert (nothing.bins, nothing.joint, nothing.calibration_check) == ([], [], [])
    assert (nothing.up_rate, nothing.noise) == (None, None)


def test_bins_are_as_wide_as_asked(measured):
    dwells, setup = measured
    (width_c,) = {each.bin_high_c - each.bin_low_c for each in evaluate(dwells, setup, 20.0).bins}
    assert width_c == 20.0


def test_tables_that_were_written_hold_the_results(results, tmp_path):
    folder = RunFolder(tmp_path)
    write_results(folder, results)
    assert counted(BIAS_BINS_TABLE.read(folder.bias_bins)) == counted(results.bins)
    assert read_noise(folder.noise).angle_random_walk == results.noise.angle_random_walk
    written = joint_bias_rows(results.joint, results.up_rate)
    for row, read in zip(written, JOINT_BIASES_TABLE.iterate(folder.joint_biases), strict=True):
        assert (read.plateau, read.dwell, read.position, read.gyro) == (
            row.plateau, row.dwell, row.position, row.gyro,
        )  # fmt: skip
        assert read.joint_dph == pytest.approx(row.joint_dph, rel=1e-8)
    plateaus = joint_plateau_rows(results.joint, results.up_rate)
    assert [row.finding for row in JOINT_PLATEAUS_TABLE.read(folder.joint)] == [
        row.finding for row in plateaus
    ]
    assert not folder.calibration_check.exists()


def test_the_budget_of_each_dwell_and_bin_adds_up_to_its_stated_uncertainty(results, tmp_path):
    folder = RunFolder(tmp_path)
    write_results(folder, results)
    squares = defaultdict(float)
    for row in BUDGET_TABLE.iterate(folder.budget):
        if not (row.is_sum or math.isnan(row.share)):
            squares[row.axis, row.position, row.dwell, row.bin_low_c] += row.sigma**2
    stated = {
        (gyro, dwell.row.position, dwell.row.dwell): dwell.row.sigma_dph[axis]
        for dwell in results.dwells
        for axis, gyro in enumerate("xyz")
    } | {(each.gyro, each.position, each.bin_low_c): each.sigma_dph for each in results.bins if each.count}
    assert len(squares) == len(stated) == 36 + 36
    for (gyro, position, dwell, low_c), variance in squares.items():
        sigma_dph = stated[gyro, position, low_c if dwell is None else dwell]
        assert math.sqrt(variance) == pytest.approx(sigma_dph, rel=1e-6)


def test_a_run_without_results_leaves_tables_without_rows(tmp_path):
    folder = RunFolder(tmp_path)
    write_results(folder, RunResults())
    assert BIAS_BINS_TABLE.read(folder.bias_bins) == []
    assert list(JOINT_BIASES_TABLE.iterate(folder.joint_biases)) == []
    assert JOINT_PLATEAUS_TABLE.read(folder.joint) == []
    assert not folder.noise.exists()
    assert not folder.budget.exists()


def test_a_folder_that_can_not_be_written_is_an_error(results, tmp_path):
    with pytest.raises(RunFolderError, match="can't be written"):
        write_results(RunFolder(tmp_path / "absent"), results)


def test_dwells_without_a_set_point_are_one_stop(measured):
    dwells, setup = measured
    nowhere = [replace(dwell, row=replace(dwell.row, chamber_set_c=math.nan)) for dwell in dwells[:4]]
    (plateau,) = evaluate(nowhere, setup, 5.0).joint
    assert len(plateau.dwells) == 4


def test_noise_is_estimated_from_dwells_that_the_declared_one_does_not_explain(measured, results):
    dwells, setup = measured
    flags = [lack_of_fit_text(dwell.estimate.fit) for dwell in dwells]
    unexplained = [
        replace(dwell.with_flag(flag), persistent_flags=(flag,))
        for dwell, flag in zip(dwells, flags, strict=True)
    ]
    found = evaluate(unexplained, setup, 5.0)
    assert (found.bins, found.joint, found.up_rate) == ([], [], None)
    assert found.noise.angle_random_walk == results.noise.angle_random_walk
    disturbed = evaluate([unexplained[0].with_flag("door opened"), *unexplained[1:]], setup, 5.0)
    assert disturbed.noise.duration_s == pytest.approx(22 * 300.0, abs=30.0)


def test_power_ons_are_solved_apart(measured):
    dwells, setup = measured
    restarted = [replace(dwell, row=replace(dwell.row, run="later")) for dwell in dwells[2:4]]
    found = evaluate([*dwells[:2], *restarted], setup, 5.0)
    assert [[dwell.number for dwell in each.dwells] for each in found.joint] == [[1, 2], [3, 4]]


def test_each_dwell_is_planned_with_its_number_cycle_set_point_and_expected_temperature():
    planned = planned_dwells(expand(*load_procedure(find_document("procedures", "six_position_fig7"))))
    assert [each.dwell for each in planned] == list(range(1, 61))
    seventh, last = planned[6], planned[-1]
    assert (seventh.cycle, seventh.chamber_set_c, seventh.position) == (1, 20.5, "z_up")
    assert (last.cycle, last.chamber_set_c, last.position) == (2, 20.5, "z_up")
    assert 20.5 < seventh.gyro_c[0] < 50.0
