"""Manual control: executes commands and checks interlocks at every tick; formats readings as text."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TypeVar

import numpy as np

from gyrobench.bench.engine.interlocks.watch import TrippedError
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.foundations.errors import FaultError, GyrobenchError, InstrumentError, RefusedError
from gyrobench.bench.jog.manual_limits import TABLE_AXES, ManualLimits
from gyrobench.bench.jog.terminal import CommandError, Display, Interruptions
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.station.instruments import CHAMBER, RATE_TABLE
from gyrobench.bench.station.interlocks import FORBID_MANUAL_CHAMBER, FORBID_MANUAL_MOTION
from gyrobench.bench.station.safe_state import RAMP_PERIOD_S, SafeAction, finish_ramp
from gyrobench.drivers.ins.can_bus import INSTRUMENT
from gyrobench.drivers.ins.ins_status import InsStatus
from gyrobench.drivers.ins.readout import Alignment, InsMode

#: Rate of a move without a given rate, deg/s, if the limits allow it.
_DEFAULT_RATE_DPS = 10.0
_MOVE_FACTOR, _MOVE_MARGIN_S = 1.5, 30.0
_MAX_START_S = 180.0
_TRIES = 3
_MAX_EVENTS = 16
#: Maximum number of ticks until the table is at rest, and the maximum rate at rest, deg/s.
_STOP_TICKS, _REST_DPS = 60, 0.01

_T = TypeVar("_T")


class ManualControl:
    """Executes one command at a time; a command that fails or is interrupted leaves the table stopped.

    ``bench`` has been started. ``beat_guard`` sends the guard its heartbeat and returns a note to print, or
    None.
    """

    def __init__(
        self,
        bench: LiveBench,
        limits: ManualLimits,
        display: Display,
        beat_guard: Callable[[], str | None],
        interruptions: Interruptions,
    ) -> None:
        self.bench = bench
        self.limits = limits
        self._display = display
        self._beat_guard = beat_guard
        self._interruptions = interruptions
        self._turning: dict[str, float] = {}
        self._ticked_s = bench.clock.now()
        if bench.units[0].has_started():
            bench.units[0].state.detected_on()
        self.tripped: list[str] = []  #: Names of the interlocks that are tripped.
        for trip in bench.trips():
            self.tripped.append(trip.name)
            display.print(f"Interlock {trip.name}: {trip.text}")

    def tick(self, follow: bool = False) -> None:
        """Poll the bench for one tick, check interlocks and signals.

        ``follow``: whether to read all instruments at this tick, even if their period is not over. Raises
        TrippedError if an interlock tripped; the bench is then in its safe state. Raises
        StoppedByOperatorError or EndSessionError if a signal arrived.
        """
        self.bench.tick()
        self._ticked_s = self.bench.clock.now()
        if follow or self._turning:
            self.bench.read_instruments()
        self._beat()
        self.bench.check_set_point_reached()
        self._check_interlocks()
        self._stop_before_limits()
        self._interruptions.check()

    def idle(self) -> None:
        """Poll a bench in real time between commands; does nothing on virtual time."""
        self._interruptions.check()
        bench = self.bench
        if bench.clock.is_virtual:
            return
        bench.poll_units()
        file = bench.station.file
        # A tick lasts until the next tick of the bench: started early it delays commands, late it misses one.
        if bench.clock.now() >= self._ticked_s + file.tick_s - min(file.poll_period_s, file.tick_s / 2.0):
            self.tick()

    def move(self, angles_deg: Mapping[str, float], rate_dps: float | None) -> None:
        """Move axes to angles and wait until they are in position."""
        if rate_dps is None:
            rate_dps = min(_DEFAULT_RATE_DPS, *(axis.rate_dps for axis in self.limits.axes.values()))
        if rate_dps <= 0.0:
            raise CommandError("the rate of a move must be above 0 deg/s. Nothing was moved.")
        for axis, angle_deg in angles_deg.items():
            self.limits.check_angle(axis, angle_deg)
            self.limits.check_rate(axis, rate_dps)
        self.servo_on()
        with self._stop_on_failure():
            self._turning.clear()
            self._retry(
                lambda: self.bench.instruments.table.move_to(self._by_axis_number(angles_deg), rate_dps)
            )
            self._wait_for_position(angles_deg, rate_dps)
        self._display.print(self._angles_text())

    def turn_at(self, axis: str, rate_dps: float) -> None:
        """Turn an axis at a constant rate until `stop` or shortly before its limit."""
        if rate_dps == 0.0:
            self.stop()
            return
        self.limits.check_rate(axis, rate_dps)
        self.bench.read_instruments()
        room_deg = self.limits.room_deg(axis, self._angle_deg(axis), rate_dps)
        if room_deg <= 0.0:
            raise CommandError(
                f"the {axis} axis is too close to its limit to turn at {rate_dps:g} deg/s. Nothing was moved."
            )
        self.servo_on()
        with self._stop_on_failure():
            number = next(iter(self._by_axis_number({axis: 0.0})))
            self._retry(lambda: self.bench.instruments.table.turn_at(number, rate_dps))
        self._turning[axis] = rate_dps
        self._display.print(
            f"{axis} axis turns at {rate_dps:g} deg/s for at most {room_deg:.0f} deg; `stop` stops it"
        )

    def stop(self) -> None:
        """Stop the table and wait until it rests."""
        self._turning.clear()
        self._retry(lambda: self.bench.instruments.table.stop())
        self.bench.read_instruments()
        for _ in range(_STOP_TICKS):
            if all(abs(rate) < _REST_DPS for rate in self.bench.readings.table.rate_dps):
                break
            self.bench.tick()
            self.bench.read_instruments()
            self._beat()
        self._display.print(f"table stopped: {self._angles_text()}")

    def servo_on(self) -> None:
        """Set the table's limits, clear latched faults and close its servos, unless that is done."""
        self._require_untripped(FORBID_MANUAL_MOTION)
        if not self.bench.state.expected.table_prepared:
            self.bench.prepare_table()
            self._display.print("servos on")

    def servo_off(self) -> None:
        """Stop the table and open its servos."""
        self._turning.clear()
        self.bench.state.table_released()
        self._retry(lambda: self.bench.instruments.table.release())
        self._display.print("table stopped, servos off")

    def chamber_to(self, temperature_c: float, ramp_c_per_min: float | None) -> None:
        """Set the chamber's temperature and switch it on; does not wait."""
        ramp = self.limits.ramp_c_per_min if ramp_c_per_min is None else ramp_c_per_min
        self.limits.check_chamber(temperature_c, ramp)
        self._require_untripped(FORBID_MANUAL_CHAMBER)
        self.bench.state.chamber_state_unknown()
        # The driver is looked up at each use: reopening a port creates a new one.
        self._retry(lambda: self.bench.instruments.chamber.set_temperature(temperature_c, ramp))
        self._retry(lambda: self.bench.instruments.chamber.switch(True))
        self.bench.state.chamber_commanded(temperature_c)
        self._display.print(
            f"chamber set to {temperature_c:g} degC at {ramp:g} degC/min; `watch` shows its progress"
        )

    def chamber_switch(self, on: bool) -> None:
        """Switch the chamber's temperature control."""
        if on:
            self._require_untripped(FORBID_MANUAL_CHAMBER)
        self.bench.state.chamber_switching(on)
        self._retry(lambda: self.bench.instruments.chamber.switch(on))
        self.bench.state.chamber_switched(on)
        self._display.print(f"chamber {'on' if on else 'off'}")

    def unit_switch(self, on: bool) -> None:
        """Switch the INS, or ask the operator to do so; after power-on wait for its first frames."""
        power = self.bench.station.file.unit.power
        if power == "always_on":
            raise CommandError("the INS of this bench is always on (station file: unit.power)")
        self.bench.units[0].state.state_unknown()
        if power == "operator":
            self._display.print(f"Switch the INS {'on' if on else 'off'} by hand now.")
        else:
            self._retry(lambda: self.bench.instruments.power_unit(on))
        if not on:
            self._display.print("INS off")
            return
        begin_s = self.bench.clock.now()
        while not self.bench.units[0].has_started():
            elapsed_s = self.bench.clock.now() - begin_s
            if elapsed_s > _MAX_START_S:
                raise InstrumentError(
                    "INS",
                    f"sends no frames {elapsed_s:.0f} s after power-on. Check its power and the CAN bus.",
                )
            self._display.progress(f"INS starts, {elapsed_s:.0f} s")
            self.tick()
        self.bench.read_instruments()
        self.bench.units[0].state.detected_on()
        self._display.print(f"INS on: {_mode_text(self.bench.readings.ins)}")

    def ins(self, command: str) -> None:
        """Command the INS: ``align``, ``navigate`` or ``standby``."""
        self.bench.instruments.ins.enter(InsMode[command.upper()])
        self.bench.read_instruments()
        self._display.print(f"INS: {_mode_text(self.bench.readings.ins)}")

    def watch(self, duration_s: float) -> None:
        """Print the readings for a time."""
        end_s = self.bench.clock.now() + duration_s
        for line in _WATCH_HEADER:
            self._display.print(_WATCH_COLUMNS.format(*line).rstrip())
        while self.bench.clock.now() < end_s - 1e-6:
            self.tick(follow=True)
            self._display.progress(_watch_line(self.bench))
        self._display.print(_watch_line(self.bench))

    def clear(self) -> None:
        """Clear the chamber's latched alarms; `servo on` clears those of the table."""
        self._retry(lambda: self.bench.instruments.chamber.clear_alarms())
        self.bench.read_instruments()
        active = ", ".join(self.bench.readings.chamber.alarms)
        self._display.print(
            f"chamber alarms cleared; still active: {active or 'none'}. `servo on` clears table faults."
        )

    def events(self) -> list[str]:
        """Describe each of the chamber's event outputs."""
        lines = []
        for number in range(1, _MAX_EVENTS + 1):
            try:
                on = self.bench.instruments.chamber.is_event_on(number)
            except RefusedError:
                break
            power = self.bench.station.file.unit
            unit = "  (the INS)" if power.power == "chamber_event" and power.power_event == number else ""
            lines.append(f"event {number}  {'on' if on else 'off'}{unit}")
        return lines or ["the chamber has no event outputs"]

    def make_safe(self) -> list[SafeAction]:
        """Bring the whole bench to the station's safe state, servos open."""
        self._turning.clear()
        return self.bench.make_safe(meanwhile=self._beat_guard)

    def finish_ramp(self, actions: list[SafeAction]) -> list[SafeAction]:
        """Wait until the set point has its safe value, or a signal; returns the results of the actions."""
        results = {action.what: action for action in actions}
        for new_results in finish_ramp(self.bench.station, self.bench.instruments, actions, self._beat_guard):
            results |= {action.what: action for action in new_results}
            self._beat()
            try:
                self._interruptions.check()
            except GyrobenchError:
                break
            self.bench.clock.sleep(RAMP_PERIOD_S)
        return list(results.values())

    def _wait_for_position(self, angles_deg: Mapping[str, float], rate_dps: float) -> None:
        self.bench.read_instruments()
        distance_deg = max(abs(angle - self._angle_deg(axis)) for axis, angle in angles_deg.items())
        limit_s = _MOVE_FACTOR * distance_deg / rate_dps + _MOVE_MARGIN_S
        end_s = self.bench.clock.now() + limit_s
        while not self._retry(lambda: self.bench.instruments.table.in_position()):
            self.tick(follow=True)
            self._display.progress(self._angles_text())
            if self.bench.clock.now() > end_s:
                raise FaultError(
                    "rate table", f"not in position after {limit_s:.0f} s: {self._angles_text()}"
                )
        self.bench.read_instruments()

    def _beat(self) -> None:
        if note := self._beat_guard():
            self._display.print(note)

    def _check_interlocks(self) -> None:
        trips = self.bench.trips()
        names = [trip.name for trip in trips]
        for name in self.tripped:
            if name not in names:
                self._display.print(f"Interlock {name}: cleared")
        new_trips = [trip for trip in trips if trip.name not in self.tripped]
        self.tripped = names
        if new_trips:
            self._turning.clear()
            for action in self.bench.make_safe(release_table=False, meanwhile=self._beat_guard):
                self._display.print(action.text)
            raise TrippedError(new_trips)

    def _stop_before_limits(self) -> None:
        for axis, rate_dps in list(self._turning.items()):
            room_deg = self.limits.room_deg(axis, self._angle_deg(axis), rate_dps)
            if room_deg <= abs(rate_dps) * self.bench.station.file.tick_s:
                self._display.print(f"{axis} axis is close to its limit and is stopped")
                self.stop()

    def _require_untripped(self, names: frozenset[str]) -> None:
        tripped = sorted(names.intersection(self.tripped))
        if tripped:
            raise CommandError(f"the interlock {', '.join(tripped)} is tripped. Nothing was done.")

    @contextlib.contextmanager
    def _stop_on_failure(self) -> Iterator[None]:
        try:
            yield
        except BaseException:
            with contextlib.suppress(InstrumentError):
                self.bench.instruments.table.stop()
            raise

    def _retry(self, exchange: Callable[[], _T]) -> _T:
        """Exchange with an instrument; repeated if it is lost on the line."""
        for _ in range(_TRIES - 1):
            try:
                return exchange()
            except (FaultError, RefusedError):
                raise
            except InstrumentError:
                self.bench.tick()
        return exchange()

    def _angle_deg(self, axis: str) -> float:
        return self.bench.table_angles()[TABLE_AXES.index(axis)]

    def _by_axis_number(self, angles_deg: Mapping[str, float]) -> dict[int, float]:
        section = self.bench.station.file.rate_table
        numbers = {"outer": section.outer_axis_number, "inner": section.inner_axis_number}
        return {numbers[axis]: angle for axis, angle in angles_deg.items()}

    def _angles_text(self) -> str:
        return ", ".join(f"{axis} {self._angle_deg(axis):.4f} deg" for axis in self.limits.axes)


