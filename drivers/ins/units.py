"""Dimensions of the quantities that an INS sends, and the spellings of their units."""

from __future__ import annotations

from enum import StrEnum
from types import MappingProxyType

import numpy as np

from gyrobench.bench.foundations.arrays import DPH_TO_RADPS, STANDARD_GRAVITY


class Dimension(StrEnum):
    """Physical dimension of a quantity, which determines the units that its signal may have."""

    TIME = "time"
    SPEED = "speed"
    ANGLE = "angle"
    ANGULAR_RATE = "angular rate"
    ACCELERATION = "acceleration"
    TEMPERATURE = "temperature"
    NUMBER = "number"


_KNOT_MPS = 1852.0 / 3600.0
_DEGREE_RAD = np.pi / 180.0
_ZERO_C_IN_K = 273.15

#: Gain and offset of each unit to SI or degrees Celsius, by dimension and spelling of the unit.
UNIT_SPELLINGS: MappingProxyType[Dimension, dict[str, tuple[float, float]]] = MappingProxyType(
    {
        Dimension.TIME: {
            **dict.fromkeys(("s", "sec"), (1.0, 0.0)),
            "ms": (1e-3, 0.0),
            **dict.fromkeys(("us", "µs", "μs"), (1e-6, 0.0)),
            "ns": (1e-9, 0.0),
        },
        Dimension.SPEED: {
            **dict.fromkeys(("m/s", "m.s-1", "mps"), (1.0, 0.0)),
            **dict.fromkeys(("kt", "kn", "knot", "knots"), (_KNOT_MPS, 0.0)),
            **dict.fromkeys(("km/h", "kph"), (1.0 / 3.6, 0.0)),
        },
        Dimension.ANGLE: {
            **dict.fromkeys(("rad", "radian"), (1.0, 0.0)),
            **dict.fromkeys(("deg", "degree", "degrees", "°"), (_DEGREE_RAD, 0.0)),
            "arcsec": (_DEGREE_RAD / 3600.0, 0.0),
        },
        Dimension.ANGULAR_RATE: {
            "rad/s": (1.0, 0.0),
            **dict.fromkeys(("deg/s", "°/s"), (_DEGREE_RAD, 0.0)),
            **dict.fromkeys(("deg/h", "°/h"), (DPH_TO_RADPS, 0.0)),
        },
        Dimension.ACCELERATION: {
            **dict.fromkeys(("m/s2", "m/s^2", "m/s²"), (1.0, 0.0)),
            "g": (STANDARD_GRAVITY, 0.0),
            "mg": (1e-3 * STANDARD_GRAVITY, 0.0),
        },
        Dimension.TEMPERATURE: {
            **dict.fromkeys(("degC", "deg C", "°C", "C"), (1.0, 0.0)),
            "K": (1.0, -_ZERO_C_IN_K),
            **dict.fromkeys(("degF", "deg F", "°F", "F"), (5.0 / 9.0, -160.0 / 9.0)),
        },
    }
)
