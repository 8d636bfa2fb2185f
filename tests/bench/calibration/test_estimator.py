"""Coefficients from increments of a rotated unit: correct, as good as possible, and honest about the rest."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from gyrobench.bench.calibration import estimator
from gyrobench.bench.calibration.coefficients import COEFFICIENTS, SensorErrors
from gyrobench.bench.calibration.estimator import bias_per_asymmetry, calibrate, covariances_by_source
from gyrobench.bench.calibration.increment_recording import IncrementRecording, SensorNoise
from gyrobench.bench.calibration.information import BIAS_DRIFT, CalibrationOptions
from gyrobench.bench.calibration.problem import CalibrationProblem
from gyrobench.bench.foundations.arrays import DPH_TO_RADPS, STANDARD_GRAVITY
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.error_model import Site
from tests.bench.calibration.rotated_unit import EARTH, EIGHTEEN, Noise, Unit

LONG = pytest.mark.long
SITE = Site(np.deg2rad(45.0))
RANDOM = np.random.default_rng(11)
ERRORS = {
    "gyro_bias": np.array([5e-8, -1e-7, 7e-8]),
    "gyro_matrix": RANDOM.normal(0.0, 5e-5, (3, 3)),
    "force_bias": np.array([5e-4, -3e-4, 2e-4]),
    "force_matrix": RANDOM.normal(0.0, 2e-4, (3, 3)),
}
TRUTH = SensorErrors(**ERRORS).vector()
INDEX = {f"{each.name}_{each.axis}": number for number, each in enumerate(COEFFICIENTS)}


def rotated_unit(**changes):
    return Unit(**({"gravity": SITE.gravity, "sample_hz": 20.0, "dwell_s": 60.0} | ERRORS | changes))


@cache
def eighteen():
    return rotated_unit().increments()


def recorded(increments, seed, sample_hz=20.0, noise=None):
    random, dt = np.random.default_rng(seed), 1.0 / sample_hz
    return IncrementRecording(dt, *(noise or Noise()).added(*increments, dt, random))


def test_every_coefficient_of_eighteen_rotations_is_found_as_well_as_the_noise_allows():
    found = [calibrate([recorded(eighteen(), seed)], SITE) for seed in range(5)]
    assert all(each.is_observed.all() for each in found)
    deviations = np.array([(each.values - TRUTH) / each.sigmas for each in found])
    # 105 values: the standard deviation of their root mean square is about 0.085 with the correlations.
    assert np.sqrt(np.mean(deviations**2)) == pytest.approx(1.0, abs=0.21)
    assert np.mean(np.abs(deviations) < 1.96) > 0.88
    assert min(each.fit.p_value for each in found) > 1e-4


def test_a_bias_that_drifts_is_no_misfit_and_leaves_the_other_coefficients_right():
    angle, velocity = eighteen()
    time_s = 0.05 * (np.arange(len(angle)) + 0.5)
    drift = np.deg2rad([0.2, -0.15, 0.1]) / 3600.0**2
    drifted = angle + 0.05 * np.outer(time_s - time_s.mean(), drift), velocity
    options = CalibrationOptions(bias_drift=BIAS_DRIFT)
    found = [calibrate([recorded(drifted, seed)], SITE, options) for seed in range(4)]
    deviations = np.array([(each.values - TRUTH) / each.sigmas for each in found])
    assert np.sqrt(np.mean(deviations**2)) == pytest.approx(1.0, abs=0.25)
    assert min(each.fit.p_value for each in found) > 1e-3
    assert "bias_drift" in covariances_by_source(found[0])
    constant = calibrate([recorded(drifted, 0)], SITE)
    assert constant.fit.p_value < 1e-3
    assert (constant.sigmas > found[0].sigmas).all()


@pytest.mark.long
def test_intervals_hold_while_biases_drift_only_if_the_drift_is_estimated():
    """50 min in which each bias changes by 0.05 deg/h per hour, up or down, in 100 runs."""
    hz, noise = 5.0, Noise()
    angle, velocity = rotated_unit(sample_hz=hz, dwell_s=149.0).increments()
    since_half_s = (np.arange(len(angle)) + 0.5 - 0.5 * len(angle)) / hz
    estimated, constant, misfits = [], [], []
    for seed in range(100):
        random = np.random.default_rng([seed, 8])
        drift = np.deg2rad(random.choice([-0.05, 0.05], 3)) / 3600.0**2
        drifted = noise.added(angle + np.outer(since_half_s, drift) / hz, velocity, 1.0 / hz, random)
        log = IncrementRecording(1.0 / hz, *drifted)
        found = calibrate([log], SITE, CalibrationOptions(bias_drift=BIAS_DRIFT))
        without = calibrate([log], SITE)
        estimated.append((found.values - TRUTH) / found.sigmas)
        misfits.append([each.fit.p_value < 1e-3 for each in (found, without)])
        # Of a misfit they are widened.
        widening = np.sqrt(without.fit.chi2 / without.fit.dof) if misfits[-1][1] else 1.0
        away = (without.values - TRUTH) / without.sigmas
        constant.append([away, away * widening, found.sigmas / without.sigmas * widening])
    widened, by_noise, costs = np.moveaxis(constant, 1, 0)

    def held(deviations):
        return np.mean(np.abs(deviations) < 1.96)

    assert 0.93 < held(estimated) < 0.97
    assert held(by_noise) < 0.92
    assert held(widened) > 0.97
    assert np.mean(misfits, axis=0) == pytest.approx([0.0, 1.0], abs=0.05)
    assert np.mean(costs) < 1.02


def test_the_uncertainty_is_the_cramer_rao_bound(monkeypatch):
    """Information of the same data in another way: attitude in closed form, noise as one matrix."""
    noise = Noise()
    exact = SensorNoise(
        *(np.full(3, each) for each in (noise.angle_random_walk, 0.0, noise.velocity_random_walk, 1e-4))
    )
    monkeypatch.setattr(estimator, "measure_noise", lambda *_: exact)
    unit = rotated_unit(rotations=EIGHTEEN[:6], dwell_s=40.0, ramp_s=2.0)
    found = calibrate([recorded(unit.increments(), 3)], SITE)
    rests = found.recordings[0].rests
    ends = np.arange(20, rests[-1].end + 1, 20)
    used = np.any([(ends >= rest.begin) & (ends <= rest.end) for rest in rests], axis=0)
    response = responses(unit)[ends[used] - 1]
    time = ends[used] / 20.0
    early, late = np.minimum.outer(time, time), np.maximum.outer(time, time)
    white = noise.white_velocity**2 * (np.eye(len(time)) + 1.0)
    vertical = noise.velocity_random_walk**2 * early + white
    # A random walk of the tilt, integrated through gravity.
    level = vertical + (SITE.gravity * noise.angle_random_walk) ** 2 * early**2 * (3.0 * late - early) / 6.0
    information = sum(
        response[:, axis].T @ np.linalg.solve(covariance, response[:, axis])
        for axis, covariance in enumerate((level, level, vertical))
    )
    bound = np.sqrt(np.diag(np.linalg.inv(information + np.diag(np.full(24, 1e-6)))))[:21]
    seen = found.is_observed & (found.sigmas < 0.01 * np.array([each.size for each in COEFFICIENTS]))
    assert seen.sum() >= 19
    np.testing.assert_allclose(found.sigmas[seen], bound[seen], rtol=0.02)


def responses(unit):
    """Integral of force and gravity (n, 3, 24) after each sample, by coefficients and first attitude."""
    dt = 1.0 / unit.sample_hz
    rates, forces = (each * dt for each in unit.sensed(dt * (np.arange(len(unit.increments()[0])) + 0.5)))
    time = dt * (np.arange(len(rates)) + 0.5)
    outer, inner = unit.profile(time)
    C_nb = Rotation.from_rotvec(np.outer(outer[0], [1, 0, 0])) * Rotation.from_rotvec(
        np.outer(inner[0], [0, 0, 1])
    )
    earth = EARTH * np.array([0.0, np.cos(SITE.latitude), np.sin(SITE.latitude)])
    to_inertial = Rotation.from_rotvec(np.outer(time, earth)).as_matrix()
    C = C_nb.as_matrix()
    gyro = np.concatenate(
        [C * dt, np.stack([C[:, :, i] * rates[:, [j]] for i in range(3) for j in range(3)], axis=2)], axis=2
    )
    tilt = np.zeros((len(time), 3, 24))
    tilt[:, :, :12] = np.cumsum(to_inertial @ gyro, axis=0)
    tilt[:, :, 21:] = np.eye(3)
    tilt = to_inertial.transpose(0, 2, 1) @ tilt
    rows, columns = np.tril_indices(3)
    lift = np.zeros((len(time), 3, 24))
    lift[:, :, 12:15] = C * dt
    lift[:, :, 15:21] = np.stack(
        [C[:, :, i] * forces[:, [j]] for i, j in zip(rows, columns, strict=True)], axis=2
    )
    up = np.array([0.0, 0.0, SITE.gravity * dt])
    return np.cumsum(np.cross(tilt, up, axisa=1).transpose(0, 2, 1) + lift, axis=0)


# pandas 3 ignores an argument of pyins with a warning.
@pytest.mark.filterwarnings("ignore::Warning")
def test_increments_simulated_by_pyins_give_the_coefficients():
    """Biases, scale factors and misalignments of all sensors, together within their covariance."""
    sim = pytest.importorskip("pyins.sim", reason="python-ins is in the extra 'dev'")
    unit = rotated_unit()
    begin, span, *_ = unit.segments()[-1]
    time = np.arange(round((begin + span) * 20.0) + 1) / 20.0
    outer, inner = unit.profile(time)
    attitude = Rotation.from_rotvec(np.outer(outer[0], [1, 0, 0])) * Rotation.from_rotvec(
        np.outer(inner[0], [0, 0, 1])
    )
    to_ned = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]] @ attitude.as_matrix())
    rph = to_ned.as_euler("ZYX", degrees=True)[:, ::-1]
    place = np.tile([45.0, 0.0, 0.0], (len(time), 1))
    _, imu = sim.generate_imu(time, place, rph, np.zeros((len(time), 3)), "increment")
    angle, velocity = imu.to_numpy()[1:, :3], imu.to_numpy()[1:, 3:]
    angle = angle @ (np.eye(3) + unit.gyro_matrix).T + unit.gyro_bias * 0.05
    velocity = velocity @ (np.eye(3) + unit.force_matrix).T + unit.force_bias * 0.05
    assert np.count_nonzero(TRUTH) == len(COEFFICIENTS)
    found = calibrate([recorded((angle, velocity), 4)], SITE)
    deviations = (found.values - TRUTH) / found.sigmas
    assert np.abs(deviations).max() < 4.0
    scaled = np.linalg.solve(found.correlations, deviations)
    assert chi2.ppf(0.001, len(COEFFICIENTS)) < deviations @ scaled < chi2.ppf(0.999, len(COEFFICIENTS))
    assert found.fit.p_value > 1e-4


def test_a_tumble_in_separate_logs_gives_all_accelerometer_coefficients():
    turns = [Rotation.from_euler("zyx", each, degrees=True) for each in ATTITUDES]
    logs = [
        recorded(rotated_unit(rotations=(), dwell_s=120.0, start=turn).increments(), number)
        for number, turn in enumerate(turns)
    ]
    found = calibrate(logs, SITE)
    accelerometers = slice(12, 21)
    assert found.is_observed[accelerometers].all()
    deviations = ((found.values - TRUTH) / found.sigmas)[accelerometers]
    assert np.abs(deviations).max() < 4.0
    assert found.sigmas[INDEX["accelerometer_bias_x"]] < 3e-5
    # The Earth alone turned the gyros.
    assert not found.is_observed[3:12].any()


ATTITUDES = [(0, 0, 0), (0, 0, 180), (0, 0, 90), (0, 0, -90), (0, 90, 0), (0, -90, 0)]
ATTITUDES += [(0, 0, 45), (0, 45, 0), (90, 45, 20), (30, -45, 30), (0, 30, 135), (20, -30, -135)]


def test_a_tumble_gives_the_quadratic_terms_of_the_accelerometers():
    square = np.array([30.0, -20.0, 10.0]) * 9.80665e-6 / 9.80665**2
    turns = [Rotation.from_euler("zyx", each, degrees=True) for each in ATTITUDES]
    logs = []
    for number, turn in enumerate(turns):
        angle, velocity = rotated_unit(rotations=(), dwell_s=120.0, start=turn).increments()
        logs.append(recorded((angle, velocity + 20.0 * square * velocity**2), number))
    found = calibrate(logs, SITE, CalibrationOptions(quadratic=True))
    terms = slice(21, 24)
    assert found.is_observed[terms].all()
    assert np.abs((found.values[terms] - square) / found.sigmas[terms]).max() < 4.0
    in_tables = found.sigmas[terms] * [each.per_si for each in found.coefficients[terms]]
    assert in_tables.max() < 5.0
    deviations = ((found.values[:21] - TRUTH) / found.sigmas[:21])[12:]
    assert np.abs(deviations).max() < 4.0
    # Without them the accelerometers contradict the noise.
    assert calibrate(logs, SITE).fit.p_value < 1e-3


@pytest.mark.parametrize("count", [18, 9])
def test_quadratic_terms_of_usual_size_pass_for_no_accelerometer_bias(count):
    """Too few rotations leave a part of them open, as an uncertainty of the biases."""
    square = np.array([5.0, -4.0, 3.0]) * 9.80665e-6 / 9.80665**2
    angle, velocity = rotated_unit(rotations=EIGHTEEN[:count], dwell_s=149.0, sample_hz=10.0).increments()
    log = recorded((angle, velocity + 10.0 * square * velocity**2), 3, 10.0)
    found = calibrate([log], SITE, CalibrationOptions(quadratic=None))
    assert found.is_observed.all()
    assert np.abs((found.values - TRUTH) / found.sigmas).max() < 4.0
    assert found.findings == ()
    without = calibrate([log], SITE)
    assert (np.abs(without.values - TRUTH) / without.sigmas)[12:15].max() > 8.0
    if count == 18:
        (note,) = found.notes
        assert note.startswith("the accelerometers have quadratic terms, in ug/g2: x +")
    total = sum(covariances_by_source(found).values())
    np.testing.assert_allclose(np.diag(total), np.diag(found.covariance), rtol=1e-3)
    nothing = calibrate([recorded((angle, velocity), 3, 10.0)], SITE, CalibrationOptions(quadratic=None))
    assert (nothing.findings, nothing.notes) == ((), ())


def test_up_and_down_alone_do_not_show_quadratic_terms():
    logs = [
        recorded(rotated_unit(rotations=(), start=Rotation.from_euler("x", turn)).increments(), 3)
        for turn in (0.0, np.pi)
    ]
    found = calibrate(logs, SITE, CalibrationOptions(quadratic=True))
    assert not found.is_observed[21:].any()


def test_whole_turns_against_the_table_give_the_scale_factor_to_a_tenth_of_a_ppm():
    spins = (("inner", 3600.0), ("inner", -3600.0))
    unit = rotated_unit(rotations=(*EIGHTEEN[:9], *spins), rate_dps=60.0, sample_hz=50.0)
    log = recorded(unit.increments(), 5, 50.0)
    alone = calibrate([log], SITE)
    with_turns = calibrate([log], SITE, CalibrationOptions(whole_turns=1.0 * np.pi / 648000.0))
    z = INDEX["gyro_scale_factor_z"]
    assert alone.sigmas[z] > 3e-7
    assert with_turns.sigmas[z] < 1e-7
    assert abs(with_turns.values[z] - TRUTH[z]) < 4.0 * with_turns.sigmas[z]


SPINS = (("inner", 3600.0, 60.0), ("inner", -3600.0, 60.0))
ONE_ARCSEC = CalibrationOptions(whole_turns=1.0 * np.pi / 648000.0)


@cache
def spun_increments(more_scale_z=0.0):
    """Nine rotations at 10 deg/s and ten whole turns each way at 60 deg/s about z."""
    matrix = ERRORS["gyro_matrix"] + np.diag([0.0, 0.0, more_scale_z])
    unit = rotated_unit(rotations=(*EIGHTEEN[:9], *SPINS), sample_hz=50.0, gyro_matrix=matrix)
    return unit.increments()


def spun(more_scale_z=0.0, at_high_rates_ppm=0.0):
    angle, velocity = spun_increments(more_scale_z)
    is_fast = np.abs(angle[:, 2:]) > np.deg2rad(30.0) / 50.0
    angle = angle * (1.0 + 1e-6 * at_high_rates_ppm * is_fast)
    return recorded((angle, velocity), 5, 50.0)


def test_whole_turns_that_contradict_the_rotations_are_named_and_make_scale_factors_uncertain():
    z = INDEX["gyro_scale_factor_z"]
    agreeing = calibrate([spun()], SITE, ONE_ARCSEC)
    assert agreeing.findings == ()
    found = calibrate([spun(at_high_rates_ppm=6.0)], SITE, ONE_ARCSEC)
    (finding,) = found.findings
    assert finding.startswith("whole turns contradict the rotations (p = ")
    assert "z +" in finding
    assert found.sigmas[z] > 1e-6 > 10.0 * agreeing.sigmas[z]
    assert abs(found.values[z] - TRUTH[z]) < 3.0 * found.sigmas[z]
    parts = covariances_by_source(found)
    np.testing.assert_allclose(np.diag(sum(parts.values())), np.diag(found.covariance)[:21], rtol=1e-6)
    assert np.sqrt(parts["misfit"][z, z]) > 0.9 * found.sigmas[z]


def test_whole_turns_at_several_rates_that_contradict_one_another_are_named():
    """A scale factor that grows with the rate: by 1 ppm from rest to 10 deg/s."""
    turns = [("inner", sign * 360.0, rate) for rate in (5.0, 10.0, 20.0) for sign in (1.0, -1.0)]
    unit = rotated_unit(rotations=(*EIGHTEEN[:9], *turns))
    angle, velocity = unit.increments()
    is_turning = np.abs(angle[:, 2:]) > 1e-4
    growing = angle * (1.0 + 1e-6 * is_turning * np.abs(angle[:, 2:]) / (np.deg2rad(10.0) / 20.0))
    options = replace(ONE_ARCSEC, whole_turns=0.1 * np.pi / 648000.0)
    found, agreeing = (
        calibrate([recorded(each, 5)], SITE, options) for each in ((growing, velocity), (angle, velocity))
    )
    assert agreeing.findings == ()
    (finding,) = found.findings
    assert finding.startswith("whole turns contradict one another (p = ")
    assert re.search(
        r"the z gyro deviates from its mean by -\S+ ppm at 5 deg/s, .* \+\S+ ppm at 20 deg/s", finding
    )
    z = INDEX["gyro_scale_factor_z"]
    assert found.sigmas[z] > 0.4e-6 > 2.0 * agreeing.sigmas[z]


def test_an_asymmetry_of_the_scale_factor_passes_for_no_bias():
    turns = (("inner", 360.0), ("inner", -360.0)) * 6
    unit = rotated_unit(rotations=(*EIGHTEEN[:9], *turns), dwell_s=40.0, sample_hz=20.0)
    angle, velocity = unit.increments()
    log = recorded((angle + 1.5e-6 * np.abs(angle) * [0.0, 0.0, 1.0], velocity), 5)
    found = calibrate([log], SITE, ONE_ARCSEC)
    asymmetry, z = found.coefficients[-1], INDEX["gyro_bias_z"]
    assert (asymmetry.name, asymmetry.axis) == ("gyro_scale_factor_asymmetry", "z")
    assert abs(found.values[-1] - 3e-6) < 4.0 * found.sigmas[-1] < 2.5e-6
    assert found.findings == ()
    assert abs(found.values[z] - TRUTH[z]) < 2.0 * found.sigmas[z]
    taken_for_bias = calibrate([log], SITE, replace(ONE_ARCSEC, asymmetries=()))
    assert abs(taken_for_bias.values[z] - TRUTH[z]) > 4.0 * taken_for_bias.sigmas[z]


def test_a_table_that_settles_by_some_arcsec_after_a_spin_leaves_the_scale_factor_right():
    angle, velocity = spun_increments()
    fast = np.flatnonzero(np.abs(angle[:, 2]) > np.deg2rad(30.0) / 50.0)
    ends = [*fast[np.flatnonzero(np.diff(fast) > 50)], fast[-1]]  # and its ramp down follows
    angle, time_s = angle.copy(), np.arange(1, 1001) / 50.0
    for end in ends:
        overshoot = np.sign(angle[end, 2]) * 10.0 * np.pi / 648000.0
        angle[end, 2] += overshoot
        angle[end + 60 :][:1000, 2] += np.diff(overshoot * np.exp(-time_s / 0.8), prepend=overshoot)
    found = calibrate([recorded((angle, velocity), 5, 50.0)], SITE, ONE_ARCSEC)
    z = INDEX["gyro_scale_factor_z"]
    assert found.findings == ()
    assert abs(found.values[z] - TRUTH[z]) < 3.0 * found.sigmas[z] < 3e-7


def test_whole_turns_are_found_where_the_scale_factor_is_wrong_by_more_than_they_miss():
    more = 2e-3  # 7 deg of ten turns
    found = calibrate([spun(more)], SITE, ONE_ARCSEC)
    assert [turn.kind for turn in found.rotations[0]].count("spin") == 2
    z = INDEX["gyro_scale_factor_z"]
    assert abs(found.values[z] - ERRORS["gyro_matrix"][2, 2] - more) < 4.0 * found.sigmas[z] < 4e-7


def test_a_misfit_is_stated_with_what_would_explain_it():
    angle, velocity = eighteen()
    bent = velocity + 2e-5 / 9.8 * velocity * np.abs(velocity) / 0.05
    (finding,) = calibrate([recorded((angle, velocity + 2e-6 * velocity**2 / 0.05), 4)], SITE).findings
    assert "noise does not explain the velocity at rest" in finding
    assert "(gyrobench calibrate --quadratic) would explain it: chi2 falls from" in finding
    with pytest.raises(MeasurementError, match="at most 10 times is accepted"):
        calibrate([recorded((angle, bent * 1.0 + 4e-5 * velocity**2 / 0.05), 4)], SITE)


def test_what_would_explain_a_misfit_is_tried_with_whole_turns_as_uncertain_as_they_contradict_rotations():
    log = spun(at_high_rates_ppm=30.0)
    bent = replace(log, velocity=log.velocity + 2e-6 * log.velocity**2 / log.interval_s)
    turns, misfit = calibrate([bent], SITE, ONE_ARCSEC).findings
    assert turns.startswith("whole turns contradict the rotations")
    assert (
        "Quadratic terms of the accelerometers (gyrobench calibrate --quadratic) would explain it" in misfit
    )


@pytest.mark.parametrize("off_deg", [0.1, pytest.param(-0.1, marks=LONG)])
def test_a_wrong_latitude_is_named_with_the_right_one(off_deg):
    site, options = Site(SITE.latitude + np.deg2rad(off_deg)), CalibrationOptions(gravity=SITE.gravity)
    (finding,) = calibrate([recorded(eighteen(), 2)], site, options).findings
    latitude_deg = float(finding.partition("A latitude of ")[2].split()[0])
    assert latitude_deg == pytest.approx(45.0, abs=0.02)


@pytest.mark.parametrize("are_rates", [False, True])
def test_a_sample_interval_that_is_wrong_by_a_thousandth_is_named_beside_the_latitude_that_explains_as_much(
    are_rates,
):
    log = recorded(eighteen(), 14)
    scale = 1.001 if are_rates else 1.0
    wrong = IncrementRecording(log.interval_s * 1.001, log.angle * scale, log.velocity * scale)
    (finding,) = calibrate([wrong], SITE).findings
    assert re.search(r"A latitude of \S+ deg or samples 0\.0(4999|5)\d* s apart and not 0\.05005 s", finding)


def test_another_sample_interval_is_solved_once_however_large_the_misfit(monkeypatch):
    solved, solve = [], CalibrationProblem.solve

    def counted(problem):
        solved.append(problem.sections[0].interval_s)
        return solve(problem)

    monkeypatch.setattr(CalibrationProblem, "solve", counted)
    log = recorded(eighteen(), 14)
    wrong = IncrementRecording(log.interval_s * 1.002, log.angle, log.velocity)
    calibration = calibrate([wrong], SITE, CalibrationOptions(gravity=SITE.gravity))
    assert calibration.fit.chi2 > 2.5 * calibration.fit.dof
    others = [interval_s for interval_s in solved if interval_s != wrong.interval_s]
    assert len(others) == len(set(others)) > 0


@pytest.mark.parametrize("off_deg", [pytest.param(10.0, marks=LONG), -10.0])
def test_a_latitude_that_is_wrong_by_many_degrees_is_named_as_well(off_deg):
    site, options = Site(SITE.latitude + np.deg2rad(off_deg)), CalibrationOptions(gravity=SITE.gravity)
    with pytest.raises(MeasurementError, match="would explain it") as refused:
        calibrate([recorded(eighteen(), 2)], site, options)
    latitude_deg = float(str(refused.value).partition("A latitude of ")[2].split()[0])
    assert latitude_deg == pytest.approx(45.0, abs=0.02)


def test_what_only_reduces_a_misfit_is_no_explanation():
    angle, velocity = eighteen()
    bent = recorded((angle, velocity + 2e-6 * velocity**2 / 0.05), 4)
    with pytest.raises(MeasurementError, match="would reduce it: chi2 falls from") as refused:
        calibrate([bent], Site(SITE.latitude + 0.1), CalibrationOptions(gravity=SITE.gravity))
    assert "A latitude of 4" in str(refused.value)
    assert "noise alone gives 54. Something else is wrong too" in str(refused.value)


#: Sensitivities of the gyros to the specific force, SI: some 0.01 deg/h/g.
SENSITIVITY = DPH_TO_RADPS / STANDARD_GRAVITY * RANDOM.normal(0.0, 0.01, (3, 3))


@cache
def following_force():
    """Eighteen rotations of a unit whose gyro biases follow the specific force."""
    unit = rotated_unit(force_bias=np.zeros(3), force_matrix=np.zeros((3, 3)))
    (angle, velocity), (_, true) = eighteen(), unit.increments()
    return angle + true @ SENSITIVITY.T, velocity


def test_gyro_biases_that_follow_the_specific_force_are_estimated_where_asked_for():
    options = CalibrationOptions(g_sensitivity=True)
    found = [calibrate([recorded(following_force(), seed)], SITE, options) for seed in range(3)]
    truth = np.concatenate([TRUTH, SENSITIVITY.ravel()])
    deviations = np.array([(each.values - truth) / each.sigmas for each in found])
    assert np.sqrt(np.mean(deviations**2)) == pytest.approx(1.0, abs=0.25)
    assert [each.kind for each in found[0].coefficients[21:]] == ["g_sensitivity"] * 9
    assert found[0].is_observed.all()


def test_gyro_biases_that_follow_the_specific_force_are_found_where_noise_explains_nothing():
    options = CalibrationOptions(g_sensitivity=None, gravity=SITE.gravity)
    found = calibrate([recorded(following_force(), 1)], SITE, options)
    (note,) = found.notes
    assert note.startswith("the gyro biases follow the specific force (p = ")
    assert found.findings == ()
    i, j = np.unravel_index(np.argmax(np.abs(SENSITIVITY)), (3, 3))
    named_dph_per_g = re.search(rf"{'xyz'[i]} gyro ([-+]\d\.\d+) ± [\d.e-]+ along {'xyz'[j]}", note)[1]
    truth_dph_per_g = SENSITIVITY[i, j] * STANDARD_GRAVITY / DPH_TO_RADPS
    assert float(named_dph_per_g) == pytest.approx(truth_dph_per_g, abs=0.003)
    assert np.abs((found.values[:21] - TRUTH) / found.sigmas[:21]).max() < 4.0
    without = calibrate([recorded(following_force(), 1)], SITE, replace(options, g_sensitivity=False))
    assert (
        "gyro biases that follow the specific force (gyrobench calibrate --g-sensitivity)"
        in without.findings[0].lower()
    )
    assert np.median(without.sigmas / found.sigmas[:21]) > 1.3
    nothing = calibrate([recorded(eighteen(), 1)], SITE, options)
    assert (len(nothing.values), nothing.findings, nothing.notes) == (21, (), ())


def test_rotations_too_few_to_show_biases_that_follow_the_specific_force_allow_for_them():
    noise = Noise(angle_random_walk=0.1 * Noise.angle_random_walk)
    turns = (("outer", 90.0), ("inner", 90.0), ("outer", 90.0))
    unit = rotated_unit(rotations=turns, force_bias=np.zeros(3), force_matrix=np.zeros((3, 3)))
    angle, velocity = unit.increments()
    followed = recorded((angle + 2.0 * velocity @ SENSITIVITY.T, velocity), 1, noise=noise)
    options = CalibrationOptions(g_sensitivity=None, gravity=SITE.gravity)
    found = calibrate([followed], SITE, options)
    (note,) = found.notes
    assert note.startswith("too few rotations to show gyro biases that follow the specific force")
    truth = SensorErrors(ERRORS["gyro_bias"], ERRORS["gyro_matrix"]).vector()

    def largest(each):
        return np.abs((each.values - truth) / each.sigmas)[each.is_observed].max()

    assert largest(found) < 3.0 < largest(calibrate([followed], SITE, replace(options, g_sensitivity=False)))
    total = sum(covariances_by_source(found).values())
    np.testing.assert_allclose(np.diag(total), np.diag(found.covariance), rtol=1e-3)


@pytest.mark.parametrize(
    ("latitude_deg", "off_deg"),
    [
        pytest.param(at_deg, off_deg, marks=[] if (at_deg, off_deg) == (-60.0, -0.1) else LONG)
        for at_deg in (45.0, 20.0, -60.0)
        for off_deg in (0.1, -0.1)
    ],
)
def test_a_wrong_latitude_passes_for_no_bias_that_follows_the_specific_force(latitude_deg, off_deg):
    """Its error of the Earth's rate along Up is one along the specific force."""
    site = Site(np.deg2rad(latitude_deg + off_deg))
    unit = rotated_unit(latitude_deg=latitude_deg, gravity=site.gravity)
    found = calibrate([recorded(unit.increments(), 2)], site, CalibrationOptions(g_sensitivity=None))
    (finding,) = found.findings
    named_deg = float(finding.partition("A latitude of ")[2].split()[0])
    assert named_deg == pytest.approx(latitude_deg, abs=0.03)


