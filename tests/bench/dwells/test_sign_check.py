"""Wrong signs and axes of the signal map, in dwells of a strapdown that shares no code with the bench."""

import re
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.dwells.measure_dwell import measure_dwell
from tests.adversarial.frames import dwell_frames
from tests.adversarial.harness import Case, any_unit, dwell_angles, setup_of
from tests.adversarial.rows import EULER, VELOCITY
from tests.adversarial.strapdown import Place, Schedule, simulate

LONG = pytest.mark.long
SIGNALS = "ins.signals"
EXCHANGED = {f"{SIGNALS}.velocity_{a}": f"{VELOCITY}{b}" for a, b in (("east", "NORTH"), ("north", "EAST"))}
SHORT = Schedule(window_s=75.0)
MIRRORED = {
    name: {f"{SIGNALS}.velocity_{name}": {"signal": f"{VELOCITY}{name.upper()}", "sign": -1}}
    for name in ("east", "north")
}


def measured(station, position="z_up", seed=1, schedule=None, **unit):
    random = np.random.default_rng(seed)
    case = Case(replace(any_unit(random), **unit), Place(), schedule or Schedule(), station)
    setup = setup_of(case)
    angles = dwell_angles(setup, position)
    output = simulate(case.unit, case.place, case.schedule, angles, random)
    return measure_dwell(*dwell_frames(output, position, angles, 1, random), setup)


@pytest.mark.parametrize(
    ("name", "position"),
    [
        ("east", "y_down"),
        ("north", "z_up"),
        *(pytest.param(*each, marks=LONG) for each in (("east", "z_up"), ("north", "x_up"))),
    ],
)
def test_a_velocity_with_the_wrong_sign_is_named_and_gives_no_bias(name, position):
    dwell = measured(MIRRORED[name], position)
    assert dwell.setup_fault.startswith(f"{SIGNALS}.velocity_{name} has the wrong sign: at rest")
    assert dwell.flags == (dwell.setup_fault,)
    assert np.isnan(dwell.row.bias_dph).all()


def test_both_velocities_with_the_wrong_sign_are_named_beside_what_would_look_the_same():
    """With z up, angles with the wrong sign tilt the other way, and nothing else shows."""
    fault = measured(MIRRORED["east"] | MIRRORED["north"]).setup_fault
    assert "velocity_east has the wrong sign and ins.signals.velocity_north has the wrong sign; or" in fault
    assert "euler.roll has the wrong sign and ins.signals.attitude.euler.pitch has the wrong sign" in fault
    assert "euler" not in measured(MIRRORED["east"] | MIRRORED["north"], "x_up").setup_fault


@pytest.mark.parametrize("station", [{}, EXCHANGED], ids=["right", "exchanged"])
def test_short_windows_pass_any_axes_and_do_not_count_as_a_test(station):
    dwell = measured(station, schedule=SHORT)
    assert (dwell.setup_fault, dwell.are_signs_tested) == ("", False)


@pytest.mark.parametrize("position", ["z_up", "x_down"])
@pytest.mark.parametrize("seed", [1, *(pytest.param(each, marks=LONG) for each in (2, 3))])
def test_windows_of_ten_minutes_test_signs_and_axes(position, seed):
    assert measured({}, position, seed).are_signs_tested


def test_output_too_coarse_does_not_count_as_a_test():
    assert not measured({}, velocity_output_mps=0.02, attitude_output_arcsec=5.0).are_signs_tested


def test_east_and_north_exchanged_are_named():
    fault = measured(EXCHANGED).setup_fault
    assert fault.startswith(f"{SIGNALS}.velocity_east and {SIGNALS}.velocity_north are exchanged")


@pytest.mark.parametrize("position", ["y_up", pytest.param("x_down", marks=LONG)])
def test_a_heading_with_the_wrong_sense_is_named(position):
    fault = measured({f"{EULER}.yaw_positive": "up"}, position).setup_fault
    assert fault.startswith(f"{EULER}.yaw_positive is 'up' in place of 'down': the attitude deviates")
    off_deg, otherwise_deg = map(float, re.search(r"by (\S+) deg, and by (\S+) deg", fault).groups())
    assert off_deg > 80.0
    assert otherwise_deg < 5.0


