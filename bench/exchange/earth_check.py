"""Compares the Earth's rotation in the rates of a log with the one that was subtracted from them.

What remains of it in the biases follows the attitude like the Earth's rotation, by the same vector in all
gyros. The vector shows a wrong azimuth, latitude or scale. Exchanged or reversed axes leave no common vector;
each possible assignment of axes is tried. Biases that follow gravity differ from gyro to gyro and fit none.
Each gyro is also compared by itself along Up, which takes fewer positions: of a rate without the Earth's
rotation all of it remains, of one with the wrong sign twice as much. Three that were vertical in one way each
share a mistake if the same large rate remains in all.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.exchange.import_map import EarthRate
from gyrobench.bench.foundations.arrays import RADPS_TO_DPH, BoolArray, FloatArray
from gyrobench.bench.navigation.earth import EARTH_RATE, earth_rate_enu
from gyrobench.bench.navigation.positions import AXES, POSITIONS

#: Smallest vertical rate of the Earth for which a gyro is tested by itself, deg/h, and relative tolerance.
_MIN_VERTICAL_DPH, _TOLERANCE = 1.0, 0.1
#: Fewest rows, fewest gyros that were up and down, and powers of the temperature in a bias.
_MIN_ROWS, _MIN_GYROS, _POWERS = 12, 2, 3
#: Largest share of the scatter of the biases that a mistake leaves: in general, and of one that is vertical
#: to within the next share, which biases that follow gravity resemble if three gyros have the same.
_MAX_LEFT, _MAX_LEFT_VERTICAL, _MAX_LEVEL = 0.25, 0.05, 0.2
#: Smallest remaining rate, and smallest scatter by exchanged axes, as shares of the Earth's rotation.
_MIN_RATE, _MIN_SCATTER = 0.001, 0.05
#: A scale is wrong if it is off by more than this; latitude or azimuth is wrong if the error is at least this
#: share of the other one.
_MIN_SCALE_ERROR, _MIN_SHARE = 0.02, 0.1
_EARTH_DPH = EARTH_RATE * RADPS_TO_DPH


def earth_warnings(rows: Sequence[DwellRow], rule: EarthRate, is_by_force: bool) -> list[str]:
    """Warnings if the biases contain a part of the Earth's rotation that a mistake in the map explains.

    ``is_by_force``: whether accelerometers gave the positions, so that their axes may be wrong as well.
    """
    vertical = [*_vertical_warnings(rows, rule.latitude_deg)]
    if len(rows) < _MIN_ROWS:
        return vertical
    has_azimuth = rule.azimuth_deg is not None
    azimuth = math.radians(rule.azimuth_deg or 0.0)
    C_nb = {name: position.C_nb(azimuth) for name, position in POSITIONS.items()}
    earth = earth_rate_enu(math.radians(rule.latitude_deg)) * RADPS_TO_DPH
    bias = np.array([row.bias_dph for row in rows]).T
    used = np.ones_like(bias, dtype=bool)
    axes_enu = np.array([C_nb[row.position] for row in rows]).transpose(2, 0, 1)  # gyro, row, ENU
    if not has_azimuth:  # the level gyros sense an unknown part of the rate North
        used = np.abs(axes_enu[:, :, 2]) > 0.5
    bases = [_temperature_basis(rows, gyro, used[gyro]) for gyro in range(3)]

    def freed(values: FloatArray) -> FloatArray:
        """Values (3, n, ...) of gyros and rows, without what follows the temperature, in one column."""
        parts = [values[gyro, used[gyro]] for gyro in range(3)]
        return np.concatenate(
            [part - basis @ (basis.T @ part) for part, basis in zip(parts, bases, strict=True)]
        )

    def size(values: FloatArray) -> float:
        return float(np.sqrt(np.mean(values**2)))

    turned = [
        np.ptp(each[chosen, 2]) > 1.0 for each, chosen in zip(axes_enu, used, strict=True) if chosen.any()
    ]
    if sum(turned) < _MIN_GYROS or used.sum(axis=1)[used.any(axis=1)].min() < _MIN_ROWS // 2:
        return vertical or [*_common_warning(bias, axes_enu[:, :, 2], rule.latitude_deg)]
    data = freed(bias)
    scatter = size(data)
    design = freed(axes_enu)[:, 0 if has_azimuth else 2 :]
    solution, *_ = np.linalg.lstsq(design, data, rcond=1e-6)
    rest = np.zeros(3)
    rest[0 if has_azimuth else 2 :] = solution
    is_vertical = math.hypot(rest[0], rest[1]) < _MAX_LEVEL * abs(rest[2])
    limit = _MAX_LEFT_VERTICAL if is_vertical else _MAX_LEFT
    if size(data - design @ solution) < limit * scatter:
        is_small = float(np.linalg.norm(rest)) < _MIN_RATE * _EARTH_DPH
        return vertical or ([] if is_small else [_rate_text(earth + rest, rule)])
    if not has_azimuth or scatter < _MIN_SCATTER * _EARTH_DPH:
        return vertical
    names = [row.position for row in rows]
    for text, expected in _other_axes(C_nb, earth, is_by_force):
        if size(data - freed(np.array([expected[name] for name in names]).T)) < _MAX_LEFT * scatter:
            return [text]
    scales = [freed(np.where(np.arange(3)[:, None] == k, axes_enu @ earth, 0.0)) for k in range(3)]
    errors, *_ = np.linalg.lstsq(np.array(scales).T, data, rcond=1e-6)
    if vertical or size(data - errors @ scales) > _MAX_LEFT * scatter:
        return vertical
    worst = int(np.argmax(np.abs(errors)))
    return [
        f"the {AXES[worst]} gyro senses {1.0 + errors[worst]:.3g} times the Earth's rotation. Check unit and "
        "scale of its column"
    ]


def _vertical_warnings(rows: Sequence[DwellRow], latitude_deg: float) -> Iterator[str]:
    """Warnings about gyros that lack the vertical part of the Earth's rotation, or have its wrong sign."""
    vertical_dph = _EARTH_DPH * math.sin(math.radians(latitude_deg))
    if abs(vertical_dph) <= _MIN_VERTICAL_DPH:
        return
    for index, axis in enumerate(AXES):
        biases_by_way = (
            [sign * row.bias_dph[index] for row in rows if row.position == f"{axis}_{way}"]
            for way, sign in (("up", 1.0), ("down", -1.0))
        )
        means = [float(np.mean(biases)) for biases in biases_by_way if biases]
        along_up_dph = float(np.mean(means)) if means else 0.0
        excess = -along_up_dph / vertical_dph  # 1 without rotation in the log, 2 with one of the wrong sign
        if abs(excess - 1.0) < _TOLERANCE:
            yield (
                f"if vertical, the {axis} gyro seems to lack the Earth's rotation: subtracting "
                f"it leaves {along_up_dph:.1f} deg/h along Up. Check 'unit' and 'scale' of the gyro; "
                "leave 'earth_rate' out if it was removed from the log"
            )
        elif abs(excess - 2.0) < 2.0 * _TOLERANCE:
            found = (
                f"differs by {2.0 * abs(along_up_dph):.1f} deg/h with its axis up and down: four times"
                if len(means) == 2
                else f"is {along_up_dph:.1f} deg/h along Up: twice"
            )
            yield (
                f"the bias of the {axis} gyro {found} the vertical part of the Earth's rotation, as with "
                "wrong signs of the accelerometers ('position'), of the gyro or of the latitude. Check them"
            )