#: Cosine of the largest tilt at which the unit counts as in a position.
_MIN_COSINE = math.cos(math.radians(0.1))


def readings(bench: LiveBench, tripped: Sequence[str]) -> list[str]:
    """Format all readings of the instruments, in lines of at most 80 columns."""
    newest, absent = bench.readings, bench.instruments.absent
    angles, rates = bench.table_angles(), bench.station.table_axes_of(newest.table.rate_dps)
    servo = "servos on" if newest.table.is_servoed else "servos off"
    is_single_axis = bench.station.file.rate_table.is_single_axis
    table = [
        f"Table      {name} {angle:9.4f} deg  {rate:8.4f} deg/s"
        for name, angle, rate in zip(("outer", "inner"), angles, rates, strict=True)
        if not (is_single_axis and name == "outer")
    ]
    table.append(f"           {servo}; the unit is {_position_text(bench)}")
    lines = ["Table      left out"] if RATE_TABLE in absent else table
    chamber = newest.chamber
    air = _format_or_dash(chamber.temperature_c, ".1f")
    set_point = _format_or_dash(chamber.set_point_c, ".1f")
    state = {True: ", on", False: ", off", None: ""}[chamber.is_on]
    chamber_text = f"air {air} degC, set point {set_point} degC{state}"
    lines.append(f"Chamber    {'left out' if CHAMBER in absent else chamber_text}")
    lines += ["INS        left out"] if INSTRUMENT in absent else _ins_lines(newest.ins)
    lines.append(f"Faults     {'; '.join([*newest.table.faults, *newest.chamber.alarms]) or 'none'}")
    lines.append(f"Interlocks {', '.join(tripped) or 'none tripped'}")
    return lines


