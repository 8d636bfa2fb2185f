"""Ramps for a chamber whose controller can't ramp: the bench moves the set point in small steps."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.errors import RefusedError
from gyrobench.drivers.chamber import Chamber, ChamberReading

#: Smallest step of the set point, K, except for the last one.
_MIN_STEP_C = 0.1
#: Longest time between two calls that counts for a step, s; a longer gap does not make the step larger.
_MAX_GAP_S = 30.0


@dataclass
class _Ramp:
    target_c: float
    c_per_s: float
    commanded_c: float  #: Set point commanded last.
    commanded_s: float  #: Time of that command.
    confirmed_c: float | None = None  #: The same, as the controller rounds it; None until it is read back.


class SoftwareRamp:
    """A chamber whose ramps run in the bench; all other calls go to the chamber's driver unchanged.

    :meth:`advance` moves the set point and has to be called every few seconds. A ramp starts at the air
    temperature. It ends at its target, or early if the chamber is switched off, gets another command, or its
    set point is changed at the panel. Readings give the target as set point while the controller holds the
    commanded step.
    """

    def __init__(self, chamber: Chamber, clock: Clock) -> None:
        self._chamber = chamber
        self._clock = clock
        self._ramp: _Ramp | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._chamber, name)

    @property
    def is_ramping(self) -> bool:
        """Whether a ramp is in progress."""
        return self._ramp is not None

    def continue_from(self, previous: SoftwareRamp) -> None:
        """Continue the ramp of the driver that used the line before it was opened again."""
        self._ramp = previous._ramp

    def set_temperature(self, temperature_c: float, rate_c_per_min: float | None) -> None:
        """Begin a ramp, or command a set point without one; raises as :meth:`Chamber.set_temperature`."""
        self._ramp = None
        if rate_c_per_min is None:
            self._chamber.set_temperature(temperature_c, None)
            return
        self._check(temperature_c, rate_c_per_min)
        air_c, now_s = self._chamber.read().temperature_c, self._clock.now()
        self._ramp = _Ramp(temperature_c, rate_c_per_min / 60.0, air_c, now_s)
        self.advance()

    def set_point_c(self) -> float:
        """Target of the ramp, or the set point last commanded."""
        return self._chamber.set_point_c() if self._ramp is None else self._ramp.target_c

    def switch(self, on: bool) -> None:
        """Switch the chamber; switching off ends the ramp."""
        if not on:
            self._ramp = None
        self._chamber.switch(on)

    def read(self) -> ChamberReading:
        """Read the chamber, with the target of a ramp as set point."""
        reading, ramp = self._chamber.read(), self._ramp
        if ramp is None or ramp.confirmed_c not in (None, reading.set_point_c):
            return reading
        return replace(reading, set_point_c=ramp.target_c)

    def advance(self) -> None:
        """Move the set point if a step is due.

        Ends the ramp and raises RefusedError if the controller refuses the step, or its set point was
        changed at the panel.
        """
        ramp = self._ramp
        if ramp is None:
            return
        now_s = self._clock.now()
        remaining_c = ramp.target_c - ramp.commanded_c
        step_c = ramp.c_per_s * min(now_s - ramp.commanded_s, _MAX_GAP_S)
        is_last = abs(remaining_c) <= step_c
        if ramp.confirmed_c is not None and step_c < _MIN_STEP_C and not is_last:
            return
        try:
            if ramp.confirmed_c not in (None, present_c := self._chamber.set_point_c()):
                raise self._refused(
                    f"its set point was changed from {ramp.confirmed_c} to {present_c} °C in a ramp, which "
                    "ends there. Leave its panel alone, and command the temperature again"
                )
            # Unknown until it is read back: a reply may be lost although the command was executed.
            ramp.confirmed_c, ramp.commanded_s = None, now_s
            ramp.commanded_c = (
                ramp.target_c if is_last else ramp.commanded_c + math.copysign(step_c, remaining_c)
            )
            self._chamber.set_temperature(ramp.commanded_c, None)
            ramp.confirmed_c = self._chamber.set_point_c()
        except RefusedError:
            self._ramp = None
            raise
        if is_last:
            self._ramp = None

    def _check(self, temperature_c: float, rate_c_per_min: float) -> None:
        """Raise RefusedError if the controller would refuse the target of a ramp."""
        if not (0.0 < rate_c_per_min < math.inf and math.isfinite(temperature_c)):
            raise self._refused(f"a ramp of {rate_c_per_min} °C/min to {temperature_c} °C can't be commanded")
        try:
            low_c, high_c = self._chamber.limits_c()
        except RefusedError:
            return  # the controller has no query for them
        if not low_c <= temperature_c <= high_c:
            limits = f"the controller's limits, {low_c} to {high_c} °C"
            raise self._refused(f"a set point of {temperature_c} °C is outside {limits}")

    def _refused(self, message: str) -> RefusedError:
        return RefusedError("chamber", message)
