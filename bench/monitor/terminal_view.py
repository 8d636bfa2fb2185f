"""A run in the terminal: a line for each dwell, the live view below, and the operator's answers."""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any, TextIO, cast

from rich.console import Console, Group
from rich.live import Live
from rich.padding import Padding
from rich.status import Status
from rich.text import Text

from gyrobench.bench.bias.bias_filter import StateSpaceEstimate
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.engine.job import Job
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.observers import ObserverGroup, RunObserver
from gyrobench.bench.engine.operator import ConsentingOperator, Operator, RunCommand
from gyrobench.bench.engine.run_outcome import RunOutcome
from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.text import counted, flag_text, hours_minutes
from gyrobench.bench.monitor.snapshot import RunSnapshot
from gyrobench.bench.monitor.snapshot_recorder import SnapshotRecorder
from gyrobench.bench.monitor.terminal import (
    BackgroundStream,
    Keyboard,
    RunConsole,
    is_c_locale,
    is_in_foreground,
)
from gyrobench.bench.monitor.terminal_screen import MAX_HEIGHT, MAX_WIDTH, screen
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.procedure.plan import Plan, PlannedStep
from gyrobench.bench.procedure.steps import SetChamber
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.provenance import emulated_bench_text


class _TerminalOperator:
    """Takes answers and commands from the keyboard without waiting for them."""

    #: Commands that are accepted.
    commands: Sequence[RunCommand] = tuple(RunCommand)

    def __init__(self, console: Console, keyboard: Keyboard) -> None:
        self._console = console
        self._keyboard = keyboard
        self._answers: Sequence[str] = ()

    def ask(self, question: str, answers: Sequence[str]) -> None:
        """Print the question and the answers to choose from."""
        self._answers = answers
        self._console.print(f"\n{question}\nAnswer with one of: {', '.join(answers)}", soft_wrap=True)

    def answer(self) -> str | None:
        """The answer, once one of the possible answers has been typed."""
        typed = self._keyboard.line()
        if typed in self._answers:
            self._answers = ()
            return typed
        if typed:
            self._console.print(f"Answer with one of: {', '.join(self._answers)}", soft_wrap=True)
        return None

    def withdraw(self) -> None:
        """Withdraw the question."""
        self._answers = ()

    def command(self) -> RunCommand | None:
        """A command that has been typed; other input prints the commands."""
        typed = "" if self._answers else self._keyboard.line()
        if typed in self.commands:
            return RunCommand(typed)
        if typed:
            reason = f"{typed}: a run on virtual time never waits. " if typed in list(RunCommand) else ""
            self._console.print(f"{reason}Type one of: {', '.join(self.commands)}", soft_wrap=True)
        return None


class _VirtualTimeOperator(_TerminalOperator):
    """Takes commands from the keyboard, and consents to every question, since virtual time can't wait."""

    commands = (RunCommand.SKIP, RunCommand.FINISH, RunCommand.ABORT)

    def __init__(self, console: Console, keyboard: Keyboard) -> None:
        super().__init__(console, keyboard)
        self._consent = ConsentingOperator()
        self._wall_clock = WallClock()
        self._next_poll_s = 0.0

    def ask(self, question: str, answers: Sequence[str]) -> None:
        """Choose an answer."""
        self._consent.ask(question, answers)

    def answer(self) -> str | None:
        """The chosen answer."""
        return self._consent.answer()

    def command(self) -> RunCommand | None:
        """A command that has been typed; polled a few times a second, since ticks take microseconds."""
        now_s = self._wall_clock.now()
        if now_s < self._next_poll_s:
            return None
        self._next_poll_s = now_s + _KEY_INTERVAL_S
        return super().command()


_UNITS_TEXT = "Biases in 0.001 deg/h with their standard uncertainty, temperatures in degC."
_TICKS_PER_UPDATE = 50
_TABLE_HEAD = "dwell   cycle  position gyro x    bias x        bias y        bias z     left h"
_FLAG_INDENT = 8


