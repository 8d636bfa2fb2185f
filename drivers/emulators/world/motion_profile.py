"""Jerk-limited motion along one coordinate, as a function of time alone.

A motion is a sequence of pieces of constant jerk. It starts from any position, rate and acceleration,
so motions join without a step in any of the three.
"""

from __future__ import annotations

import itertools
import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.kernels import compiled

#: Settling follows x^3 exp(-x), x in time constants: smooth at its start, greatest at x = 3.
_SETTLING_PEAK = 27.0 * math.exp(-3.0)
#: After this many time constants settling is below 1e-6 of its size and ends.
_SETTLING_TIME_CONSTANTS = 25.0
#: Positions closer to each other than this are equal.
_SAME_POSITION_DEG = 1e-10


@dataclass(frozen=True)
class AxisLimits:
    """Bounds of a motion; those of position may be infinite."""

    rate_dps: float
    acceleration_dps2: float
    jerk_dps3: float
    low_deg: float
    high_deg: float


class AxisState(NamedTuple):
    """Position, rate and acceleration of an axis."""

    position_deg: float
    rate_dps: float = 0.0
    acceleration_dps2: float = 0.0

    def after(self, jerk_dps3: float, duration_s: float) -> AxisState:
        """State after a piece of constant jerk."""
        position, rate, acceleration = self
        t = duration_s
        return AxisState(
            position + t * (rate + t * (acceleration / 2.0 + t * jerk_dps3 / 6.0)),
            rate + t * (acceleration + t * jerk_dps3 / 2.0),
            acceleration + t * jerk_dps3,
        )


class Piece(NamedTuple):
    """A piece of constant jerk; the last piece of a motion may be endless."""

    jerk_dps3: float
    duration_s: float


@dataclass(frozen=True)
class Settling:
    """Overshoot after the end of a motion, and its decay."""

    size_deg: float
    time_constant_s: float

    @property
    def duration_s(self) -> float:
        """Time from the end of the motion to complete rest."""
        return _SETTLING_TIME_CONSTANTS * self.time_constant_s if self.size_deg else 0.0

    def state(self, time_s: float) -> AxisState:
        """Offset and its derivatives at a time since the end of the motion; zero before and after."""
        if not 0.0 < time_s < self.duration_s:
            return AxisState(0.0)
        tau_s, x = self.time_constant_s, time_s / self.time_constant_s
        scale = self.size_deg * math.exp(-x) / _SETTLING_PEAK
        return AxisState(
            scale * x**3, scale * (3.0 - x) * x**2 / tau_s, scale * (6.0 - 6.0 * x + x**2) * x / tau_s**2
        )


def change_rate(start: AxisState, rate_dps: float, limits: AxisLimits) -> list[Piece]:
    """Fastest profile to a constant rate: build up acceleration, hold it, reduce it to zero."""
    jerk = limits.jerk_dps3
    # the final rate if the present acceleration is only reduced to zero
    natural_dps = start.rate_dps + start.acceleration_dps2 * abs(start.acceleration_dps2) / (2.0 * jerk)
    sign = 1.0 if rate_dps >= natural_dps else -1.0
    first = sign * start.acceleration_dps2
    change = sign * (rate_dps - start.rate_dps)
    peak = max(first, math.sqrt(max(0.0, jerk * change + first * first / 2.0)))
    ceiling = max(limits.acceleration_dps2, first)
    hold_s = 0.0
    if peak > ceiling:
        peak = ceiling
        hold_s = max(0.0, change - (2.0 * peak * peak - first * first) / (2.0 * jerk)) / peak
    ramp_up, ramp_down = Piece(sign * jerk, (peak - first) / jerk), Piece(-sign * jerk, peak / jerk)
    return [ramp_up, Piece(0.0, hold_s), ramp_down]


def rest_position(start: AxisState, limits: AxisLimits) -> float:
    """Position of rest after an immediate stop."""
    return _end(start, change_rate(start, 0.0, limits)).position_deg


