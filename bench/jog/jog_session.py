"""A session of manual control: opens the bench, executes commands, and leaves the bench safe."""

from __future__ import annotations

import math
import shutil
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from itertools import takewhile
from pathlib import Path

import numpy as np

from gyrobench.bench.engine.interlocks.watch import TrippedError
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.foundations.errors import GyrobenchError, InstrumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.foundations.text import counted, did_you_mean
from gyrobench.bench.guard.process import guard_for
from gyrobench.bench.jog.manual_control import ManualControl, limit_lines, readings
from gyrobench.bench.jog.manual_limits import TABLE_AXES, manual_limits
from gyrobench.bench.jog.terminal import (
    CommandError,
    Display,
    EndSessionError,
    Interruptions,
    StoppedByOperatorError,
    TypedLines,
)
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.station.bench_lock import JOG_COMMAND, BenchLock
from gyrobench.bench.station.instruments import CHAMBER, RATE_TABLE, Emulation, Instruments
from gyrobench.bench.station.station import Station

_PROMPT = "jog> "
_TICKS_TO_FIRST_FRAME = 2


def jog_bench(name: str, commands: Sequence[str], emulation: Emulation, leave: bool) -> bool:
    """Open a bench, execute commands, and leave it in its safe state.

    ``name`` is a station file, or the name of a shipped one; without ``commands`` the lines of standard input
    are executed. ``leave``: whether chamber, INS power and servos keep their state at the end. Returns
    whether all commands succeeded and the bench was left as intended. Raises DocumentError if the station
    file is wrong. Raises BenchInUseError if another process holds the bench. Raises InstrumentError if no
    instrument can be reached when the bench is opened; a single unreachable one is left out.
    """
    station = Station(find_document("stations", name))
    station.check_dbc()
    clock = station.new_clock()
    display = Display(sys.stdout, clock)

    def report(instrument: str, error: InstrumentError | None) -> None:
        display.print(str(error) if error is not None else f"{instrument}: replies again")

    folder = Path(tempfile.mkdtemp(prefix="gyrobench-jog-"))
    with ExitStack() as resources:
        resources.callback(_remove_if_empty, folder)  # nothing was opened
        interruptions = resources.enter_context(Interruptions())
        lock = resources.enter_context(BenchLock(station, folder, clock, JOG_COMMAND))
        instruments = resources.enter_context(Instruments(station, clock, emulation, may_be_absent=True))
        for each in (RATE_TABLE, CHAMBER):
            with suppress(InstrumentError):  # left out, or identified later
                instruments.identify(each)
        for error in instruments.absent.values():
            display.print(f"Left out: {error}")
        for text in lock.taken_over:
            display.print(text)
        bench = LiveBench(station, instruments, clock, [], report)
        bench.start()
        _await_first_frame(bench)
        limits = manual_limits(station, instruments.table, instruments.chamber)
        guard = resources.enter_context(guard_for(station, folder, clock))
        control = ManualControl(bench, limits, display, guard.beat, interruptions)
        session = _Session(control, display, commands, leave)
        succeeded = session.run()
        is_safe = session.end()
        if is_safe:
            guard.release()
    if is_safe:
        shutil.rmtree(folder, ignore_errors=True)
    return succeeded and is_safe


def _remove_if_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()


def _await_first_frame(bench: LiveBench) -> None:
    """Wait for the first frame of an INS that is on, for a few ticks."""
    for _ in range(_TICKS_TO_FIRST_FRAME):
        bench.tick()
        bench.read_instruments()
        if math.isfinite(bench.readings.ins.age_s):
            return


