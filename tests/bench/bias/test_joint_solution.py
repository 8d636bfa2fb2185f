import dataclasses
import math

import numpy as np
import pytest
from scipy.stats import chi2

from gyrobench.bench.bias.bias_filter import estimate_state_space
from gyrobench.bench.bias.joint_solution import SHARED_ACCELEROMETER_MATRIX, JointDwell, pooled_up_rate
from gyrobench.bench.bias.parameters import ErrorModel, PriorKnowledge
from gyrobench.bench.bias.plateaus import group_plateaus
from gyrobench.bench.bias.statistics import uniformity_p_value
from gyrobench.bench.bias.vertical_pairs import Finding
from gyrobench.bench.foundations.arrays import RADPS_TO_DPH
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.earth import EARTH_RATE
from tests.bench.bias.emulated_dwells import DPH, LATITUDE_DEG, UG, emulate, sensors, site
from tests.bench.bias.emulated_groups import (
    ALL,
    ARCMIN,
    ARCSEC,
    NOISE,
    Unit,
    any_unit,
    follow_gravity,
    is_vertical,
    joint_solution_of,
    measure,
)

SURVEYED = PriorKnowledge.from_datasheet(latitude_arcmin=0.02)
# As the units of emulated_groups are: their mounts do not tilt and their accelerometers do not drift.
PRIOR = dataclasses.replace(SURVEYED, tilt_step=0.0, accelerometer_drift=0.0)
ANY_LATITUDE = dataclasses.replace(PRIOR, latitude=1.0 * ARCMIN)
GROUPS = 8
VERTICAL = is_vertical()


@pytest.fixture(scope="module")
def wrong_latitude():
    """Units measured at a latitude that is wrong by an arcmin: each with all six positions."""
    random = np.random.default_rng(20)
    units = [any_unit(random, latitude_error_arcmin=1.0) for _ in range(GROUPS)]
    return [(unit, measure(unit, random, first=1 + 6 * n)) for n, unit in enumerate(units)]


@pytest.fixture(scope="module")
def solutions(wrong_latitude):
    """Solutions of those with a latitude that is taken for right."""
    return [joint_solution_of(dwells, PRIOR) for _, dwells in wrong_latitude]


@pytest.fixture(scope="module")
def right_latitude():
    random = np.random.default_rng(21)
    unit = any_unit(random)
    return unit, measure(unit, random)


def errors(biases, unit, positions=ALL):
    return biases.bias_radps - unit.true_bias_dph(positions) * DPH


def rms_dph(values):
    return np.sqrt(np.mean(np.square(values))) * RADPS_TO_DPH


def assert_explained(squares, dof):
    assert chi2.cdf(squares, dof) == pytest.approx(0.5, abs=0.499)


def squares(biases, unit):
    """Errors squared in units of their covariance; a correction by the dwells' own rate leaves 17 of 18."""
    error = errors(biases, unit).ravel()
    return error @ np.linalg.pinv(biases.covariance, rcond=1e-6, hermitian=True) @ error


def test_dwell_by_itself_is_its_own_estimate():
    random = np.random.default_rng(5)
    dwell = emulate(
        "y_down", sensors((0.02, -0.01, 0.03), (90.0, 50.0, -70.0), NOISE), noise=NOISE, random=random,
        outer_level=True, gyro_c=lambda time_s: 20.0 + np.outer(time_s, [1e-3, 2e-3, -1e-3]),
    )  # fmt: skip
    prior = SURVEYED
    estimate = estimate_state_space(dwell, ErrorModel(site(), NOISE, prior))
    single = joint_solution_of([JointDwell(1, "y_down", estimate.information)], prior).single
    np.testing.assert_allclose(
        single.bias_radps[0] * RADPS_TO_DPH, estimate.bias_dph, atol=1e-3 * estimate.sigma_dph.min()
    )
    np.testing.assert_allclose(single.sigma_radps[0] * RADPS_TO_DPH, estimate.sigma_dph, rtol=1e-3)