def move(
    start: AxisState, target_deg: float, limits: AxisLimits
) -> tuple[list[Piece], list[Piece], list[Piece]]:
    """Fastest profile to rest at a target: pieces up to the peak rate, at that rate, and down to rest.

    For an infinite target the second part is endless and the third empty.
    """
    if math.isinf(target_deg):
        rate_dps = math.copysign(limits.rate_dps, target_deg)
        return change_rate(start, rate_dps, limits), [Piece(0.0, math.inf)], []

    def beyond_deg(peak_dps: float) -> float:
        up = change_rate(start, peak_dps, limits)
        down = change_rate(AxisState(0.0, peak_dps), 0.0, limits)
        return _end(start, up + down).position_deg - target_deg

    if abs(beyond_deg(0.0)) < _SAME_POSITION_DEG:
        return [], [], change_rate(start, 0.0, limits)
    peak_dps = math.copysign(limits.rate_dps, -beyond_deg(0.0))
    along_s = -beyond_deg(peak_dps) / peak_dps
    if along_s < 0.0:
        along_s = 0.0
        peak_dps = _root(beyond_deg, 0.0, peak_dps)
    down = change_rate(AxisState(0.0, peak_dps), 0.0, limits)
    return change_rate(start, peak_dps, limits), [Piece(0.0, along_s)], down


def _root(function: Callable[[float], float], one: float, other: float) -> float:
    """Where a function is zero between two points at which its signs differ (Illinois method)."""
    at_one, at_other = function(one), function(other)
    while abs(other - one) > 1e-13 + 1e-15 * abs(other) and at_other:
        middle = other - at_other * (other - one) / (at_other - at_one)
        at_middle = function(middle)
        if at_middle * at_other < 0.0:
            one, at_one = other, at_other
        else:
            at_one *= 0.5
        other, at_other = middle, at_middle
    return other


class Motion:
    """A motion from its start on, without end.

    After the pieces the axis is at rest, unless the last one is endless. ``target_deg`` is the position of
    rest, free of the rounding of the pieces.
    """

    def __init__(
        self, start_s: float, start: AxisState, pieces: Sequence[Piece], settling: Settling,
        target_deg: float | None = None,
    ) -> None:  # fmt: skip
        pieces = [piece for piece in pieces if piece.duration_s > 0.0]
        endless = bool(pieces) and math.isinf(pieces[-1].duration_s)
        finite = pieces[:-1] if endless else pieces
        states = list(itertools.accumulate(finite, lambda state, piece: state.after(*piece), initial=start))
        if not endless:
            states[-1] = AxisState(states[-1].position_deg if target_deg is None else target_deg)
        self.start_s = start_s
        self._times_s = list(itertools.accumulate((p.duration_s for p in finite), initial=start_s))
        self._states = states
        self._jerks_dps3 = [*(piece.jerk_dps3 for piece in finite), 0.0]
        # Start, position, rate, acceleration and jerk of each piece.
        self._pieces = np.column_stack([self._times_s, states, self._jerks_dps3])
        self._settling = settling
        #: end_s, still_from_s: End of the pieces; end of settling, after which the position is constant.
        self.end_s = math.inf if endless else self._times_s[-1]
        self.still_from_s = self.end_s + settling.duration_s

    @property
    def last_state(self) -> AxisState:
        """State after the last finite piece, settling left out."""
        return self._states[-1]

    def at(self, time_s: float) -> AxisState:
        """State at one time, not before the start."""
        if time_s >= self.still_from_s:
            return self._states[-1]
        index = max(0, bisect_right(self._times_s, time_s) - 1)
        state = self._states[index].after(self._jerks_dps3[index], time_s - self._times_s[index])
        if time_s <= self.end_s:
            return state
        return AxisState(*map(sum, zip(state, self._settling.state(time_s - self.end_s), strict=True)))

    def positions_deg(self, time_s: FloatArray) -> FloatArray:
        """Position at each time, shape (n,), none before the start."""
        settling = self._settling
        return np.asarray(
            _positions_deg(
                time_s, self._pieces, self.end_s, settling.size_deg, settling.time_constant_s,
                settling.duration_s,
            )
        )  # fmt: skip


def _end(start: AxisState, pieces: Sequence[Piece]) -> AxisState:
    for piece in pieces:
        start = start.after(*piece)
    return start


@compiled
def _positions_deg(
    time_s: FloatArray, pieces: FloatArray, end_s: float, settling_deg: float, time_constant_s: float,
    settling_s: float,
) -> FloatArray:  # fmt: skip
    positions = np.empty(time_s.size)
    for k in range(time_s.size):
        index = pieces.shape[0] - 1
        while index > 0 and time_s[k] < pieces[index, 0]:
            index -= 1
        t = time_s[k] - pieces[index, 0]
        rate, acceleration, jerk = pieces[index, 2], pieces[index, 3], pieces[index, 4]
        positions[k] = pieces[index, 1] + t * (rate + t * (acceleration / 2.0 + t * jerk / 6.0))
        since_s = time_s[k] - end_s
        if 0.0 < since_s < settling_s:
            x = since_s / time_constant_s
            positions[k] += settling_deg * math.exp(-x) / _SETTLING_PEAK * x**3
    return positions