class LinesView(RunObserver):
    """Prints each dwell as soon as it is measured; on a terminal with ``has_status`` also a status line."""

    def __init__(self, console: Console, plan: Plan, has_status: bool = True) -> None:
        self._console = console
        self._plan = plan
        self._ticks = 0
        self._left_s = plan.duration_s
        self._step = ""
        self._live_biases = ""
        self._has_printed_head = self._has_several_units = False
        self._has_status = has_status and console.is_terminal
        self._status: Status | None = None

    def __enter__(self) -> LinesView:
        self._console.print(
            f"{self._plan.procedure.procedure}: {counted(len(self._plan.steps), 'step')}, "
            f"{counted(self._plan.dwell_count, 'dwell')}, {hours_minutes(self._plan.duration_s)} h planned"
        )
        if self._has_status:
            self._status = self._console.status("starting")
            self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._status:
            self._status.stop()

    def noted(self, text: str) -> None:
        """Print a message."""
        self._console.print(text, highlight=False)

    def begun(self, folder: RunFolder, bench: LiveBench, outcome: RunOutcome) -> None:  # noqa: ARG002
        """Print that the bench is emulated; the lines name the unit of each dwell if there are several."""
        if text := emulated_bench_text(folder):
            self._console.print(text, style="bold yellow", highlight=False, soft_wrap=True)
        self._has_several_units = bool(outcome.units)

    def dropped(self, unit: str, why: str) -> None:
        """Print that a unit is dropped."""
        self._console.print(f"Unit {unit} is dropped: {why}", style="bold red", highlight=False)

    def step_started(self, planned: PlannedStep, bench: LiveBench) -> None:
        """Show the step; chamber steps are printed with the time since the start."""
        self._step = f"{planned.label}: {planned.step.describe()}"
        self._live_biases = ""
        self._ticks = 0
        if isinstance(planned.step, SetChamber):
            time = hours_minutes(bench.clock.now())
            chamber = f"chamber {bench.readings.chamber.temperature_c:.1f} degC now"
            self._console.print(
                f"{time:>5s} h  {planned.step.describe()}, {chamber}", highlight=False, soft_wrap=True
            )

    def ticked(self, bench: LiveBench, left_s: float) -> None:
        """Update temperatures and remaining time."""
        self._left_s = left_s
        self._ticks += 1
        if self._status and self._ticks % _TICKS_PER_UPDATE == 1:
            optics = bench.readings.ins.optics_c
            gyro = f"gyro {optics[0]:.1f} degC | " if optics[0] == optics[0] else ""
            chamber = f"chamber {bench.readings.chamber.temperature_c:.1f} degC"
            status = f"{self._live_biases} | " if self._live_biases else f"{chamber}, {gyro}"
            text = f"{hours_minutes(left_s)} h left | {status}{self._step}"
            self._status.update(Text(text, no_wrap=True, overflow="ellipsis"))

    def estimable(self, estimate: Callable[[], StateSpaceEstimate | None]) -> None:
        """Show the present biases with the next update."""
        if self._status and (estimate_now := estimate()):
            pairs = zip(AXES, 1e3 * estimate_now.bias_dph, 1e3 * estimate_now.sigma_dph, strict=True)
            self._live_biases = " ".join(f"{axis} {bias:+z.1f}±{sigma:.1f}" for axis, bias, sigma in pairs)

    def dwell_measured(self, row: DwellRow) -> None:
        """Print a dwell, the table head above the first dwell, and the reasons below a flagged dwell."""
        if not self._has_printed_head:
            columns = (
                f"unit {_TABLE_HEAD}".removesuffix("     left h") if self._has_several_units else _TABLE_HEAD
            )
            self._console.print(f"{_UNITS_TEXT}\n{columns}", highlight=False)
            self._has_printed_head = True
        number = f"{row.dwell:3d}/{self._plan.dwell_count:<3d}"
        if self._has_several_units:
            number = f"{row.unit} {number}"
        temperature = "-" if math.isnan(row.gyro_c[0]) else f"{row.gyro_c[0]:.1f}"
        head = f"{number} {row.cycle:5d}  {row.position:<7s} {temperature:>6s}"
        if row.flags:
            self._console.print(f"{head}  flagged", highlight=False)
            self._console.print(Padding(Text(flag_text(row.flags)), (0, 0, 0, _FLAG_INDENT), expand=False))
            return
        values = " ".join(
            f"{bias * 1e3:+z7.2f} ±{sigma * 1e3:<4.2f}"
            for bias, sigma in zip(row.bias_dph, row.sigma_dph, strict=True)
        )
        remaining = "" if self._has_several_units else f" {hours_minutes(self._left_s):>6s}"
        self._console.print(f"{head} {values}{remaining}", highlight=False, soft_wrap=True)


#: Rows above the view, for lines that scroll.
_ROWS_ABOVE = 4
_MIN_HEIGHT = 4
#: Intervals at which the snapshot and the typed keys are updated.
_SNAPSHOT_INTERVAL_S, _KEY_INTERVAL_S = 1.0, 0.1


