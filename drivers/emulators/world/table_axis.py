"""One axis of a rate table: limits, motion and encoder.

The servo brings the *encoder* to the commanded position; the true angle differs from it by the
encoder's error, which is repeatable over angle.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.drivers.emulators.world.motion_profile import (
    AxisLimits,
    AxisState,
    Motion,
    Piece,
    Settling,
    change_rate,
    move,
    rest_position,
)

_ARCSEC_DEG = 1.0 / 3600.0
#: Deceleration at an obstacle, relative to the axis's limit.
_JAM = 50.0
#: Time before the last command for which positions are kept.
_MEMORY_S = 1.0


@dataclass(frozen=True)
class AxisParameters:
    """Limits and errors of one axis."""

    rate_limit_dps: float = 30.0
    acceleration_limit_dps2: float = 30.0
    jerk_limit_dps3: float = 60.0
    position_low_deg: float = -400.0
    position_high_deg: float = 400.0
    #: Bound of the encoder's error: a first harmonic of the angle and a second of half its size.
    position_error_arcsec: float = 1.0
    position_error_phases_deg: tuple[float, float] = (0.0, 0.0)  #: Phases of the two harmonics.
    settling_time_constant_s: float = 0.3
    #: Overshoot after braking at the acceleration limit; proportional to deceleration.
    settling_amplitude_arcsec: float = 20.0

    @property
    def limits(self) -> AxisLimits:
        """Limits that the axis can't exceed."""
        dynamic = (self.rate_limit_dps, self.acceleration_limit_dps2, self.jerk_limit_dps3)
        return AxisLimits(*dynamic, self.position_low_deg, self.position_high_deg)


class TableAxis:
    """One axis, at rest until the first command.

    Commands come in order of time. Position and rate are available from one second before the last
    command on.
    """

    def __init__(self, parameters: AxisParameters, position_deg: float = 0.0) -> None:
        self.parameters = parameters
        #: Called before the motion changes, with the time: what depends on the angle until then.
        self.before_motion: Callable[[float], None] = lambda now_s: None  # noqa: ARG005
        self.limits = parameters.limits  #: Limits of later commands; a motion under way keeps its own.
        rest = Motion(0.0, AxisState(position_deg), [], Settling(0.0, 1.0))
        self._motions = [rest]
        self._commanded: Motion | None = None
        #: Distance from the target at which a move ends, because the servo is too weak.
        self._missed_deg = self.friction_deg = 0.0
        self._complete_from_s, self._complete_until_s = 0.0, math.inf
        self._rest_angle_deg = self._true_angle(np.asarray(position_deg))

    def move_to(self, position_deg: float, now_s: float) -> None:
        """Move to an encoder position, clipped to the position limits, and hold it."""
        target_deg = min(max(position_deg, self.limits.low_deg), self.limits.high_deg)
        distance_deg = target_deg - self.encoder(now_s).position_deg
        missed_deg = math.copysign(min(self.friction_deg, abs(distance_deg)), distance_deg)
        reached_deg = target_deg - missed_deg
        up, along, down = move(self.encoder(now_s), reached_deg, self.limits)
        self._start(now_s, [*up, *along, *down], self._settling(down), reached_deg)
        self._missed_deg = missed_deg

    def turn_at(self, rate_dps: float, now_s: float) -> None:
        """Turn at a rate until the next command; at a position limit the axis stops."""
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
        """Open the servo: the brake stops the axis, without settling."""
        pieces = change_rate(self.encoder(now_s), 0.0, self.limits)
        self._start(now_s, pieces, self._settling([]))

    def overcome(self, now_s: float, by_deg: float = 0.0) -> None:
        """Move the axis against its servo by an external force and hold it there.

        Until :meth:`let_go`, commands change the commanded profile but not the axis.
        """
        start, limits = self.encoder(now_s), self.parameters.limits
        if by_deg:
            target_deg = start.position_deg + by_deg
            up, along, down = move(start, target_deg, limits)
            pieces = [*up, *along, *down]
        else:
            target_deg = None
            acceleration_dps2, jerk_dps3 = _JAM * limits.acceleration_dps2, _JAM**2 * limits.jerk_dps3
            hard = replace(limits, acceleration_dps2=acceleration_dps2, jerk_dps3=jerk_dps3)
            pieces = change_rate(start, 0.0, hard)
        commanded = self._commanded or self._motions[-1]
        self._follow(Motion(now_s, start, pieces, self._settling([]), target_deg))
        self._commanded = commanded

    def let_go(self, now_s: float, *, servo: bool) -> None:
        """End :meth:`overcome` and the effect of :attr:`friction_deg`; a closed servo follows its command."""
        commanded, self._commanded = self._commanded, None
        target_deg = self.rest_position_deg + self._missed_deg
        self._missed_deg = 0.0
        if commanded is not None:
            target_deg = commanded.last_state.position_deg
        if servo and math.isfinite(self._complete_until_s):
            self.stop(now_s)  # a missed rotation is not made up
        elif servo and target_deg != self.rest_position_deg:
            self.move_to(target_deg, now_s)

    def encoder(self, now_s: float) -> AxisState:
        """Encoder reading at a time not before the last command."""
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
        if self._missed_deg and now_s >= motion.still_from_s:
            return -self._missed_deg
        if motion.end_s < now_s < motion.still_from_s:
            return motion.at(now_s).position_deg - motion.last_state.position_deg
        return 0.0

    def position_deg(self, time_s: FloatArray) -> FloatArray:
        """True angle at each time, shape (n,), not wrapped."""
        if time_s.size and time_s.min() >= self._motions[-1].still_from_s:
            return np.full(time_s.shape, self._rest_angle_deg)
        encoder_deg = self._motions[-1].positions_deg(time_s)
        # Before the start of a motion the one before it was under way.
        for earlier, later in zip(self._motions[-2::-1], self._motions[:0:-1], strict=True):
            before = time_s < later.start_s
            if not before.any():
                break
            encoder_deg = np.where(before, earlier.positions_deg(time_s), encoder_deg)
        return self._true_angle(encoder_deg)

    def profile_complete(self, now_s: float) -> bool:
        """Whether the commanded position or rate is reached and held."""
        return self._complete_from_s <= now_s < self._complete_until_s

    @property
    def still_from_s(self) -> float:
        """End of the last motion and its settling, different for each; the angle is exactly constant then."""
        return self._motions[-1].still_from_s

    def is_moving(self, now_s: float) -> bool:
        """Whether the angle still changes."""
        return now_s < self._motions[-1].still_from_s

    def _start(
        self, now_s: float, pieces: list[Piece], settling: Settling, target_deg: float | None = None
    ) -> None:
        motion = Motion(now_s, self.encoder(now_s), pieces, settling, target_deg)
        self._missed_deg = 0.0
        self._complete_from_s, self._complete_until_s = motion.end_s, math.inf
        if self._commanded is not None:
            self._commanded = motion
        else:
            self._follow(motion)

    def _follow(self, motion: Motion) -> None:
        now_s = motion.start_s
        self.before_motion(now_s)
        # a motion is kept while its end, the start of the next one, is recent
        ends_s = [later.start_s for later in self._motions[1:]] + [now_s]
        recent = [m for m, end_s in zip(self._motions, ends_s, strict=True) if end_s > now_s - _MEMORY_S]
        self._motions = [*recent, motion]
        self._rest_angle_deg = self._true_angle(np.asarray(motion.last_state.position_deg))

    def _settling(self, braking: list[Piece]) -> Settling:
        """Overshoot after braking in three pieces, in proportion to the deceleration."""
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
