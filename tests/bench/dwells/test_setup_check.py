"""Wrong scale, axes or damping of velocities and wrong hemisphere, in dwells of an independent strapdown."""

import re
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.bias.damping import Damping
from gyrobench.bench.bias.joint_solution import JointDwell, solve_jointly
from gyrobench.bench.bias.parameters import ErrorModel, PriorKnowledge
from gyrobench.bench.dwells.setup_check import drift_fault, measured_scales, setup_evidence, setup_fault
from tests.adversarial import frames
from tests.adversarial.frames import euler_deg
from tests.adversarial.harness import ALL, LATITUDES_DEG, Case, any_unit, measured_dwells
from tests.adversarial.strapdown import Place, Schedule
from tests.bench.bias.emulated_dwells import UG, emulate, noise_model, sensors, site

KNOT_MPS = 0.514444


def dwells_of(*, station=None, latitude_deg=36.4, seed=3, positions=ALL, window_s=600.0, **unit):
    """One dwell in each position."""
    random = np.random.default_rng(seed)
    unit, place = replace(any_unit(random), **unit), Place(latitude_deg)
    case = Case(unit, place, Schedule(window_s=window_s), station or {}, positions)
    return measured_dwells(case, random)


#: Each position is in one of these pairs of an upper and a lower one.
PAIRS = tuple(zip(ALL[::2], ALL[3::2] + ALL[1:2], strict=True))
LONG = pytest.mark.long
SCALES = (
    ((0.5,) * 3, "velocity_east and ins.signals.velocity_north have a wrong scale.*half the scale"),
    ((1.0 / KNOT_MPS,) * 3, "have a wrong scale.*knots taken for m/s"),
    ((3.6,) * 3, "have a wrong scale.*km/h taken for m/s"),
    ((1.0, 0.5, 1.0), "^ins.signals.velocity_north has a wrong scale"),
    ((2.0, 1.0, 1.0), "^ins.signals.velocity_east has a wrong scale"),
    ((1000.0,) * 3, r"± \d+ times the velocity.*mm/s taken for m/s"),
)
UNITS = (
    {},
    {"accelerometer_bias_ug": (-1000.0, 1000.0, 1000.0)},
    {"accelerometer_drift_ug_per_h": (30.0, -30.0, 30.0)},
    {"accelerometer_drift_ug_per_h": (100.0, -100.0, 100.0)},
    {"accelerometer_drift_ug_per_h": (300.0, 0.0, 0.0)},
    {"accelerometer_drift_ug_per_h": (300.0, -300.0, 300.0)},
    {"accelerometer_transient_ug": (20.0, -20.0, 20.0)},
    {"angle_random_walk": 0.0012},
    {"velocity_damping_s": 600.0},
    {"gyro_pulse_arcsec": 5.0},
    {"bias_step_dph": (0.0, 0.02, 0.0)},
    {"velocity_output_mps": 1e-3, "attitude_output_arcsec": 5.0},
)


@pytest.mark.parametrize(
    ("scale", "cause", "positions"),
    [
        *((*case, pair) for case, pair in zip((SCALES[0], SCALES[1], SCALES[3]), PAIRS, strict=True)),
        *(pytest.param(*case, ALL, marks=LONG) for case in SCALES),
    ],
)
def test_a_wrong_scale_of_the_velocities_is_named_in_every_dwell(scale, cause, positions):
    dwells = dwells_of(velocity_scale=scale, positions=positions)
    assert all("a wrong scale" in str(dwell.row.flags) for dwell in dwells)
    assert re.search(cause, dwells[-1].setup_fault), dwells[-1].setup_fault


def test_a_scale_that_each_dwell_leaves_open_is_found_by_all_together():
    dwells = dwells_of(velocity_scale=(0.85,) * 3)
    assert not any(setup_fault([dwell.evidence]) for dwell in dwells)
    assert all("a wrong scale" in str(dwell.row.flags) for dwell in dwells)


def test_a_scale_that_two_per_cent_are_wrong_is_found_where_biases_are_large():
    """As with gravity taken for 10 m/s^2: a bias of 0.3 deg/h would be wrong by 0.006."""
    dwells = dwells_of(velocity_scale=(1.0197,) * 3, gyro_bias_dph=(0.3, -0.2, 0.25))
    assert all("a wrong scale: 1.0" in str(dwell.row.flags) for dwell in dwells)