def _common_warning(bias_dph: FloatArray, up: FloatArray, latitude_deg: float) -> Iterator[str]:
    """Warning if the vertical gyros have the same large bias along Up, of which each was up or down alone.

    ``bias_dph``, ``up``: Shapes (3, n), bias and Up component of each gyro's axis in n rows.
    """
    is_vertical = np.abs(up) > 0.5
    if not is_vertical.any(axis=1).all():
        return
    along_up_dph = np.average(bias_dph * np.sign(up), axis=1, weights=is_vertical)
    mean_dph = float(along_up_dph.mean())
    if abs(mean_dph) > max(_MIN_VERTICAL_DPH, float(np.ptp(along_up_dph)) / _MAX_LEFT_VERTICAL):
        vertical_dph = _EARTH_DPH * math.sin(math.radians(latitude_deg))
        yield _vertical_text(vertical_dph + mean_dph, latitude_deg)


def _temperature_basis(rows: Sequence[DwellRow], gyro: int, used: BoolArray) -> FloatArray:
    """Orthonormal powers (m, k) of the temperature of a gyro in its used rows (n,)."""
    temperature_c = np.array([row.gyro_c[gyro] for row in rows])[used]
    if not len(temperature_c):
        return np.empty((0, 0))
    scaled = (temperature_c - temperature_c.mean()) / max(float(np.ptp(temperature_c)), 1e-9)
    return np.linalg.qr(scaled[:, np.newaxis] ** np.arange(_POWERS))[0]


