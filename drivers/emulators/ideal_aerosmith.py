"""Emulator of an Ideal Aerosmith single-axis table controller at its serial port.

Commands are three letters and a number. The reply to each is a prompt; a question mark before the prompt
reports an unknown command. Source: programs that drive such tables; there is no public manual. Sinusoidal
motion and calibration are not emulated.

Assumptions where the sources are silent: the answer to ``STA`` is 1 while the axis moves, otherwise 0; the
prompt of absolute and relative moves comes at once; the axis moves only with the motor switched on.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Literal

from gyrobench.drivers.emulators.dialect import TableEmulation, TextInstrument, decimal
from gyrobench.drivers.emulators.world.table_axis import TableAxis

#: The axis of the world that the table uses.
_AXIS = 2
_PROMPT = b">"
_COMMAND = re.compile(r"([A-Z]{3}|P(?=[-+.\d]))(.*)")
_DEFAULT_TOLERANCE_DEG = 0.01
_STANDSTILL_DPS = 1e-3
_DECIMALS = 4
_LATENCY_S = 0.02


class IdealAerosmithEmulator(TextInstrument):
    """The emulated controller with its axis.

    ``done`` is the answer to ``MCO`` when a motion is complete; programs in the field disagree about it.
    ``jog_prompt`` is when the prompt of ``JOG`` comes: with the stop or the next ``STA``, or at once.
    """

    def __init__(
        self, axis: TableAxis, *, done: Literal[0, 1] = 1, jog_prompt: Literal["late", "at_once"] = "late"
    ) -> None:
        super().__init__(_LATENCY_S)
        self.axis = axis
        self._done = done
        self._jog_prompt = jog_prompt
        self._zero_deg = self._home_deg = 0.0
        self._set_defaults()
        #: Commands with a number, and commands without.
        self._with_number: dict[str, Callable[[float], bytes | None]] = {
            "JOG": self._jog,
            "MOV": self._move_to,
            "P": self._move_to,
            "RMO": lambda distance_deg: self._move_to(self._position_deg + distance_deg),
            "VEL": partial(self._set_limit, "rate_dps"),
            "ACL": partial(self._set_limit, "acceleration_dps2"),
            "SRV": self._set_servo,
            "DIR": self._set_direction,
            "HOF": self._set_home,
            "MCO": self._motion_complete,
        }
        self._without_number: dict[str, Callable[[], bytes | None]] = {
            "HOM": lambda: self._move_to(self._home_deg),
            "STO": self._stop,
            "PPO": lambda: self._format_number(self._position_deg),
            "PVE": lambda: self._format_number(self.axis.encoder(self._now_s).rate_dps),
            "STA": lambda: b"1" if self.axis.is_moving(self._now_s) else b"0",
            "MCO": lambda: self._motion_complete(_DEFAULT_TOLERANCE_DEG),
            "ZER": self._set_zero,
            "PZR": self._set_zero,
        }

    def is_servoed(self, axis: int) -> bool:
        """Whether the motor is switched on."""
        if axis != _AXIS:
            raise KeyError(axis)
        return self._servo

    def power_off(self, now_s: float) -> None:
        """Lose power: the brake stops the axis."""
        self.axis.release(now_s)
        self._discard_input()
        self._set_defaults()

    def power_on(self, now_s: float) -> None:
        """Restart with the motor off and the defaults."""

    def _set_defaults(self) -> None:
        self._servo = False
        self._direction = 1.0
        self._target_deg = self.axis.rest_position_deg
        self._prompt_pending = False
        self.axis.limits = self.axis.parameters.limits

    @property
    def _position_deg(self) -> float:
        return self.axis.encoder(self._now_s).position_deg - self._zero_deg

    def _reply(self, request: str) -> bytes:
        parts = _COMMAND.fullmatch(request.upper())
        name, rest = (parts[1], parts[2]) if parts else ("", "")
        late_prompt = b""
        if self._prompt_pending and name in ("STO", "STA"):
            self._prompt_pending, late_prompt = False, _PROMPT
        answer = self._execute(name, rest)
        if name == "JOG" and answer == b"" and self._jog_prompt == "late":
            self._prompt_pending = True
            return b""
        if answer is None:
            answer = b"?"
        return late_prompt + (answer + b"\r" if answer else b"") + _PROMPT

    def _execute(self, name: str, rest: str) -> bytes | None:
        """Execute a command; returns its answer, possibly empty, or None if it is unknown or impossible."""
        if not rest:
            command = self._without_number.get(name)
            return command() if command else None
        command_with_number, value = self._with_number.get(name), decimal(rest)
        return command_with_number(value) if command_with_number and value is not None else None

    def _format_number(self, value: float) -> bytes:
        return f"{value:.{_DECIMALS}f}".encode("ascii")

    def _jog(self, rate_dps: float) -> bytes | None:
        if not self._servo or abs(rate_dps) > self.axis.parameters.rate_limit_dps:
            return None
        self.axis.turn_at(self._direction * rate_dps, self._now_s)
        return b""

    def _move_to(self, position_deg: float) -> bytes | None:
        target_deg, widest = position_deg + self._zero_deg, self.axis.parameters.limits
        if not self._servo or not widest.low_deg <= target_deg <= widest.high_deg:
            return None
        self._target_deg = target_deg
        self.axis.move_to(target_deg, self._now_s)
        return b""

    def _stop(self) -> bytes:
        self.axis.stop(self._now_s)
        return b""

    def _set_limit(self, bound: str, value: float) -> bytes | None:
        if not 0.0 < value <= getattr(self.axis.parameters.limits, bound):
            return None
        self.axis.limits = replace(self.axis.limits, **{bound: value})
        return b""

    def _set_servo(self, state: float) -> bytes | None:
        if state not in (0.0, 1.0):
            return None
        self._servo = bool(state)
        if not self._servo:
            self.axis.release(self._now_s)
        return b""

    def _set_direction(self, direction: float) -> bytes | None:
        if direction not in (0.0, 1.0):
            return None
        self._direction = -1.0 if direction else 1.0
        return b""

    def _set_home(self, position_deg: float) -> bytes:
        self._home_deg = position_deg
        return b""

    def _set_zero(self) -> bytes:
        self._zero_deg = self.axis.encoder(self._now_s).position_deg
        return b""

    def _motion_complete(self, tolerance_deg: float) -> bytes:
        state = self.axis.encoder(self._now_s)
        is_near = abs(state.position_deg - self._target_deg) <= tolerance_deg
        is_done = is_near and abs(state.rate_dps) < _STANDSTILL_DPS
        return str(self._done if is_done else 1 - self._done).encode("ascii")


DIALECT = TableEmulation(lambda axes: IdealAerosmithEmulator(axes[_AXIS]))