def test_a_small_wrong_scale_is_found_where_drifts_seem_to_follow_the_biases():
    wrong = dwells_of(velocity_scale=(1.05,) * 3, gyro_bias_dph=(0.1, -0.05, 0.07))
    assert not any(setup_fault([dwell.evidence]) for dwell in wrong)
    assert all("a wrong scale: 1.0" in str(dwell.row.flags) for dwell in wrong)
    # Drifts that differ from dwell to dwell do not pass for it.
    random = np.random.default_rng(0)
    drifting = [
        replace(dwell.evidence, velocities=replace(velocities, drift=drift))
        for dwell in dwells_of(gyro_bias_dph=(0.1, -0.05, 0.07))
        for velocities in [dwell.evidence.velocities]
        for drift in [velocities.drift + 60.0 * UG / 3600.0 * random.standard_normal(3)]
    ]
    assert setup_fault(drifting) == ""
    (scale, sigma), *_ = measured_scales(drifting)
    assert (abs(scale - 1.0) < 4.0 * sigma, sigma > 0.005) == (True, True)


@pytest.mark.parametrize(
    ("turned_deg", "positions"),
    [
        *(pytest.param(each, ALL, marks=LONG) for each in (20.0, -30.0, 60.0, 120.0, -165.0)),
        (120.0, PAIRS[1]),
    ],
)
def test_velocities_in_axes_turned_about_up_are_named_with_the_angle(turned_deg, positions):
    """As of an INS that navigates in wander azimuth and sends the true heading."""
    dwells = dwells_of(velocity_turned_deg=turned_deg, positions=positions)
    found = re.search(r"are turned by (\S+) ± (\S+) deg about Up", dwells[-1].setup_fault)
    assert found, dwells[-1].setup_fault
    away_deg = (float(found[1]) - turned_deg + 180.0) % 360.0 - 180.0
    assert abs(away_deg) < 4.0 * max(float(found[2]), 1.0)
    assert all("turned by" in str(dwell.row.flags) for dwell in dwells)


def test_a_right_angle_about_up_is_named_as_exchanged_axes():
    dwells = dwells_of(velocity_turned_deg=90.0, positions=ALL[:2])
    assert all("are exchanged and ins.signals.velocity_" in dwell.setup_fault for dwell in dwells)


@LONG
def test_axes_turned_about_up_are_found_beside_a_drift_of_the_accelerometers():
    dwells = dwells_of(velocity_turned_deg=20.0, accelerometer_drift_ug_per_h=(100.0, -100.0, 100.0))
    assert re.search(r"are turned by (1[6-9]|2[0-4])", dwells[-1].setup_fault), dwells[-1].setup_fault


@pytest.mark.parametrize(
    "latitude_deg",
    [pytest.param(each, marks=[] if each == -35.0 else [LONG]) for each in LATITUDES_DEG if abs(each) > 30.0],
)
def test_a_latitude_of_the_wrong_hemisphere_is_named_in_nearly_every_dwell(latitude_deg):
    """The Coriolis acceleration needs a velocity, which is small by chance where biases cancel."""
    station = {"location.latitude_deg": -latitude_deg}
    dwells = dwells_of(station=station, latitude_deg=latitude_deg)
    named = ["location.latitude_deg has the wrong sign" in str(dwell.row.flags) for dwell in dwells]
    assert sum(named) >= 5


def test_a_longitude_entered_as_latitude_is_found_by_all_dwells_together():
    dwells = dwells_of(station={"location.latitude_deg": 10.0}, latitude_deg=52.0)
    nearer = [re.search(r"latitude of the INS: at (\d+) deg, not 10 deg", str(each.flags)) for each in dwells]
    assert [found and found[1] for found in nearer] == ["40"] * 6


@pytest.mark.parametrize(
    ("unit", "positions"),
    [
        ({"velocity_damping_s": 600.0}, PAIRS[1]),
        pytest.param({"velocity_damping_s": 600.0}, ALL, marks=LONG),
        pytest.param({"accelerometer_transient_ug": (20.0, -20.0, 20.0)}, ALL, marks=LONG),
    ],
)
def test_a_wrong_hemisphere_is_named_by_the_error_model_in_a_unit_with_other_errors(unit, positions):
    dwells = dwells_of(station={"location.latitude_deg": -36.4}, positions=positions, **unit)
    assert any("at 36.4 deg, not -36.4 deg, the chi2" in str(dwell.row.flags) for dwell in dwells)


