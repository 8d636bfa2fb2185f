"""Where the body axes point, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gyrobench.bench.live.picture_parts import Attitude
from gyrobench.bench.navigation.positions import AXES

_NAMES = (("East", "West"), ("North", "South"), ("Up", "Down"))
#: From there on an axis is said to point in a direction, and below the rest of it not to lean to it.
_ALONG = math.cos(math.radians(10.0))


def directions(attitude: Attitude) -> str:
    """Say where the body axes point: "x East, y South, z Down", or "x East-North" for one in between."""
    columns = zip(*attitude.body_in_enu, strict=True)
    return ", ".join(f"{name} {_direction(column)}" for name, column in zip(AXES, columns, strict=True))


def _direction(cosines: Sequence[float]) -> str:
    """Direction of an axis in a word, or two or three where it lies between."""
    nearest_first = sorted(range(3), key=lambda index: -abs(cosines[index]))
    if abs(cosines[nearest_first[0]]) >= _ALONG:
        nearest_first = nearest_first[:1]
    named = [index for index in nearest_first if abs(cosines[index]) > 1.0 - _ALONG]
    return "-".join(_NAMES[index][cosines[index] < 0.0] for index in named)
