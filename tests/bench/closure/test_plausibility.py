"""Tables that no bench measures are refused before the search, each problem once and with its column."""

import re
from dataclasses import replace

import pytest

from gyrobench.bench.bias.dwell_table import write_dwells
from gyrobench.bench.closure.plausibility import implausible
from gyrobench.bench.closure.quantity import quantity
from tests.bench.closure.thermal_bench import measure
from tests.bench.command_line import refusal_of


@pytest.fixture(scope="module")
def rows():
    return measure(cycles=2).rows


def kelvin(values):
    return tuple(value + 273.15 for value in values)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (lambda row: {"start_s": 0.0, "end_s": 1200.0}, "dwells start at 0 s"),
        (lambda row: {"end_s": row.end_s + 86_400.0}, "before dwell 1 ends"),
        (
            lambda row: {"sigma_dph": tuple(2e5 * sigma for sigma in row.sigma_dph)},
            "all biases of that gyro lie within",
        ),
        (lambda row: {"gyro_c": (1000.0, *row.gyro_c[1:])}, "gyro_x_c is 1000 degC"),
        (lambda row: {"gyro_c": kelvin(row.gyro_c)}, "gyro_z_c .* in kelvin"),
    ],
)
def test_close_names_what_can_not_be_and_searches_nothing(rows, tmp_path, changes, message):
    write_dwells(tmp_path / "dwells.csv", [replace(row, **changes(row)) for row in rows])
    problem = refusal_of("close", "dwells.csv", cwd=tmp_path)
    assert re.search(message, problem)
    assert "implausible" in problem
    assert not (tmp_path / "closure").exists()


def test_one_wrong_temperature_is_named_and_a_sound_table_has_no_problems(rows):
    assert implausible(rows) == []
    (problem,) = implausible([replace(rows[0], gyro_c=(25.0, 999.0, 25.0)), *rows[1:]])
    assert problem.startswith(f"gyro_y_c is 999 degC in dwell {rows[0].dwell}, outside ")
    (problem,) = implausible([replace(row, gyro_c=(25.0, 999.0, 25.0)) for row in rows[:3]] + rows[3:])
    assert problem.startswith(f"gyro_y_c is 999 degC in dwell {rows[0].dwell} and 2 others, outside ")


def test_a_bias_that_lost_its_decimal_point_is_named(rows):
    wrong = [replace(rows[7], bias_dph=(rows[7].bias_dph[0], -317935458.0, rows[7].bias_dph[2]))]
    (problem,) = implausible([*rows[:7], *wrong, *rows[8:]])
    assert problem == (
        f"bias_y_dph is 3.18e+08 deg/h in size in dwell {rows[7].dwell}, more than the 1e+06 deg/h of "
        "any gyro: correct the value or its unit"
    )


@pytest.mark.parametrize("factor", [1e3, 1e-3])
@pytest.mark.parametrize("columns", [("bias_dph", "sigma_dph"), ("bias_dph",)])
@pytest.mark.parametrize("step", [2, 7])
def test_rows_in_a_unit_a_thousand_times_smaller_or_larger_are_named(rows, factor, columns, step):
    scaled = [
        replace(row, **{name: tuple(factor * each for each in getattr(row, name)) for name in columns})
        if index % step
        else row
        for index, row in enumerate(rows)
    ]
    problems = implausible(scaled)
    words = {"bias_dph": "bias values", "sigma_dph": "uncertainties"}
    (problem,) = [each for each in problems if "about 1000 times" in each]
    assert problem.startswith(f"{' and '.join(words[name] for name in columns)} of ")
    assert problem.endswith("some seem to be in mdeg/h; give all in deg/h")


def test_a_gyro_that_fails_is_no_wrong_unit(rows):
    failed = [replace(row, bias_dph=(1000.0 * row.bias_dph[0], *row.bias_dph[1:])) for row in rows[30:]]
    assert implausible([*rows[:30], *failed]) == []


@pytest.mark.parametrize(
    ("searched", "column"),
    [("gyro_bias", "sigma_y_dph"), ("gyro_scale_factor", "the uncertainty of gyro_scale_factor_y")],
)
@pytest.mark.parametrize("sigma", [0.0, -0.002])
def test_uncertainties_that_are_not_above_zero_are_named(rows, searched, column, sigma):
    wrong = [replace(row, sigma_dph=(0.002, sigma, 0.002)) for row in rows[:2]]
    (problem,) = implausible([*wrong, *rows[2:]], quantity(searched))
    unit = quantity(searched).unit
    assert problem.startswith(
        f"{column} is {sigma:g} {unit} in dwell {rows[0].dwell} and 1 other; it must be "
    )


def test_sigmas_too_cautious_by_a_factor_of_five_are_no_problem(rows):
    assert implausible([replace(row, sigma_dph=tuple(5.0 * s for s in row.sigma_dph)) for row in rows]) == []


def scaled(rows, factor, *columns):
    return [
        replace(row, **{name: tuple(factor * value for value in getattr(row, name)) for name in columns})
        for row in rows
    ]


@pytest.mark.parametrize(
    ("unit", "per_dph", "to_dph"), [("deg/s", 1 / 3600, "3600"), ("rad/s", 4.8481368e-6, "206265")]
)
def test_biases_and_sigmas_in_another_unit_are_named_with_the_unit(rows, unit, per_dph, to_dph):
    advice = f"the unit seems to be {unit}: multiply"
    (problem,) = implausible(scaled(rows, per_dph, "bias_dph", "sigma_dph"))
    assert problem.endswith(f"{advice} bias_{{x,y,z}}_dph and sigma_{{x,y,z}}_dph by {to_dph}")
    (problem,) = implausible(scaled(rows, per_dph, "sigma_dph"))
    assert problem.endswith(f"{advice} sigma_{{x,y,z}}_dph by {to_dph}")


def test_sigmas_of_a_very_good_and_of_a_poor_gyro_are_no_problem(rows):
    for factor in (0.03, 1e4):
        assert implausible(scaled(rows, factor, "bias_dph", "sigma_dph")) == []


def test_sigmas_of_one_gyro_that_no_gyro_reaches_are_named(rows):
    (problem,) = implausible(
        [replace(row, sigma_dph=(*row.sigma_dph[:2], 1e-12 * row.sigma_dph[2])) for row in rows]
    )
    assert problem.startswith("sigma_z_dph in dwells of this length mean an angle random walk of ")
    assert problem.endswith("correct sigma_z_dph or their unit")


def test_a_cycle_that_was_pasted_twice_is_no_second_measurement(rows):
    first = [row for row in rows if row.cycle == 1]
    later_s = max(row.end_s for row in first) + 7200.0
    copies = [
        replace(
            row,
            cycle=2,
            run=f"{row.run} again",
            dwell=row.dwell + 1000,
            start_s=row.start_s + later_s,
            end_s=row.end_s + later_s,
        )
        for row in first
    ]
    [problem] = implausible([*first, *copies])
    assert problem.startswith(f"dwell {copies[0].dwell} has biases and gyro temperatures of dwell 1 ")
    assert f"and {len(copies) - 1} others have those of another one" in problem
    one = [replace(row, gyro_c=tuple(each + 0.1 for each in row.gyro_c)) for row in copies]
    assert implausible([*first, *one[:-1], replace(copies[-1], start_s=one[-1].start_s)]) == []
