import csv
import math
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.calibration.coefficients import COEFFICIENTS, COUNT
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.runs.tables.coefficient_table import PlateauCoefficientRow
from gyrobench.bench.verification.coefficient_verification import (
    CoefficientRun,
    compare_coefficients,
    corrections,
    write_coefficient_tables,
)
from tests.bench.verification.missions_once import missions_once
from tests.bench.verification.runs_alone import coefficient_result

SITE = Site(np.radians(45.0))
TEMPERATURES_C = (-20.0, 0.0, 20.0, 40.0, 60.0)
SIGMA = 0.1
NAMES = [f"{each.name}_{each.axis}" for each in COEFFICIENTS]


@pytest.fixture(scope="module", autouse=True)
def shared_missions():
    with missions_once():
        yield


def rows_of(polynomials, seed=0, unobserved=()):
    """Coefficients of plateaus: noise, and polynomials in temperature by name."""
    random = np.random.default_rng(seed)
    rows = []
    for plateau, at_c in enumerate(TEMPERATURES_C, 1):
        for each in COEFFICIENTS:
            name = f"{each.name}_{each.axis}"
            value = np.polynomial.polynomial.polyval(at_c, polynomials.get(name, [0.0]))
            value += SIGMA * random.standard_normal()
            sigma = np.nan if name in unobserved else SIGMA
            # The temperature of an accelerometer is that of the case.
            here_c = at_c if each.sensor == "gyro" else at_c - 7.0
            rows.append(
                PlateauCoefficientRow(
                    plateau, 1, at_c - 10.0, here_c, each.name, each.axis,
                    np.nan if name in unobserved else value, sigma, each.unit, "", np.nan, 0.0,
                )
            )  # fmt: skip
    return rows


def test_polynomials_have_the_degree_that_the_data_need():
    known = {
        "gyro_scale_factor_x": [12.0, 0.08, -2e-3],
        "accelerometer_bias_z": [40.0, 0.5],
        "gyro_misalignment_yz": [-9.0],
    }
    found = corrections(rows_of(known, unobserved={"accelerometer_misalignment_zx"}))
    for name, polynomial in known.items():
        assert len(found[name].polynomial) == len(polynomial)
        at_c = np.linspace(-20.0, 60.0, 9)
        fitted, true = (
            np.polynomial.polynomial.polyval(at_c, each) for each in (found[name].polynomial, polynomial)
        )
        assert np.abs(fitted - true).max() < 5.0 * SIGMA
    assert "accelerometer_misalignment_zx" not in found
    assert not any(name.startswith("gyro_bias") for name in found)


def test_a_coefficient_is_used_within_the_temperatures_at_which_it_was_measured():
    true = [5.0, 0.01, 4e-4]
    rows = rows_of({"accelerometer_scale_factor_x": true})
    known_c = [at_c for at_c in TEMPERATURES_C if at_c > 20.0]
    rows = [
        replace(row, value=np.nan, sigma=np.nan)
        if row.coefficient == "accelerometer_scale_factor" and TEMPERATURES_C[row.plateau - 1] <= 20.0
        else row
        for row in rows
    ]
    found = corrections(rows)
    assert found["accelerometer_scale_factor_x"].range_c == (min(known_c), max(known_c))
    assert found["gyro_scale_factor_x"].range_c == (min(TEMPERATURES_C), max(TEMPERATURES_C))


@pytest.fixture(scope="module")
def results():
    """Without compensation, and with one that leaves noise."""
    large = {f"{each.name}_{each.axis}": [20.0] for each in COEFFICIENTS if each.name != "gyro_bias"}
    tables = {"none": rows_of(large), "declared": rows_of({}, seed=1, unobserved={"gyro_scale_factor_z"})}
    return [coefficient_result(name, rows, {}, SITE) for name, rows in tables.items()]


def test_what_is_left_is_compared_with_the_noise(results):
    before, after = results
    assert before.ratio > 100.0
    assert 0.7 < after.ratio < 1.4
    np.testing.assert_allclose(before.noise, SIGMA)
    z = NAMES.index("gyro_scale_factor_z")
    assert np.isnan(after.rms[z])
    assert after.plateaus[z] == 0
    assert before.plateaus[z] == len(TEMPERATURES_C)
    assert after.worst.error.stated_nmi[-1] < 0.5 * before.worst.error.stated_nmi[-1]


def test_plateaus_of_a_dwell_alone_do_not_count_beside_those_with_rotations():
    dwell_alone = [replace(row, plateau=99, value=1e3, gyro_rate_c_per_h=np.nan) for row in rows_of({})]
    found = coefficient_result("declared", rows_of({}) + dwell_alone, {}, SITE)
    assert np.array_equal(found.rms, coefficient_result("declared", rows_of({}), {}, SITE).rms)
    assert {each.plateau for each in found.missions} == set(range(1, len(TEMPERATURES_C) + 1))
    assert coefficient_result("declared", dwell_alone, {}, SITE).rms.max() == pytest.approx(1e3)