@pytest.mark.parametrize(
    ("unit", "latitude_deg", "positions"),
    [
        (UNITS[6], 36.4, PAIRS[0]),
        (UNITS[9], -52.0, PAIRS[1]),
        *(pytest.param(unit, at_deg, ALL, marks=LONG) for unit in UNITS for at_deg in (36.4, -52.0)),
    ],
)
def test_no_error_of_the_unit_passes_for_a_wrong_set_up(unit, latitude_deg, positions):
    dwells = dwells_of(latitude_deg=latitude_deg, positions=positions, **unit)
    assert [dwell.setup_fault for dwell in dwells] == [""] * len(positions)
    if evidence := [dwell.evidence for dwell in dwells if dwell.evidence]:
        (scale, sigma), *_ = measured_scales(evidence)
        assert abs(scale - 1.0) < 4.0 * sigma


@pytest.mark.parametrize(
    ("scale_ppm", "misalignment_arcsec", "positions", "expected"),
    [
        (0.0, 0.0, ALL[:1], 1.0),
        (200.0, 0.0, ALL[:1], 40.0),
        pytest.param(-100.0, 0.0, ALL[2:4], 20.0, marks=LONG),
        pytest.param(0.0, 60.0, ALL, 1.0, marks=LONG),
    ],
)
def test_turns_show_the_scale_factors_of_the_gyros(scale_ppm, misalignment_arcsec, positions, expected):
    dwells = dwells_of(
        gyro_scale_ppm=(scale_ppm,) * 3,
        gyro_misalignment_arcsec=misalignment_arcsec * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0]),
        positions=positions,
    )
    joint = [JointDwell(each.row.dwell, each.row.position, each.joint_information) for each in dwells]
    assert solve_jointly(joint, PriorKnowledge()).scale_factor_ratio == pytest.approx(expected, rel=0.2)


@pytest.mark.parametrize(
    ("sent", "declared", "position", "named"),
    [
        ("as declared", "rpy_321", "y_up", ""),
        ("as declared", "pry_231", "x_down", ""),
        ("the other", "rpy_321", "y_down", "sequence is rpy_321, in which roll is undefined"),
        ("the other", "pry_231", "x_up", "sequence is pry_231, in which pitch is undefined"),
        ("the other", "rpy_321", "x_up", ""),
    ],
)
def test_a_wrong_euler_sequence_shows_at_its_singularity(monkeypatch, sent, declared, position, named):
    is_pry = (declared == "pry_231") == (sent == "as declared")
    monkeypatch.setattr(frames, "euler_deg", lambda C_nb, _: euler_deg(C_nb, is_pry))
    station = {"ins.signals.attitude.euler.sequence": declared}
    (dwell,) = dwells_of(station=station, positions=(position,))
    assert named in dwell.setup_fault
    assert bool(named) == bool(dwell.setup_fault)


@pytest.mark.parametrize("aligns_again", [False, True])
def test_an_ins_that_aligns_again_is_flagged_by_its_velocity_if_the_heading_does_not_show_it(aligns_again):
    # Without a bias East a new alignment finds the same heading.
    (dwell,) = dwells_of(aligns_again=aligns_again, gyro_bias_dph=(0.0, 0.01, 0.0), positions=ALL[:1])
    assert ("window 2 begins with a velocity of zero" in str(dwell.flags)) == aligns_again


@pytest.mark.parametrize("positions", [PAIRS[1], pytest.param(ALL, marks=LONG)], ids=["pair", "all"])
def test_a_drift_of_the_accelerometers_beyond_what_is_declared_is_named_as_such(positions):
    drift = (300.0, -300.0, 300.0)
    dwells = dwells_of(accelerometer_drift_ug_per_h=drift, positions=positions)
    flags = [str(dwell.row.flags) for dwell in dwells]
    found = [re.search(r"the ([xyz]) accelerometer drifts by (\S+) ± (\S+) ug/h", text) for text in flags]
    assert all(found)
    for axis, drift_ug_per_h, sigma in (each.groups() for each in found):
        assert abs(float(drift_ug_per_h) - drift["xyz".index(axis)]) < 4.0 * float(sigma)
    station = {"ins.uncertainty.accelerometer_drift_ug_per_h": 300.0}
    declared = dwells_of(station=station, accelerometer_drift_ug_per_h=drift, positions=positions[:2])
    assert not any("accelerometer drifts" in str(dwell.row.flags) for dwell in declared)


