"""Locks: one run at a time holds a bench, and one process at a time writes a run folder.

A lock is the operating system's (by filelock) on a small file, so that it ends with the process that
holds it, however that ends. The file names the holder. A bench has one file for each port, in a folder
that all users of the machine share: ``/run/lock`` where all may write, else ``/tmp``, or the folder in
the environment variable GYROBENCH_LOCK_DIR. A bench that several machines reach, for instance over TCP,
is locked on each machine separately.
"""

from __future__ import annotations

import contextlib
import errno
import getpass
import hashlib
import json
import os
import re
import shlex
import socket
import stat
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass, fields
from ipaddress import ip_address
from pathlib import Path
from typing import Self

from filelock import lock_descriptor

from gyrobench.bench.foundations.clock import Clock, Deadline, WallClock
from gyrobench.bench.foundations.errors import BenchInUseError, GyrobenchError
from gyrobench.bench.foundations.operator_name import command_line
from gyrobench.bench.runs.folder import LOCK
from gyrobench.bench.station.station import Station
from gyrobench.bench.station.station_file import InsSection

LOCK_DIR_VARIABLE = "GYROBENCH_LOCK_DIR"
#: Command of a guard in its locks.
GUARD_COMMAND = "guard of this run"
#: Command of a session of manual control.
JOG_COMMAND = "gyrobench jog"

_SHARED_FOLDERS = (Path("/run/lock"), Path("/tmp"))  # noqa: S108 - files there are opened with care
_WRITABLE_BY_ALL = stat.S_ISVTX | stat.S_IRWXO
_MAX_BYTES = 16384
_MAX_COMMAND_CHARACTERS, _MAX_PATH_CHARACTERS = 300, 1500
_EMULATED = "emulator"
#: A process that only checks whether a lock is held takes it for an instant.
_MAX_CHECK_S = 0.3
_POLL_S = 0.05
#: Flags that not all systems have.
_FLAGS = sum(getattr(os, name, 0) for name in ("O_NOFOLLOW", "O_CLOEXEC", "O_NONBLOCK"))


@dataclass(frozen=True)
class Holder:
    """Process that holds a lock: its command line, run folder, and when it took the lock (UTC, ISO 8601)."""

    pid: int
    user: str
    host: str
    command: str
    run: str
    started: str

    def describe(self) -> str:
        """All of it in one phrase."""
        return (
            f"run {self.run} (process {self.pid} of {self.user} on {self.host}, since {self.started}: "
            f"{self.command})"
        )


def _in_progress(run: str) -> str:
    quoted = shlex.quote(run)
    return (
        f"That run is still in progress: watch it with `gyrobench monitor {quoted}`, or end it with "
        f"`gyrobench control {quoted} abort`."
    )


class _LockFile:
    """A locked file with its holder's identity in it."""

    def __init__(self, path: Path, mode: int) -> None:
        self._descriptor = _opened(path, mode)
        self.held = False

    def take(self) -> bool:
        """Take the lock if it is free."""
        self.held = _locked(self._descriptor)
        return self.held

    def holder(self) -> Holder | None:
        """The last holder that did not release the lock; None where the lock was released."""
        with contextlib.suppress(OSError):
            return _parsed(os.pread(self._descriptor, _MAX_BYTES, 0))
        return None

    def sign(self, holder: Holder) -> None:
        """Write the holder into the file; on a full disk the lock holds without it."""
        with contextlib.suppress(OSError):
            os.ftruncate(self._descriptor, 0)
            os.pwrite(self._descriptor, json.dumps(asdict(holder)).encode(), 0)

    def release(self) -> None:
        """Release the lock; the file stays, since another process may be opening it."""
        if self.held:
            with contextlib.suppress(OSError):
                os.ftruncate(self._descriptor, 0)
        os.close(self._descriptor)


class _Lock:
    """Locks on several files, taken all or none; a context manager."""

    #: Of the files: the next user of a bench writes into its locks.
    _mode = 0o666

    def __init__(
        self, paths: dict[str, Path], identity: Callable[[], Holder], clock: Clock, patience_s: float = 0.0
    ) -> None:
        self._paths = paths
        self._identity = identity
        self._clock = clock
        self._files: list[_LockFile] = []
        self._patience_s = max(patience_s, _MAX_CHECK_S)
        self._taken = ExitStack()
        #: One note for each holder that ended without releasing its locks.
        self.taken_over: list[str] = []

    def __enter__(self) -> Self:
        identity = self._identity()
        left_by: dict[Holder, list[str]] = {}
        with ExitStack() as taken:
            for what, path in sorted(self._paths.items(), key=lambda item: item[1]):
                file = _LockFile(path, self._mode)
                taken.callback(file.release)
                self._take(what, file)
                if (former := file.holder()) is not None:
                    left_by.setdefault(former, []).append(what)
                file.sign(identity)
                self._files.append(file)
            self._taken = taken.pop_all()
        self.taken_over = [
            f"took over locks left by {former.describe()}, which did not release them: {', '.join(what)}"
            for former, what in left_by.items()
        ]
        return self

    def __exit__(self, *_: object) -> None:
        self._taken.close()

    def _take(self, what: str, file: _LockFile) -> None:
        deadline = Deadline(self._clock, self._patience_s)
        while not file.take():
            if deadline.expired():
                holder = file.holder()
                by = "an unidentified process" if holder is None else holder.describe()
                raise BenchInUseError(f"{what} is in use by {by}. {self._advice(holder)}")
            self._clock.sleep(_POLL_S)

    def _advice(self, holder: Holder | None) -> str:
        raise NotImplementedError


