import numpy as np
import pytest

from gyrobench.bench.calibration.coefficients import COEFFICIENTS, COUNT, SensorErrors
from gyrobench.bench.calibration.mission import mission_error, navigate_mission
from gyrobench.bench.foundations.arrays import DPH_TO_RADPS
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.rotational_ins import (
    HALF_TURNS,
    RETRACED_HALF_TURNS,
    SIX_POSITIONS,
    rotate_for,
)

SITES = [Site(np.radians(latitude)) for latitude in (5.0, 45.0, -34.0, 67.0)]
SCHEMES = (HALF_TURNS, RETRACED_HALF_TURNS, SIX_POSITIONS)
#: Large residuals of each kind, in the units of tables.
LEFT = {"bias": {"gyro": 0.002, "accelerometer": 10.0}, "scale_factor": 3.0, "misalignment": 1.0}


def residuals(seed):
    sizes = [LEFT[each.kind] for each in COEFFICIENTS]
    sizes = [
        size[each.sensor] if isinstance(size, dict) else size
        for size, each in zip(sizes, COEFFICIENTS, strict=True)
    ]
    per_si = np.array([each.per_si for each in COEFFICIENTS])
    return np.array(sizes) / per_si * np.random.default_rng(seed).standard_normal(COUNT)


#: Each site and each scheme is among the quick tests.
SCHEMES_AT_SITES = [
    pytest.param(site, scheme, marks=[] if at % len(SCHEMES) == number else [pytest.mark.long])
    for at, site in enumerate(SITES)
    for number, scheme in enumerate(SCHEMES)
]


@pytest.mark.parametrize(("site", "scheme"), SCHEMES_AT_SITES)
def test_sensors_without_error_stay_within_a_metre_for_a_day(site, scheme):
    _, error_m = navigate_mission(SensorErrors(), site, scheme)
    assert np.abs(error_m).max() < 1.0


@pytest.mark.parametrize("site", SITES)
def test_constant_biases_err_as_by_the_linear_error_model(site):
    bias_dph = np.array([0.01, -0.02, 0.015])
    time_s, error_m = navigate_mission(SensorErrors(gyro_bias=bias_dph * DPH_TO_RADPS), site, SIX_POSITIONS)
    linear = rotate_for(86400.0, SIX_POSITIONS, lambda at_s, _: np.tile(bias_dph, (len(at_s), 1)), site)
    expected_m = [np.interp(time_s, linear.time_s, each) for each in (linear.east_m, linear.north_m)]
    assert np.abs(error_m - expected_m).max() < 0.05 * np.abs(expected_m).max()


def test_a_scheme_that_retraces_its_turns_cancels_misalignments():
    tilted = SensorErrors(
        gyro_matrix=np.radians(1.0 / 3600.0) * np.array([[0, 0, 1.0], [0, 0, 0], [0, 0, 0]])
    )
    day_m = {
        scheme: np.hypot(*navigate_mission(tilted, SITES[1], scheme)[1]).max()
        for scheme in (HALF_TURNS, RETRACED_HALF_TURNS)
    }
    assert day_m[RETRACED_HALF_TURNS] < 0.1 * day_m[HALF_TURNS]


@pytest.mark.long
def test_the_distribution_is_that_of_missions_with_drawn_coefficients():
    site, values, roots = SITES[1], residuals(1), np.diag(np.abs(residuals(2)))
    error = mission_error(values, roots @ roots, site)
    draws = values + np.random.default_rng(3).standard_normal((30, COUNT)) @ roots
    full_nmi = np.array(
        [
            np.hypot(*navigate_mission(SensorErrors.from_vector(each), site, RETRACED_HALF_TURNS)[1]).max()
            / 1852.0
            for each in draws
        ]
    )
    assert error.median_nmi[-1] == pytest.approx(np.median(full_nmi), rel=0.25)
    assert np.mean(full_nmi < error.high_nmi[-1]) > 0.85
    stated_nmi = (
        np.hypot(*navigate_mission(SensorErrors.from_vector(values), site, RETRACED_HALF_TURNS)[1]).max()
        / 1852.0
    )
    assert error.stated_nmi[-1] == pytest.approx(stated_nmi)
    known = mission_error(values, np.zeros((COUNT, COUNT)), site)
    np.testing.assert_allclose(known.median_nmi, known.stated_nmi, rtol=0.01)
    assert np.all(np.diff(known.stated_nmi) >= 0.0)
