"""The operator of a run: questions that the run asks, and commands that the operator gives.

Commands come from the terminal or as signals: pause, continue, hold, skip, finish, abort.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from types import FrameType
from typing import Any, Protocol

from gyrobench.bench.foundations.clock import Clock, Deadline
from gyrobench.bench.foundations.errors import GyrobenchError, RunFolderError
from gyrobench.bench.foundations.files import parse_json, read_limited, write_whole
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import parse_journal


class RunCommand(StrEnum):
    """A command to a run in progress."""

    PAUSE = "pause"
    CONTINUE = "continue"
    HOLD = "hold"
    SKIP = "skip"
    FINISH = "finish"
    ABORT = "abort"


#: What each command does, for help texts.
COMMAND_MEANINGS: Mapping[RunCommand, str] = {
    RunCommand.PAUSE: "discard the dwell in progress and wait; the dwell is repeated on continue",
    RunCommand.CONTINUE: "continue after a pause, a hold or a question of the procedure",
    RunCommand.HOLD: "finish the dwell in progress, then wait at this temperature",
    RunCommand.SKIP: "discard the dwell in progress and continue with the next one",
    RunCommand.FINISH: "finish the plateau in progress, then end as with abort",
    RunCommand.ABORT: "bring the bench to its safe state and end; the run can be resumed",
}

#: Signals and their commands, the preferred signal first. Ctrl-Z pauses: a stopped process would leave the
#: bench without control. SIGCONT is none: programs that stop a process, as cpulimit, send it too.
_COMMAND_SIGNALS: Mapping[signal.Signals, RunCommand] = {
    signal.SIGTERM: RunCommand.ABORT,
    signal.SIGINT: RunCommand.ABORT,
    signal.SIGHUP: RunCommand.ABORT,
    signal.SIGTSTP: RunCommand.PAUSE,
    signal.SIGRTMAX: RunCommand.CONTINUE,
    signal.SIGUSR1: RunCommand.HOLD,
    signal.SIGUSR2: RunCommand.SKIP,
    signal.SIGRTMIN: RunCommand.FINISH,
}

_MAX_SENDER_BYTES = 10_000
#: A run reads commands at every tick, but an exchange with an instrument that does not answer takes longer.
_MAX_REPLY_S, _REPLY_PERIOD_S = 30.0, 0.1
_TERMINAL_SIGNALS = (signal.SIGTTIN, signal.SIGTTOU)


@dataclass(frozen=True)
class ReceivedCommand:
    """A command, its source (the name of a signal, or the terminal) and its operator, for the journal."""

    command: RunCommand
    source: str
    operator: str = ""  #: Empty if unknown, as of a signal of another program.


@dataclass(frozen=True)
class PendingReply:
    """Reply to a command that was sent to a run, in its journal after ``begin`` bytes."""

    run_folder: Path
    command: RunCommand
    begin: int

    def refusal(self, clock: Clock, is_in_progress: Callable[[], bool]) -> str:
        """Wait for the reply; returns why the run did not accept the command, empty if it did."""
        deadline = Deadline(clock, _MAX_REPLY_S)
        while not deadline.expired():
            is_over = not is_in_progress()  # before the last look at the journal
            for entry in self._new_entries():
                if entry.get("event") == "ordered" and entry.get("order") == self.command:
                    return str(entry.get("refused", ""))
            if is_over:
                return "the run has ended"
            clock.sleep(_REPLY_PERIOD_S)
        return f"the run has not reacted within {_MAX_REPLY_S:g} s. Look at it with gyrobench monitor"

    def _new_entries(self) -> list[dict[str, Any]]:
        journal = RunFolder(self.run_folder).journal
        with contextlib.suppress(OSError, RunFolderError), journal.open("rb") as lines:
            lines.seek(self.begin)
            return list(parse_journal(lines, journal))
        return []


def send_command(run_folder: Path, command: RunCommand, pid: int, sender: str) -> PendingReply:
    """Send a command to the process of a run by a signal, with its sender's name for the journal.

    On a full disk it is sent without the name. Raises OSError if the process can't be signalled, and
    RunFolderError if the signal would end it, as the process of an older version or one that only reads.
    """
    journal = RunFolder(run_folder).journal
    reply = PendingReply(run_folder, command, journal.stat().st_size if journal.exists() else 0)
    number = next(number for number, each in _COMMAND_SIGNALS.items() if each is command)
    if command is not RunCommand.ABORT and not _is_handled(pid, number):
        raise RunFolderError(
            f"{run_folder}: process {pid} does not know {command}: it is of another version, or does not run "
            "the procedure now. No signal was sent; type the command in the run's terminal"
        )
    with contextlib.suppress(RunFolderError):
        write_whole(_sender_file(run_folder, command), json.dumps({"pid": pid, "operator": sender}).encode())
    os.kill(pid, number)
    return reply


def _is_handled(pid: int, number: signal.Signals) -> bool:
    """Whether a process catches, blocks or ignores a signal; True on a system without such a list."""
    try:
        lines = [line.partition(":") for line in Path(f"/proc/{pid}/status").read_text().splitlines()]
        masks = [int(mask, 16) for name, _, mask in lines if name in ("SigBlk", "SigIgn", "SigCgt")]
    except (OSError, ValueError):
        return True
    return not masks or any(mask >> (number - 1) & 1 for mask in masks)


def take_sender(run_folder: Path, command: RunCommand) -> str:
    """Name of the operator who sent a command by `gyrobench control`; empty for other signals."""
    path = _sender_file(run_folder, command)
    try:
        entry = parse_json(read_limited(path, _MAX_SENDER_BYTES, RunFolderError))
        path.unlink()
        return str(entry["operator"]) if entry["pid"] == os.getpid() else ""
    except (RunFolderError, OSError, ValueError, KeyError, TypeError):
        return ""


def _sender_file(run_folder: Path, command: RunCommand) -> Path:
    return run_folder / f".sent-{command}"


class CommandReceivedError(GyrobenchError):
    """The operator commanded a pause, or skipped the dwell in progress."""

    def __init__(self, received: ReceivedCommand) -> None:
        super().__init__(f"{received.command} by {received.source}")
        self.received = received


class CommandQueue:
    """Queue of commands to a run, which reads it at every tick.

    As a context manager it handles the signals, so that no signal ends the process in the middle of an
    exchange with an instrument.
    """

    def __init__(self) -> None:
        self._commands: deque[ReceivedCommand] = deque()

    def __enter__(self) -> CommandQueue:
        self._previous = {}
        if threading.current_thread() is threading.main_thread():
            # An ignored signal stays ignored, such as SIGHUP under nohup.
            handled = [
                number for number in _COMMAND_SIGNALS if signal.getsignal(number) is not signal.SIG_IGN
            ]
            self._previous = {number: signal.signal(number, self._handle_signal) for number in handled}
            # The terminal must not stop a background run that reads from it or writes to it.
            for number in _TERMINAL_SIGNALS:
                self._previous[number] = signal.signal(number, signal.SIG_IGN)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _handle_signal(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002
        name = signal.Signals(number)
        self.add(_COMMAND_SIGNALS[name], name.name)

    def add(self, command: RunCommand, source: str) -> None:
        """Add a command with its source, for the journal."""
        self._commands.append(ReceivedCommand(command, source))

    def take(self) -> ReceivedCommand | None:
        """Remove and return the oldest command; an abort comes before all others."""
        if not self._commands:
            return None
        abort = next((each for each in self._commands if each.command is RunCommand.ABORT), None)
        if abort is not None:
            self._commands.clear()
            return abort
        return self._commands.popleft()


class Operator(Protocol):
    """Answers questions; the run continues to tick until it has the answer."""

    def ask(self, question: str, answers: Sequence[str]) -> None:
        """Ask a question without waiting for the answer."""

    def answer(self) -> str | None:
        """Return the answer, or None before it is given."""

    def withdraw(self) -> None:
        """Withdraw the open question."""

    def command(self) -> RunCommand | None:
        """Return a command typed since the last call, or None; not while a question is open."""


class ConsentingOperator:
    """Gives the first answer at once, for emulated benches without an operator.

    After ``patience`` successive first answers to one question it gives the last answer: a fault of an
    emulated bench clears by itself or never.
    """

    def __init__(self, patience: int = 30) -> None:
        self._patience = patience
        self._last_question: tuple[str, int] = ("", 0)
        self._answer: str | None = None

    def ask(self, question: str, answers: Sequence[str]) -> None:
        """Choose an answer."""
        previous, times = self._last_question
        self._last_question = (question, times + 1 if question == previous else 1)
        self._answer = answers[0] if self._last_question[1] <= self._patience else answers[-1]

    def answer(self) -> str | None:
        """Return the chosen answer, once."""
        answer, self._answer = self._answer, None
        return answer

    def withdraw(self) -> None:
        """Do nothing: no question stays open."""

    def command(self) -> RunCommand | None:
        """Return None."""
        return None


def ask_operator(
    operator: Operator,
    question: str,
    answers: Sequence[str],
    answer_by_command: Callable[[], str | None] = lambda: None,
) -> Generator[None, None, str]:
    """Ask a question and yield once a tick until it is answered; returns the answer."""
    operator.ask(question, answers)
    try:
        while (answer := operator.answer() or answer_by_command()) is None:
            yield
    finally:
        operator.withdraw()  # also if an exception ends the wait
    return answer
