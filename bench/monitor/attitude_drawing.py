"""Drawing of the unit's axes in perspective, as numbers that a template draws."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.monitor.snapshot import Attitude
from gyrobench.bench.navigation.positions import AXES

#: Width and height of the drawing.
SIZE = 240.0

#: The viewpoint is south-east of the unit and above it; its distance is in lengths of an axis.
_EYE_AZIMUTH, _EYE_HEIGHT, _EYE_DISTANCE = math.radians(-55.0), math.radians(26.0), 6.0
_ZOOM = 425.0
_CENTRE = np.array([0.0, 0.0, 0.05])
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
    body = np.array(attitude.body_in_enu).T
    arrows = [
        (f"world {name}", name, axis, _WORLD_LENGTH) for name, axis in zip("ENU", np.eye(3), strict=True)
    ]
    arrows += [(f"body gyro-{name}", name, axis, _BODY_LENGTH) for name, axis in zip(AXES, body, strict=True)]
    arrows.sort(key=lambda arrow: _towards_eye(arrow[2]))
    return AxesDrawing(
        floor=_floor(),
        box=_box(body),
        behind=tuple(_arrow(*each) for each in arrows if _towards_eye(each[2]) < 0.0),
        before=tuple(_arrow(*each) for each in arrows if _towards_eye(each[2]) >= 0.0),
        words=attitude.directions(),
    )


#: Directions from the eye: to the right, upwards and ahead, as columns.
_EYE = np.array(
    [
        [-math.sin(_EYE_AZIMUTH), math.cos(_EYE_AZIMUTH), 0.0],
        [
            -math.sin(_EYE_HEIGHT) * math.cos(_EYE_AZIMUTH),
            -math.sin(_EYE_HEIGHT) * math.sin(_EYE_AZIMUTH),
            math.cos(_EYE_HEIGHT),
        ],
        [
            -math.cos(_EYE_HEIGHT) * math.cos(_EYE_AZIMUTH),
            -math.cos(_EYE_HEIGHT) * math.sin(_EYE_AZIMUTH),
            -math.sin(_EYE_HEIGHT),
        ],
    ]
).T


def _towards_eye(axis: FloatArray) -> float:
    return -float(axis @ _EYE[:, 2])


def _seen(point: FloatArray) -> tuple[float, float]:
    """Place of a point in the drawing."""
    right, upward, ahead = ((point - _CENTRE) @ _EYE).tolist()
    scale = _ZOOM / (_EYE_DISTANCE + ahead)
    return (round(SIZE / 2.0 + scale * right, 1), round(SIZE / 2.0 - scale * upward, 1))


def _points(points: list[tuple[float, float]]) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points)


def _arrow(look: str, label: str, axis: FloatArray, length: float) -> Arrow:
    start, tip = _seen(np.zeros(3)), _seen(length * axis)
    right, down = tip[0] - start[0], tip[1] - start[1]
    drawn = math.hypot(right, down)
    along = (right / (drawn or 1.0), down / (drawn or 1.0))
    across = (-along[1], along[0])
    off, aside = (_BESIDE_TIP, across) if length == _BODY_LENGTH else (_BEHIND_TIP, along)
    label_at = (round(tip[0] + off * aside[0], 1), round(tip[1] + off * aside[1], 1))
    size = min(_HEAD_LENGTH, drawn)  # an axis seen from its end has a short head
    back = (tip[0] - size * along[0], tip[1] - size * along[1])
    sides = [(back[0] + half * across[0], back[1] + half * across[1]) for half in (_HEAD_WIDTH, -_HEAD_WIDTH)]
    return Arrow(look, label, start, tip, _points([tip, *sides]), label_at)


def _floor() -> tuple[str, ...]:
    """Lines of a grid on the ground, East-West and North-South."""
    places = (-0.8, -0.4, 0.0, 0.4, 0.8)
    low, high = places[0], places[-1]
    lines = [((low, at, _FLOOR), (high, at, _FLOOR)) for at in places]
    lines += [((at, low, _FLOOR), (at, high, _FLOOR)) for at in places]
    return tuple(_points([_seen(np.array(end)) for end in ends]) for ends in lines)


def _box(body: FloatArray) -> tuple[str, ...]:
    """Faces of the unit, the farthest first."""
    faces: list[tuple[float, str]] = []
    for normal in range(len(body)):
        first, second = (index for index in range(len(body)) if index != normal)
        for sign in (-1.0, 1.0):
            outward = sign * _BOX[normal] * body[normal]
            corners = [
                outward + a * _BOX[first] * body[first] + b * _BOX[second] * body[second]
                for a, b in ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))
            ]
            faces.append((_towards_eye(outward), _points([_seen(corner) for corner in corners])))
    return tuple(points for _, points in sorted(faces))
