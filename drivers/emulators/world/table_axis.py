"""One axis of a rate table: its jerk-limited motion, limits and encoder.

A motion is a sequence of pieces of constant jerk, and depends only on time. It can start at any position,
rate and acceleration, so there is no step in these between motions. The servo brings the *encoder* to the
commanded position; the true angle differs from it by the encoder's error, which is a function of the angle.
"""

from __future__ import annotations

import itertools
import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.kernels import compiled

#: Maximum of x^3 exp(-x), at x = 3: settling follows it, with x in time constants, from a smooth start.
_SETTLING_PEAK = 27.0 * math.exp(-3.0)
#: Duration of settling in time constants; it has then decayed below 1e-6 of its size.
_SETTLING_TIME_CONSTANTS = 25.0
#: Positions that differ by less than this count as equal.
_SAME_POSITION_DEG = 1e-10


@dataclass(frozen=True)
class MotionLimits:
    """Limits of a motion; those of the position may be infinite."""

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
        """Offset and its derivatives at a time since the end of the motion; zero outside the settling."""
        if not 0.0 < time_s < self.duration_s:
            return AxisState(0.0)
        tau_s, x = self.time_constant_s, time_s / self.time_constant_s
        scale = self.size_deg * math.exp(-x) / _SETTLING_PEAK
        return AxisState(
            scale * x**3, scale * (3.0 - x) * x**2 / tau_s, scale * (6.0 - 6.0 * x + x**2) * x / tau_s**2
        )


def change_rate(start: AxisState, rate_dps: float, limits: MotionLimits) -> list[Piece]:
    """Compute the fastest profile to a constant rate: build up acceleration, hold it, reduce it to zero."""
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


def rest_position(start: AxisState, limits: MotionLimits) -> float:
    """Compute the rest position after an immediate stop."""
    return _end(start, change_rate(start, 0.0, limits)).position_deg


def move(
    start: AxisState, target_deg: float, limits: MotionLimits
) -> tuple[list[Piece], list[Piece], list[Piece]]:
    """Compute the fastest profile to rest at a target.

    Returns the pieces up to the peak rate, at that rate, and down to rest. For an infinite target the second
    part is endless and the third empty.
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


def _root(function: Callable[[float], float], a: float, b: float) -> float:
    """Find the root of a function between two points at which its signs differ (Illinois method)."""
    value_a, value_b = function(a), function(b)
    while abs(b - a) > 1e-13 + 1e-15 * abs(b) and value_b:
        middle = b - value_b * (b - a) / (value_b - value_a)
        if middle == b:  # the limit of floating-point resolution
            break
        value_middle = function(middle)
        if value_middle * value_b < 0.0:
            a, value_a = b, value_b
        else:
            value_a *= 0.5
        b, value_b = middle, value_middle
    return b


class Motion:
    """A motion, defined from its start to any later time.

    After the pieces the axis is at rest, unless the last piece is endless. ``target_deg`` is the exact rest
    position; by default that computed from the pieces, with their rounding errors.
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
        #: end_s, settled_from_s: End of the pieces, and end of settling; the position is then constant.
        self.end_s = math.inf if endless else self._times_s[-1]
        self.settled_from_s = self.end_s + settling.duration_s

    @property
    def last_state(self) -> AxisState:
        """State after the last finite piece, without settling."""
        return self._states[-1]

    def at(self, time_s: float) -> AxisState:
        """State at one time, not before the start."""
        if time_s >= self.settled_from_s:
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


_ARCSEC_DEG = 1.0 / 3600.0
#: Ratio of the deceleration at an obstacle to the axis's limit.
_JAM_FACTOR = 50.0
#: Time before the last command for which positions can still be read, s.
_HISTORY_S = 1.0


@dataclass(frozen=True)
class AxisParameters:
    """Limits and errors of one axis."""

    rate_limit_dps: float = 30.0
    acceleration_limit_dps2: float = 30.0
    jerk_limit_dps3: float = 60.0
    position_low_deg: float = -400.0
    position_high_deg: float = 400.0
    #: Bound of the encoder's error: a first harmonic of the angle, and a second of half its amplitude.
    position_error_arcsec: float = 1.0
    position_error_phases_deg: tuple[float, float] = (0.0, 0.0)  #: Phases of the two harmonics.
    settling_time_constant_s: float = 0.3
    #: Overshoot after braking at the acceleration limit; proportional to deceleration.
    settling_amplitude_arcsec: float = 20.0

    @property
    def limits(self) -> MotionLimits:
        """Limits that the axis can't exceed."""
        dynamic = (self.rate_limit_dps, self.acceleration_limit_dps2, self.jerk_limit_dps3)
        return MotionLimits(*dynamic, self.position_low_deg, self.position_high_deg)