def _ins_lines(ins: InsStatus) -> list[str]:
    if not math.isfinite(ins.age_s):
        return ["INS        sends no frames"]
    velocity = (
        f"{name} {_format_or_dash(each, '+.4f')}"
        for name, each in zip("ENU", ins.velocity_enu_mps, strict=True)
    )
    return [
        f"INS        {_mode_text(ins)}, last frame {ins.age_s:.1f} s ago",
        f"           velocity   {'  '.join(velocity)} m/s",
        f"           gyros      {_xyz(ins.optics_c)} degC, case {_format_or_dash(ins.case_c, '.1f')} degC",
        f"           boards     {_xyz(ins.electronics_c)} degC",
    ]


#: One line of `watch`, of at most 80 columns, and the names and units above its columns.
_WATCH_COLUMNS = "{:>7} {:>9} {:>9} {:>6} {:>6} {:>9} {:>9}  {}"
_WATCH_HEADER = (
    ("time", "outer", "inner", "air", "gyros", "v East", "v North", "INS"),
    ("s", "deg", "deg", "degC", "degC", "m/s", "m/s", ""),
)


def _watch_line(bench: LiveBench) -> str:
    """Format the changing readings in one line of at most 80 columns."""
    newest = bench.readings
    outer, inner = bench.table_angles()
    ins = newest.ins
    return _WATCH_COLUMNS.format(
        f"{newest.polled_s:.0f}",
        f"{outer:.3f}",
        f"{inner:.3f}",
        _format_or_dash(newest.chamber.temperature_c, ".1f"),
        _format_or_dash(float(np.mean(ins.optics_c)), ".1f"),
        *(_format_or_dash(each, "+.3f") for each in ins.velocity_enu_mps[:2]),
        ins.mode.name.lower() if math.isfinite(ins.age_s) else "silent",
    )