class BenchLock(_Lock):
    """Holds every port of a bench; a context manager.

    Emulated ports live inside one process and need no lock. Names of one device, such as a link under
    ``/dev/serial/by-id`` or two names of a host, lead to the same lock. ``run_path`` is the run folder, or
    where it will be. ``command`` is by default the command line, and ``patience_s`` how long to wait for
    another holder's release. Raises BenchInUseError when entered if another process holds a port, and
    GyrobenchError if a lock file can't be opened.
    """

    def __init__(
        self,
        station: Station,
        run_path: Path,
        clock: Clock,
        command: str | None = None,
        patience_s: float = 0.0,
    ) -> None:
        super().__init__(_port_files(station), lambda: _identity(run_path, command), clock, patience_s)
        self._command = command

    def sign(self, run_path: Path) -> None:
        """Write the run folder into the locks, once it is there."""
        for file in self._files:
            file.sign(_identity(run_path, self._command))

    def _advice(self, holder: Holder | None) -> str:
        if holder is not None and holder.command == GUARD_COMMAND:
            return "Try again in a minute: it is bringing the bench to its safe state after that run."
        if holder is not None and holder.command == JOG_COMMAND:
            return "Nothing was moved: an operator controls it manually; `quit` there releases it."
        run = "RUN" if holder is None else holder.run
        return f"Nothing was moved: wait for its end, or end it with `gyrobench control {run} abort`."


class RunLock(_Lock):
    """Holds a run folder; a context manager with the same attributes and errors as :class:`BenchLock`."""

    _mode = 0o644

    def __init__(self, run_path: Path, clock: Clock, command: str | None = None) -> None:
        paths = {f"the run folder {run_path}": run_path / LOCK}
        super().__init__(paths, lambda: _identity(run_path, command), clock)

    def _advice(self, holder: Holder | None) -> str:
        return _in_progress("RUN" if holder is None else holder.run)


def require_no_holder(run_path: Path) -> None:
    """Raise BenchInUseError where a process holds a run folder."""
    if (holder := holder_of(run_path)) is not None:
        raise BenchInUseError(
            f"the run folder {run_path} is in use by {holder.describe()}. {_in_progress(holder.run)}"
        )


def holder_of(run_path: Path) -> Holder | None:
    """Find the process that holds a run folder; None if it is free."""
    return _present_holder(run_path / LOCK)


def is_held_by(run_path: Path, pid: int) -> bool:
    """Whether the kernel lists that process as the holder of a run folder.

    Without such a list, whether no other user may have written the lock.
    """
    status = (run_path / LOCK).stat()
    try:
        held = [line.split() for line in Path("/proc/locks").read_text().splitlines()]
    except OSError:
        return pid > 1 and status.st_uid == os.geteuid() and not status.st_mode & 0o022
    return pid > 1 and any(
        fields[1] == "FLOCK" and fields[4] == str(pid) and fields[5].endswith(f":{status.st_ino}")
        for fields in held
        if len(fields) > 5 and fields[1] != "->"
    )


def bench_holders(station: Station) -> list[Holder]:
    """Find the processes that hold ports of a bench, each once."""
    holders = (_present_holder(path) for path in _port_files(station).values())
    return list(dict.fromkeys(holder for holder in holders if holder is not None))


def _present_holder(path: Path) -> Holder | None:
    try:
        descriptor = os.open(path, os.O_RDONLY | _FLAGS)
    except OSError:
        return None
    try:
        return None if _is_free(descriptor) else _parsed(os.pread(descriptor, _MAX_BYTES, 0))
    finally:
        os.close(descriptor)


def _locked(descriptor: int) -> bool:
    """Take the lock on an open file if it is free; a system without locks gives it to all."""
    try:
        return lock_descriptor(descriptor, blocking=False)
    except OSError as error:
        if error.errno == errno.ENOSYS:
            return True
        raise