class TableAxis:
    """One axis, at rest until the first command.

    Commands must be in the order of time. Position and rate can be read from one second before the last
    command on.
    """

    def __init__(self, parameters: AxisParameters, position_deg: float = 0.0) -> None:
        self.parameters = parameters
        #: Called with the time before the motion changes, to evaluate what depends on the angle until then.
        self.before_motion: Callable[[float], None] = lambda now_s: None  # noqa: ARG005
        self.limits = parameters.limits  #: Limits of later commands; a motion in progress keeps its limits.
        rest = Motion(0.0, AxisState(position_deg), [], Settling(0.0, 1.0))
        self._motions = [rest]
        self._commanded: Motion | None = None
        #: Distance from the target at which a move ends because of friction.
        self._missed_deg = self.friction_deg = 0.0
        self._complete_from_s, self._complete_until_s = 0.0, math.inf
        self._rest_angle_deg = self._true_angle(np.asarray(position_deg))

    def move_to(self, position_deg: float, now_s: float) -> None:
        """Move to an encoder position, clipped to the position limits, and hold that position."""
        target_deg = min(max(position_deg, self.limits.low_deg), self.limits.high_deg)
        distance_deg = target_deg - self.encoder(now_s).position_deg
        missed_deg = math.copysign(min(self.friction_deg, abs(distance_deg)), distance_deg)
        reached_deg = target_deg - missed_deg
        up, along, down = move(self.encoder(now_s), reached_deg, self.limits)
        self._start(now_s, [*up, *along, *down], self._settling(down), reached_deg)
        self._missed_deg = missed_deg

    def turn_at(self, rate_dps: float, now_s: float) -> None:
        """Turn at a rate until the next command; the axis stops at a position limit."""
        rate_dps = min(max(rate_dps, -self.limits.rate_dps), self.limits.rate_dps)
        end_deg = self.limits.high_deg if rate_dps > 0.0 else self.limits.low_deg
        start = self.encoder(now_s)
        if rate_dps == 0.0 or (end_deg - rest_position(start, self.limits)) * rate_dps <= 0.0:
            self.stop(now_s)
            return
        up, along, down = move(start, end_deg, replace(self.limits, rate_dps=abs(rate_dps)))
        self._start(now_s, [*up, *along, *down], self._settling(down), end_deg)
        self._complete_from_s = now_s + sum(piece.duration_s for piece in up)
        self._complete_until_s = self._complete_from_s + sum(piece.duration_s for piece in along)

    def stop(self, now_s: float) -> None:
        """Stop within the limits and hold the position."""
        pieces = change_rate(self.encoder(now_s), 0.0, self.limits)
        self._start(now_s, pieces, self._settling(pieces))

    def release(self, now_s: float) -> None:
        """Open the servo: the brake stops the axis without settling."""
        pieces = change_rate(self.encoder(now_s), 0.0, self.limits)
        self._start(now_s, pieces, self._settling([]))

    def hold_by_force(self, now_s: float, by_deg: float = 0.0) -> None:
        """Move the axis by ``by_deg`` against its servo with an external force, and hold it there.

        Until :meth:`end_force`, commands change the commanded profile but do not move the axis.
        """
        start, limits = self.encoder(now_s), self.parameters.limits
        if by_deg:
            target_deg = start.position_deg + by_deg
            up, along, down = move(start, target_deg, limits)
            pieces = [*up, *along, *down]
        else:
            target_deg = None
            acceleration_dps2, jerk_dps3 = (
                _JAM_FACTOR * limits.acceleration_dps2,
                _JAM_FACTOR**2 * limits.jerk_dps3,
            )
            jam_limits = replace(limits, acceleration_dps2=acceleration_dps2, jerk_dps3=jerk_dps3)
            pieces = change_rate(start, 0.0, jam_limits)
        commanded = self._commanded or self._motions[-1]
        self._append_motion(Motion(now_s, start, pieces, self._settling([]), target_deg))
        self._commanded = commanded

    def end_force(self, now_s: float, *, servo: bool) -> None:
        """End :meth:`hold_by_force` and the effect of friction; a closed servo then follows its command."""
        commanded, self._commanded = self._commanded, None
        target_deg = self.rest_position_deg + self._missed_deg
        self._missed_deg = 0.0
        if commanded is not None:
            target_deg = commanded.last_state.position_deg
        if servo and math.isfinite(self._complete_until_s):
            self.stop(now_s)  # a constant-rate turn is not resumed
        elif servo and target_deg != self.rest_position_deg:
            self.move_to(target_deg, now_s)

    def encoder(self, now_s: float) -> AxisState:
        """Encoder reading at ``now_s``, which must not be before the last command."""
        return self._motions[-1].at(now_s)

    @property
    def rest_position_deg(self) -> float:
        """Encoder position after the present move or stop."""
        return self._motions[-1].last_state.position_deg

    def following_error_deg(self, now_s: float) -> float:
        """Encoder minus commanded profile: the overshoot while the axis settles, or the missed distance."""
        motion = self._motions[-1]
        if self._commanded is not None:
            return self.encoder(now_s).position_deg - self._commanded.at(now_s).position_deg
        if self._missed_deg and now_s >= motion.settled_from_s:
            return -self._missed_deg
        if motion.end_s < now_s < motion.settled_from_s:
            return motion.at(now_s).position_deg - motion.last_state.position_deg
        return 0.0

    def position_deg(self, time_s: FloatArray) -> FloatArray:
        """True angle at each time, shape (n,), not wrapped."""
        if time_s.size and time_s.min() >= self._motions[-1].settled_from_s:
            return np.full(time_s.shape, self._rest_angle_deg)
        encoder_deg = self._motions[-1].positions_deg(time_s)
        # Times before the start of a motion belong to the previous motion.
        for earlier, later in zip(self._motions[-2::-1], self._motions[:0:-1], strict=True):
            is_before = time_s < later.start_s
            if not is_before.any():
                break
            encoder_deg = np.where(is_before, earlier.positions_deg(time_s), encoder_deg)
        return self._true_angle(encoder_deg)

    def profile_complete(self, now_s: float) -> bool:
        """Whether the commanded position or rate is reached and held."""
        return self._complete_from_s <= now_s < self._complete_until_s

    @property
    def settled_from_s(self) -> float:
        """End of the last motion and its settling, which identifies it; the angle is then constant."""
        return self._motions[-1].settled_from_s

    def is_moving(self, now_s: float) -> bool:
        """Whether the angle still changes at ``now_s``."""
        return now_s < self._motions[-1].settled_from_s

    def _start(
        self, now_s: float, pieces: list[Piece], settling: Settling, target_deg: float | None = None
    ) -> None:
        motion = Motion(now_s, self.encoder(now_s), pieces, settling, target_deg)
        self._missed_deg = 0.0
        self._complete_from_s, self._complete_until_s = motion.end_s, math.inf
        if self._commanded is not None:
            self._commanded = motion
        else:
            self._append_motion(motion)

    def _append_motion(self, motion: Motion) -> None:
        now_s = motion.start_s
        self.before_motion(now_s)
        # A motion is kept as long as its end, which is the start of the next motion, is recent.
        ends_s = [later.start_s for later in self._motions[1:]] + [now_s]
        recent = [m for m, end_s in zip(self._motions, ends_s, strict=True) if end_s > now_s - _HISTORY_S]
        self._motions = [*recent, motion]
        self._rest_angle_deg = self._true_angle(np.asarray(motion.last_state.position_deg))

    def _settling(self, braking: list[Piece]) -> Settling:
        """Overshoot after braking in three pieces, proportional to the deceleration; none if no pieces."""
        deceleration_dps2 = braking[-1].jerk_dps3 * braking[-1].duration_s if braking else 0.0
        parameters = self.parameters
        share = deceleration_dps2 / parameters.acceleration_limit_dps2
        size_deg = share * parameters.settling_amplitude_arcsec * _ARCSEC_DEG
        return Settling(size_deg, parameters.settling_time_constant_s)

    def _true_angle(self, encoder_deg: FloatArray) -> FloatArray:
        parameters = self.parameters
        error_deg = parameters.position_error_arcsec * _ARCSEC_DEG / 1.5
        first_deg, second_deg = parameters.position_error_phases_deg
        harmonics = np.sin(np.deg2rad(encoder_deg + first_deg))
        harmonics += 0.5 * np.sin(np.deg2rad(2.0 * encoder_deg + second_deg))
        return encoder_deg + error_deg * harmonics
