"""Dimensions of the quantities that an INS sends, their units, and the spellings of these."""

from __future__ import annotations

import re
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

# fmt: off
_SPELLINGS = (
    ("°|degrees?", "deg"), ("[µμ]", "u"), (r"²|\^2|\*\*2", "2"), (" per ", "/"), (r"sec(ond)?s?(?=2?$)", "s"),
    (r"/h(ou)?rs?$", "/h"), ("/s/s$", "/s2"),
)
# fmt: on
_SYNONYMS = {"dps": "deg/s", "mdps": "mdeg/s", "radps": "rad/s", "dph": "deg/h", "mps2": "m/s2"}


def usual_spelling(unit: str) -> str:
    """The unit as the files of this package spell it: deg/h for "°/hr", m/s2 for "m/s²"."""
    if not unit.startswith("arc"):
        for pattern, spelling in _SPELLINGS:
            unit = re.sub(pattern, spelling, unit)
    return _SYNONYMS.get(unit, unit)


#: Gain and offset of each unit to SI or degrees Celsius, by dimension and its :func:`usual_spelling`.
UNITS: MappingProxyType[Dimension, dict[str, tuple[float, float]]] = MappingProxyType(
    {
        Dimension.TIME: {"s": (1.0, 0.0), "ms": (1e-3, 0.0), "us": (1e-6, 0.0), "ns": (1e-9, 0.0)},
        Dimension.SPEED: {
            **dict.fromkeys(("m/s", "m.s-1", "mps"), (1.0, 0.0)),
            "cm/s": (1e-2, 0.0),
            "mm/s": (1e-3, 0.0),
            **dict.fromkeys(("kt", "kn", "knot", "knots"), (_KNOT_MPS, 0.0)),
            **dict.fromkeys(("km/h", "kph"), (1.0 / 3.6, 0.0)),
        },
        Dimension.ANGLE: {
            **dict.fromkeys(("rad", "radian"), (1.0, 0.0)),
            "mrad": (1e-3, 0.0),
            "urad": (1e-6, 0.0),
            "deg": (_DEGREE_RAD, 0.0),
            "mdeg": (1e-3 * _DEGREE_RAD, 0.0),
            "arcmin": (_DEGREE_RAD / 60.0, 0.0),
            "arcsec": (_DEGREE_RAD / 3600.0, 0.0),
        },
        Dimension.ANGULAR_RATE: {
            "rad/s": (1.0, 0.0),
            "mrad/s": (1e-3, 0.0),
            "deg/s": (_DEGREE_RAD, 0.0),
            "mdeg/s": (1e-3 * _DEGREE_RAD, 0.0),
            "deg/h": (DPH_TO_RADPS, 0.0),
        },
        Dimension.ACCELERATION: {
            "m/s2": (1.0, 0.0),
            "g": (STANDARD_GRAVITY, 0.0),
            "mg": (1e-3 * STANDARD_GRAVITY, 0.0),
            "ug": (1e-6 * STANDARD_GRAVITY, 0.0),
        },
        Dimension.TEMPERATURE: {
            **dict.fromkeys(("degC", "deg C", "C"), (1.0, 0.0)),
            "K": (1.0, -_ZERO_C_IN_K),
            **dict.fromkeys(("degF", "deg F", "F"), (5.0 / 9.0, -160.0 / 9.0)),
        },
    }
)