@pytest.mark.long
def test_noise_above_the_declared_one_passes_for_no_bias_that_follows_the_specific_force():
    walks = Noise.angle_random_walk, Noise.velocity_random_walk
    options = CalibrationOptions(g_sensitivity=None, gravity=SITE.gravity, walks=walks)
    noisy = Noise(angle_random_walk=1.6 * Noise.angle_random_walk)
    increments = rotated_unit(sample_hz=10.0, dwell_s=149.0).increments()
    logs = [recorded(increments, seed, 10.0, noisy) for seed in range(40)]
    found = [calibrate([log], SITE, options) for log in logs]
    assert sum(bool(each.findings) for each in found) > 10
    assert not any(each.notes for each in found)


@pytest.mark.parametrize("off_deg", [1.5, pytest.param(0.6, marks=LONG)])
def test_a_wrong_latitude_is_hidden_by_no_true_sensitivity(off_deg):
    """At the equator its error is a rate Up alone, as an equal own sensitivity of all gyros."""
    still = {"force_matrix": np.zeros((3, 3)), "force_bias": np.zeros(3)}
    unit = rotated_unit(latitude_deg=0.0, dwell_s=149.0, sample_hz=10.0, **still)
    angle, velocity = unit.increments()
    log = recorded((angle + velocity @ SENSITIVITY.T, velocity), 1, 10.0)
    options = CalibrationOptions(g_sensitivity=None, gravity=SITE.gravity)
    found = calibrate([log], Site(np.deg2rad(off_deg)), options)
    assert (found.notes, len(found.findings)) == ((), 1)


