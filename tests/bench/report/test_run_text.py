"""Findings in words."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.bias.bins import BiasBin, PositionComparison, bin_biases, compare_positions, paper_bins
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.noise_estimate import estimate_noise
from gyrobench.bench.navigation.attitude import rotation_matrices, rotation_vector_enu
from gyrobench.bench.report.run_text import (
    accelerometers_sentence,
    agreement_sentence,
    differing,
    equality_sentence,
    fit_sentence,
    flags_sentence,
    heading_sentence,
    noise_sentence,
    power_cycle_sentence,
    run_findings,
    scatter_sentence,
    setup_sentences,
    signs_sentence,
    temperatures_sentence,
)
from gyrobench.bench.runs.journal import RunFacts
from gyrobench.bench.runs.tables.joint_table import JointPlateauRow
from tests.bench.bias.test_noise_estimate import GRAVITY, simulated
from tests.bench.report.made_up_noise import made_up_noise

COMPARISON = PositionComparison(
    gyro="x",
    bin_low_c=20.0,
    bin_high_c=25.0,
    p_value=0.004,
    largest_pair=("y_up", "z_up"),
    largest_difference_dph=0.0123,
    largest_difference_sigma_dph=0.0013,
    temperature_spread_c=0.1,
)


def a_bin(low_c: float, **changes: object) -> BiasBin:
    base = BiasBin("x", "z_up", low_c, low_c + 5.0, low_c + 2.0, 0.004, 0.0009, 2, 1.0, 0.4)
    return replace(base, **changes)


def test_each_bin_of_a_gyro_makes_the_test_stricter() -> None:
    assert differing([COMPARISON]) == [COMPARISON]
    others = [replace(COMPARISON, bin_low_c=low, p_value=0.5) for low in (30.0, 40.0)]
    assert differing([COMPARISON, *others]) == []
    assert differing([COMPARISON, *(replace(other, gyro="y") for other in others)]) == [COMPARISON]


def test_sentence_states_where_and_by_how_much() -> None:
    sentence = equality_sentence([COMPARISON])
    assert "in 1 of 1 bins: from 20 to 25 °C (p < 0.01, one comparison)" in sentence
    assert "Y-Up above Z-Up by 0.0123 ± 0.0013 deg/h" in sentence


def test_sentence_counts_only_the_bins_that_differ() -> None:
    hotter = replace(COMPARISON, bin_low_c=25.0, bin_high_c=30.0, p_value=0.3)
    assert equality_sentence([COMPARISON, hotter]) == (
        "The bias differs between positions in 1 of 2 bins: from 20 to 25 °C (p < 0.01, corrected for 2 "
        "comparisons). Largest difference from 20 to 25 °C: Y-Up above Z-Up by 0.0123 ± 0.0013 deg/h (k = 1)."
    )


def test_sentence_says_that_nothing_was_found_or_compared() -> None:
    hotter = replace(COMPARISON, bin_low_c=25.0, bin_high_c=30.0, p_value=0.3)
    assert equality_sentence([replace(COMPARISON, p_value=0.3), hotter]) == (
        "No significant difference between positions from 20 to 30 °C (no p < 0.01, corrected for 2 "
        "comparisons)."
    )
    assert equality_sentence([]).startswith("Nothing to compare")


def test_made_up_runs_are_judged_rightly(bins: list[BiasBin], equal_bins: list[BiasBin]) -> None:
    for gyro in "xyz":
        parting = compare_positions([each for each in bins if each.gyro == gyro])
        assert {each.bin_low_c for each in differing(parting)} >= {-25.0, 5.0, 15.0}
        assert all(each.bin_high_c <= 50.0 for each in differing(parting))
        agreeing = compare_positions([each for each in equal_bins if each.gyro == gyro])
        assert equality_sentence(agreeing).startswith("No significant difference between positions from")


def test_scatter_is_stated_only_where_uncertainties_do_not_explain_it() -> None:
    quiet = [a_bin(0.0), a_bin(5.0, count=1, spread_p_value=float("nan"))]
    assert scatter_sentence(quiet) == ""
    assert "Z-Up 10 to 15 °C." in scatter_sentence([*quiet, a_bin(10.0, spread_p_value=1e-6)])


def test_agreement_names_the_bins_that_the_estimators_judge_differently() -> None:
    hotter = replace(COMPARISON, bin_low_c=25.0, bin_high_c=30.0, p_value=0.3)
    equal = replace(COMPARISON, p_value=0.3)
    different = replace(hotter, p_value=1e-6)
    ours = [COMPARISON, hotter]
    assert agreement_sentence(ours, ours) == "The paper's method agrees."
    assert agreement_sentence(ours, [COMPARISON, different]).endswith(
        "disagrees: it also finds a difference from 25 to 30 °C."
    )
    assert agreement_sentence(ours, [equal, different]).endswith(
        "a difference from 25 to 30 °C, and it finds none from 20 to 25 °C."
    )
    assert agreement_sentence(ours, []) == ""


def test_leaks_of_the_papers_method_show_as_differences_of_equal_positions(equal_bins: list[BiasBin]) -> None:
    own = [each for each in equal_bins if each.gyro == "y"]
    sentence = agreement_sentence(compare_positions(own), compare_positions(paper_bins(own)))
    assert sentence.startswith("The paper's method disagrees: it also finds a difference from -25")


def test_fit_of_dwells_whose_noise_is_as_declared_is_no_surprise(dwells: list[DwellRow]) -> None:
    sentence = fit_sentence(dwells)
    assert sentence.startswith("Residuals of 71 dwells are 0.")
    assert sentence.endswith("Error model and noise explain the data.")


@pytest.mark.parametrize(("power", "verdict"), [(4.0, "too small"), (0.2, "too large")])
def test_p_values_that_chance_does_not_give_are_stated(
    dwells: list[DwellRow], power: float, verdict: str
) -> None:
    sentence = fit_sentence([replace(row, fit_p_value=row.fit_p_value**power) for row in dwells])
    assert f"p-values are {verdict} (" in sentence
    assert "explain" not in sentence
    assert "disturbed" not in sentence


def test_dwells_that_do_not_fit_are_named(dwells: list[DwellRow]) -> None:
    bad = [replace(row, fit_p_value=1e-7) if row.dwell in (3, 5) else row for row in dwells]
    assert fit_sentence(bad).endswith("Outlying: dwells 3 and 5 (smallest p = 1e-7).")
    bad[9] = replace(dwells[9], fit_p_value=0.0)
    assert fit_sentence(bad).endswith("Outlying: dwells 3, 5 and 10 (smallest p < 1e-9).")


def test_single_dwell_and_none_have_their_sentences(
    dwells: list[DwellRow], old_dwells: list[DwellRow]
) -> None:
    only = replace(dwells[0], fit_ratio=1.04, fit_p_value=0.3)
    assert fit_sentence([only]) == (
        "Residuals of the only dwell tested are 1.04 times as large as expected (p = 0.300). "
        "Error model and noise explain the data."
    )
    assert "larger than assumed" in fit_sentence([replace(only, fit_p_value=1e-4)])
    assert fit_sentence(old_dwells) == ""


def test_verdict_seldom_blames_chance() -> None:
    random = np.random.default_rng(11)
    row = DwellRow("U", "1", 1, 1, "z_up", 0, 1, 0, (0,) * 3, (0,) * 3, (0,) * 3, (1,) * 3)
    runs = [[replace(row, fit_ratio=1.0, fit_p_value=p) for p in random.uniform(size=60)] for _ in range(300)]
    blamed = sum("explain the data" not in fit_sentence(run) for run in runs)
    assert blamed <= 9  # 3 are expected


def test_the_flag_that_keeps_half_of_the_dwells_out_is_stated(dwells: list[DwellRow]) -> None:
    assert flags_sentence(dwells) == ""
    assert flags_sentence([]) == ""
    half = [replace(row, flags=("no signal",) if number % 2 else ()) for number, row in enumerate(dwells)]
    assert f"{len(half) // 2} of {len(half)} dwells" in flags_sentence(half)
    assert flags_sentence(half).endswith(f"({len(half) // 2}): no signal")
    assert flags_sentence(half, "the operator stopped it") == flags_sentence(half)
    assert flags_sentence(half, "no signal") == ""  # stated as the reason
    drifts = [replace(row, flags=(f"drifts by {number - 3:+.1f} ug/h",)) for number, row in enumerate(dwells)]
    drifts[0] = replace(drifts[0], flags=("no signal",))
    assert f"({len(drifts) - 1}): drifts by -2.0 ug/h" in flags_sentence(drifts)


@pytest.mark.parametrize(
    ("factor", "offset_c", "named"),
    [
        (1.0, 0.0, ""),
        (0.5, 0.0, "temperature signals"),
        (1.8, 32.0, "temperature signals"),
        (
            1.0,
            15.0,
            "23.0 to 23.0 K above the chamber's air; unit.thermal.self_heating_c of the station is 9 K",
        ),
        (1.0, -15.0, "-7.0 to -7.0 K above the chamber's air"),
        (1.0, 5.0, ""),
    ],
)
def test_temperatures_in_a_wrong_scale_or_with_an_offset_are_named(
    dwells: list[DwellRow], factor: float, offset_c: float, named: str
) -> None:
    station = {"unit": {"thermal": {"self_heating_c": 9}}}
    settled = [
        replace(
            row,
            chamber_c=10.0 * number,
            gyro_c=(factor * (10.0 * number + 8.0) + offset_c,) * 3,
            gyro_rate_c_per_h=(1.0,) * 3,
            board_c=(math.nan,) * 3,
        )
        for number, row in enumerate(dwells)
    ]
    assert named in temperatures_sentence(settled, station)
    assert bool(named) == bool(temperatures_sentence(settled, station))
    assert temperatures_sentence(settled[:3], station) == ""
    moving = [replace(row, gyro_rate_c_per_h=(60.0,) * 3) for row in settled]
    assert temperatures_sentence(moving, station) == ""


def test_exchanged_temperatures_of_optics_and_electronics_are_named(dwells: list[DwellRow]) -> None:
    def settled(board_c: tuple[float, float, float]) -> list[DwellRow]:
        still = {"chamber_c": 25.0, "gyro_c": (35.0,) * 3, "gyro_rate_c_per_h": (1.0,) * 3}
        return [replace(row, board_c=board_c, **still) for row in dwells]

    assert temperatures_sentence(settled((42.0, math.nan, 36.0)), {}) == ""
    found = temperatures_sentence(settled((28.0, math.nan, 36.0)), {})
    assert "optics are warmer than the electronics, by 7.0 K or more (gyro x)" in found
    assert "exchanged in signal map or DBC file" in found
    one_warmer = [*settled((28.0,) * 3)[1:], settled((42.0,) * 3)[0]]
    assert temperatures_sentence(one_warmer, {}) == ""


@pytest.mark.parametrize(
    ("finding", "p_values", "titles"),
    [
        ("latitude", (0.3, 0.3), []),
        ("latitude_off", (1e-9, 0.3), ["Wrong latitude."]),
        ("not_latitude", (0.3, 0.3), ["Rate Up."]),
        ("not_contradicted", (1e-9, 1e-5), ["Dwells contradict one another."]),
    ],
)
def test_what_the_joint_solution_finds_wrong_with_the_bench_is_stated(
    finding: str, p_values: tuple[float, float], titles: list[str]
) -> None:
    numbers = [0.0] * 6 + [0.0, 0.001, 0.006, 0.001, 10.0, 0.1, 0.5]
    row = JointPlateauRow(1, 1, 6, 25.0, *numbers, finding, *p_values)
    assert list(setup_sentences([row])) == titles
    assert setup_sentences([]) == {}


def test_a_heading_that_the_ins_holds_is_named() -> None:
    windows = [window for position in ("z_up", "x_up") for window in simulated(position=position)]
    random = np.random.default_rng(3)

    def held(C_nb: np.ndarray, noise_rad: float) -> np.ndarray:
        turned = rotation_vector_enu(C_nb, C_nb[0]) * [0.0, 0.0, 1.0]
        noise = np.outer(random.normal(0.0, noise_rad, len(C_nb)), [0.0, 0.0, 1.0])
        return rotation_matrices(noise - turned) @ C_nb

    assert heading_sentence(estimate_noise(windows, GRAVITY)) == ""
    for noise_rad in (0.0, 5e-7):
        aided = [replace(window, C_nb=held(window.C_nb, noise_rad)) for window in windows]
        assert "seems to hold or aid it" in heading_sentence(estimate_noise(aided, GRAVITY))
    assert heading_sentence(None) == ""


@pytest.mark.parametrize(
    ("declared_arw", "declared_vrw", "texts"),
    [
        (0.001, 20.0, []),
        (0.002, 40.0, []),  # a data sheet's limits
        (0.001, 0.0, []),
        (0.06, 20.0, ["Angle random walk of all gyros", "declared 0.06 deg/sqrt(h). The uncertainties"]),
        (0.0005, 20.0, ["others are too small. Declare ins.noise.angle_random_walk_deg_per_sqrt_h: 0.00"]),
        (0.001, 100.0, ["Velocity random walk", "Declare ins.noise.velocity_random_walk_ug_per_sqrt_hz: 2"]),
        (0.001, 10.0, ["Velocity random walk", "too small"]),
    ],
)
def test_declared_noise_that_the_data_contradict_is_named_with_what_to_declare(
    declared_arw: float, declared_vrw: float, texts: list[str]
) -> None:
    declared = {
        "angle_random_walk_deg_per_sqrt_h": declared_arw,
        "velocity_random_walk_ug_per_sqrt_hz": declared_vrw,
    }
    text = noise_sentence(made_up_noise(), {"ins": {"noise": declared}})
    assert all(each in text for each in texts)
    assert bool(text) == bool(texts)
    found = run_findings([], {"ins": {"noise": declared}}, made_up_noise(), [])
    assert found.get("Declared noise.", "") == text


def test_noise_that_is_estimated_or_not_measured_contradicts_no_declaration() -> None:
    assert noise_sentence(made_up_noise(), {"ins": {"noise": "estimated"}}) == ""
    declared = {"ins": {"noise": {"angle_random_walk_deg_per_sqrt_h": 0.06}}}
    assert noise_sentence(None, declared) == ""
    coarse = [replace(each, velocity_enu_mps=np.round(each.velocity_enu_mps, 1)) for each in simulated()]
    hidden = estimate_noise(coarse, GRAVITY)
    assert "Velocity" not in noise_sentence(hidden, declared)
    declared["ins"]["noise"]["velocity_random_walk_ug_per_sqrt_hz"] = 1e6
    assert "Velocity random walk: measured below " in noise_sentence(hidden, declared)


@pytest.mark.parametrize(
    ("ug_per_k", "declared", "count"),
    [
        (0.0, {"accelerometer_slope_ug_per_c": 0.0}, 0),
        (1.0, {"accelerometer_slope_ug_per_c": 0.0}, 6),
        (1.0, {"accelerometer_slope_ug_per_c": 0.0, "accelerometer_drift_ug_per_h": 200.0}, 0),
        (1.0, {"accelerometer_slope_ug_per_c": 1.0}, 0),
        (1.0, {}, 6),
        (1.5, {"accelerometer_slope_ug_per_c": 2.0}, 0),
        (6.0, {"accelerometer_slope_ug_per_c": 2.0}, 6),
    ],
)
def test_accelerometers_that_follow_the_temperature_more_than_declared_are_named(
    dwells: list[DwellRow], ug_per_k: float, declared: dict[str, float], count: int
) -> None:
    random = np.random.default_rng(5)
    rows = [
        replace(
            row,
            gyro_c=(8.0 * number,) * 3,
            case_c=8.0 * number if number % 2 else np.nan,
            gyro_rate_c_per_h=(100.0 if number < 6 else 1.0,) * 3,
            accelerometer_ug=tuple(30.0 + ug_per_k * 8.0 * number + random.normal(0.0, 2.0, 3)),
            accelerometer_sigma_ug=(2.0, 2.0, 800.0),
        )
        for number, row in enumerate(dwells)
    ]
    station = {"ins": {"uncertainty": declared}}
    text = accelerometers_sentence(rows, station)
    assert (f"In {count} dwells that is a drift of up to" in text) == bool(count)
    assert not count or f"looks like {0.00573 * ug_per_k:.3f} deg/h of a level gyro" in text
    value = re.search(r"Declare accelerometer_slope_ug_per_c: ([\d.]+) in", text)
    assert not count or ug_per_k <= 1.02 * float(value[1]) <= 1.15 * ug_per_k
    unknown = [replace(row, accelerometer_ug=(np.nan,) * 3) for row in rows]
    assert accelerometers_sentence(unknown, station) == accelerometers_sentence([], {}) == ""


@pytest.mark.parametrize(
    ("are_tested", "latitude_deg", "stated"),
    [
        (None, 5.0, ""),
        (
            False,
            36.4,
            "Signs and axes of the signal map were not tested: the windows are too short, the output is "
            "too coarse, or the velocities do not follow",
        ),
        (True, 36.4, ""),
        (True, -35, ""),
        (True, 5.0, "At 5 deg of latitude no dwell shows whether heading and"),
        (True, -8, "At -8 deg of latitude"),
    ],
)
def test_what_no_dwell_tested_of_the_signal_map_is_stated(
    are_tested: bool | None, latitude_deg: float, stated: str
) -> None:
    station = {"location": {"latitude_deg": latitude_deg}}
    text = signs_sentence(RunFacts(are_signs_tested=are_tested), station, "mine.yaml")
    assert text.startswith(stated)
    assert bool(text) == bool(stated)


def test_power_cycles_that_measured_different_positions_are_named(dwells: list[DwellRow]) -> None:
    good = [row for row in dwells if not row.flags]
    assert power_cycle_sentence(bin_biases(good)) == ""
    apart = [replace(row, run=row.position[0]) for row in good if row.position in ("z_up", "y_up")]
    sentence = power_cycle_sentence(bin_biases(apart))
    assert sentence.endswith("Only positions of the same power cycle are compared there.")