@pytest.mark.parametrize(
    ("window_s", "damping_s", "positions"),
    [
        (240.0, 1500.0, ALL),
        *(
            pytest.param(*each, ALL * 2, marks=LONG)
            for each in ((240.0, 600.0), (240.0, 1500.0), (300.0, 2000.0))
        ),
    ],
)
def test_the_tilt_shows_a_damped_velocity_in_short_windows(window_s, damping_s, positions):
    dwells = dwells_of(window_s=window_s, velocity_damping_s=damping_s, positions=positions)
    assert all("damps its velocity" in str(dwell.row.flags) for dwell in dwells)
    rate = Damping.mean([dwell.evidence.velocities.damping for dwell in dwells]).rate
    assert 1.0 / rate == pytest.approx(damping_s, rel=0.3)


@pytest.mark.parametrize("position", ["z_up", "y_down"])
def test_a_bias_that_changes_with_the_turn_passes_for_no_damping_and_no_wrong_latitude(position):
    change = {"bias_step_dph": (0.044, 0.017, 0.033), "bias_step_s": 612.0}
    (dwell,) = dwells_of(seed=4, positions=(position,), **change)
    assert "a bias is not constant" in dwell.flags[0]
    assert not re.search("damps|latitude", str(dwell.flags))


@pytest.mark.parametrize(
    ("unit", "window_s", "positions"),
    [
        ({}, 240.0, PAIRS[0]),
        (UNITS[3], 240.0, PAIRS[2]),
        *(
            pytest.param(unit, window_s, ALL, marks=LONG)
            for unit in (UNITS[0], UNITS[3], UNITS[6])
            for window_s in (240.0, 300.0)
        ),
    ],
)
def test_short_windows_of_a_free_inertial_ins_do_not_pass_for_damped_ones(unit, window_s, positions):
    dwells = dwells_of(window_s=window_s, positions=positions, **unit)
    assert not any("damps its velocity" in str(dwell.row.flags) for dwell in dwells)
    assert [dwell.setup_fault for dwell in dwells] == [""] * len(positions)


@pytest.mark.parametrize(
    ("step_dph", "seed", "positions"),
    [
        ((0.0, 0.02, 0.0), 3, ("y_up", "x_down")),
        pytest.param((0.02, 0.0, 0.0), 4, ("y_up", "x_down"), marks=LONG),
    ],
)
def test_a_bias_that_steps_does_not_pass_for_the_other_hemisphere(step_dph, seed, positions):
    """The other latitude leaves much less of chi2, but not as little as a step of the bias does."""
    dwells = dwells_of(latitude_deg=-52.0, seed=seed, positions=positions, bias_step_dph=step_dph)
    assert [dwell.setup_fault for dwell in dwells] == ["", ""]
    assert any("a bias is not constant" in str(dwell.flags) for dwell in dwells)


@pytest.mark.parametrize(
    ("latitude_deg", "seed"),
    [(36.4, 3), pytest.param(-52.0, 4, marks=LONG), pytest.param(-52.0, 6, marks=LONG)],
)
def test_a_bias_that_changes_with_the_turn_passes_for_no_other_latitude(latitude_deg, seed):
    """As a bias that follows the heading; it leaves residuals at every latitude."""
    dwells = dwells_of(
        latitude_deg=latitude_deg,
        seed=seed,
        positions=("y_up", "x_down"),
        bias_step_dph=(0.03, -0.02, 0.0),
        bias_step_s=610.0,
    )
    assert [dwell.setup_fault for dwell in dwells] == ["", ""]
    assert all("a bias is not constant" in str(dwell.flags) for dwell in dwells)


@pytest.mark.parametrize("declared_ug_per_k", [0.0, 2.0])
def test_accelerometers_that_follow_the_temperature_pass_for_no_wrong_scale_and_no_drift(declared_ug_per_k):
    """On a ramp of 60 K/h: their part of the velocity looks like that of a tilt."""

    def warming(time_s):
        return np.tile(time_s[:, np.newaxis] / 60.0, 3)

    noise = noise_model(0.0006)
    ins = sensors(
        (0.01, -0.01, 0.01), noise=noise, accelerometer_bias_change=lambda time_s: 2.0 * UG * warming(time_s)
    )
    dwell = emulate(ins=ins, noise=noise, random=np.random.default_rng(1), gyro_c=warming)
    known = PriorKnowledge.from_datasheet(accelerometer_slope_ug_per_c=declared_ug_per_k)
    unknown = replace(dwell, windows=tuple(replace(each, accelerometer_c=None) for each in dwell.windows))
    with_temperatures, without = (
        setup_evidence(each, ErrorModel(site(), noise, known), 0.0, is_latitude_sent=True)
        for each in (dwell, unknown)
    )
    assert setup_fault([with_temperatures]) == drift_fault(with_temperatures.velocities) == ""
    assert "accelerometer drifts by 1" in drift_fault(without.velocities)
