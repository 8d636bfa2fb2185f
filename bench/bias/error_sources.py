"""Error sources of measured biases and coefficients, with their names in uncertainty budgets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from gyrobench.bench.foundations.arrays import (
    DEG_PER_SQRT_H_TO_SI,
    DPH_TO_RADPS,
    RAD_TO_ARCMIN,
    RAD_TO_ARCSEC,
    RADPS_TO_DPH,
    UG_PER_SQRT_HZ_TO_SI,
    UG_TO_MPS2,
)


@dataclass(frozen=True)
class ErrorSource:
    """A source of error."""

    title: str  #: Name in reports.
    unit: str
    per_si: float  #: Factor from SI to the unit.
    is_common: bool = False  #: Whether the error is the same in all dwells of a bin.
    note: str = ""
    #: Whether it is the same in all dwells of one attitude, at any temperature.
    is_of_attitude: bool = False


_DECLARED = "declared in ins.uncertainty"
#: Sources by their names in tables, in the order of the tables.
SOURCES: Mapping[str, ErrorSource] = MappingProxyType(
    {
        "angle_random_walk": ErrorSource(
            "angle random walk of the gyros", "deg/sqrt(h)", 1 / DEG_PER_SQRT_H_TO_SI
        ),
        "velocity_random_walk": ErrorSource(
            "velocity random walk of the accelerometers", "ug/sqrt(Hz)", 1 / UG_PER_SQRT_HZ_TO_SI
        ),
        "velocity_output": ErrorSource("noise and resolution of the velocity output", "m/s", 1.0),
        "heading_output": ErrorSource("noise and resolution of the attitude output", "urad", 1e6),
        "accelerometer_bias": ErrorSource(
            "accelerometer bias",
            "ug",
            1 / UG_TO_MPS2,
            True,
            "prior knowledge; where it is large, the data decide",
        ),
        "accelerometer_drift": ErrorSource(
            "drift of the accelerometers in the dwell", "ug/h", 3600 / UG_TO_MPS2, note=_DECLARED
        ),
        "accelerometer_slope": ErrorSource(
            "accelerometer temperature within the dwell", "ug/K", 1 / UG_TO_MPS2, True, _DECLARED
        ),
        "accelerometer_settling": ErrorSource(
            "settling of the accelerometers after the turn", "ug", 1 / UG_TO_MPS2, True, _DECLARED
        ),
        "gyro_scale_factor": ErrorSource(
            "gyro scale factor in the turn", "ppm", 1e6, True, _DECLARED, is_of_attitude=True
        ),
        "gyro_misalignment": ErrorSource(
            "gyro misalignment in the turn", "arcsec", RAD_TO_ARCSEC, True, _DECLARED, is_of_attitude=True
        ),
        "tilt_step": ErrorSource(
            "tilt of the sensors on their mount in the turn", "arcsec", RAD_TO_ARCSEC, False, _DECLARED
        ),
        "latitude": ErrorSource(
            "latitude and deflection of the vertical",
            "arcmin",
            RAD_TO_ARCMIN,
            True,
            "declared in location.latitude_uncertainty_arcmin",
            is_of_attitude=True,
        ),
        "bias_slope": ErrorSource(
            "gyro temperature within the dwell", "deg/h/K", RADPS_TO_DPH, True, _DECLARED
        ),
        "initial_state": ErrorSource(
            "initial attitude and velocity", "", 1.0, note="estimated from the data"
        ),
        "dwells": ErrorSource("dwells of the plateau", "", 1.0, note="noise, drift, tilt: see their budgets"),
        "bias_drift": ErrorSource("drift of the gyro biases", "", 1.0, note="estimated from the data"),
        "white_angle": ErrorSource("noise and resolution of the angle increments", "urad", 1e6),
        "white_velocity": ErrorSource("noise and resolution of the velocity increments", "m/s", 1.0),
        "table_return": ErrorSource(
            "return of the table after whole turns",
            "arcsec",
            RAD_TO_ARCSEC,
            note="declared in rate_table.repeatability_arcsec",
        ),
        "g_sensitivity": ErrorSource(
            "gyro biases that follow the specific force",
            "",
            1.0,
            note="0.01 deg/h for each g; only if the rotations are too few to show them",
        ),
        "quadratic": ErrorSource(
            "quadratic terms of the accelerometers", "", 1.0, note="20 ug/g^2; estimated from the data"
        ),
        "gravity": ErrorSource("gravity", "m/s^2", 1.0, note="declared, or an anomaly of 30 mGal"),
        "temperature_change": ErrorSource(
            "change of temperature within the plateau",
            "",
            1.0,
            note="slope between plateaus times the range of temperatures; with two plateaus or more",
        ),
        "misfit": ErrorSource(
            "residuals beyond the noise", "", 1.0, note="the model does not explain the data"
        ),
        "assumed_size": ErrorSource(
            "assumed size of the coefficients", "", 1.0, note="large; the data decide what they show"
        ),
        "temperature_sensor": ErrorSource("temperature sensor of the gyro", "K", 1.0, True),
        "power_cycles": ErrorSource("repeatability between power cycles", "deg/h", DPH_TO_RADPS),
    }
)