def test_without_noise_only_what_is_not_modelled_is_left():
    unit = Unit(
        any_unit(np.random.default_rng(27)).bias_dph, accelerometer_matrix=5.0 * ARCSEC * np.ones((3, 3))
    )
    solution = joint_solution_of(measure(unit, None), PRIOR)
    assert np.abs(errors(solution.together, unit)).max() * RADPS_TO_DPH < 1e-4


def test_errors_of_the_joint_biases_are_those_of_their_covariance(wrong_latitude):
    total = sum(
        squares(joint_solution_of(dwells, ANY_LATITUDE).together, unit) for unit, dwells in wrong_latitude
    )
    assert_explained(total, 18 * GROUPS)


def test_accelerometer_biases_and_misalignments_are_found_with_their_uncertainty(wrong_latitude):
    total, dof = 0.0, 0
    for unit, dwells in wrong_latitude:
        solution = joint_solution_of(dwells, ANY_LATITUDE)
        bias, sigma = solution.accelerometer_bias
        total += (((bias - unit.accelerometer_ug * UG) / sigma) ** 2).sum()
        matrix, sigma = (
            each[SHARED_ACCELEROMETER_MATRIX].reshape(3, 3)
            for each in (solution.fit.values, solution.fit.sigmas)
        )
        beside = ~np.eye(3, dtype=bool)
        total += (((matrix - unit.accelerometer_matrix)[beside] / sigma[beside]) ** 2).sum()
        dof += 9
        assert np.diagonal(matrix).tolist() == [0.0, 0.0, 0.0]
    # Correlated, so the sum scatters more than that of as many independent squares.
    assert total / dof == pytest.approx(1.0, abs=0.4)


@pytest.fixture
def dwells(right_latitude):
    return right_latitude[1]


def test_gyro_errors_larger_than_declared_widen_the_uncertainties_as_data_show(right_latitude):
    unit, dwells = right_latitude
    assert joint_solution_of(dwells, PRIOR).gyro_error_factor == 1.0
    misaligned = dataclasses.replace(unit, gyro_matrix=10.0 * unit.gyro_matrix)
    solution = joint_solution_of(measure(misaligned, np.random.default_rng(22)), PRIOR)
    assert solution.gyro_error_factor == pytest.approx(10.0, rel=0.5)
    for biases in (solution.single, solution.together):
        assert np.abs(errors(biases, misaligned) / biases.sigma_radps).max() < 3.5


def test_gyro_errors_that_a_single_dwell_contradicts_widen_its_uncertainties():
    unit = any_unit(np.random.default_rng(2))
    misaligned = dataclasses.replace(unit, gyro_matrix=60.0 * unit.gyro_matrix)
    solution = joint_solution_of(measure(misaligned, np.random.default_rng(102), ("x_up",)), PRIOR)
    assert 60.0 < solution.gyro_error_factor < 150.0
    assert np.abs(errors(solution.single, misaligned, ("x_up",)) / solution.single.sigma_radps).max() < 3.0


@pytest.mark.parametrize("accelerometer_arcsec", [0.0, 20.0])
def test_gyro_errors_need_a_declared_size_to_exceed_it(right_latitude, accelerometer_arcsec):
    unit, _ = right_latitude
    matrix = accelerometer_arcsec * ARCSEC * np.array([[0.0, 1.0, -1.0], [1.0, 0.0, 1.0], [-1.0, 1.0, 0.0]])
    dwells = measure(dataclasses.replace(unit, accelerometer_matrix=matrix), np.random.default_rng(23))
    none = dataclasses.replace(PRIOR, gyro_misalignment=0.0, gyro_scale_factor=0.0)
    assert joint_solution_of(dwells, none).gyro_error_factor == 1.0


def gain_of(dwells, prior):
    """Uncertainty dwell by dwell over the joint one."""
    found = joint_solution_of(dwells, prior)
    return found.single.sigma_radps / found.together.sigma_radps


