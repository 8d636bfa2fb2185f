"""A run that was started in a terminal: who watches it and who answers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TextIO, cast

from gyrobench.bench.engine.observers import ObserverGroup
from gyrobench.bench.engine.operator import ConsentingOperator, Operator
from gyrobench.bench.engine.observers import RunObserver
from gyrobench.bench.engine.job import Job
from gyrobench.bench.live.console import PatientConsole
from gyrobench.bench.live.keyboard import Keyboard, is_in_foreground
from gyrobench.bench.live.lines_view import LinesView
from gyrobench.bench.live.patient_stream import PatientStream
from gyrobench.bench.live.recorder import PictureRecorder
from gyrobench.bench.live.terminal_operator import TerminalOperator
from gyrobench.bench.live.terminal_view import TerminalView

#: So long a terminal has at the end to take what has not been shown yet.
_LONGEST_DRAIN_S = 10.0


@contextmanager
def watched(console: PatientConsole, job: Job, wants_live: bool) -> Iterator[tuple[RunObserver, Operator]]:
    """Record the picture of a run, and show the run, while the context lasts.

    Parameters
    ----------
    console : PatientConsole
        Where to show it. It is never waited for.
    job : Job
        What is to be run.
    wants_live : bool
        Whether the whole picture is shown. That needs a terminal that can move its cursor and listens to
        this process; elsewhere there are lines only.

    Returns
    -------
    RunObserver, Operator
        The one who watches, and the one who answers: the person at the terminal, but on virtual time, where
        nobody can be waited for, one who consents to all.
    """
    keyboard = Keyboard()
    operator = ConsentingOperator() if job.is_virtual else TerminalOperator(console, keyboard)
    is_live = wants_live and console.is_terminal and not console.is_dumb_terminal and is_in_foreground()
    recorder = PictureRecorder(job.plan)
    with ExitStack() as shown:
        stream = shown.enter_context(_never_waited_for(console))
        lines = shown.enter_context(LinesView(console, job.plan, has_status=not is_live))
        watchers: list[RunObserver] = [recorder, lines]
        if is_live:
            view = TerminalView(console, recorder, keyboard, not job.is_virtual, lambda: not stream.is_behind)
            watchers.append(shown.enter_context(view))
        yield ObserverGroup(*watchers), operator


@contextmanager
def _never_waited_for(console: PatientConsole) -> Iterator[PatientStream]:
    """Write in the background; what is left at the end is waited for a while."""
    before = console.file
    stream = PatientStream(cast(TextIO, before), console.on_broken_pipe)
    console.file = cast(TextIO, stream)
    try:
        yield stream
    finally:
        stream.drain(_LONGEST_DRAIN_S)
        console.file = before
