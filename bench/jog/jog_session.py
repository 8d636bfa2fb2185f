"""A session by hand, from the name of a station to the safe state at its end."""

from __future__ import annotations

import math
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

import can

from gyrobench.bench.engine.interlocks.watch import TrippedError
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.foundations.errors import GyrobenchError, InstrumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.guard.process import guard_for
from gyrobench.bench.jog.manual_control import ManualControl
from gyrobench.bench.jog.manual_limits import manual_limits
from gyrobench.bench.jog.shell import Shell
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
_LISTEN_TICKS = 2
_QUIT, _LEAVE = ("quit", "exit", "q"), ("leave",)


class _Unrecorded:
    """Nothing of a session by hand is kept."""

    next_part = 1

    def write(self, messages: Iterable[can.Message]) -> None:
        """Forget frames."""

    def cut(self) -> None:
        """Do nothing."""

    def add(self, row: tuple[float, ...]) -> None:
        """Forget readings."""

    def flush(self) -> None:
        """Do nothing."""


def jog_bench(name: str, commands: Sequence[str], emulation: Emulation, leave: bool) -> bool:
    """Open a bench, carry commands out, and leave it safe.

    Parameters
    ----------
    name : str
        Station file, or the name of a shipped one.
    commands : sequence of str
        What to do; without any, lines of standard input.
    leave : bool
        Whether chamber, unit and servos stay as they are at the end.

    Returns
    -------
    bool
        Whether all commands were carried out and the bench was left as it should be.

    Raises
    ------
    DocumentError
        The station file is wrong.
    BenchInUseError
        A run, or somebody else by hand, holds the bench.
    InstrumentError
        An instrument can't be reached when the bench is opened.
    """
    station = Station(find_document("stations", name))
    station.check_dbc()
    clock = station.new_clock()
    display = Display(sys.stdout, clock)
    folder = Path(tempfile.mkdtemp(prefix="gyrobench-jog-"))
    with ExitStack() as held:
        interruptions = held.enter_context(Interruptions())
        lock = held.enter_context(BenchLock(station, folder, clock, JOG_COMMAND))
        instruments = held.enter_context(Instruments(station, clock, emulation))
        for text in lock.taken_over:
            display.tell(text)
        bench = LiveBench(station, instruments, clock, _Unrecorded(), _Unrecorded(), _failure_teller(display))
        bench.start()
        _listen(bench)
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


def _failure_teller(display: Display) -> Callable[[str, InstrumentError | None], None]:
    def tell(instrument: str, error: InstrumentError | None) -> None:
        display.tell(str(error) if error is not None else f"{instrument}: answers again")

    return tell


def _listen(bench: LiveBench) -> None:
    """Let an INS that is on be heard before anybody asks for it."""
    for _ in range(_LISTEN_TICKS):
        bench.tick()
        bench.read_instruments()
        if math.isfinite(bench.readings.ins.age_s):
            return


class _Session:
    """Takes commands until there are no more, or one says to end."""

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
        """Carry out command by command; one that fails is the last unless a person types them."""
        station = self._control.bench.station
        if self._is_typed:
            self._display.tell(f"{station.file.station} by hand. `help` lists the commands, `quit` ends.")
        all_done = True
        while True:
            try:
                self._control.idle()  # commands that come without a pause are watched over all the same
                line = next(self._lines, None)
                if line is None or line.lower() in _QUIT:
                    return all_done
                if line.lower() in _LEAVE:
                    self._leave = True
                    return all_done
                if not self._is_typed and line and not line.startswith("#"):
                    self._display.tell(f"{_PROMPT}{line}")
                self._shell.carry_out(line.partition("#")[0])
            except EndSessionError as error:
                self._display.tell(str(error))
                return False
            except StoppedByOperatorError:
                self._stop()
                if not self._is_typed:
                    return False
            except GyrobenchError as error:
                all_done = self._is_typed
                self._display.tell(_told(error))
                if not self._is_typed:
                    return False

    def end(self) -> bool:
        """Leave the bench in its safe state, or as it is; tells whether that was done."""
        if self._leave:
            self._stop()
            self._display.tell("Chamber, unit and servos are left as they are.")
            return True
        actions = self._control.make_safe()
        for action in actions:
            self._display.tell(action.text)
        return not any(action.problem for action in actions)

    def _stop(self) -> None:
        try:
            self._control.stop()
        except GyrobenchError as error:
            self._display.tell(f"The table could not be stopped: {error}")

    def _typed_lines(self) -> Iterator[str]:
        lines = TypedLines(sys.stdin.fileno(), self._control.idle)

        def typed() -> str | None:
            if self._is_typed:
                self._display.prompt(_PROMPT)
            return lines.next()

        # Unlike a generator, it goes on after what is raised while a line is waited for.
        return iter(typed, None)


def _told(error: GyrobenchError) -> str:
    if isinstance(error, TrippedError):
        return "\n".join(f"Interlock {trip.name}: {trip.text}" for trip in error.trips)
    return str(error)