def _position_text(bench: LiveBench) -> str:
    C_nb = bench.station.table.attitude(*bench.table_angles())
    for name, position in POSITIONS.items():
        if C_nb[2, position.up_axis] * position.up_sign > _MIN_COSINE:
            turn = C_nb @ position.C_nb().T
            azimuth_deg = math.degrees(math.atan2(turn[1, 0], turn[0, 0])) % 360.0
            return f"in {name}, azimuth {azimuth_deg:.2f} deg"
    return "in none of the six positions"


def limit_lines(limits: ManualLimits) -> list[str]:
    """Format the limits of commands, a line for each axis and one for the chamber."""
    lines = [
        f"{name:8} {axis.low_deg:g} to {axis.high_deg:g} deg, at most {axis.rate_dps:g} deg/s"
        for name, axis in limits.axes.items()
    ]
    air = f"{limits.low_c:g} to {limits.high_c:g} degC, at most {limits.ramp_c_per_min:g} degC/min"
    return [*lines, f"{'chamber':8} {air}"]


def _mode_text(ins: InsStatus) -> str:
    if ins.mode is InsMode.UNKNOWN:
        return "mode unknown"
    aligned = {
        Alignment.NONE: ", not aligned",
        Alignment.COARSE: ", coarsely aligned",
        Alignment.FINE: ", finely aligned",
    }
    return f"{ins.mode.name.lower()}{aligned.get(ins.alignment, '')}"


def _format_or_dash(value: float | None, form: str) -> str:
    return "-" if value is None or not math.isfinite(value) else format(value, form)


def _xyz(values: Sequence[float]) -> str:
    return "  ".join(
        f"{axis} {_format_or_dash(value, '.2f')}" for axis, value in zip("xyz", values, strict=True)
    )
