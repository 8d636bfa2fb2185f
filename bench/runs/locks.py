"""Locks: one process at a time writes a run folder.

A lock is the operating system's lock (by filelock) on a small file, so that it is released at any end of the
process that holds it. The file contains the holder's identity.
"""

from __future__ import annotations

import contextlib
import errno
import getpass
import json
import os
import shlex
import socket
import stat
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Self

from filelock import lock_descriptor

from gyrobench.bench.foundations.clock import Clock, Deadline, WallClock
from gyrobench.bench.foundations.errors import BenchInUseError, UnusablePathError
from gyrobench.bench.foundations.operator_name import command_line
from gyrobench.bench.runs.folder import LOCK

LOCK_DIR_VARIABLE = "GYROBENCH_LOCK_DIR"
_MAX_BYTES = 16384
_MAX_COMMAND_CHARACTERS, _MAX_PATH_CHARACTERS = 300, 1500
#: A process that only checks whether a lock is held may take it for less than this time.
_MAX_CHECK_S = 0.3
_POLL_S = 0.05
#: Flags that not all systems have.
_FLAGS = sum(getattr(os, name, 0) for name in ("O_NOFOLLOW", "O_CLOEXEC", "O_NONBLOCK"))


@dataclass(frozen=True)
class Holder:
    """Process that holds a lock: its command line, run folder, and time of locking (UTC, ISO 8601)."""

    pid: int
    user: str
    host: str
    command: str
    run: str
    started: str

    def describe(self) -> str:
        """Describe the holder in one phrase."""
        return (
            f"run {self.run} (process {self.pid} of {self.user} on {self.host}, since {self.started}: "
            f"{self.command})"
        )


def _run_in_progress_text(run: str) -> str:
    quoted = shlex.quote(run)
    return (
        f"That run is still in progress: watch it with `gyrobench monitor {quoted}`, or end it with "
        f"`gyrobench control {quoted} abort`."
    )


class _LockFile:
    """A locked file with its holder's identity in it."""

    def __init__(self, path: Path, mode: int) -> None:
        self._descriptor = _open_lock_file(path, mode)
        self.held = False

    def take(self) -> bool:
        """Take the lock if it is free."""
        self.held = _try_lock(self._descriptor)
        return self.held

    def holder(self) -> Holder | None:
        """The last holder that did not release the lock; None if the lock was released."""
        with contextlib.suppress(OSError):
            return _parse_holder(os.pread(self._descriptor, _MAX_BYTES, 0))
        return None

    def sign(self, holder: Holder) -> None:
        """Write the holder to the file; on a full disk the lock is held without it."""
        with contextlib.suppress(OSError):
            os.ftruncate(self._descriptor, 0)
            os.pwrite(self._descriptor, json.dumps(asdict(holder)).encode(), 0)

    def release(self) -> None:
        """Release the lock; the file remains, since another process may be opening it."""
        if self.held:
            with contextlib.suppress(OSError):
                os.ftruncate(self._descriptor, 0)
        os.close(self._descriptor)


class Lock:
    """Locks on several files, taken all or none; a context manager."""

    #: Mode of the files: the next user of a bench writes to them.
    _mode = 0o666

    def __init__(
        self, paths: dict[str, Path], identity: Callable[[], Holder], clock: Clock, patience_s: float = 0.0
    ) -> None:
        self._paths = paths
        self._identity = identity
        self._clock = clock
        self._files: list[_LockFile] = []
        self._patience_s = max(patience_s, _MAX_CHECK_S)
        self._resources = ExitStack()
        #: A note for each holder that ended without releasing its locks.
        self.taken_over: list[str] = []

    def __enter__(self) -> Self:
        identity = self._identity()
        names_by_holder: dict[Holder, list[str]] = {}
        with ExitStack() as resources:
            for name, path in sorted(self._paths.items(), key=lambda item: item[1]):
                file = _LockFile(path, self._mode)
                resources.callback(file.release)
                self._take(name, file)
                if (previous_holder := file.holder()) is not None:
                    names_by_holder.setdefault(previous_holder, []).append(name)
                file.sign(identity)
                self._files.append(file)
            self._resources = resources.pop_all()
        self.taken_over = [
            f"locks taken over: {', '.join(names)}. They were left by {holder.describe()}"
            for holder, names in names_by_holder.items()
        ]
        return self

    def __exit__(self, *_: object) -> None:
        self._resources.close()

    def _take(self, name: str, file: _LockFile) -> None:
        deadline = Deadline(self._clock, self._patience_s)
        while not file.take():
            if deadline.expired():
                holder = file.holder()
                holder_text = "an unidentified process" if holder is None else holder.describe()
                raise BenchInUseError(f"{name} is in use by {holder_text}. {self._advice(holder)}")
            self._clock.sleep(_POLL_S)

    def _advice(self, holder: Holder | None) -> str:
        raise NotImplementedError