@pytest.mark.parametrize(
    "prior",
    [
        SURVEYED,
        ANY_LATITUDE,
        PriorKnowledge.from_datasheet(gyro_misalignment_arcsec=30.0, gyro_scale_factor_ppm=30.0),
        PriorKnowledge.from_datasheet(tilt_step_arcsec=20.0, accelerometer_misalignment_arcsec=0.0),
        PriorKnowledge.from_datasheet(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    ],
)
def test_joint_solution_is_nowhere_worse_than_dwell_by_dwell(dwells, prior):
    assert gain_of(dwells, prior).min() > 1.0 - 1e-6


def test_gain_is_small_where_noise_alone_limits(dwells):
    gain = gain_of(dwells, SURVEYED)
    assert gain.max() < 1.02


def test_gain_is_large_for_vertical_gyros_where_the_latitude_is_not_known(dwells):
    gain = gain_of(dwells, ANY_LATITUDE)
    assert gain[VERTICAL].min() > 1.4
    assert gain[~VERTICAL].max() < 1.02


def test_gain_is_large_for_level_gyros_where_their_axes_are_not_known(dwells):
    prior = PriorKnowledge.from_datasheet(
        latitude_arcmin=0.02,
        gyro_misalignment_arcsec=30.0,
        accelerometer_misalignment_arcsec=30.0,
        accelerometer_drift_ug_per_h=0.0,
    )
    gain = gain_of(dwells, prior)
    assert gain[~VERTICAL].max() > 1.8
    assert gain[VERTICAL].max() < 1.05


def test_bias_of_one_dwell_does_not_draw_those_of_the_others():
    random = np.random.default_rng(22)
    unit = any_unit(random)
    unit.bias_dph["y_up"][:] = 0.5, -0.5, 0.5
    solution = joint_solution_of(measure(unit, random), PRIOR)
    assert np.abs(errors(solution.together, unit) / solution.together.sigma_radps).max() < 4.0


def test_dwells_that_share_what_they_should_agree(dwells):
    assert joint_solution_of(dwells, PRIOR).fit.p_value > 0.01


def test_accelerometer_biases_that_changed_between_dwells_are_noticed():
    random = np.random.default_rng(23)
    before = any_unit(random)
    after = dataclasses.replace(before, accelerometer_ug=before.accelerometer_ug + 150.0)
    dwells = measure(before, random, ALL[:3]) + measure(after, random, ALL[3:], first=4)
    assert joint_solution_of(dwells, PRIOR).fit.p_value < 1e-4


@pytest.mark.long
def test_p_value_of_the_agreement_is_uniform_for_misalignments_beyond_the_declared_ones():
    random, prior = np.random.default_rng(24), dataclasses.replace(PRIOR, accelerometer_transient=0.0)
    p_values = []
    for _ in range(16):
        unit = any_unit(random)
        beside = np.where(np.eye(3, dtype=bool), 1.0, 8.0)
        unit = dataclasses.replace(
            unit, gyro_matrix=beside * unit.gyro_matrix, accelerometer_matrix=8.0 * unit.accelerometer_matrix
        )
        p_values.append(joint_solution_of(measure(unit, random), prior).fit.p_value)
    assert uniformity_p_value(p_values) > 0.01
    assert min(p_values) > 1e-3


def test_latitude_that_is_wrong_by_more_than_declared_is_noticed_and_distinguished_from_other_faults(
    solutions,
):
    assert np.median([each.fit.p_value for each in solutions]) < 0.01
    assert np.median([each.north_free_fit.p_value for each in solutions]) > 0.05


def test_latitude_error_is_found_from_up_and_down(solutions):
    rate = pooled_up_rate(solutions, PRIOR)
    expected = -EARTH_RATE * math.cos(math.radians(LATITUDE_DEG)) * ARCMIN
    assert rate.rate == pytest.approx(expected, abs=3.0 * rate.sigma)
    assert rate.latitude_error == pytest.approx(1.0 * ARCMIN, abs=3.0 * rate.latitude_sigma)
    assert rate.latitude_sigma < 0.05 * ARCMIN
    assert rate.finding is Finding.LATITUDE_OFF
    assert rate.applies


def test_correction_removes_the_latitude_error_from_vertical_gyros_alone(wrong_latitude, solutions):
    rate = pooled_up_rate(solutions, PRIOR)
    corrected = [each.corrected(rate) for each in solutions]
    before, after = (
        rms_dph(
            [errors(each, unit)[VERTICAL] for each, (unit, _) in zip(biases, wrong_latitude, strict=True)]
        )
        for biases in ([each.together for each in solutions], corrected)
    )
    assert before > 0.003
    assert after < 0.0013
    for solution, biases in zip(solutions, corrected, strict=True):
        np.testing.assert_array_equal(biases.bias_radps[~VERTICAL], solution.north_free.bias_radps[~VERTICAL])


def test_errors_of_corrected_biases_are_those_of_their_covariance(wrong_latitude, solutions):
    total = sum(
        squares(each.corrected(), unit) for each, (unit, _) in zip(solutions, wrong_latitude, strict=True)
    )
    assert_explained(total, 17 * GROUPS)


def test_pooled_correction_covers_what_other_temperatures_add(solutions):
    own, corrected = solutions[0], solutions[0].corrected(pooled_up_rate(solutions, PRIOR))
    half_sums = VERTICAL.ravel() / 6.0
    half_differences = half_sums * np.repeat([1.0, -1.0] * 3, 3)
    # What is left of the half-differences is their noise about a rate that seven others helped to find.
    left = math.sqrt(half_differences @ corrected.covariance @ half_differences)
    assert left == pytest.approx(own.up_rate.sigma * math.sqrt(1.0 - 1.0 / GROUPS), rel=0.01)
    # Half-sums do not hold the rate.
    before, after = (half_sums @ each.covariance @ half_sums for each in (own.north_free, corrected))
    assert after == pytest.approx(before, rel=1e-9)


def test_biases_that_differ_up_and_down_are_left_alone():
    random = np.random.default_rng(24)
    unit = follow_gravity(any_unit(random), np.array([0.0, 0.006, -0.006]))
    rate = joint_solution_of(measure(unit, random), PRIOR).up_rate
    assert rate.finding is Finding.DIFFERENT
    assert not rate.applies


def test_bias_that_follows_gravity_alike_in_all_gyros_is_no_latitude_error():
    random = np.random.default_rng(25)
    unit = follow_gravity(any_unit(random), np.array([0.004, 0.004, 0.004]))
    rate = joint_solution_of(measure(unit, random), PRIOR).up_rate
    assert rate.finding is Finding.NOT_LATITUDE
    assert not rate.applies


def test_two_pairs_make_a_weaker_statement_and_one_none(wrong_latitude):
    _, dwells = wrong_latitude[0]
    three, two, one, none = (
        joint_solution_of([dwells[k] for k in chosen], PRIOR).up_rate
        for chosen in (range(6), range(4), (0, 1, 2, 4), (0, 2, 4))
    )
    assert three.sigma < two.sigma < one.sigma
    assert one.finding is Finding.ONE_GYRO
    assert not one.applies
    assert none.finding is Finding.NO_PAIR
    assert not none.applies
    assert math.isnan(none.rate)


def test_without_a_pair_there_is_nothing_to_take_away(dwells):
    solution = joint_solution_of(dwells[::2], PRIOR)
    np.testing.assert_array_equal(solution.corrected().bias_radps, solution.north_free.bias_radps)


def test_repeated_position_counts_as_one_half_of_its_pair(wrong_latitude):
    unit, dwells = wrong_latitude[0]
    again = measure(unit, np.random.default_rng(26), ("z_up",), first=7)
    once = joint_solution_of(dwells, PRIOR)
    twice = joint_solution_of([*dwells, *again], PRIOR)
    assert twice.pairs.gyros == (0, 1, 2)
    assert twice.up_rate.sigma < once.up_rate.sigma
    assert twice.pairs.covariance[2, 2] == pytest.approx(0.75 * once.pairs.covariance[2, 2], rel=0.01)


def test_different_temperatures_up_and_down_widen_the_half_difference(dwells):
    warmer = [
        dataclasses.replace(each, gyro_c=(25.0, 25.0, 25.0 + 2.0 * (each.number == 2))) for each in dwells
    ]
    plain, wide = (joint_solution_of(each, PRIOR).pairs.covariance for each in (dwells, warmer))
    np.testing.assert_allclose(wide - plain, np.diag([0.0, 0.0, (1.0 * PRIOR.bias_slope) ** 2]), atol=1e-22)


def test_temperatures_that_were_not_measured_count_as_equal(dwells):
    unknown = [dataclasses.replace(each, gyro_c=(math.nan,) * 3) for each in dwells]
    np.testing.assert_array_equal(
        joint_solution_of(unknown, PRIOR).pairs.covariance, joint_solution_of(dwells, PRIOR).pairs.covariance
    )


def test_order_of_the_dwells_does_not_matter(dwells):
    there, back = joint_solution_of(dwells, PRIOR), joint_solution_of(dwells[::-1], PRIOR)
    np.testing.assert_allclose(
        back.together.bias_radps[::-1],
        there.together.bias_radps,
        atol=1e-6 * there.together.sigma_radps.min(),
    )
    assert back.up_rate.rate == pytest.approx(there.up_rate.rate, rel=1e-6)


def test_plateaus_are_dwells_in_a_row_of_one_cycle_and_set_point(right_latitude):
    _, (dwell, *_) = right_latitude
    plateaus = [(1, 60.0), (1, 60.0), (1, -20.0), (2, -20.0), (2, 60.0), (2, math.nan), (2, math.nan)]
    dwells = [
        dataclasses.replace(dwell, number=number, cycle=cycle, chamber_set_c=set_c)
        for number, (cycle, set_c) in enumerate(plateaus)
    ]
    groups = group_plateaus(dwells)
    assert [[each.number for each in group] for group in groups] == [[0, 1], [2], [3], [4], [5, 6]]


def test_no_dwell_is_an_error():
    with pytest.raises(MeasurementError, match="no dwell"):
        joint_solution_of([], PRIOR)


def test_power_ons_are_not_solved_together(right_latitude):
    _, (dwell, *_) = right_latitude
    dwells = [dataclasses.replace(dwell, number=n, run=run) for n, run in enumerate("aabba")]
    assert [[each.number for each in group] for group in group_plateaus(dwells)] == [[0, 1], [2, 3], [4]]


def test_a_plateau_ends_where_the_gyros_are_warmer_than_before(right_latitude):
    _, (dwell, *_) = right_latitude
    unknown = math.nan
    temperatures = [20.0, 24.0, 26.0, unknown, 29.0, 23.9, 33.0]  # means so far 20, 22, 23.3, 23.3; 29, 29
    dwells = [
        dataclasses.replace(dwell, number=n, gyro_c=(mean - 1.0, mean + 1.0, unknown))
        for n, mean in enumerate(temperatures)
    ]
    groups = [[each.number for each in group] for group in group_plateaus(dwells)]
    assert groups == [[0, 1, 2, 3], [4], [5], [6]]


def test_dwells_that_do_not_agree_in_any_way_show_no_rate_up(solutions):
    wrong_in_both = [
        dataclasses.replace(
            each,
            fit=dataclasses.replace(each.fit, p_value=1e-4),
            north_free_fit=dataclasses.replace(each.north_free_fit, p_value=1e-4),
        )
        for each in solutions
    ]
    rate = pooled_up_rate([wrong_in_both[0], *solutions[1:]], PRIOR)
    assert rate.rate == pooled_up_rate(solutions[1:], PRIOR).rate
    assert not {dwell.number for dwell in solutions[0].dwells} & set(rate.weights)
    assert pooled_up_rate(wrong_in_both, PRIOR) is None
    assert pooled_up_rate([], PRIOR) is None


def test_dwells_that_only_a_wrong_latitude_parts_show_the_rate_up(solutions):
    parted = dataclasses.replace(solutions[0], fit=dataclasses.replace(solutions[0].fit, p_value=0.0))
    assert {dwell.number for dwell in parted.dwells} <= set(pooled_up_rate([parted], PRIOR).weights)
