"""Ramps for a chamber whose controller does not ramp its set point: the set point is moved in small steps."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.errors import RefusedError
from gyrobench.drivers.chamber import Chamber, ChamberReading

#: Smallest step of the set point, K, except for the last one.
_STEP_C = 0.1
#: A pause between readings longer than this does not become a larger step.
_MAX_PAUSE_S = 30.0


@dataclass
class _Ramp:
    target_c: float
    c_per_s: float
    at_c: float  #: Set point commanded last.
    moved_s: float  #: When.
    held_c: float | None = None  #: What the controller holds for it; None before it has confirmed it.


class SoftwareRamp:
    """A chamber with the ramps that its controller lacks; all else is the chamber's driver's.

    :meth:`advance` moves the set point on and has to be called every few seconds. A ramp starts at the air's
    temperature, and ends where the chamber is switched off, commanded otherwise, or changed at its panel.
    Readings have the end of the ramp as set point while the controller holds what was commanded.
    """

    def __init__(self, chamber: Chamber, clock: Clock) -> None:
        self._chamber = chamber
        self._clock = clock
        self._ramp: _Ramp | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._chamber, name)

    @property
    def is_moving(self) -> bool:
        """Whether the set point has not reached the end of its ramp."""
        return self._ramp is not None

    def continue_from(self, before: SoftwareRamp) -> None:
        """Continue the ramp of the driver that had the line before."""
        self._ramp = before._ramp

    def set_temperature(self, temperature_c: float, rate_c_per_min: float | None) -> None:
        """Begin a ramp, or command a temperature without one; raises as :class:`Chamber` describes."""
        self._ramp = None
        if rate_c_per_min is None:
            self._chamber.set_temperature(temperature_c, None)
            return
        self._check(temperature_c, rate_c_per_min)
        air_c, now_s = self._chamber.read().temperature_c, self._clock.now()
        self._ramp = _Ramp(temperature_c, rate_c_per_min / 60.0, air_c, now_s)
        self.advance()

    def set_point_c(self) -> float:
        """End of the ramp, or the temperature last commanded."""
        return self._chamber.set_point_c() if self._ramp is None else self._ramp.target_c

    def switch(self, on: bool) -> None:
        """Switch the chamber; off ends the ramp."""
        if not on:
            self._ramp = None
        self._chamber.switch(on)

    def read(self) -> ChamberReading:
        """Read the chamber."""
        reading, ramp = self._chamber.read(), self._ramp
        if ramp is None or ramp.held_c not in (None, reading.set_point_c):
            return reading
        return replace(reading, set_point_c=ramp.target_c)

    def advance(self) -> None:
        """Move the set point on if a step is due.

        Raises RefusedError, at the end of the ramp, if the controller refuses the step or was changed at its
        panel.
        """
        ramp = self._ramp
        if ramp is None:
            return
        now_s = self._clock.now()
        way_c = ramp.target_c - ramp.at_c
        step_c = ramp.c_per_s * min(now_s - ramp.moved_s, _MAX_PAUSE_S)
        is_last = abs(way_c) <= step_c
        if ramp.held_c is not None and step_c < _STEP_C and not is_last:
            return
        try:
            if ramp.held_c not in (None, held_c := self._chamber.set_point_c()):
                raise self._refused(
                    f"its set point was changed from {ramp.held_c} to {held_c} °C in a ramp, which "
                    "ends there. Leave its panel alone, and command the temperature again"
                )
            # Unknown until it is read back: a reply may be lost although the command was executed.
            ramp.held_c, ramp.moved_s = None, now_s
            ramp.at_c = ramp.target_c if is_last else ramp.at_c + math.copysign(step_c, way_c)
            self._chamber.set_temperature(ramp.at_c, None)
            ramp.held_c = self._chamber.set_point_c()
        except RefusedError:
            self._ramp = None
            raise
        if is_last:
            self._ramp = None

    def _check(self, temperature_c: float, rate_c_per_min: float) -> None:
        """Raise RefusedError if the end of a ramp would be refused."""
        if not (0.0 < rate_c_per_min < math.inf and math.isfinite(temperature_c)):
            raise self._refused(f"a ramp of {rate_c_per_min} °C/min to {temperature_c} °C can't be commanded")
        try:
            low_c, high_c = self._chamber.limits_c()
        except RefusedError:
            return  # it has no query for them
        if not low_c <= temperature_c <= high_c:
            limits = f"the controller's limits, {low_c} to {high_c} °C"
            raise self._refused(f"a set point of {temperature_c} °C is outside {limits}")

    def _refused(self, message: str) -> RefusedError:
        return RefusedError("chamber", message)