def test_coefficients_are_compared_at_the_plateaus_that_all_runs_have():
    """One run has large values at a plateau that the other lacks, and its plateaus are numbered on."""
    hot = [replace(row, value=1e3) if row.plateau == 5 else row for row in rows_of({})]
    some = [replace(row, plateau=row.plateau - 1) for row in rows_of({}) if row.plateau != 1]
    some = [row for row in some if row.plateau != 4]
    runs = [CoefficientRun(name, rows, {}) for name, rows in (("none", hot), ("declared", some))]
    none, declared = compare_coefficients(runs, SITE)
    np.testing.assert_allclose(none.rms, declared.rms)
    assert none.plateaus.tolist() == declared.plateaus.tolist() == [3] * COUNT
    assert [each.plateau for each in declared.missions] == [2, 3, 4]
    assert [each.is_in_all for each in none.missions] == [False, True, True, True, False]
    assert none.worst.gyro_c == declared.worst.gyro_c
    elsewhere = [replace(row, cycle=2) for row in rows_of({})]
    assert compare_coefficients([runs[0], CoefficientRun("declared", elsewhere, {})], SITE) == ()


def test_correlations_change_the_distribution_of_missions():
    rows = rows_of({})
    alone = coefficient_result("none", rows, {}, SITE).missions[0].error
    together = coefficient_result("none", rows, {1: np.ones((COUNT, COUNT))}, SITE).missions[0].error
    assert np.array_equal(alone.stated_nmi, together.stated_nmi)
    assert not np.allclose(alone.high_nmi, together.high_nmi, rtol=0.01)


def test_the_tables_have_a_row_for_each_coefficient_and_time(results, tmp_path):
    write_coefficient_tables(tmp_path, results)
    rows = list(csv.DictReader((tmp_path / "coefficient_comparison.csv").read_text().splitlines()))
    assert len(rows) == 2 * COUNT
    assert rows[3]["coefficient"] == "gyro_scale_factor_x"
    assert float(rows[3]["rms"]) == pytest.approx(results[0].rms[3], rel=1e-6)
    missions = list(csv.DictReader((tmp_path / "mission.csv").read_text().splitlines()))
    assert len(missions) == 2 * len(TEMPERATURES_C) * 3
    assert [row["hours"] for row in missions[:3]] == ["1", "8", "24"]
    assert float(missions[2]["position_95_nmi"]) >= float(missions[2]["position_median_nmi"])


def one_plateau(ratio, correlations, **run):
    """What is left of each coefficient at one plateau, in times its noise."""
    rows = [replace(row, value=ratio * SIGMA) for row in rows_of({}) if row.plateau == 1]
    return compare_coefficients([CoefficientRun("declared", rows, correlations, **run)], SITE)[0]


def test_coefficients_that_share_their_errors_are_not_better_by_as_little_as_independent_ones():
    together = {1: np.full((COUNT, COUNT), 0.9) + 0.1 * np.eye(COUNT)}
    assert one_plateau(7.0, {}).is_better_than(one_plateau(10.0, {}))
    assert not one_plateau(7.0, together).is_better_than(one_plateau(10.0, together))
    assert one_plateau(1.0, together).is_better_than(one_plateau(10.0, together))


def test_the_noise_of_what_was_loaded_is_noise_of_coefficients_too():
    loaded = corrections([row for row in rows_of({}) if row.plateau == 1])
    assert one_plateau(1.6, {}).noise_p_value < 1e-3 < one_plateau(1.6, {}, loaded=loaded).noise_p_value
    assert one_plateau(3.0, {}, loaded=loaded).noise_p_value < 1e-6


def test_an_error_that_all_plateaus_share_hides_no_remainder_and_is_no_improvement():
    """The error of gravity in the scale factors of the accelerometers cancels where it was loaded."""
    gravity, scale = 300.0 * SIGMA, "accelerometer_scale_factor"
    loaded = {name: each for name, each in corrections(rows_of({})).items() if name.startswith(scale)}
    together = [name.startswith(scale) for name in NAMES]
    correlations = np.where(np.outer(together, together), 1.0, np.eye(COUNT))
    # That of the latitude, in a coefficient that hardly correlates with these, is another one.
    by_latitude = NAMES.index("gyro_misalignment_xz")
    correlations[by_latitude] = correlations[:, by_latitude] = np.where(together, 1e-3, 0.0)

    def result(compensation, value, **run):
        rows = [
            replace(row, value=value, sigma=math.hypot(gravity, SIGMA)) if row.coefficient == scale else row
            for row in rows_of({})
        ]
        by_plateau = dict.fromkeys({row.plateau for row in rows}, correlations)
        common = {(row.plateau, row.name): (gravity, 0.0) for row in rows if row.coefficient == scale}
        common |= {(row.plateau, NAMES[by_latitude]): (0.0, 0.5 * SIGMA) for row in rows}
        return CoefficientRun(compensation, rows, by_plateau, common=common, **run)

    runs = [result("none", 2.5 * gravity), result("declared", 5.0 * SIGMA, loaded=loaded)]
    none, declared = compare_coefficients(runs, SITE)
    assert declared.noise_p_value < 1e-6
    assert not declared.is_better_than(none)
    large, _ = compare_coefficients([result("none", 30.0 * gravity), runs[1]], SITE)
    assert declared.is_better_than(large)