def _is_free(descriptor: int) -> bool:
    """Whether no process holds the lock; a shared lock, so that checks never take each other for a holder."""
    try:
        import fcntl
    except ImportError:  # a system without shared locks
        return _locked(descriptor)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno == errno.ENOSYS
    return True


def _port_files(station: Station) -> dict[str, Path]:
    """Lock file of each port, by the port's name in messages."""
    folder = _lock_folder()
    # Two names of one port have one file, so that a station that gives it twice does not lock itself out.
    files = {_file_name(port): what for what, port in _ports(station)}
    return {what: folder / name for name, what in files.items()}


def _ports(station: Station) -> Iterator[tuple[str, str]]:
    file = station.file
    for what, section in (("rate table", file.rate_table), ("chamber", file.chamber)):
        url = section.installed_dialect.line.complete_url(section.port)
        if not url.startswith(f"{_EMULATED}://"):
            yield f"the {what}'s port {section.port}", _same_for_one_port(url)
    for unit in station.units:
        yield from _bus_port(unit.file.ins)


def _bus_port(ins: InsSection) -> Iterator[tuple[str, str]]:
    if ins.interface != _EMULATED:
        name = f"the INS's port {ins.interface} {ins.channel}"
        if ins.interface == "slcan":
            yield name, _same_for_one_port(ins.channel.partition("@")[0])
        else:
            host = [_same_for_one_host(str(ins.options["host"]))] if "host" in ins.options else []
            port = [str(ins.options["port"])] if "port" in ins.options else []
            yield name, ":".join([ins.interface, *host, *port, ins.channel])


def _same_for_one_port(url: str) -> str:
    scheme, separator, rest = url.partition("://")
    address = rest.partition("?")[0] if separator else url
    if separator and scheme not in ("spy", "alt"):  # those two are serial devices
        host, colon, port = address.lower().rpartition(":")
        return f"{_same_for_one_host(host)}:{port}" if colon else _same_for_one_host(address)
    return os.path.realpath(address)


def _same_for_one_host(name: str) -> str:
    """Lowest address of a host, one for all names of this machine; the name where it can't be resolved."""
    name = name.lower().strip("[]")
    try:
        found = {ip_address(str(each[4][0])) for each in socket.getaddrinfo(name, None)}
    except (OSError, ValueError):
        return name
    if any(each.is_loopback or each.is_unspecified for each in found):
        return "localhost"
    return min(map(str, found))


def _file_name(port: str) -> str:
    readable = re.sub(r"[^A-Za-z0-9]+", "-", port).strip("-")[-40:]
    return f"gyrobench-{readable}-{hashlib.sha256(port.encode()).hexdigest()[:12]}.lock"


def _lock_folder() -> Path:
    given = os.environ.get(LOCK_DIR_VARIABLE)
    if given:
        return Path(given)
    for folder in _SHARED_FOLDERS:
        with contextlib.suppress(OSError):
            if folder.stat().st_mode & _WRITABLE_BY_ALL == _WRITABLE_BY_ALL:
                return folder
    return _SHARED_FOLDERS[-1]


def _opened(path: Path, mode: int) -> int:
    """Open a lock file, or make it with this mode; never through a link that another user planted."""
    flags = os.O_RDWR | _FLAGS
    try:
        for more in (0, os.O_CREAT | os.O_EXCL, 0):
            # Not O_CREAT alone: the kernel may refuse that for files of other users in shared folders.
            with contextlib.suppress(FileNotFoundError if not more else FileExistsError):
                descriptor = os.open(path, flags | more, mode)
                break
        else:
            raise FileNotFoundError(errno.ENOENT, "appears and disappears", str(path))
    except OSError as error:
        raise _can_not_lock(path, error.strerror or str(error)) from error
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode) or status.st_nlink > 1:  # a second name may be a trap as well
        os.close(descriptor)
        raise _can_not_lock(path, "it is not an ordinary file")
    if more or (status.st_uid == os.geteuid() and status.st_mode & ~mode & 0o777):
        os.fchmod(descriptor, mode)
    return descriptor


def _can_not_lock(path: Path, why: str) -> GyrobenchError:
    return GyrobenchError(
        f"{path}: can't be used as a lock: {why}. Remove it, or name another folder in {LOCK_DIR_VARIABLE}."
    )


def _identity(run_path: Path, command: str | None) -> Holder:
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


def _parsed(data: bytes) -> Holder | None:
    """Holder from a lock file's content, which any user may have written."""
    try:
        found = json.loads(data)
        values = {field.name: found[field.name] for field in fields(Holder)}
    except (ValueError, KeyError, TypeError):
        return None
    pid = values.pop("pid")
    if type(pid) is not int or not all(isinstance(value, str) for value in values.values()):
        return None
    printable = {name: "".join(c if c.isprintable() else "?" for c in text) for name, text in values.items()}
    return Holder(pid, **printable)