class RunLock(Lock):
    """Holds a run folder; a context manager. ``command`` is by default the command line.

    When entered, raises BenchInUseError if another process holds the folder, and UnusablePathError if its
    lock file can't be opened.
    """

    _mode = 0o644

    def __init__(self, run_path: Path, clock: Clock, command: str | None = None) -> None:
        paths = {f"the run folder {run_path}": run_path / LOCK}
        super().__init__(paths, lambda: identity_of(run_path, command), clock)

    def _advice(self, holder: Holder | None) -> str:
        return _run_in_progress_text("RUN" if holder is None else holder.run)


def require_no_holder(run_path: Path) -> None:
    """Raise BenchInUseError if a process holds a run folder."""
    if (holder := holder_of(run_path)) is not None:
        raise BenchInUseError(
            f"the run folder {run_path} is in use by {holder.describe()}. {_run_in_progress_text(holder.run)}"
        )


def holder_of(run_path: Path) -> Holder | None:
    """Find the process that holds a run folder; None if it is free."""
    return present_holder(run_path / LOCK)


def is_held_by(run_path: Path, pid: int) -> bool:
    """Whether the kernel lists a process as the holder of a run folder.

    On a system without such a list: whether no other user can have written the lock.
    """
    status = (run_path / LOCK).stat()
    try:
        entries = [line.split() for line in Path("/proc/locks").read_text().splitlines()]
    except OSError:
        return pid > 1 and status.st_uid == os.geteuid() and not status.st_mode & 0o022
    return pid > 1 and any(
        entry[1] == "FLOCK" and entry[4] == str(pid) and entry[5].endswith(f":{status.st_ino}")
        for entry in entries
        if len(entry) > 5 and entry[1] != "->"
    )


def present_holder(path: Path) -> Holder | None:
    """Find the process that holds a lock file; None if it is free."""
    try:
        descriptor = os.open(path, os.O_RDONLY | _FLAGS)
    except OSError:
        return None
    try:
        return None if _is_free(descriptor) else _parse_holder(os.pread(descriptor, _MAX_BYTES, 0))
    finally:
        os.close(descriptor)


def _try_lock(descriptor: int) -> bool:
    """Take the lock on an open file if it is free; always succeeds on a system without locks."""
    try:
        return lock_descriptor(descriptor, blocking=False)
    except OSError as error:
        if error.errno == errno.ENOSYS:
            return True
        raise


def _is_free(descriptor: int) -> bool:
    """Whether no process holds the lock; takes a shared lock, so that checks do not see each other."""
    try:
        import fcntl
    except ImportError:  # a system without shared locks
        return _try_lock(descriptor)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno == errno.ENOSYS
    return True


def _open_lock_file(path: Path, mode: int) -> int:
    """Open a lock file, or create it with ``mode``; follows no link, which another user may have made."""
    flags = os.O_RDWR | _FLAGS
    try:
        for extra_flags in (0, os.O_CREAT | os.O_EXCL, 0):
            # Not only O_CREAT: the kernel may refuse it for files of other users in shared folders.
            with contextlib.suppress(FileNotFoundError if not extra_flags else FileExistsError):
                descriptor = os.open(path, flags | extra_flags, mode)
                break
        else:
            raise FileNotFoundError(errno.ENOENT, "appears and disappears", str(path))
    except OSError as error:
        raise _lock_error(path, error.strerror or str(error)) from error
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode) or status.st_nlink > 1:  # a second hard link may be an attack as well
        os.close(descriptor)
        raise _lock_error(path, "it is not an ordinary file")
    if extra_flags or (status.st_uid == os.geteuid() and status.st_mode & ~mode & 0o777):
        os.fchmod(descriptor, mode)
    return descriptor


def _lock_error(path: Path, reason: str) -> UnusablePathError:
    if path.name == LOCK:
        return UnusablePathError(
            f"{path}: can't be used as a lock: {reason}. Check the permissions of the run folder, or copy it."
        )
    return UnusablePathError(
        f"{path}: can't be used as a lock: {reason}. Remove it, or name another folder in "
        f"{LOCK_DIR_VARIABLE}."
    )


def identity_of(run_path: Path, command: str | None) -> Holder:
    """Holder of a lock of this process for a run; ``command`` is by default the command line."""
    command = command_line() if command is None else command
    return Holder(
        os.getpid(), _user(), socket.gethostname(), command[:_MAX_COMMAND_CHARACTERS],
        str(run_path.absolute())[:_MAX_PATH_CHARACTERS], WallClock().utc().isoformat(timespec="seconds"),
    )  # fmt: skip


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError, ImportError):  # a user without an entry, as in containers
        return str(os.getuid())


def _parse_holder(data: bytes) -> Holder | None:
    """Parse a lock file's content, which any user may have written; None if it is invalid."""
    try:
        content = json.loads(data)
        values = {field.name: content[field.name] for field in fields(Holder)}
    except (ValueError, KeyError, TypeError):
        return None
    pid = values.pop("pid")
    if type(pid) is not int or not all(isinstance(value, str) for value in values.values()):
        return None
    printable = {name: "".join(c if c.isprintable() else "?" for c in text) for name, text in values.items()}
    return Holder(pid, **printable)
