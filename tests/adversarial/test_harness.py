"""The independent strapdown, its frames, and the counts of the table."""

from dataclasses import replace
from pathlib import Path

import cantools
import numpy as np
import pytest

import gyrobench.drivers.ins as ins_drivers
from tests.adversarial import harness
from tests.adversarial.frames import dwell_frames, euler_deg
from tests.adversarial.rows import CLEAN, ROWS
from tests.adversarial.strapdown import Place, Schedule, Unit, simulate

DBC = Path(ins_drivers.__file__).parent / "gyrobench_ins.dbc"
TURN = [(0.0, 0.0), (0.0, 180.0)]
PERFECT = Unit(angle_random_walk=0.0, velocity_random_walk=0.0)


def simulated(unit=PERFECT):
    return simulate(unit, Place(), Schedule(window_s=120.0), TURN, np.random.default_rng(0))


def test_a_perfect_ins_stays_at_rest_and_follows_the_turn():
    output = simulated()
    (_, end), (begin, _) = output.windows
    at_rest = np.r_[:end, begin : len(output.time_s)]
    assert np.abs(output.velocity_enu_mps[at_rest]).max() < 1e-5
    _, _, heading = euler_deg(output.C_nb, is_pry=False)
    middle = sum(output.turns[0]) // 2
    assert heading[middle] == pytest.approx(270.0, abs=1.0)
    assert heading[-1] == pytest.approx(180.0, abs=1e-4)


def test_a_lever_arm_shows_as_velocity_in_the_turn_alone():
    output = simulated(replace(PERFECT, lever_arm_m=(0.1, 0.0, 0.0)))
    middle = sum(output.turns[0]) // 2
    rate = 2.0 * np.pi / 25.0
    # Body x points North by then, and moves West.
    np.testing.assert_allclose(output.velocity_enu_mps[middle], [-0.1 * rate, 0.0, 0.0], atol=1e-3)
    assert np.abs(output.velocity_enu_mps[-1]).max() < 1e-4


def test_a_level_bias_grows_quadratically_at_first():
    output = simulated(replace(PERFECT, gyro_bias_dph=(0.0, 1.0, 0.0)))
    end = output.windows[0][1] - 1
    expected = 0.5 * 9.797 * np.radians(1.0 / 3600.0) * output.time_s[end] ** 2
    assert output.velocity_enu_mps[end, 0] == pytest.approx(expected, rel=0.01)


def test_frames_decode_to_the_output_by_cantools():
    output = simulated(Unit(gyro_bias_dph=(0.5, -0.5, 0.5)))
    marks, frames = dwell_frames(output, "z_up", TURN, 1, np.random.default_rng(1))
    database = cantools.database.load_file(DBC)

    def value(message, signal, epoch):
        identifier = database.get_message_by_name(message).frame_id
        data = frames.data[np.flatnonzero(frames.arbitration_id == identifier)[epoch]]
        return database.decode_message(identifier, bytes(data), decode_choices=False)[signal]

    for epoch in (0, 700, len(output.time_s) - 1):
        east, north, _ = output.velocity_enu_mps[epoch]
        roll, pitch, heading = (angle[epoch] for angle in euler_deg(output.C_nb, is_pry=False))
        assert value("VELOCITY_NE", "VELOCITY_EAST", epoch) == pytest.approx(east, abs=1e-4)
        assert value("VELOCITY_NE", "VELOCITY_NORTH", epoch) == pytest.approx(north, abs=1e-4)
        assert value("ROLL_PITCH", "ROLL", epoch) == pytest.approx(roll, abs=1e-6)
        assert value("ROLL_PITCH", "PITCH", epoch) == pytest.approx(pitch, abs=1e-6)
        assert value("HEADING", "HEADING", epoch) == pytest.approx(heading, abs=1e-6)
        assert value("HEADING", "EPOCH_COUNTER", epoch) == epoch
    assert value("INS_STATUS", "MODE", 3) == 3
    assert value("SYSTEM_TIME", "TIME_S", 7) == 7
    assert marks.windows[-1].end_frame == len(frames)


def test_readme_and_table_have_all_wrong_set_ups():
    root = Path(__file__).parents[2]
    page = (root / "docs/reliability.md").read_text()
    table = page.partition("<!-- wrong set-ups: begin -->")[2].partition("<!-- wrong set-ups: end -->")[0]
    names = [
        line.split(" | ")[0].removeprefix("| ") for line in table.splitlines()[3:] if line.startswith("| ")
    ]
    assert names == [row.name for row in (*ROWS, CLEAN)]
    assert f"{len(ROWS)} of them on an independent strapdown" in (root / "README.md").read_text()


@pytest.mark.long
def test_errors_of_good_dwells_have_the_size_that_is_stated():
    result = harness.measure_row(CLEAN, runs=2)
    assert (result.flagged, result.silent) == (0, 0)
    assert 0.6 < result.rms(level=True) < 1.5
    assert 0.5 < result.rms(level=False) < 1.6
