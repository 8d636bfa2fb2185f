"""A session of manual control, from the name of a station to the safe state at its end."""

from __future__ import annotations

import math
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

from gyrobench.bench.engine.interlocks.watch import TrippedError
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.foundations.errors import GyrobenchError, InstrumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.guard.process import guard_for
from gyrobench.bench.jog.manual_control import ManualControl
from gyrobench.bench.jog.manual_limits import manual_limits
from gyrobench.bench.jog.shell import END_COMMANDS, Shell
from gyrobench.bench.jog.terminal import (
    Display,
    EndSessionError,
    Interruptions,
    StoppedByOperatorError,
    TypedLines,
)
from gyrobench.bench.station.instruments import Emulation, Instruments
from gyrobench.bench.station.locks import JOG_COMMAND, BenchLock
from gyrobench.bench.station.station import Station

_PROMPT = "jog> "
_TICKS_TO_FIRST_FRAME = 2


def jog_bench(name: str, commands: Sequence[str], emulation: Emulation, leave: bool) -> bool:
    """Open a bench, execute commands, and leave it in its safe state.

    Result: whether all commands succeeded and the bench was left as intended. Raises DocumentError if the
    station file is wrong. Raises BenchInUseError if another process holds the bench. Raises InstrumentError
    if no instrument can be reached when the bench is opened; one that can't is left out.

    Parameters
    ----------
    name : str
        Station file, or the name of a shipped one.
    commands : sequence of str
        Commands; if empty, lines of standard input.
    leave : bool
        Whether chamber, INS power and servos stay as they are at the end.
    """
    station = Station(find_document("stations", name))
    station.check_dbc()
    clock = station.new_clock()
    display = Display(sys.stdout, clock)

    def report(instrument: str, error: InstrumentError | None) -> None:
        display.print(str(error) if error is not None else f"{instrument}: replies again")

    folder = Path(tempfile.mkdtemp(prefix="gyrobench-jog-"))
    with ExitStack() as held:
        interruptions = held.enter_context(Interruptions())
        lock = held.enter_context(BenchLock(station, folder, clock, JOG_COMMAND))
        instruments = held.enter_context(Instruments(station, clock, emulation, may_be_absent=True))
        for error in instruments.absent.values():
            display.print(f"Left out: {error}")
        for text in lock.taken_over:
            display.print(text)
        bench = LiveBench(station, instruments, clock, [], report)
        bench.start()
        _await_first_frame(bench)
        limits = manual_limits(station, instruments.table, instruments.chamber)
        guard = held.enter_context(guard_for(station, folder, clock))
        control = ManualControl(bench, limits, display, guard.beat, interruptions)
        session = _Session(control, display, commands, leave)
        all_done = session.run()
        is_safe = session.end()
        if is_safe:
            guard.release()
    if is_safe:
        shutil.rmtree(folder, ignore_errors=True)
    return all_done and is_safe


def _await_first_frame(bench: LiveBench) -> None:
    """Give an INS that is on the time to send before the first command."""
    for _ in range(_TICKS_TO_FIRST_FRAME):
        bench.tick()
        bench.read_instruments()
        if math.isfinite(bench.readings.ins.age_s):
            return


class _Session:
    """Executes commands until the last one, or one that ends the session."""

    def __init__(
        self, control: ManualControl, display: Display, commands: Sequence[str], leave: bool
    ) -> None:
        self._control = control
        self._display = display
        self._shell = Shell(control, display)
        self._leave = leave
        self._is_typed = not commands and sys.stdin.isatty()
        self._lines = iter(commands) if commands else self._typed_lines()

    def run(self) -> bool:
        """Execute the commands; the first failure ends the session unless an operator types them."""
        if self._is_typed:
            name = self._control.bench.station.file.station
            self._display.print(f"Manual control of {name}. `help` lists the commands, `quit` ends.")
        all_done = True
        while True:
            try:
                self._control.idle()  # interlocks are checked between commands that follow each other at once
                line = next(self._lines, None)
                if line is None or line.lower() in END_COMMANDS:
                    self._leave = self._leave or (line or "").lower() == "leave"
                    return all_done
                if not self._is_typed and line and not line.startswith("#"):
                    self._display.print(f"{_PROMPT}{line}")
                self._shell.execute(line.partition("#")[0])
            except EndSessionError as error:
                self._display.print(str(error))
                return False
            except StoppedByOperatorError:
                self._stop()
                if not self._is_typed:
                    return False
            except GyrobenchError as error:
                all_done = self._is_typed
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
            self._display.print("The chamber's set point is moved to its safe value; Ctrl-C ends that.")
            actions = self._control.finish_ramp(actions)
        for action in actions:
            self._display.print(action.text)
        return not any(action.problem for action in actions)

    def _stop(self) -> None:
        try:
            self._control.stop()
        except GyrobenchError as error:
            self._display.print(f"The table could not be stopped: {error}")

    def _typed_lines(self) -> Iterator[str]:
        lines = TypedLines(sys.stdin.fileno(), self._control.idle)

        def typed() -> str | None:
            if self._is_typed:
                self._display.prompt(_PROMPT)
            return lines.next()

        # Unlike a generator, this iterator continues after an exception raised while it waits for a line.
        return iter(typed, None)


def _error_text(error: GyrobenchError) -> str:
    if isinstance(error, TrippedError):
        return "\n".join(f"Interlock {trip.name}: {trip.text}" for trip in error.trips)
    return str(error)
