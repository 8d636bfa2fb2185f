"""The engine's side of the guard: start it, send heartbeats, release it."""

from __future__ import annotations

import contextlib
import os
import select
import subprocess
import sys
from pathlib import Path
from typing import Self

from gyrobench.bench.foundations.clock import Clock, Deadline
from gyrobench.bench.foundations.errors import GyrobenchError
from gyrobench.bench.guard.watching import BEAT, LOG_NAME, READY, RELEASE, GuardConfig
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.station.station import Station

#: A guard is ready in a fraction of a second, unless the machine is busy.
_READY_TIME_S = 30.0
#: A guard that dies repeatedly is restarted at this interval.
_RESTART_PAUSE_S = 60.0
#: A small pipe soon fills with unread heartbeats if the guard hangs.
_PIPE_BYTES = 4096


class Guard:
    """Interface for the engine; this base class has no guard, for instruments emulated in its process."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...

    def beat(self) -> str | None:
        """Send a heartbeat, at every tick; returns a note for the journal, if any."""
        return None

    def release(self) -> None:
        """Report that the bench is safe, and end the guard."""


class GuardProcess(Guard):
    """A guard process for one run; a context manager.

    Without :meth:`release`, the guard makes the bench safe on exit: it waits until the bench's lock is free,
    and tries for minutes. So release it once the bench is safe, and enter it with the bench locked. Raises
    GyrobenchError if the guard does not start (when entered).
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
        """Process number of the guard; None without one."""
        return None if self._process is None else self._process.pid

    def __enter__(self) -> Self:
        self._start()
        return self

    def __exit__(self, *_: object) -> None:
        self._close_pipe()

    def beat(self) -> str | None:
        """Send a heartbeat; a guard that died or hangs is replaced, and the returned note reports that."""
        if self._pipe is None:
            return self._replace("there was no guard process")
        try:
            os.write(self._pipe, BEAT)
        except BrokenPipeError:
            return self._replace("the guard process died")
        except BlockingIOError:
            return self._replace("the guard process hung")
        return None

    def release(self) -> None:
        """Report that the bench is safe, and wait until the guard has ended."""
        if self._pipe is not None and self._process is not None:
            with contextlib.suppress(BrokenPipeError, BlockingIOError, subprocess.TimeoutExpired):
                os.write(self._pipe, RELEASE)
                self._process.wait(_READY_TIME_S)
        self._end()

    def _replace(self, problem: str) -> str | None:
        was_running = self._pipe is not None
        self._end()
        if not was_running and self._clock.now() - self._started_s < _RESTART_PAUSE_S:
            return None
        try:
            self._start()
        except GyrobenchError as error:
            return f"{problem}, and a new one could not be started: {error}"
        return f"{problem}; a new one was started"

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None
        self._close_pipe()

    def _close_pipe(self) -> None:
        if self._pipe is not None:
            os.close(self._pipe)
            self._pipe = None

    def _start(self) -> None:
        """Start a guard, as the only process with the other end of the pipe."""
        import fcntl  # POSIX only

        self._started_s = self._clock.now()
        read_end, write_end = os.pipe()  # closed in every child except for the passed descriptor
        try:
            fcntl.fcntl(write_end, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
            os.set_blocking(write_end, False)
            os.write(write_end, self._config().line())  # before it runs, in case the engine is killed now
            self._process = self._spawn(read_end)
        except (OSError, ValueError) as error:
            os.close(write_end)
            raise GyrobenchError(f"the guard process can't be started: {error}") from error
        finally:
            os.close(read_end)
        self._pipe = write_end
        try:
            self._await_ready(self._process)
        except GyrobenchError:
            self._end()
            raise

    def _spawn(self, pipe: int) -> subprocess.Popen[bytes]:
        with contextlib.ExitStack() as opened:
            try:
                errors = opened.enter_context((self._folder / LOG_NAME).open("ab")).fileno()
            except OSError:
                errors = subprocess.DEVNULL
            return subprocess.Popen(
                [
                    sys.executable,
                    "-P",  # imports nothing from the working directory
                    "-m",
                    "gyrobench.bench.guard",
                ],
                stdin=pipe,
                stdout=subprocess.PIPE,
                stderr=errors,
                start_new_session=True,
            )

    def _config(self) -> GuardConfig:
        run_copy = RunFolder(self._folder).station  # unaffected by edits of the original
        return GuardConfig(
            station=str((run_copy if run_copy.is_file() else self._station.path).absolute()),
            folder=str(self._folder.absolute()),
            silence_s=self._station.file.guard.silence_s,
            engine_pid=os.getpid(),
            epoch=self._clock.epoch.isoformat(),
            now_s=self._clock.now(),
            speed=self._clock.speed,
        )

    def _await_ready(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout is not None  # noqa: S101 - for the type checker
        deadline = Deadline(self._clock, _READY_TIME_S)
        with process.stdout as answers:
            ready, _, _ = select.select([answers], [], [], deadline.remaining_s())
            answer = os.read(answers.fileno(), len(READY)) if ready else b""
        if answer != READY:
            raise GyrobenchError(
                "the guard process did not start, and nothing may run without it. "
                f"Find the cause in {self._folder / LOG_NAME}, and start again"
            )


def guard_for(station: Station, folder: Path, clock: Clock) -> Guard:
    """Return a guard process, or one without effect if table and chamber are emulated in this process."""
    if clock.is_virtual or (station.file.rate_table.is_emulated and station.file.chamber.is_emulated):
        return Guard()
    return GuardProcess(station, folder, clock)
