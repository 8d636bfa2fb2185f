"""The operator of a run: questions that the run asks, and commands that the operator gives.

Commands come from the terminal or as signals: pause, continue, hold, skip, abort.
"""

from __future__ import annotations

import json
import os
import signal
import threading
from collections import deque
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from types import FrameType, MappingProxyType
from typing import Protocol

from gyrobench.bench.foundations.errors import GyrobenchError, RunFolderError
from gyrobench.bench.foundations.files import parse_json, read_limited, write_whole


class RunCommand(StrEnum):
    """A command to a run in progress."""

    PAUSE = "pause"
    CONTINUE = "continue"
    HOLD = "hold"
    SKIP = "skip"
    ABORT = "abort"


#: What each command does, for help texts.
COMMAND_MEANINGS: Mapping[RunCommand, str] = MappingProxyType(
    {
        RunCommand.PAUSE: "discard the dwell in progress and wait; the dwell is repeated on continue",
        RunCommand.CONTINUE: "continue after a pause or a hold",
        RunCommand.HOLD: "finish the dwell in progress, then wait at this temperature",
        RunCommand.SKIP: "discard the dwell in progress and continue with the next one",
        RunCommand.ABORT: "bring the bench to its safe state and end; the run can be resumed",
    }
)

#: Signals that give a command, the preferred one first. Ctrl-Z pauses: a stopped process would leave the
#: bench without control.
_COMMAND_SIGNALS: Mapping[signal.Signals, RunCommand] = MappingProxyType(
    {
        signal.SIGTERM: RunCommand.ABORT,
        signal.SIGINT: RunCommand.ABORT,
        signal.SIGHUP: RunCommand.ABORT,
        signal.SIGTSTP: RunCommand.PAUSE,
        signal.SIGCONT: RunCommand.CONTINUE,
        signal.SIGUSR1: RunCommand.HOLD,
        signal.SIGUSR2: RunCommand.SKIP,
    }
)

_MAX_SENDER_BYTES = 10_000
_TERMINAL_SIGNALS = (signal.SIGTTIN, signal.SIGTTOU)


@dataclass(frozen=True)
class GivenCommand:
    """A command and its source (a signal's name, the terminal), for the journal."""

    command: RunCommand
    by: str


def send_command(run_folder: Path, command: RunCommand, pid: int, sender: str) -> None:
    """Signal a command to the process of a run, with its sender's name for the journal.

    Raises OSError if the process can't be signalled, and RunFolderError if the name can't be written.
    """
    number = next(number for number, each in _COMMAND_SIGNALS.items() if each is command)
    write_whole(_sender_file(run_folder, command), json.dumps({"pid": pid, "operator": sender}).encode())
    os.kill(pid, number)


def take_sender(run_folder: Path, command: RunCommand) -> str:
    """Name of who sent a command to this process by `gyrobench control`; empty for other signals."""
    path = _sender_file(run_folder, command)
    try:
        sent = parse_json(read_limited(path, _MAX_SENDER_BYTES, RunFolderError))
        path.unlink()
        return str(sent["operator"]) if sent["pid"] == os.getpid() else ""
    except (RunFolderError, OSError, ValueError, KeyError, TypeError):
        return ""


def _sender_file(run_folder: Path, command: RunCommand) -> Path:
    return run_folder / f".sent-{command}"


class CommandReceivedError(GyrobenchError):
    """The operator commanded a pause, or skipped the dwell in progress."""

    def __init__(self, given: GivenCommand) -> None:
        super().__init__(f"{given.command} by {given.by}")
        self.given = given


class CommandQueue:
    """Commands that wait to be executed; the run reads the queue at every tick.

    As a context manager it catches the signals, so that no signal ends the process in the middle of an
    exchange with an instrument.
    """

    def __init__(self) -> None:
        self._given: deque[GivenCommand] = deque()

    def __enter__(self) -> CommandQueue:
        self._previous = {}
        if threading.current_thread() is threading.main_thread():
            # A signal that is ignored, as SIGHUP under nohup, stays ignored.
            caught = [number for number in _COMMAND_SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
            self._previous = {number: signal.signal(number, self._caught) for number in caught}
            # The terminal must not stop a run in the background that reads from it or writes to it.
            for number in _TERMINAL_SIGNALS:
                self._previous[number] = signal.signal(number, signal.SIG_IGN)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _caught(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002
        name = signal.Signals(number)
        self.give(_COMMAND_SIGNALS[name], name.name)

    def give(self, command: RunCommand, by: str) -> None:
        """Add a command; ``by`` is its source, for the journal."""
        self._given.append(GivenCommand(command, by))

    def take(self) -> GivenCommand | None:
        """Remove and return the oldest command; an abort comes before all others."""
        if not self._given:
            return None
        abort = next((given for given in self._given if given.command is RunCommand.ABORT), None)
        if abort is not None:
            self._given.clear()
            return abort
        return self._given.popleft()


class Operator(Protocol):
    """Answers questions; the run continues to tick until the answer is there."""

    def ask(self, question: str, answers: Sequence[str]) -> None:
        """Ask a question without waiting for the answer."""

    def answer(self) -> str | None:
        """Return the answer, or None while there is none."""

    def withdraw(self) -> None:
        """Withdraw the open question."""

    def command(self) -> RunCommand | None:
        """Return a command typed since the last call, or None; not while a question is open."""


class ConsentingOperator:
    """Gives the first answer at once, for emulated benches without an operator.

    After ``patience`` first answers to one question in a row it gives the last answer instead: a fault of an
    emulated bench passes by itself or never.
    """

    def __init__(self, patience: int = 30) -> None:
        self._patience = patience
        self._asked: tuple[str, int] = ("", 0)
        self._answer = ""

    def ask(self, question: str, answers: Sequence[str]) -> None:
        """Choose an answer."""
        before, times = self._asked
        self._asked = (question, times + 1 if question == before else 1)
        self._answer = answers[0] if self._asked[1] <= self._patience else answers[-1]

    def answer(self) -> str | None:
        """Return the chosen answer."""
        return self._answer

    def withdraw(self) -> None:
        """Do nothing."""

    def command(self) -> RunCommand | None:
        """Return None always."""
        return None


def ask_operator(operator: Operator, question: str, answers: Sequence[str]) -> Generator[None, None, str]:
    """Ask a question and yield once a tick until it is answered; returns the answer."""
    operator.ask(question, answers)
    try:
        while (answer := operator.answer()) is None:
            yield
    finally:
        operator.withdraw()  # also where something else ends the waiting
    return answer
