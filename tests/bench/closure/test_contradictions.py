"""Columns with a wrong unit or sign, which a search would explain, are refused with a repair."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.bias.dwell_table import write_dwells
from gyrobench.bench.closure.plausibility import implausible
from tests.bench.closure.thermal_bench import measure
from tests.bench.command_line import refusal_of


@pytest.fixture(scope="module")
def rows():
    return measure(cycles=2, power_on_each_cycle=True).rows


def scaled(factor, *names):
    def change(row):
        values = {name: getattr(row, name) for name in names}
        return {
            name: tuple(factor * each for each in value) if isinstance(value, tuple) else factor * value
            for name, value in values.items()
        }

    return change


RATES = ("gyro_rate_c_per_h",)
TIMES = ("start_s", "end_s")
SINCE = ("since_power_on_s",)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (scaled(-1.0, *RATES), "change the sign of gyro_{x,y,z}_rate_c_per_h"),
        (scaled(1.0 / 60.0, *RATES), "degC/min: multiply gyro_{x,y,z}_rate_c_per_h by 60"),
        (scaled(-1.0 / 3600.0, *RATES), "wrong sign: multiply gyro_{x,y,z}_rate_c_per_h by -3600"),
        (scaled(0.0, *RATES), "changes at a rate of 0: correct gyro_{x,y,z}_rate_c_per_h"),
        (lambda row: {"gyro_rate_c_per_h": (5.0, 5.0, 5.0)}, "correct the unit of gyro_"),
        (
            lambda row: {"gyro_rate_c_per_h": (*row.gyro_rate_c_per_h[:2], -row.gyro_rate_c_per_h[2])},
            "change the sign of gyro_z_rate_c_per_h",
        ),
        (lambda row: {"gyro_c": tuple(1.8 * each + 32.0 for each in row.gyro_c)}, "_c seems to be in degF"),
        (scaled(1.0 / 60.0, *SINCE), "seems to be min: multiply since_power_on_s by 60"),
        (scaled(0.0, *SINCE), "grows by 0 s in each second of start_s: correct since_power_on_s"),
        (lambda row: {"since_power_on_s": 5000.0}, "correct since_power_on_s"),
        (scaled(1.0 / 3600.0, *TIMES), "seems to be h: multiply start_s and end_s by 3600"),
        (scaled(1000.0, *TIMES), "seems to be ms: multiply start_s and end_s by 0.001"),
        (
            scaled(1.0 / 3600.0, *TIMES, *SINCE),
            "seems to be h: multiply start_s, end_s and since_power_on_s by 3600",
        ),
        (
            scaled(1000.0, *TIMES, *SINCE),
            "seems to be ms: multiply start_s, end_s and since_power_on_s by 0.001",
        ),
        (lambda row: {"gyro_c": (25.0, *row.gyro_c[1:])}, "gyro_x_c is 25 degC in all dwells"),
    ],
)
def test_a_wrong_unit_or_sign_is_named_with_what_repairs_it(rows, change, message):
    problems = implausible([replace(row, **change(row)) for row in rows])
    assert any(message in problem for problem in problems), problems


def in_degf(row):
    return {
        "gyro_c": tuple(1.8 * each + 32.0 for each in row.gyro_c),
        "gyro_rate_c_per_h": tuple(1.8 * each for each in row.gyro_rate_c_per_h),
    }


@pytest.mark.parametrize("known", ["chamber_set_c", "chamber_c"])
def test_temperatures_and_rates_in_degf_are_named_by_those_of_the_chamber(rows, known):
    others = dict.fromkeys({"chamber_set_c", "chamber_c"} - {known}, math.nan)
    changed = [replace(row, **in_degf(row), **others) for row in rows]
    (problem,) = implausible(changed)
    assert "gyro_{x,y,z}_c seems to be in degF: correct its values" in problem
    # A short profile does not show it: self-heating may change by as much.
    short = [row for row in changed if abs(getattr(row, known) - 20.0) < 15.0]
    assert not any("degF" in problem for problem in implausible(short))


def test_a_unit_that_heats_itself_after_a_cold_start_is_not_taken_for_one_in_degf(rows):
    """By 32 K, in a profile of 40 K that begins with a power-on at its coldest temperature."""
    places = [(-40.0, -38.0, 600.0), (0.0, 32.0, 20_000.0)] * 2
    dwells = [
        replace(
            row,
            run=f"R{number}",
            chamber_set_c=set_c,
            chamber_c=set_c,
            gyro_c=(gyro_c + 0.1 * number,) * 3,
            since_power_on_s=since_s,
        )
        for number, (row, (set_c, gyro_c, since_s)) in enumerate(zip(rows, places, strict=False))
    ]
    assert implausible(dwells) == []


def test_temperatures_of_one_gyro_in_degf_are_named(rows):
    one = [
        replace(row, **{name: (*getattr(row, name)[:2], value[2]) for name, value in in_degf(row).items()})
        for row in rows
    ]
    (problem,) = implausible(one)
    assert "gyro_z_c seems to be in degF" in problem


def test_close_refuses_contradictory_columns_and_searches_nothing(rows, tmp_path):
    negated = [replace(row, **scaled(-1.0, *RATES)(row)) for row in rows]
    write_dwells(tmp_path / "dwells.csv", negated)
    problem = refusal_of("close", "dwells.csv", cwd=tmp_path)
    assert "change the sign of gyro_{x,y,z}_rate_c_per_h" in " ".join(problem.split())
    assert not (tmp_path / "closure").exists()


@pytest.mark.parametrize(("change", "message"), [(RATES, "of run R2"), (SINCE, "of run R2 grows")])
def test_a_wrong_unit_in_one_run_is_found(rows, change, message):
    changed = [replace(row, **scaled(1.0 / 60.0, *change)(row)) if row.run == "R2" else row for row in rows]
    (problem,) = implausible(changed)
    assert message in problem
    assert "by 60" in problem


def test_dwells_on_another_clock_are_named(rows):
    later = [replace(row, start_s=row.start_s + 1.7e9, end_s=row.end_s + 1.7e9) for row in rows[60:]]
    (problem,) = implausible([*rows[:60], *later])
    assert re.search(rf"for dwell {later[0].dwell} of the same run R2: use one clock", problem)


@pytest.mark.parametrize(
    "changed",
    [
        {"cycles": 2, "dwell_s": 1200.0, "pause_s": 600.0},
        {"cycles": 2, "profile": ((60.0, 1.0, 9.0), (-20.0, 1.0, 9.0), (20.0, 1.0, 3.0))},
        {"cycles": 2, "power_steps_h": 7.3},
    ],
)
def test_correct_tables_of_other_campaigns_have_no_problem(changed):
    assert implausible(measure(**changed).rows) == []


def test_few_or_noisy_rows_are_not_refused(rows):
    assert implausible(rows[:1]) == implausible(rows[:3]) == implausible(rows[::7]) == []
    noisy = [
        replace(
            row, gyro_rate_c_per_h=tuple(each + 3.0 * (-1.0) ** row.dwell for each in row.gyro_rate_c_per_h)
        )
        for row in rows
    ]
    assert implausible(noisy) == []


def test_a_restart_within_a_dwell_and_missing_dwells_are_no_contradiction(rows):
    """A unit that restarts in a dwell may keep the name of its run, as may the dwells after a missing one."""
    restarted_s = rows[30].start_s + 600.0

    def after_restart(row):
        return replace(row, since_power_on_s=row.start_s - restarted_s) if row.start_s > restarted_s else row

    kept = [after_restart(row) for row in rows if row.run == "R1"]
    assert implausible(kept) == []
    assert implausible([row for row in kept if row.dwell != rows[30].dwell]) == []


SET_POINTS_C = (60.0, 20.0, -30.0, 0.0, 45.0) * 2


def soaked(biases, lags_h=((1.0, 0.4),), soak_h=1.0, noise_c=0.0, resolution_c=0.0):
    """Six dwells of 20 min at each set point after a soak: the rest of each ramp decays with these lags.

    ``biases``: rows with the other values. ``lags_h``: pairs of the share of the ramp and its time constant.
    """
    draw, rows, before_c = np.random.default_rng(4), [], 20.0
    for plateau, set_c in enumerate(SET_POINTS_C):
        for number in range(6):
            start_h = soak_h + 0.43 * number
            ends_h = np.array([start_h, start_h + 1.0 / 3.0])
            off_c = sum((before_c - set_c) * share * np.exp(-ends_h / lag) for share, lag in lags_h)
            sums = sum((before_c - set_c) * share * lag * np.exp(-ends_h / lag) for share, lag in lags_h)
            mean_c = set_c + 12.0 - 3.0 * np.diff(sums)[0] + noise_c * draw.normal(size=3)
            rate_c_per_h = 3.0 * np.diff(off_c)[0] + 3.0 * noise_c * draw.normal(size=3)
            if resolution_c:
                mean_c = np.round(mean_c / resolution_c) * resolution_c
            first_s = 3600.0 * (5.0 * plateau + start_h)
            rows.append(
                replace(
                    biases[len(rows)],
                    dwell=len(rows) + 1,
                    cycle=1 + plateau // 5,
                    run="R1",
                    start_s=first_s,
                    end_s=first_s + 1200.0,
                    since_power_on_s=first_s,
                    chamber_set_c=set_c,
                    gyro_c=tuple(mean_c.tolist()),
                    gyro_rate_c_per_h=tuple(rate_c_per_h.tolist()),
                )
            )
        before_c = set_c
    return rows


@pytest.mark.parametrize("soak_h", [0.5, 1.0, 1.5])
@pytest.mark.parametrize(
    ("factor", "message"),
    [
        (1.0 / 60.0, "degC/min: multiply gyro_{x,y,z}_rate_c_per_h by 60"),
        (1.0 / 3600.0, "degC/s: multiply gyro_{x,y,z}_rate_c_per_h by 3600"),
        (-1.0, "change the sign of gyro_{x,y,z}_rate_c_per_h"),
    ],
)
def test_a_wrong_unit_of_the_rates_is_found_in_dwells_after_soaks(rows, factor, message, soak_h):
    table = soaked(rows, soak_h=soak_h, noise_c=0.01)
    (problem,) = implausible([replace(row, **scaled(factor, *RATES)(row)) for row in table])
    assert message in problem


@pytest.mark.parametrize("soak_h", [0.5, 1.0, 2.0, 4.0])
@pytest.mark.parametrize(
    "changed",
    [
        {},
        {"lags_h": ((0.7, 0.2), (0.3, 1.5))},
        {"lags_h": ((1.5, 0.5), (-0.5, 0.2))},
        {"noise_c": 0.02},
        {"noise_c": 0.2},
        {"resolution_c": 0.1},
        {"resolution_c": 1.0},
    ],
    ids=["one lag", "two lags", "a delay", "noise", "much noise", "0.1 degC", "whole degC"],
)
def test_correct_rates_of_dwells_after_soaks_have_no_problem(rows, soak_h, changed):
    assert implausible(soaked(rows, soak_h=soak_h, **changed)) == []
