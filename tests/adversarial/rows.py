"""The rows of the table: what is done wrong, and what its flag must name."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from tests.adversarial.harness import Case, Row

VELOCITY = "VELOCITY_NE.VELOCITY_"
EULER = "ins.signals.attitude.euler"


def _nothing(case: Case) -> Case:
    return case


def _unit(**fields: Any) -> Any:
    """Another unit."""
    return lambda case: replace(case, unit=replace(case.unit, **fields))


def _station(changes: Mapping[str, Any]) -> Any:
    """Another station file."""
    return lambda case: replace(case, station={**case.station, **changes})


def _latitude(error_arcmin: float) -> Any:
    return lambda case: replace(case, place=replace(case.place, latitude_error_arcmin=error_arcmin))


def _base(east_deg: float, north_deg: float, up_deg: float) -> Any:
    """A table whose base is turned."""
    turned = (east_deg, north_deg, up_deg)
    return lambda case: replace(case, place=replace(case.place, table_turned_deg=turned))


def _mirrored(*names: str) -> Any:
    return _station(
        {
            f"ins.signals.velocity_{name}": {"signal": f"{VELOCITY}{name.upper()}", "sign": -1}
            for name in names
        }
    )


def _reversed(angle: str) -> dict[str, Any]:
    return {"signal": f"ROLL_PITCH.{angle}", "sign": -1}


def _sequence(name: str) -> Any:
    return _station({f"{EULER}.sequence": name})


def _opposite_latitude(case: Case) -> Case:
    return _station({"location.latitude_deg": -case.place.latitude_deg})(case)


def _longitude(degrees: float) -> Any:
    """A longitude for the latitude in the station file; the INS, which sends none, has the right one."""
    return _station({"location.latitude_deg": degrees})


def _degrees_and_minutes(case: Case) -> Case:
    """54 minutes of latitude entered as 0.54 deg in the station file; the INS has the right latitude."""
    whole = float(int(case.place.latitude_deg))
    minutes = math.copysign(54.0, whole)
    place = replace(case.place, latitude_deg=whole + minutes / 60.0)
    return _station({"location.latitude_deg": whole + minutes / 100.0})(replace(case, place=place))


def _height_in_feet(case: Case) -> Case:
    return _station({"location.height_m": 5380.0})(replace(case, place=replace(case.place, height_m=1640.0)))


def _mounted(x: str, y: str, z: str) -> Any:
    """A unit on the table as the station file does not say: its z axis by right angles elsewhere."""
    return _station({"rate_table.mounting": {"x": x, "y": y, "z": z}})


def _clocks(case: Case) -> Case:
    return replace(case, arrival_jitter_s=0.005, arrival_drift=1e-4)


_TEMPERATURE = "ins.signals.gyro_optics_temperature"
_EXCHANGED_TEMPERATURES = {
    f"{_TEMPERATURE}.x": "GYRO_OPTICS_TEMPERATURE.Y",
    f"{_TEMPERATURE}.y": "GYRO_OPTICS_TEMPERATURE.X",
}
_EXCHANGED_ANGLES = {f"{EULER}.roll": "ROLL_PITCH.PITCH", f"{EULER}.pitch": "ROLL_PITCH.ROLL"}
_EXCHANGED = {
    "ins.signals.velocity_east": f"{VELOCITY}NORTH",
    "ins.signals.velocity_north": f"{VELOCITY}EAST",
}

#: With nothing wrong.
CLEAN = Row("nothing", _nothing, runs=84)

ROWS = (
    Row("velocity_north with the wrong sign", _mirrored("north"), "velocity_north"),
    Row("velocity_east with the wrong sign", _mirrored("east"), "velocity_east"),
    Row("both velocities with the wrong sign", _mirrored("north", "east"), "velocity_(north|east)"),
    Row("east and north exchanged", _station(_EXCHANGED), "exchange"),
    Row("yaw_positive wrong", _station({f"{EULER}.yaw_positive": "up"}), "yaw_positive"),
    Row("roll with the wrong sign", _station({f"{EULER}.roll": _reversed("ROLL")}), "roll"),
    Row("pitch with the wrong sign", _station({f"{EULER}.pitch": _reversed("PITCH")}), "pitch"),
    Row("roll and pitch exchanged", _station(_EXCHANGED_ANGLES), "exchange"),
    Row("Euler sequence rpy_321, of an INS that changes it", _sequence("rpy_321"), "sequence"),
    Row("Euler sequence pry_231, of an INS that changes it", _sequence("pry_231"), "sequence"),
    Row("velocities with half their scale", _unit(velocity_scale=(0.5,) * 3), "half the scale"),
    Row("velocities in knots taken for m/s", _unit(velocity_scale=(1.0 / 0.514444,) * 3), "knots"),
    Row(
        "velocities with 1.05 times their scale, biases near 0.1 deg/h",
        _unit(velocity_scale=(1.05,) * 3, gyro_bias_dph=(0.1, -0.05, 0.07)),
        "a wrong scale",
    ),
    Row("velocities turned by 10 deg about Up", _unit(velocity_turned_deg=10.0), "turned"),
    Row("latitude with the wrong sign", _opposite_latitude, "latitude_deg has the wrong sign"),
    Row("latitude 1 arcmin off", _latitude(1.0), "latitude"),
    Row("latitude -1 arcmin off", _latitude(-1.0), "latitude"),
    Row("latitude -3 arcmin off", _latitude(-3.0), "latitude"),
    Row("latitude 20 arcmin off", _latitude(20.0), "latitude"),
    Row("latitude 1 deg off", _latitude(60.0), "latitude"),
    Row("latitude in degrees and minutes, 0.36 deg off, in the station alone", _degrees_and_minutes),
    Row("longitude 10 deg for the latitude in the station alone", _longitude(10.0), "latitude_deg"),
    Row("longitude 70 deg for the latitude in the station alone", _longitude(70.0), "latitude_deg"),
    Row("height of 1640 m entered in feet", _height_in_feet),
    Row("outer axis of the table reversed", _station({"rate_table.outer_axis": "west"}), "outer_axis"),
    Row("inner axis of the table reversed", _station({"rate_table.inner_axis": "down"}), "inner_axis"),
    Row("unit turned by 90 deg on the table", _mounted("north", "west", "up"), "mounting"),
    Row("unit turned by 180 deg on the table", _mounted("west", "south", "up"), "mounting"),
    Row("unit upside down on the table", _mounted("east", "south", "down"), "mounting"),
    Row("table tilted by 0.1 deg", _base(0.1, -0.1, 0.0)),
    Row("table tilted by 1 deg", _base(1.0, 1.0, 0.0)),
    Row("north reference of the table 1 deg off", _base(0.0, 0.0, 1.0)),
    Row("north reference of the table 10 deg off", _base(0.0, 0.0, -10.0), "lost its zero"),
    Row("unit 0.3 m off the intersection of the table's axes", _unit(lever_arm_m=(0.3, 0.1, 0.05))),
    Row("deflection of the vertical by 8 arcsec", _latitude(8.0 / 60.0)),
    Row("deflection of the vertical by 20 arcsec", _latitude(20.0 / 60.0)),
    Row(
        "accelerometer transient of 20 ug after the turn, 120 s",
        _unit(accelerometer_transient_ug=(20.0, -20.0, 20.0)),
        "accelerometer",
    ),
    Row(
        "accelerometer transient of 10 ug after the turn, 120 s",
        _unit(accelerometer_transient_ug=(10.0, 10.0, -10.0)),
        "accelerometer",
    ),
    Row(
        "accelerometer drift of 10 ug/h, undeclared",
        _unit(accelerometer_drift_ug_per_h=(10.0, -10.0, -10.0)),
        "accelerometer",
    ),
    Row(
        "accelerometer drift of 30 ug/h, undeclared",
        _unit(accelerometer_drift_ug_per_h=(30.0, -30.0, 30.0)),
        "accelerometer",
    ),
    Row("velocity damped with 600 s", _unit(velocity_damping_s=600.0), "damp"),
    Row("alignment again after the turn, unreported", _unit(aligns_again=True), "aligned again"),
    Row(
        "alignment again after the turn, unreported, with velocity noise of 3 mm/s, undeclared",
        _unit(aligns_again=True, velocity_output_mps=0.003),
        "aligned again",
    ),
    Row(
        "gyro bias North removed in the alignment, biases near 0.05 deg/h",
        _unit(removed_bias=(0.0, 0.9, 0.0), gyro_bias_dph=(0.05, -0.04, 0.06)),
        "removes? in its alignment .* along North",
    ),
    Row(
        "gyro biases North and Up removed in the alignment, biases near 0.05 deg/h",
        _unit(removed_bias=(0.0, 1.0, 1.0), gyro_bias_dph=(0.05, -0.04, 0.06)),
        "removes? in its alignment .* along North and Up",
    ),
    Row("heading held by an aid with 3 s", _unit(heading_aid_s=3.0), "holds its heading"),
    Row("heading held by an aid with 60 s", _unit(heading_aid_s=60.0), "holds its heading"),
    Row("heading held by an aid with 200 s", _unit(heading_aid_s=200.0), "holds its heading"),
    Row("noise 2 times what is declared", _unit(angle_random_walk=0.0012), "noise"),
    Row("noise 1.3 times what is declared", _unit(angle_random_walk=0.00078), "noise"),
    Row(
        "noise 1.3 times what the data sheet says, `noise: estimated`",
        lambda case: _station({"ins.noise": "estimated"})(_unit(angle_random_walk=0.00078)(case)),
        "noise",
    ),
    Row("bias step of 0.01 deg/h in mid-window", _unit(bias_step_dph=(0.01, 0.01, 0.01)), "bias", runs=10),
    Row("bias step of 0.02 deg/h of one gyro", _unit(bias_step_dph=(0.0, 0.02, 0.0)), "bias"),
    Row("accelerometer biases of 300 ug", _unit(accelerometer_bias_ug=(300.0, -300.0, 300.0))),
    Row("accelerometer biases of 500 ug", _unit(accelerometer_bias_ug=(500.0, 500.0, -500.0))),
    Row("accelerometer biases of 1000 ug", _unit(accelerometer_bias_ug=(-1000.0, 1000.0, 1000.0))),
    Row(
        "accelerometer misalignments of 20 arcsec",
        _unit(accelerometer_misalignment_arcsec=(20.0, -20.0, 20.0, -20.0, 20.0, -20.0)),
    ),
    Row(
        "gyro misalignments of 20 arcsec, 2 declared",
        _unit(gyro_misalignment_arcsec=(20.0, -20.0, 20.0, 20.0, -20.0, 20.0)),
    ),
    Row(
        "gyro misalignments of 60 arcsec, 2 declared",
        _unit(gyro_misalignment_arcsec=(60.0, -60.0, 60.0, 60.0, -60.0, 60.0)),
    ),
    Row(
        "gyro scale factors of 200 ppm, 5 declared",
        _unit(gyro_scale_ppm=(200.0, 200.0, 200.0)),
        "scale factor",
    ),
    Row("temperatures of the x and y gyros exchanged", _station(_EXCHANGED_TEMPERATURES)),
    Row("epoch_period_s of 0.2 s for 0.1 s", _station({"ins.signals.epoch_period_s": 0.2}), "epoch_period_s"),
    Row("arrival of frames off by 5 ms rms and 100 ppm", _clocks),
    Row("undithered gyro pulses of 0.5 arcsec", _unit(gyro_pulse_arcsec=0.5), "resol"),
    Row("undithered gyro pulses of 5 arcsec", _unit(gyro_pulse_arcsec=5.0), "resol"),
)