def test_whole_turns_are_free_of_biases_that_follow_the_specific_force():
    log = spun()
    bent = replace(log, angle=log.angle + log.velocity @ (10.0 * SENSITIVITY).T)
    found = calibrate([bent], SITE, replace(ONE_ARCSEC, g_sensitivity=True))
    spins = [
        spin
        for section, start in zip(found.problem.sections, found.starts, strict=True)
        for spin in section.spin_errors(start, found.common, SITE)
    ]
    assert len(spins) == 2
    assert max(abs(spin.error) for spin in spins) < 1e-5


def test_the_opposite_latitude_passes_for_no_bias_that_follows_the_specific_force():
    site, options = Site(-SITE.latitude), CalibrationOptions(g_sensitivity=None, gravity=SITE.gravity)
    with pytest.raises(MeasurementError, match="at the opposite latitude"):
        calibrate([recorded(eighteen(), 2)], site, options)


def test_an_error_of_the_time_is_one_of_scale_factors():
    options = CalibrationOptions(scales_by_time=(3e-5, -3e-5))
    found, exact = (calibrate([recorded(eighteen(), 2)], SITE, each) for each in (options, None))
    np.testing.assert_array_equal(found.values, exact.values)
    is_scale = ["scale_factor" in name for name in INDEX]
    np.testing.assert_allclose(found.sigmas[is_scale], 3e-5, rtol=1e-3)
    np.testing.assert_allclose(found.sigmas[~np.array(is_scale)], exact.sigmas[~np.array(is_scale)])
    x = INDEX["gyro_scale_factor_x"], INDEX["accelerometer_scale_factor_x"]
    assert found.correlations[x] < -0.99