class _TerminalView(RunObserver):
    """Shows the newest snapshot and the keys being typed; lines printed to the console scroll above the view.

    The snapshot is taken in the thread of the run and drawn in a separate thread, when ``can_draw`` says that
    the terminal has shown all earlier output.
    """

    def __init__(
        self,
        console: Console,
        recorder: SnapshotRecorder,
        keyboard: Keyboard,
        commands: Sequence[RunCommand],
        can_draw: Callable[[], bool],
    ) -> None:
        self._console = console
        self._recorder = recorder
        self._keyboard = keyboard
        self._commands = commands
        self._can_draw = can_draw
        self._clock = WallClock()
        self._next_snapshot_s = 0.0
        self._snapshot: RunSnapshot | None = None
        self._stop = threading.Event()
        self._live = Live(console=console, auto_refresh=False, transient=True)
        self._thread = threading.Thread(target=self._draw_until_stopped, daemon=True)

    def __enter__(self) -> _TerminalView:
        self._keyboard.__enter__()
        self._live.start()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._live.stop()
        self._keyboard.__exit__()

    def beat(self, bench: LiveBench) -> None:  # noqa: ARG002
        """Take a new snapshot if it is due."""
        if self._clock.now() >= self._next_snapshot_s:
            self._take_snapshot()

    def held(self, *_: Any, **__: Any) -> None:
        """Show at once that the run holds, asks or has ended."""
        self._take_snapshot()

    asked = ended = held

    def _take_snapshot(self) -> None:
        self._snapshot = self._recorder.snapshot()
        self._next_snapshot_s = self._clock.now() + _SNAPSHOT_INTERVAL_S

    def _draw_until_stopped(self) -> None:
        """Draw the view when something has changed, until the context ends."""
        drawn: tuple[RunSnapshot | None, str, tuple[int, int]] | None = None
        while not self._stop.wait(_KEY_INTERVAL_S):
            size = (self._console.width, self._console.height)
            typed = self._keyboard.unfinished
            current = (self._snapshot, typed, size)
            is_same = drawn is not None and current[0] is drawn[0] and current[1:] == drawn[1:]
            if not is_same and self._can_draw():
                self._live.update(Group(*self._lines(*current)), refresh=True)
                drawn = current

    def _lines(self, snapshot: RunSnapshot | None, typed: str, size: tuple[int, int]) -> list[Text]:
        width = min(MAX_WIDTH, size[0])
        height = min(MAX_HEIGHT, max(_MIN_HEIGHT, size[1] - _ROWS_ABOVE))
        is_ascii = self._console.options.ascii_only or is_c_locale(os.environ)
        prompt = [self._prompt(snapshot, typed)]
        if snapshot is None:
            return [Text("starting", "bold cyan"), *prompt]
        return [*screen(snapshot, width, height - len(prompt), is_ascii), *prompt]

    def _prompt(self, snapshot: RunSnapshot | None, typed: str) -> Text:
        """Line with the typed keys, or with the possible inputs."""
        if typed:
            return Text(f"> {typed}_", no_wrap=True)
        question = snapshot.question if snapshot else None
        choice = "an answer" if question else ", ".join(self._commands)
        return Text.assemble("> ", (f"type {choice}", "dim"), no_wrap=True)


#: Time limit for showing the remaining output at the end.
_MAX_DRAIN_S = 10.0


@contextmanager
def observe_in_terminal(
    console: RunConsole, job: Job, wants_live: bool
) -> Iterator[tuple[RunObserver, Operator]]:
    """Record the snapshot of a run and show the run in this context; the run never waits for the output.

    The live view needs a terminal that can move its cursor, with this process in the foreground; otherwise
    lines are printed. On virtual time, which can't wait for an operator, every question is answered with
    consent.
    """
    keyboard = Keyboard()
    operator = (_VirtualTimeOperator if job.is_virtual else _TerminalOperator)(console, keyboard)
    is_live = wants_live and console.is_terminal and not console.is_dumb_terminal and is_in_foreground()
    recorder = SnapshotRecorder(job.plan)
    with ExitStack() as contexts:
        stream = contexts.enter_context(_background_output(console))
        lines = contexts.enter_context(LinesView(console, job.plan, has_status=not is_live))
        observers: list[RunObserver] = [recorder, lines]
        if is_live:
            view = _TerminalView(console, recorder, keyboard, operator.commands, lambda: not stream.is_behind)
            observers.append(contexts.enter_context(view))
        yield ObserverGroup(*observers), operator


@contextmanager
def _background_output(console: RunConsole) -> Iterator[BackgroundStream]:
    """Write in the background; at the end wait a limited time for the remaining output."""
    terminal = console.file
    stream = BackgroundStream(cast(TextIO, terminal), console.on_broken_pipe)
    console.file = cast(TextIO, stream)
    try:
        yield stream
    finally:
        stream.drain(_MAX_DRAIN_S)
        console.file = terminal
