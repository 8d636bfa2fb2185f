"""How the unit stands: its body axes, drawn as seen from the south and above."""

from __future__ import annotations

import math

from rich.text import Text

from gyrobench.bench.live.canvas import Canvas, Point
from gyrobench.bench.live.picture_parts import Attitude, Triple

_STYLES = ("red", "green", "cyan")
#: The direction that the picture is seen from: turned to the east, and raised, by these angles.
_TURN_RAD, _RAISE_RAD = math.radians(25.0), math.radians(25.0)
#: A character is twice as high as it is wide.
_ASPECT = 2.0


def axes_drawing(attitude: Attitude, width: int, height: int, is_ascii: bool) -> list[Text]:
    """Draw the body axes in so many characters."""
    canvas = Canvas(width, height, is_ascii)
    reach = min(0.5, 0.5 * height * _ASPECT / width) * 0.9
    middle: Point = (0.5, 0.5)
    columns = tuple(zip(*attitude.body_in_enu, strict=True))
    # What points away from the eye is drawn first.
    for axis in sorted(range(3), key=lambda each: -_depth(columns[each])):
        right, up = _seen(columns[axis])
        end = (middle[0] + reach * right, middle[1] + reach * up * width / (height * _ASPECT))
        canvas.line([middle, end], _STYLES[axis])
        canvas.letter(end, "xyz"[axis], f"bold {_STYLES[axis]}")
    return canvas.rows()


def _seen(cosines: Triple) -> Point:
    """Where a unit vector (East, North, Up) ends on the picture."""
    east, north, up = cosines
    right = east * math.cos(_TURN_RAD) + north * math.sin(_TURN_RAD)
    ahead = north * math.cos(_TURN_RAD) - east * math.sin(_TURN_RAD)
    return right, up * math.cos(_RAISE_RAD) + ahead * math.sin(_RAISE_RAD)


def _depth(cosines: Triple) -> float:
    east, north, up = cosines
    ahead = north * math.cos(_TURN_RAD) - east * math.sin(_TURN_RAD)
    return ahead * math.cos(_RAISE_RAD) - up * math.sin(_RAISE_RAD)