def test_rotations_about_one_level_axis_leave_open_what_they_do_not_show():
    unit = rotated_unit(rotations=(("outer", 90.0),) * 8)
    found = calibrate([recorded(unit.increments(), 6)], SITE)
    seen = {name for name, number in INDEX.items() if found.is_observed[number]}
    assert "gyro_scale_factor_x" in seen
    assert {"gyro_scale_factor_y", "gyro_scale_factor_z"}.isdisjoint(seen)
    assert np.abs((found.values - TRUTH) / found.sigmas)[found.is_observed].max() < 4.0


@pytest.mark.parametrize(
    ("latitude_deg", "bias_dph"),
    [(10.0, 0.7), pytest.param(45.0, 0.02, marks=LONG), pytest.param(5.0, 0.02, marks=LONG)],
)
def test_a_bias_along_the_only_level_axis_is_not_observed_and_keeps_no_estimate_from_converging(
    latitude_deg, bias_dph
):
    turns = [("outer", angle_deg) for angle_deg in (90, 90, -90, -90, -90, -90, 90, 90)]
    normalised = []
    for seed in (0, 8, 19):
        random = np.random.default_rng(seed)
        errors = {name: random.normal(0.0, np.std(each), each.shape) for name, each in ERRORS.items()}
        errors["force_matrix"] = np.tril(errors["force_matrix"])
        errors["gyro_bias"][0] = bias_dph * DPH_TO_RADPS
        unit = rotated_unit(rotations=turns, dwell_s=149.0, latitude_deg=latitude_deg, **errors)
        site = Site(np.deg2rad(latitude_deg))
        found = calibrate([recorded(unit.increments(), seed)], site, CalibrationOptions(gravity=SITE.gravity))
        deviations = (found.values - SensorErrors(**errors).vector()) / found.sigmas
        normalised += deviations[found.is_observed].tolist()
        assert found.is_observed[INDEX["gyro_scale_factor_x"]]
        assert not found.is_observed[INDEX["gyro_bias_x"]]
    assert np.sqrt(np.mean(np.square(normalised))) == pytest.approx(1.0, abs=0.4)