@pytest.mark.parametrize(
    ("angle", "position"), [pytest.param("ROLL", "z_up", marks=LONG), ("PITCH", "z_up"), ("ROLL", "x_up")]
)
def test_roll_or_pitch_with_the_wrong_sign_is_named(angle, position):
    name = f"{EULER}.{angle.lower()}"
    fault = measured({name: {"signal": f"ROLL_PITCH.{angle}", "sign": -1}}, position).setup_fault
    assert f"{name} has the wrong sign" in fault


def test_roll_and_pitch_exchanged_are_named():
    exchanged = {f"{EULER}.roll": "ROLL_PITCH.PITCH", f"{EULER}.pitch": "ROLL_PITCH.ROLL"}
    assert "euler.roll and ins.signals.attitude.euler.pitch are exchanged" in measured(exchanged).setup_fault


def fault_of_table(wrong, position):
    """What is named where the station file is wrong about the table, not about the INS."""
    random = np.random.default_rng(1)
    case = Case(any_unit(random), Place(), Schedule(), {})
    angles = dwell_angles(setup_of(case), position)
    output = simulate(case.unit, case.place, case.schedule, angles, random)
    setup = setup_of(replace(case, station=wrong))
    return measure_dwell(*dwell_frames(output, position, angles, 1, random), setup).setup_fault


@pytest.mark.parametrize(
    ("axis", "direction", "position"),
    [
        ("inner_axis", "down", "y_up"),
        pytest.param("inner_axis", "down", "x_down", marks=LONG),
        pytest.param("outer_axis", "west", "y_down", marks=LONG),
        ("outer_axis", "west", "x_up"),
    ],
)
def test_a_wrong_direction_of_the_table_alone_is_named_where_the_data_distinguish_it(
    axis, direction, position
):
    fault = fault_of_table({f"rate_table.{axis}": direction}, position)
    assert re.match(rf"rate_table\.{axis} has the wrong direction \([^)]*\): the attitude deviates", fault)


def test_wrong_directions_of_both_axes_are_named():
    fault = fault_of_table({"rate_table.outer_axis": "west", "rate_table.inner_axis": "down"}, "y_up")
    assert fault.startswith("rate_table.inner_axis has the wrong direction")
    assert "and rate_table.outer_axis has the wrong direction" in fault
    assert "; or" not in fault


@pytest.mark.parametrize("position", ["z_up", pytest.param("z_down", marks=LONG)])
def test_with_z_vertical_a_wrong_inner_axis_and_a_wrong_heading_are_both_named(position):
    of_table = fault_of_table({"rate_table.inner_axis": "down"}, position)
    of_heading = measured({f"{EULER}.yaw_positive": "up"}, position).setup_fault
    for fault, wrong, right in ((of_table, "down", "up"), (of_heading, "up", "down")):
        assert fault.startswith("rate_table.inner_axis has the wrong direction")
        assert f"; or {EULER}.yaw_positive is '{wrong}' in place of '{right}': the attitude" in fault


@pytest.mark.parametrize(
    ("position", "unit"),
    [
        ("z_up", {"accelerometer_bias_ug": (1000.0, -1000.0, 1000.0)}),
        ("x_down", {"accelerometer_bias_ug": (1000.0, -1000.0, 1000.0)}),
        ("y_up", {"accelerometer_transient_ug": (50.0, -50.0, 50.0)}),
        ("x_down", {"velocity_damping_s": 600.0}),
        ("y_up", {"lever_arm_m": (0.2, -0.1, 0.1)}),
        ("z_up", {"gyro_pulse_arcsec": 0.5}),
        (
            "x_down",
            {"angle_random_walk": 0.0001, "velocity_random_walk": 50.0, "gyro_bias_dph": (0.0, 0.0, 0.0)},
        ),
        ("y_up", {"velocity_output_mps": 0.02, "attitude_output_arcsec": 5.0}),
    ],
)
def test_no_error_of_the_unit_passes_for_a_wrong_sign(position, unit):
    assert measured({}, position, **unit).setup_fault == ""
