"""The engine's side of the guard: starts it, beats, releases it."""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import subprocess
import sys
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

from gyrobench.bench.foundations.clock import Clock, Deadline
from gyrobench.bench.foundations.errors import GyrobenchError
from gyrobench.bench.guard.orders import BEAT, LOG_NAME, READY, RELEASE, Orders
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.station.station import Station

#: A guard is ready in a fraction of a second; a machine may be busy.
_READY_TIME_S = 30.0
#: A guard that dies again is started again after this long.
_RESTART_PAUSE_S = 60.0
#: Beats that nobody reads fill the pipe soon, and tell of a guard that hangs.
_PIPE_BYTES = 4096
_EMULATED = "emulator://"


class Guard(Protocol):
    """What the engine asks of its guard."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    def beat(self) -> str | None:
        """Say that the engine is alive, at every tick; returns what is to be noted, if anything."""
        ...

    def release(self) -> None:
        """Say that the bench is safe and needs no guard any more."""
        ...


class NoGuard:
    """Where the bench lives inside the engine's process there is nothing to guard."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Do nothing."""

    def beat(self) -> str | None:
        """Do nothing."""
        return None

    def release(self) -> None:
        """Do nothing."""


class GuardLink:
    """A guard process for one run; a context manager.

    Leaving it without :meth:`release` leaves the guard to make the bench safe: it waits until the
    bench's lock is free, and goes on trying for minutes. So release it once the bench is safe, and
    enter it with the bench's lock held.

    Parameters
    ----------
    station : Station
        The bench.
    folder : Path
        Run folder; the guard writes its log and its deeds there.
    clock : Clock
        The run's clock.

    Raises
    ------
    GyrobenchError
        The guard does not start (when entered).
    """

    def __init__(self, station: Station, folder: Path, clock: Clock) -> None:
        self._station = station
        self._folder = folder
        self._clock = clock
        self._process: subprocess.Popen[bytes] | None = None
        self._pipe: int | None = None
        self._started_s = clock.now()

    @property
    def pid(self) -> int | None:
        """Process of the guard; None without one."""
        return None if self._process is None else self._process.pid

    def __enter__(self) -> Self:
        self._start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._hang_up()

    def beat(self) -> str | None:
        """Say that the engine is alive, at every tick.

        Returns
        -------
        str or None
            What is to be noted: that the guard was found dead or hanging, and what became of
            starting another.
        """
        if self._pipe is None:
            return self._replaced("there is no guard")
        try:
            os.write(self._pipe, BEAT)
        except BrokenPipeError:
            return self._replaced("the guard process died")
        except BlockingIOError:
            return self._replaced("the guard process hangs")
        return None

    def release(self) -> None:
        """Say that the bench is safe and needs no guard any more; waits until it has gone."""
        if self._pipe is not None and self._process is not None:
            with contextlib.suppress(BrokenPipeError, BlockingIOError, subprocess.TimeoutExpired):
                os.write(self._pipe, RELEASE)
                self._process.wait(_READY_TIME_S)
        self._end()

    def _replaced(self, found: str) -> str | None:
        first = self._pipe is not None
        self._end()
        if not first and self._clock.now() - self._started_s < _RESTART_PAUSE_S:
            return None
        try:
            self._start()
        except GyrobenchError as error:
            return f"{found}, and another could not be started: {error}"
        return f"{found}; another watches now"

    def _end(self) -> None:
        """Make sure that this guard does nothing any more."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None
        self._hang_up()

    def _hang_up(self) -> None:
        if self._pipe is not None:
            os.close(self._pipe)
            self._pipe = None

    def _start(self) -> None:
        """Start a guard that alone has the other end of the pipe."""
        self._started_s = self._clock.now()
        theirs, ours = os.pipe()  # closed in every child but for what is passed on
        try:
            fcntl.fcntl(ours, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
            os.set_blocking(ours, False)
            os.write(ours, self._orders().line())  # before it runs: an engine killed now is made good
            self._process = self._started(theirs)
        except (OSError, ValueError) as error:
            os.close(ours)
            raise GyrobenchError(f"the guard process can't be started: {error}") from error
        finally:
            os.close(theirs)
        self._pipe = ours
        try:
            self._await_ready(self._process)
        except GyrobenchError:
            self._end()
            raise

    def _started(self, pipe: int) -> subprocess.Popen[bytes]:
        with contextlib.ExitStack() as opened:
            try:
                complaints = opened.enter_context((self._folder / LOG_NAME).open("ab")).fileno()
            except OSError:
                complaints = subprocess.DEVNULL
            return subprocess.Popen(
                [
                    sys.executable,
                    "-P",
                    "-m",
                    "gyrobench.bench.guard",
                ],  # -P: nothing out of the present folder
                stdin=pipe,
                stdout=subprocess.PIPE,
                stderr=complaints,
                start_new_session=True,
            )

    def _orders(self) -> Orders:
        as_run = RunFolder(self._folder).station  # stays as it is, whoever edits the original meanwhile
        return Orders(
            station=str((as_run if as_run.is_file() else self._station.path).absolute()),
            folder=str(self._folder.absolute()),
            silence_s=self._station.file.guard.silence_s,
            engine_pid=os.getpid(),
            epoch=self._clock.epoch.isoformat(),
            now_s=self._clock.now(),
        )

    def _await_ready(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout is not None  # noqa: S101 - for the type checker
        deadline = Deadline(self._clock, _READY_TIME_S)
        with process.stdout as answers:
            ready, _, _ = select.select([answers], [], [], deadline.remaining_s())
            said = os.read(answers.fileno(), len(READY)) if ready else b""
        if said != READY:
            raise GyrobenchError(
                f"the guard process did not get ready; see {self._folder / LOG_NAME}. "
                "Nothing may run unguarded: find the cause, and start again."
            )


def guard_for(station: Station, folder: Path, clock: Clock) -> Guard:
    """Choose a guard process, or none where table and chamber are emulated inside this process."""
    section = station.file
    ports = (section.rate_table.port, section.chamber.port)
    if clock.is_virtual or all(port.startswith(_EMULATED) for port in ports):
        return NoGuard()
    return GuardLink(station, folder, clock)