def test_lever_arms_and_delay_are_estimated_where_asked_for():
    arms = np.array([[0.03, 0.0, 0.01], [-0.02, 0.04, 0.0], [0.01, -0.03, 0.05]])
    unit = rotated_unit(rate_dps=30.0, sample_hz=50.0, dwell_s=30.0, arms=arms, delay_s=0.002)
    log = recorded(unit.increments(), 7, 50.0)
    found = calibrate([log], SITE, CalibrationOptions(lever_arms=True, delay=True))
    truth = np.concatenate([TRUTH, (arms[1:] - arms[0]).ravel(), [0.002]])
    assert [each.kind for each in found.coefficients[21:]] == ["lever_arm"] * 6 + ["delay"]
    assert np.abs((found.values - truth) / found.sigmas).max() < 4.0
    assert found.sigmas[21:27].max() < 2e-3
    # Without them the velocity at rest contradicts the noise by far.
    with pytest.raises(
        MeasurementError, match=r"times the noise.*has --lever-arms, --delay, --quadratic, --g"
    ):
        calibrate([log], SITE)


@pytest.mark.parametrize(("cone_rad", "expected_dph"), [(0.0, []), (2e-3, [pytest.approx(0.024, abs=0.002)])])
def test_vibration_that_cones_faster_than_the_samples_resolve_is_named(cone_rad, expected_dph):
    (angle, velocity), dt, w = eighteen(), 0.05, 2.0 * np.pi * 2.0
    phase = w * 0.5 * dt * np.arange(2 * len(angle) + 1)
    cone = cone_rad * np.column_stack([np.cos(phase), np.sin(phase), np.zeros(len(phase))])
    coned = angle + np.diff(cone[::2], axis=0) - [0.0, 0.0, 0.5 * cone_rad**2 * w * dt]
    declared = CalibrationOptions(walks=(Noise().angle_random_walk, Noise().velocity_random_walk))
    found = calibrate([recorded((coned, velocity - np.cross(cone[1::2], velocity)), 4)], SITE, declared)
    stated = re.findall(r"the z gyro is wrong by at least (\S+) deg/h", " ".join(found.findings))
    assert list(map(float, stated)) == expected_dph
    assert bool(expected_dph) == (abs(found.values[2] - TRUTH[2]) > 0.02 * DPH_TO_RADPS)


