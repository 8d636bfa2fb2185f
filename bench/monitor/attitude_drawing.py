"""The unit's axes drawn in perspective, among East, North and Up."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gyrobench.bench.monitor.snapshot import Attitude
from gyrobench.bench.navigation.positions import AXES

#: Width and height of the drawing.
SIZE = 240.0

Vector = tuple[float, float, float]

#: The viewpoint is south-east of the unit and above it; its distance is in lengths of an axis.
_EYE_AZIMUTH, _EYE_HEIGHT, _EYE_DISTANCE = math.radians(-55.0), math.radians(26.0), 6.0
_ZOOM = 425.0
_CENTRE = (0.0, 0.0, 0.05)
_WORLD: tuple[tuple[str, Vector], ...] = (
    ("E", (1.0, 0.0, 0.0)),
    ("N", (0.0, 1.0, 0.0)),
    ("U", (0.0, 0.0, 1.0)),
)
_WORLD_LENGTH, _BODY_LENGTH = 1.3, 1.0
#: Labels of the world are behind the tip, those of the body beside it, where no other arrow ends.
_BEHIND_TIP, _BESIDE_TIP = 12.0, 15.0
_FLOOR = -0.95
_BOX = (0.34, 0.34, 0.22)
_HEAD_LENGTH, _HEAD_WIDTH = 11.0, 4.5


@dataclass(frozen=True)
class Arrow:
    """An arrow from the middle: its ends, its head as points of a polygon, and its label."""

    look: str
    label: str
    start: tuple[float, float]
    tip: tuple[float, float]
    head: str
    label_at: tuple[float, float]


@dataclass(frozen=True)
class AxesDrawing:
    """Drawing of an attitude, with its directions in words.

    Lines on the ground and faces of the unit are points of polygons, the farthest first; arrows are behind
    or before the unit.
    """

    floor: tuple[str, ...]
    box: tuple[str, ...]
    behind: tuple[Arrow, ...]
    before: tuple[Arrow, ...]
    words: str


def axes_drawing(attitude: Attitude) -> AxesDrawing:
    """Draw the unit's attitude."""
    body = [_column(attitude, index) for index in range(len(AXES))]
    arrows = [(f"world {name}", name, axis, _WORLD_LENGTH) for name, axis in _WORLD]
    arrows += [(f"body gyro-{name}", name, axis, _BODY_LENGTH) for name, axis in zip(AXES, body, strict=True)]
    arrows.sort(key=lambda arrow: _towards_eye(arrow[2]))
    return AxesDrawing(
        floor=_floor(),
        box=_box(body),
        behind=tuple(_arrow(*each) for each in arrows if _towards_eye(each[2]) < 0.0),
        before=tuple(_arrow(*each) for each in arrows if _towards_eye(each[2]) >= 0.0),
        words=attitude.directions(),
    )


def _column(attitude: Attitude, index: int) -> Vector:
    east, north, up = (row[index] for row in attitude.body_in_enu)
    return (east, north, up)


_FORWARD: Vector = (
    -math.cos(_EYE_HEIGHT) * math.cos(_EYE_AZIMUTH),
    -math.cos(_EYE_HEIGHT) * math.sin(_EYE_AZIMUTH),
    -math.sin(_EYE_HEIGHT),
)
_RIGHT: Vector = (-math.sin(_EYE_AZIMUTH), math.cos(_EYE_AZIMUTH), 0.0)
_UPWARD: Vector = (
    -math.sin(_EYE_HEIGHT) * math.cos(_EYE_AZIMUTH),
    -math.sin(_EYE_HEIGHT) * math.sin(_EYE_AZIMUTH),
    math.cos(_EYE_HEIGHT),
)


def _dot(one: Vector, other: Vector) -> float:
    return sum(a * b for a, b in zip(one, other, strict=True))


def _towards_eye(axis: Vector) -> float:
    return -_dot(axis, _FORWARD)


def _seen(point: Vector) -> tuple[float, float]:
    """Place of a point in the drawing."""
    from_centre = tuple(a - b for a, b in zip(point, _CENTRE, strict=True))
    east, north, up = from_centre
    scale = _ZOOM / (_EYE_DISTANCE + _dot((east, north, up), _FORWARD))
    right, upward = _dot((east, north, up), _RIGHT), _dot((east, north, up), _UPWARD)
    return (round(SIZE / 2.0 + scale * right, 1), round(SIZE / 2.0 - scale * upward, 1))


def _scaled(axis: Vector, length: float) -> Vector:
    return (axis[0] * length, axis[1] * length, axis[2] * length)


def _points(points: list[tuple[float, float]]) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points)


def _arrow(look: str, label: str, axis: Vector, length: float) -> Arrow:
    start, tip = _seen((0.0, 0.0, 0.0)), _seen(_scaled(axis, length))
    along = _direction_on_paper(start, tip)
    is_body = length == _BODY_LENGTH
    shift = (
        (_BESIDE_TIP * -along[1], _BESIDE_TIP * along[0])
        if is_body
        else (_BEHIND_TIP * along[0], _BEHIND_TIP * along[1])
    )
    label_at = (round(tip[0] + shift[0], 1), round(tip[1] + shift[1], 1))
    return Arrow(look, label, start, tip, _head(start, tip), label_at)


def _direction_on_paper(start: tuple[float, float], tip: tuple[float, float]) -> tuple[float, float]:
    """Unit vector from start to tip."""
    x, y = tip[0] - start[0], tip[1] - start[1]
    length = math.hypot(x, y) or 1.0
    return (x / length, y / length)


def _head(start: tuple[float, float], tip: tuple[float, float]) -> str:
    """Arrow head as it looks from the eye; an axis seen from its end has a short one."""
    along = _direction_on_paper(start, tip)
    size = min(_HEAD_LENGTH, math.dist(start, tip))
    back = (tip[0] - size * along[0], tip[1] - size * along[1])
    side = (-along[1] * _HEAD_WIDTH, along[0] * _HEAD_WIDTH)
    return _points([tip, (back[0] + side[0], back[1] + side[1]), (back[0] - side[0], back[1] - side[1])])


def _floor() -> tuple[str, ...]:
    """Lines of a grid on the ground, East-West and North-South."""
    places = (-0.8, -0.4, 0.0, 0.4, 0.8)
    low, high = places[0], places[-1]
    lines = [((low, at, _FLOOR), (high, at, _FLOOR)) for at in places]
    lines += [((at, low, _FLOOR), (at, high, _FLOOR)) for at in places]
    return tuple(_points([_seen(start), _seen(end)]) for start, end in lines)


def _box(body: list[Vector]) -> tuple[str, ...]:
    """Faces of the unit, the farthest first."""
    faces: list[tuple[float, str]] = []
    for normal in range(len(body)):
        first, second = (index for index in range(len(body)) if index != normal)
        for sign in (-1.0, 1.0):
            outward = _scaled(body[normal], sign * _BOX[normal])
            corners = [
                _sum(outward, _scaled(body[first], a * _BOX[first]), _scaled(body[second], b * _BOX[second]))
                for a, b in ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))
            ]
            faces.append((_towards_eye(outward), _points([_seen(corner) for corner in corners])))
    return tuple(points for _, points in sorted(faces))


def _sum(*vectors: Vector) -> Vector:
    east, north, up = (sum(parts) for parts in zip(*vectors, strict=True))
    return (east, north, up)
