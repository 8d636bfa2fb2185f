"""What makes the results of a run doubtful."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.bias.noise_estimate import estimate_noise
from gyrobench.bench.report.run_findings import (
    accelerometers_sentence,
    flags_sentence,
    identities_sentence,
    joint_solution_sentences,
    noise_sentence,
    run_findings,
    signs_sentence,
)
from gyrobench.bench.runs.journal import RunFacts, facts_of
from gyrobench.bench.runs.tables.joint_table import JointPlateauRow
from tests.bench.bias.test_noise_estimate import GRAVITY, simulated
from tests.bench.report.made_up_noise import made_up_noise


def test_the_flag_that_keeps_half_of_the_dwells_out_is_stated(dwells):
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
    ("finding", "p_values", "titles"),
    [
        ("latitude", (0.3, 0.3), []),
        ("latitude_off", (1e-9, 0.3), ["Wrong latitude."]),
        ("not_latitude", (0.3, 0.3), ["Rate Up."]),
        ("not_contradicted", (1e-9, 1e-5), ["Dwells contradict one another."]),
    ],
)
def test_what_the_joint_solution_finds_wrong_with_the_bench_is_stated(finding, p_values, titles):
    numbers = [0.0] * 6 + [0.0, 0.001, 0.006, 0.001, 10.0, 0.1, 0.5]
    row = JointPlateauRow(1, 1, 6, 25.0, *numbers, finding, *p_values)
    assert list(joint_solution_sentences([row])) == titles
    alone = joint_solution_sentences([replace(row, dwells=1)])
    assert list(alone) == [title for title in titles if not title.startswith("Dwells")]
    assert joint_solution_sentences([]) == {}


def test_a_contradiction_of_dwells_is_corrected_for_the_number_of_plateaus():
    numbers = [0.0] * 6 + [0.0, 0.001, 0.006, 0.001, 10.0, 0.1, 0.5]
    agreeing = JointPlateauRow(1, 1, 6, 25.0, *numbers, "latitude", 0.3, 0.3)
    contradictory = replace(agreeing, fit_p_value=1e-4, any_north_p_value=1e-4)
    (text,) = joint_solution_sentences([*[agreeing] * 4, contradictory]).values()
    assert "At 1 plateau they disagree" in text
    assert "(p = 5e-4, corrected for 5 plateaus)" in text
    assert joint_solution_sentences([*[agreeing] * 11, contradictory]) == {}
    untested = replace(agreeing, dwells=0, fit_p_value=math.nan, any_north_p_value=math.nan)
    assert joint_solution_sentences([*[untested] * 11, contradictory])


def test_gyro_errors_larger_than_declared_are_stated_with_their_size():
    row = JointPlateauRow(1, 1, 6, 25.0, *[math.nan] * 13, "latitude", 0.3, 0.3, 1.0)
    larger = replace(row, gyro_error_factor=6.53)
    (text,) = joint_solution_sentences([row, larger, row]).values()
    assert "about 6.5 times" in text
    (text,) = joint_solution_sentences([row, replace(row, scale_factor_ratio=40.2)]).values()
    assert "scale factors of the gyros are about 40 times the declared ones" in text


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
    declared_arw, declared_vrw, texts
):
    declared = {
        "angle_random_walk_deg_per_sqrt_h": declared_arw,
        "velocity_random_walk_ug_per_sqrt_hz": declared_vrw,
    }
    text = noise_sentence(made_up_noise(), {"ins": {"noise": declared}})
    assert all(each in text for each in texts)
    assert bool(text) == bool(texts)
    found = run_findings([], {"ins": {"noise": declared}}, made_up_noise(), [])
    assert found.get("Declared noise.", "") == text


def test_noise_that_is_estimated_or_not_measured_contradicts_no_declaration():
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
    dwells, ug_per_k, declared, count
):
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
def test_what_no_dwell_tested_of_the_signal_map_is_stated(are_tested, latitude_deg, stated):
    station = {"location": {"latitude_deg": latitude_deg}}
    text = signs_sentence(RunFacts(are_signs_tested=are_tested), station, "mine.yaml")
    assert text.startswith(stated)
    assert bool(text) == bool(stated)


def test_an_ins_that_identified_otherwise_in_some_dwells_is_stated() -> None:
    def facts(*events: str) -> RunFacts:
        entries = (
            {"event": "dwell_finished"} if each == "dwell" else {"event": "ins_identified", "identity": each}
            for each in events
        )
        return facts_of(entries)

    assert identities_sentence(facts("firmware 1", "dwell", "firmware 1", "dwell")) == ""
    assert identities_sentence(facts("firmware 1", "firmware 2", "dwell")) == ""
    text = identities_sentence(facts("firmware 1", "dwell", "dwell", "firmware 2", "dwell"))
    assert text.startswith(
        "The INS identified as firmware 1 in 2 dwells and as firmware 2 in 1 dwell. Another firmware may"
    )
    assert "firmware 2 in 2 dwells" in identities_sentence(
        facts("firmware 2", "dwell", "firmware 1", "dwell", "firmware 2", "dwell")
    )