class _Session:
    """Executes commands until the end of the input, or a command that ends the session."""

    def __init__(
        self, control: ManualControl, display: Display, commands: Sequence[str], leave: bool
    ) -> None:
        self._control = control
        self._display = display
        self._shell = _Shell(control, display)
        self._leave = leave
        self._is_typed = not commands and sys.stdin.isatty()
        self._input = None if commands else TypedLines(sys.stdin.fileno(), control.idle)
        # Unlike a generator, this iterator continues after an exception raised while it waits for a line.
        self._lines = (
            iter(commands) if self._input is None else iter(partial(self._next_line, self._input), None)
        )

    def run(self) -> bool:
        """Execute the commands; the first failure ends the session unless an operator types them."""
        if self._is_typed:
            name = self._control.bench.station.file.station
            self._display.print(f"Manual control of {name}. `help` lists the commands, `quit` ends.")
            return self._execute_lines()
        succeeded = self._execute_lines()
        remaining = (
            [] if succeeded else list(self._lines) if self._input is None else self._input.read_arrived()
        )
        commands = takewhile(lambda line: line.lower() not in _END_COMMANDS, remaining)
        if count := sum(bool(_command_of(line)) for line in commands):
            self._display.print(f"Not executed: {counted(count, 'command')} after this one.")
        return succeeded

    def _execute_lines(self) -> bool:
        succeeded = True
        while True:
            try:
                self._control.idle()  # checks interlocks between commands without a pause
                line = next(self._lines, None)
                if line is None or line.lower() in _END_COMMANDS:
                    self._leave = self._leave or (line or "").lower() == "leave"
                    return succeeded
                if not self._is_typed and line and not line.startswith("#"):
                    self._display.print(f"{_PROMPT}{line}")
                self._shell.execute(_command_of(line))
            except EndSessionError as error:
                self._display.print(str(error))
                return False
            except StoppedByOperatorError:
                self._stop()
                if not self._is_typed:
                    return False
            except GyrobenchError as error:
                succeeded = self._is_typed
                self._display.print(_error_text(error))
                if not self._is_typed:
                    return False

    def end(self) -> bool:
        """Leave the bench in its safe state, or as it is; returns whether that succeeded."""
        if self._leave:
            self._stop()
            self._display.print("Chamber, INS power and servos are left as they are.")
            return True
        actions = self._control.make_safe()
        absent = self._control.bench.instruments.absent
        actions = [action for action in actions if action.instrument not in absent]
        if self._control.bench.instruments.is_ramping:
            self._display.print(
                "The chamber's set point is being ramped to its safe value; Ctrl-C ends the ramp."
            )
            actions = self._control.finish_ramp(actions)
        for action in actions:
            self._display.print(action.text)
        return not any(action.problem for action in actions)

    def _stop(self) -> None:
        try:
            self._control.stop()
        except GyrobenchError as error:
            self._display.print(f"The table could not be stopped: {error}")

    def _next_line(self, lines: TypedLines) -> str | None:
        if self._is_typed:
            self._display.prompt(_PROMPT)
        return lines.next()


def _command_of(line: str) -> str:
    """Strip the comment from a line."""
    return line.partition("#")[0].strip()


def _error_text(error: GyrobenchError) -> str:
    if isinstance(error, TrippedError):
        return "\n".join(f"Interlock {trip.name}: {trip.text}" for trip in error.trips)
    return str(error)


_WATCH_S = 60.0
_MAX_WATCH_S = 604_800.0
_END_USAGES = {"quit": "end; the bench goes to its safe state", "leave": "end; only the table is stopped"}
#: Commands that end a session; "leave" without the safe state.
_END_COMMANDS = ("quit", "exit", "q", "leave")


#: Usages of a command with their meanings, and the function that takes its arguments from a list of words and
#: returns what to execute.
_JogCommand = tuple[Mapping[str, str], Callable[[list[str]], Callable[[], object]]]