def test_biases_far_above_the_earth_rate_are_found():
    unit = rotated_unit(gyro_bias=np.array([4e-3, -2e-3, 3e-3]), gyro_matrix=100.0 * ERRORS["gyro_matrix"])
    noise = Noise(angle_random_walk=3e-5, white_velocity=1e-3)
    found = calibrate([recorded(unit.increments(), 8, noise=noise)], SITE)
    truth = SensorErrors(unit.gyro_bias, unit.gyro_matrix, unit.force_bias, unit.force_matrix).vector()
    assert np.abs((found.values - truth) / found.sigmas)[found.is_observed].max() < 4.5


@pytest.mark.parametrize("scale", [0.1, 0.2])
def test_the_estimate_converges_from_large_scale_factor_errors(scale):
    force_matrix = ERRORS["force_matrix"] + scale * np.eye(3)
    angle, velocity = eighteen()
    measured = velocity @ np.linalg.inv(np.eye(3) + ERRORS["force_matrix"]).T @ (np.eye(3) + force_matrix).T
    truth = SensorErrors(**(ERRORS | {"force_matrix": force_matrix})).vector()
    # The bias of a rest is measured before the change, too.
    bias = np.linalg.solve(np.eye(3) + ERRORS["force_matrix"], ERRORS["force_bias"])
    truth[12:15] = (np.eye(3) + force_matrix) @ bias
    found = calibrate([recorded((angle, measured), 12)], SITE)
    assert found.fit.p_value > 1e-3
    assert np.abs((found.values - truth) / found.sigmas).max() < 4.0


