"""Watching the engine: protocol of the pipe, heartbeats, process, and the guard's log."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import select
import signal
import sys
import threading
from collections.abc import Callable
from dataclasses import asdict, dataclass
from enum import Enum
from pathlib import Path
from typing import TypeVar

from gyrobench.bench.foundations.clock import Clock

#: Bytes in the pipe after the configuration.
BEAT, RELEASE = b".", b"R"
#: The guard's answer when it watches.
READY = b"ready\n"
#: Name of the guard's log in the run folder.
LOG_NAME = "guard.log"

#: A write of up to this many bytes to a pipe is atomic.
_MAX_BYTES = 4096


@dataclass(frozen=True)
class GuardConfig:
    """Settings of a guard: one line of JSON, the first through the pipe."""

    station: str  #: absolute path of the station file
    folder: str  #: absolute path of the run folder
    silence_s: float  #: silence after which the engine counts as hanging
    engine_pid: int  #: the engine's process
    epoch: str  #: calendar time at zero of the run's clock, ISO 8601
    now_s: float  #: the run's clock when the guard starts
    speed: float = 1.0  #: seconds of the run's clock per second of the host

    def line(self) -> bytes:
        """Return the bytes to send; raises ValueError if they are too long for the pipe."""
        data = json.dumps(asdict(self)).encode() + b"\n"
        if len(data) > _MAX_BYTES:
            raise ValueError(f"{self.folder}: the path is too long for the guard")
        return data

    @classmethod
    def read(cls, descriptor: int) -> GuardConfig | None:
        """Read the line from the pipe; None if the engine died before it sent one."""
        data = bytearray()
        while not data.endswith(b"\n"):
            if not (byte := os.read(descriptor, 1)):
                return None
            data += byte
        return cls(**json.loads(data))


#: Longest time for which the guard waits for the disk, s of real time.
MAX_DISK_S = 5.0
_SELECT_S = 0.5
_CHUNK = 4096


class EngineEnd(Enum):
    """How the engine's heartbeats ended."""

    RELEASED = "the engine released the guard"
    CLOSED = "the engine died without releasing the guard"
    SILENT = "the engine hangs"


def watch_engine(descriptor: int, silence_s: float, clock: Clock) -> EngineEnd:
    """Wait until the engine releases the guard, dies, or is silent for too long.

    A wait that took much longer than requested counts as a short one: the machine was suspended, or neither
    guard nor engine was scheduled.
    """
    silent_s, last_s = 0.0, clock.now()
    while silent_s < silence_s:
        ready, _, _ = select.select([descriptor], [], [], min(_SELECT_S, silence_s - silent_s))
        now_s = clock.now()
        silent_s, last_s = silent_s + min(now_s - last_s, 2.0 * _SELECT_S), now_s
        if ready:
            data = os.read(descriptor, _CHUNK)
            if not data:
                return EngineEnd.CLOSED
            if RELEASE in data:
                return EngineEnd.RELEASED
            silent_s = 0.0
    return EngineEnd.SILENT


class EngineProcess:
    """The engine, the parent process, by a descriptor that stays valid if its process number is reused."""

    def __init__(self, pid: int) -> None:
        self._descriptor: int | None = None
        if os.getppid() != pid:
            return
        descriptor = os.pidfd_open(pid)
        # As it is still the parent, its number had not been reused when the descriptor was opened.
        if os.getppid() == pid:
            self._descriptor = descriptor
        else:
            os.close(descriptor)

    def wait_for_end(self, within_s: float = 0.0) -> bool:
        """Wait for the engine's end at most ``within_s``; returns whether it has ended."""
        if self._descriptor is None:
            return True
        ready, _, _ = select.select([self._descriptor], [], [], within_s)
        return bool(ready)

    def kill(self) -> None:
        """Kill the engine, even if it is stopped."""
        if self._descriptor is not None:
            with contextlib.suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._descriptor, signal.SIGKILL)


_ResultT = TypeVar("_ResultT")


class FolderAccess:
    """Accesses the run folder in a thread, in order.

    A disk that hangs, as one on a network whose server is down, blocks every access to it, also that of a
    process that is killed. It delays the guard once, by at most :data:`MAX_DISK_S`.
    """

    def __init__(self) -> None:
        self._tasks: queue.SimpleQueue[tuple[Callable[[], object], threading.Event]] = queue.SimpleQueue()
        self._last = threading.Event()
        self._last.set()
        self._hangs = False
        threading.Thread(target=self._work, daemon=True).start()

    def do(self, task: Callable[[], _ResultT]) -> _ResultT | None:
        """Do something in the run folder; returns its result, None if it failed or the disk hangs."""
        results: list[_ResultT] = []
        self._hangs = self._hangs and not self._last.is_set()
        self._last = threading.Event()
        self._tasks.put((lambda: results.append(task()), self._last))
        if not self._hangs:
            self._hangs = not self._last.wait(MAX_DISK_S)
        return results[0] if results else None

    def _work(self) -> None:
        while True:
            task, done = self._tasks.get()
            try:
                task()
            except Exception as error:  # noqa: BLE001 - the guard continues without it
                print(f"guard: unexpected {type(error).__name__}: {error}", file=sys.stderr)  # noqa: T201
            done.set()


class GuardLog:
    """Lines with their time, appended to a file; a line that can't be written is dropped."""

    def __init__(self, path: Path, clock: Clock) -> None:
        self._path = path
        self._clock = clock
        self.access = FolderAccess()

    def add(self, text: str) -> None:
        """Add a line, flushed to the disk if possible."""
        line = f"{self._clock.utc().isoformat(timespec='milliseconds')} guard {os.getpid()}: {text}\n"
        self.access.do(lambda: self._write(line))

    def _write(self, line: str) -> None:
        with contextlib.suppress(OSError), self._path.open("a", encoding="utf-8") as stream:
            stream.write(line)
            stream.flush()
            os.fsync(stream.fileno())