class _Shell:
    def __init__(self, control: ManualControl, display: Display) -> None:
        self._control = control
        self._display = display
        self._commands: Mapping[str, _JogCommand] = {
            "show": ({"show": "all readings"}, lambda _: self._show),
            "watch": ({"watch [S]": "readings for S seconds, default 60"}, self._watch),
            "table": (
                {
                    "table outer|inner ANGLE [at RATE]": "move one axis; deg, deg/s",
                    "table to POSITION [AZIMUTH] [at RATE]": "go to z_up, x_down, ...",
                    "table rate outer|inner RATE": "turn at a constant rate, deg/s",
                },
                self._table,
            ),
            "stop": ({"stop": "stop the table"}, lambda _: control.stop),
            "home": ({"home [at RATE]": "all axes to zero"}, self._home),
            "servo": (
                {"servo on|off": "close or open the table's servos"},
                lambda words: control.servo_on if _parse_on_off(words) else control.servo_off,
            ),
            "chamber": (
                {
                    "chamber TEMPERATURE [at RAMP]": "set point; degC, degC/min",
                    "chamber on|off": "switch temperature control",
                },
                self._chamber,
            ),
            "unit": (
                {"unit on|off": "switch the power of the INS"},
                lambda words: partial(control.unit_switch, _parse_on_off(words)),
            ),
            "ins": ({"ins align|navigate|standby": "command the INS"}, self._ins),
            "faults": ({"faults": "faults, alarms, tripped interlocks"}, lambda _: self._faults),
            "clear": ({"clear": "clear the chamber's alarms"}, lambda _: control.clear),
            "events": (
                {"events": "the chamber's event outputs"},
                lambda _: lambda: self._print(control.events()),
            ),
            "limits": (
                {"limits": "limits of angle, rate, temperature"},
                lambda _: lambda: self._print(limit_lines(control.limits)),
            ),
            "help": ({"help": "this list"}, self._help),
        }

    def execute(self, line: str) -> None:
        """Parse a line and execute it.

        Raises CommandError if it is not a command, or a limit forbids it. Raises GyrobenchError if it fails
        during its execution.
        """
        words = line.replace(",", " ").lower().split()
        if not words:
            return
        command = self._commands.get(words[0])
        if command is None:
            command_names = [*self._commands, *_END_USAGES]
            raise CommandError(
                f"unknown command '{words[0]}'{did_you_mean(words[0], command_names)}; `help` lists the "
                "commands"
            )
        usages, parse = command
        arguments = words[1:]
        try:
            execute = parse(arguments)
            if arguments:
                raise _UsageError(f"unexpected argument '{' '.join(arguments)}'")
        except _UsageError as error:
            raise CommandError(f"{error}. Usage: {'  or  '.join(usages)}") from None
        execute()

    def _show(self) -> None:
        self._control.bench.read_instruments()
        self._print(readings(self._control.bench, self._control.tripped))

    def _watch(self, words: list[str]) -> Callable[[], object]:
        duration_s = _parse_number(words.pop(0), "a time in s") if words else _WATCH_S
        if not 0.0 < duration_s <= _MAX_WATCH_S:
            raise _UsageError("the time must be above 0 s and at most a week")
        return partial(self._control.watch, duration_s)

    def _table(self, words: list[str]) -> Callable[[], object]:
        keyword = words.pop(0) if words else ""
        if keyword == "rate":
            axis, rate_dps = _parse_axis(words), _parse_number(_next_word(words), "a rate in deg/s")
            return partial(self._control.turn_at, axis, rate_dps)
        if keyword == "to":
            return self._to_position(words)
        axis = _parse_axis([keyword])
        angle_deg = _parse_number(_next_word(words), "an angle in deg")
        return partial(self._control.move, {axis: angle_deg}, _parse_rate(words))

    def _to_position(self, words: list[str]) -> Callable[[], object]:
        name = _next_word(words)
        if name not in POSITIONS:
            raise _UsageError(
                f"no position '{name}'{did_you_mean(name, POSITIONS)}; known: {', '.join(POSITIONS)}"
            )
        azimuth_deg = 0.0
        if words and words[0] != "at":
            azimuth_deg = _parse_number(words.pop(0), "an azimuth in deg")
        rate_dps = _parse_rate(words)
        table, axes = self._control.bench.station.table, self._control.limits.axes
        angles_deg = table.angles(POSITIONS[name].C_nb(np.deg2rad(azimuth_deg)))
        targets_deg = {axis: each for axis, each in zip(TABLE_AXES, angles_deg, strict=True) if axis in axes}
        return partial(self._control.move, targets_deg, rate_dps)

    def _home(self, words: list[str]) -> Callable[[], object]:
        return partial(self._control.move, dict.fromkeys(self._control.limits.axes, 0.0), _parse_rate(words))

    def _chamber(self, words: list[str]) -> Callable[[], object]:
        if words and words[0] in ("on", "off"):
            return partial(self._control.chamber_switch, _parse_on_off(words))
        temperature_c = _parse_number(_next_word(words), "a temperature in degC")
        if words and words[0] == "at":
            words.pop(0)
        ramp_c_per_min = _parse_number(words.pop(0), "a ramp in degC/min") if words else None
        return partial(self._control.chamber_to, temperature_c, ramp_c_per_min)

    def _ins(self, words: list[str]) -> Callable[[], object]:
        command = _next_word(words)
        if command not in ("align", "navigate", "standby"):
            raise _UsageError(f"the INS has no command '{command}'")
        return partial(self._control.ins, command)

    def _faults(self) -> None:
        self._control.bench.read_instruments()
        newest = self._control.bench.readings
        lines = [f"rate table: {each}" for each in newest.table.faults]
        lines += [f"chamber: {each}" for each in newest.chamber.alarms]
        lines += [f"interlock tripped: {each}" for each in self._control.tripped]
        self._print(lines or ["none"])

    def _help(self, words: list[str]) -> Callable[[], object]:
        words.clear()  # the help has no topics
        usages = [usage for command_usages, _ in self._commands.values() for usage in command_usages.items()]
        lines = [f"  {usage:38} {meaning}" for usage, meaning in (*usages, *_END_USAGES.items())]
        return partial(self._print, [*lines, "Ctrl-C stops the table."])

    def _print(self, lines: list[str]) -> None:
        for line in lines:
            self._display.print(line)


class _UsageError(Exception):
    """The arguments do not fit the command."""


def _next_word(words: list[str]) -> str:
    if not words:
        raise _UsageError("an argument is missing")
    return words.pop(0)


def _parse_number(word: str, quantity: str) -> float:
    try:
        number = float(word)
    except ValueError:
        number = float("nan")
    if not np.isfinite(number):
        raise _UsageError(f"'{word}' is not {quantity}")
    return number


def _parse_axis(words: list[str]) -> str:
    axis = _next_word(words)
    if axis not in TABLE_AXES:
        raise _UsageError(f"'{axis}' is not an axis; the axes are outer and inner")
    return axis


def _parse_rate(words: list[str]) -> float | None:
    """Parse ``at RATE``; None if it is missing."""
    if not words:
        return None
    if words.pop(0) != "at":
        raise _UsageError("expected 'at RATE'")
    return _parse_number(_next_word(words), "a rate in deg/s")


def _parse_on_off(words: list[str]) -> bool:
    word = _next_word(words)
    if word not in ("on", "off"):
        raise _UsageError(f"'{word}' is neither on nor off")
    return word == "on"