def test_specific_force_in_another_unit_than_declared_is_refused():
    angle, velocity = eighteen()
    with pytest.raises(
        MeasurementError, match=r"is 96\.\d+ m/s\^2, gravity 9\.806 m/s\^2.*accelerometers\.unit"
    ):
        calibrate([recorded((angle, velocity * 9.80665), 13)], SITE)


@pytest.mark.parametrize("scale", [np.pi / 180.0, 1e-3, np.pi / 180.0 / 3600.0])
def test_angles_in_a_smaller_unit_than_declared_are_refused(scale):
    angle, velocity = eighteen()
    with pytest.raises(MeasurementError, match=r"force turns by 90 deg and the gyros by .*'gyro\.unit'"):
        calibrate([recorded((angle * scale, velocity), 13)], SITE)


def test_gyros_that_do_not_resolve_the_earths_rotation_are_named():
    log = recorded(eighteen(), 13)
    angle = log.angle.copy()
    angle[: int(60.0 / log.interval_s)] = 0.0
    with pytest.raises(MeasurementError, match="Earth's rotation is below their resolution"):
        calibrate([replace(log, angle=angle)], SITE)


def test_a_scale_factor_that_no_sensor_has_is_refused():
    angle, velocity = eighteen()
    with pytest.raises(MeasurementError, match=r"accelerometer scale factor z is 0\.4.*'calibration\.acc"):
        calibrate([recorded((angle, velocity * [1.0, 1.0, 1.4]), 13)], SITE)