def _rate_text(sensed: FloatArray, rule: EarthRate) -> str:
    """Warning about the rate (3,), ENU, deg/h, that the gyros sense in place of the Earth's."""
    if rule.azimuth_deg is None:
        return _vertical_text(float(sensed[2]), rule.latitude_deg)
    scale = float(np.linalg.norm(sensed)) / _EARTH_DPH
    if abs(scale - 1.0) > _MIN_SCALE_ERROR:
        return (
            f"the gyros sense {scale:.3g} times the Earth's rotation. Check unit and scale of their columns, "
            "and whether they are rates, not increments"
        )
    latitude_deg = math.degrees(math.atan2(sensed[2], math.hypot(sensed[0], sensed[1])))
    turned_deg = math.degrees(math.atan2(sensed[0], sensed[1]))
    away_deg = latitude_deg - rule.latitude_deg
    found = []
    if abs(away_deg) > _MIN_SHARE * abs(turned_deg):
        found.append(f"a latitude_deg of {latitude_deg:.1f}")
    if abs(turned_deg) > _MIN_SHARE * abs(away_deg):
        found.append(f"an azimuth_deg of {round(rule.azimuth_deg + turned_deg, 1) % 360.0:.1f}")
    return f"the Earth's rotation in the rates fits {' and '.join(found)}. Correct 'earth_rate' in the map"


def _vertical_text(sensed_dph: float, latitude_deg: float) -> str:
    """Warning about the rate along Up, deg/h, that the gyros sense in place of the Earth's."""
    share = sensed_dph / (_EARTH_DPH * math.sin(math.radians(latitude_deg)))
    text = f"the gyros sense {share:.3g} times the vertical part of the Earth's rotation"
    advice = "Check unit and scale of the gyros, and 'latitude_deg'"
    if abs(sensed_dph) < _EARTH_DPH:
        advice += f": at {math.degrees(math.asin(sensed_dph / _EARTH_DPH)):.1f} deg that is right"
    return f"{text}. {advice}"


def _other_axes(
    C_nb: dict[str, FloatArray], earth: FloatArray, is_by_force: bool
) -> Iterator[tuple[str, dict[str, FloatArray]]]:
    """Wrong assignments of axes: a warning, and the rates (3,) that they leave in each position.

    ``C_nb``: by name of the position. ``earth``: rate (3,), ENU. ``is_by_force``: see above.
    """
    for order, signs in itertools.product(
        itertools.permutations(range(3)), itertools.product((1, -1), repeat=3)
    ):
        declared = np.zeros((3, 3))  # of true body axes
        declared[np.arange(3), order] = signs
        if (declared == np.eye(3)).all():
            continue
        held = ", ".join(
            f"{'-' if sign < 0 else ''}{AXES[true]}" for true, sign in zip(order, signs, strict=True)
        )
        text = (
            f"the Earth's rotation in the rates fits if the columns x, y, z of {{}} hold {held}. Correct them"
        )
        yield (
            text.format("the gyros"),
            {name: declared @ each.T @ earth - each.T @ earth for name, each in C_nb.items()},
        )
        if is_by_force:
            ups = {name: declared.T @ each[2] for name, each in C_nb.items()}
            true = {
                name: next(each for each in C_nb.values() if each[2] @ up > 0.5) for name, up in ups.items()
            }
            yield (
                text.format("gyros and accelerometers"),
                {name: declared @ true[name].T @ earth - each.T @ earth for name, each in C_nb.items()},
            )
