"""Perspective drawing of the unit's axes, as coordinates for a template."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.monitor.snapshot import Attitude
from gyrobench.bench.navigation.positions import AXES

#: Width and height of the drawing.
SIZE = 240.0

#: The viewpoint is south-east of the unit and above it; its distance is in units of the body axes' length.
_EYE_AZIMUTH, _EYE_HEIGHT, _EYE_DISTANCE = math.radians(-55.0), math.radians(26.0), 6.0
_ZOOM = 425.0
_CENTRE = np.array([0.0, 0.0, 0.05])
_WORLD_LENGTH, _BODY_LENGTH = 1.3, 1.0
#: Distances of labels from the tip: for world axes beyond it, for body axes beside it, to avoid overlaps.
_BEYOND_TIP, _BESIDE_TIP = 12.0, 15.0
_FLOOR_HEIGHT = -0.95
_BOX_HALF_SIZE = (0.34, 0.34, 0.22)
_HEAD_LENGTH, _HEAD_WIDTH = 11.0, 4.5


@dataclass(frozen=True)
class Arrow:
    """An arrow from the centre: its ends, its head as points of a polygon, and its label."""

    css_class: str
    label: str
    start: tuple[float, float]
    tip: tuple[float, float]
    head: str
    label_position: tuple[float, float]


@dataclass(frozen=True)
class AxesDrawing:
    """Drawing of an attitude, with a description of its directions.

    ``floor``: lines of a grid on the ground; ``box``: faces of the unit, the farthest first, both as points
    of SVG shapes. ``behind``, ``before``: arrows behind and in front of the unit.
    """

    floor: tuple[str, ...]
    box: tuple[str, ...]
    behind: tuple[Arrow, ...]
    before: tuple[Arrow, ...]
    description: str


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
        description=attitude.directions(),
    )


def view_axes(azimuth: float, height: float) -> FloatArray:
    """Directions to the right, upwards and ahead as columns (3, 3), from a viewpoint at these angles, rad."""
    right = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    level = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
    ahead = -math.cos(height) * level - [0.0, 0.0, math.sin(height)]
    return np.column_stack([right, np.cross(right, ahead), ahead])


_VIEW_AXES = view_axes(_EYE_AZIMUTH, _EYE_HEIGHT)


def _towards_eye(axis: FloatArray) -> float:
    """Component of an axis towards the viewpoint."""
    return -float(axis @ _VIEW_AXES[:, 2])


def _project(point: FloatArray) -> tuple[float, float]:
    """Coordinates of a point in the drawing."""
    right, upward, ahead = ((point - _CENTRE) @ _VIEW_AXES).tolist()
    scale = _ZOOM / (_EYE_DISTANCE + ahead)
    return (round(SIZE / 2.0 + scale * right, 1), round(SIZE / 2.0 - scale * upward, 1))


def _points_text(points: list[tuple[float, float]]) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points)


def _arrow(css_class: str, label: str, axis: FloatArray, length: float) -> Arrow:
    """Draw an arrow of ``length`` along an axis."""
    start, tip = _project(np.zeros(3)), _project(length * axis)
    right, down = tip[0] - start[0], tip[1] - start[1]
    length_px = math.hypot(right, down)
    along = (right / (length_px or 1.0), down / (length_px or 1.0))
    across = (-along[1], along[0])
    offset, label_direction = (_BESIDE_TIP, across) if length == _BODY_LENGTH else (_BEYOND_TIP, along)
    label_position = (
        round(tip[0] + offset * label_direction[0], 1),
        round(tip[1] + offset * label_direction[1], 1),
    )
    head_length = min(_HEAD_LENGTH, length_px)  # an axis that points to the viewpoint has a short head
    base = (tip[0] - head_length * along[0], tip[1] - head_length * along[1])
    sides = [(base[0] + half * across[0], base[1] + half * across[1]) for half in (_HEAD_WIDTH, -_HEAD_WIDTH)]
    return Arrow(css_class, label, start, tip, _points_text([tip, *sides]), label_position)


def _floor() -> tuple[str, ...]:
    """Lines of a grid on the ground, East-West and North-South."""
    coordinates = (-0.8, -0.4, 0.0, 0.4, 0.8)
    low, high = coordinates[0], coordinates[-1]
    lines = [
        ((low, coordinate, _FLOOR_HEIGHT), (high, coordinate, _FLOOR_HEIGHT)) for coordinate in coordinates
    ]
    lines += [
        ((coordinate, low, _FLOOR_HEIGHT), (coordinate, high, _FLOOR_HEIGHT)) for coordinate in coordinates
    ]
    return tuple(_points_text([_project(np.array(end)) for end in line]) for line in lines)


def _box(body: FloatArray) -> tuple[str, ...]:
    """Faces of the unit, the farthest first."""
    faces: list[tuple[float, str]] = []
    for normal in range(len(body)):
        first, second = (index for index in range(len(body)) if index != normal)
        for sign in (-1.0, 1.0):
            outward = sign * _BOX_HALF_SIZE[normal] * body[normal]
            corners = [
                outward + a * _BOX_HALF_SIZE[first] * body[first] + b * _BOX_HALF_SIZE[second] * body[second]
                for a, b in ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))
            ]
            faces.append((_towards_eye(outward), _points_text([_project(corner) for corner in corners])))
    return tuple(points for _, points in sorted(faces))