def test_a_wrong_hemisphere_or_accelerometers_upside_down_are_named():
    angle, velocity = eighteen()
    for force, latitude in ((velocity, -SITE.latitude), (-velocity, SITE.latitude)):
        with pytest.raises(
            MeasurementError, match=r"Correct either 'calibration\.latitude_deg' or the signs"
        ):
            calibrate([recorded((angle, force), 14)], Site(latitude))


@pytest.mark.parametrize("of_rates", [False, True])
def test_a_sample_interval_that_is_wrong_by_a_hundredth_is_named(of_rates):
    log = recorded(eighteen(), 14)
    scale = 1.01 if of_rates else 1.0
    wrong = IncrementRecording(log.interval_s * 1.01, log.angle * scale, log.velocity * scale)
    with pytest.raises(
        MeasurementError, match=r"if samples are 0\.0(4999|5) s apart and not 0\.0505 s\. Correct 'time'"
    ):
        calibrate([wrong], SITE)


def test_residuals_far_beyond_the_noise_give_no_table():
    angle, velocity = eighteen()
    drift = 2e-5 * np.linspace(0.0, 1.0, len(angle))[:, np.newaxis] ** 2  # a steady one is estimated
    with pytest.raises(MeasurementError, match="times the noise, at most 10 times is accepted"):
        calibrate([recorded((angle + 0.05 * drift, velocity), 14)], SITE)


def test_an_error_of_gravity_is_common_to_the_accelerometer_scale_factors():
    log = recorded(eighteen(), 14)
    known, unsure = (calibrate([log], SITE, CalibrationOptions(gravity_sigma=each)) for each in (0.0, 3e-4))
    scales = [INDEX[f"accelerometer_scale_factor_{axis}"] for axis in "xyz"]
    added = unsure.covariance - known.covariance
    np.testing.assert_allclose(np.sqrt(added[np.ix_(scales, scales)]), 3e-4 / SITE.gravity)
    assert np.count_nonzero(added) == 9


def test_recordings_at_different_rates_are_refused():
    slow = recorded(rotated_unit(rotations=(), dwell_s=70.0, sample_hz=10.0).increments(), 1, 10.0)
    with pytest.raises(MeasurementError, match="differ: 10 to 20 Hz"):
        calibrate([recorded(eighteen(), 14), slow], SITE)


def test_an_asymmetry_that_is_not_estimated_moves_the_biases_by_as_much_as_stated():
    angle, velocity = eighteen()
    is_turning = np.abs(angle) * 20.0 > np.deg2rad(1.0)
    measured = [
        calibrate([recorded((angle + 0.5e-6 * up * np.abs(angle) * is_turning, velocity), 1)], SITE)
        for up in (np.zeros(3), np.array([0.0, 1.0, 0.0]))
    ]
    moved = measured[1].values[:3] - measured[0].values[:3]
    np.testing.assert_allclose(1e-6 * bias_per_asymmetry(measured[0])[:, 1], moved, atol=0.02 * moved[1])
    assert moved[1] > 0.3 * measured[0].sigmas[1]
    with_all = calibrate([recorded(eighteen(), 1)], SITE, CalibrationOptions(asymmetries=(0, 1, 2)))
    assert bias_per_asymmetry(with_all).shape == (3, 0)
