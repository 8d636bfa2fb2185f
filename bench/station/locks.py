"""Locks: one run at a time holds a bench, and one process at a time writes a run folder.

A lock is an advisory one of the kernel (flock) on a small file, so that it ends with the process
that holds it, however that ends. The file says who holds it. A bench has one file for each port,
in a folder that all users of the machine share: ``/run/lock`` where everybody may write there,
else ``/tmp``, or what the environment variable GYROBENCH_LOCK_DIR names. A bench that several
machines reach, for instance over TCP, is locked on each machine by itself only.
"""

from __future__ import annotations

import contextlib
import fcntl
import getpass
import hashlib
import json
import os
import re
import shlex
import socket
import stat
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from types import TracebackType
from typing import Self

from gyrobench.bench.foundations.clock import Clock, Deadline, WallClock
from gyrobench.bench.foundations.errors import BenchInUseError, GyrobenchError
from gyrobench.bench.runs.folder import LOCK
from gyrobench.bench.station.station import Station

LOCK_DIR_VARIABLE = "GYROBENCH_LOCK_DIR"
#: What a guard calls itself.
GUARD_COMMAND = "guard of this run"
#: What a session by hand calls itself.
JOG_COMMAND = "gyrobench jog"

_SHARED_FOLDERS = (Path("/run/lock"), Path("/tmp"))  # noqa: S108 - files there are opened with care
_EVERYBODY_ADDS = stat.S_ISVTX | stat.S_IRWXO
_MOST_BYTES = 16384
_LONGEST_TEXT = 300
_EMULATED = "emulator"
#: Others hold a lock for an instant when they look whether it is held.
_LOOKERS_TIME_S = 0.3
_LOOK_S = 0.05


@dataclass(frozen=True)
class Holder:
    """Who holds a lock.

    Attributes
    ----------
    pid : int
        Process.
    user, host, command : str
        Whose it is, where it runs, and how it was started.
    run : str
        Run folder.
    started : str
        When it took the lock, UTC in ISO 8601.
    """

    pid: int
    user: str
    host: str
    command: str
    run: str
    started: str

    def describe(self) -> str:
        """Say all of it in one phrase."""
        return (
            f"run {self.run} (process {self.pid} of {self.user} on {self.host}, since {self.started}: "
            f"{self.command})"
        )


class _LockFile:
    """A file with the kernel's lock on it and its holder's identity in it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._descriptor = _opened(path)
        self.held = False

    def take(self) -> bool:
        """Take the lock if nobody has it."""
        with contextlib.suppress(BlockingIOError):
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self.held = True
        return self.held

    def holder(self) -> Holder | None:
        """Whoever wrote the file last; None where it was left in order."""
        with contextlib.suppress(OSError):
            return _parsed(os.pread(self._descriptor, _MOST_BYTES, 0))
        return None

    def sign(self, holder: Holder) -> None:
        """Write who holds it."""
        # The lock is the kernel's; a full disk costs only the name of its holder.
        with contextlib.suppress(OSError):
            os.ftruncate(self._descriptor, 0)
            os.pwrite(self._descriptor, json.dumps(asdict(holder)).encode(), 0)

    def release(self) -> None:
        """Let go; the file stays, since another process may just be opening it."""
        if self.held:
            with contextlib.suppress(OSError):
                os.ftruncate(self._descriptor, 0)
        os.close(self._descriptor)


class _Lock:
    """Locks on several files, taken all or none; a context manager."""

    def __init__(
        self, paths: dict[str, Path], identity: Callable[[], Holder], clock: Clock, patience_s: float = 0.0
    ) -> None:
        self._paths = paths
        self._identity = identity
        self._clock = clock
        self._files: list[_LockFile] = []
        self._patience_s = max(patience_s, _LOOKERS_TIME_S)
        self._taken = ExitStack()
        self.taken_over: list[str] = []

    def __enter__(self) -> Self:
        identity = self._identity()
        left_by: dict[Holder, list[str]] = {}
        with ExitStack() as taken:
            for what, path in sorted(self._paths.items(), key=lambda item: item[1]):
                file = _LockFile(path)
                taken.callback(file.release)
                self._take(what, file)
                if (former := file.holder()) is not None:
                    left_by.setdefault(former, []).append(what)
                file.sign(identity)
                self._files.append(file)
            self._taken = taken.pop_all()
        self.taken_over = [
            f"took over what {former.describe()} left locked without holding it any more: {', '.join(what)}"
            for former, what in left_by.items()
        ]
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._taken.close()

    def _take(self, what: str, file: _LockFile) -> None:
        deadline = Deadline(self._clock, self._patience_s)
        while not file.take():
            if deadline.expired():
                holder = file.holder()
                raise BenchInUseError(f"{what} is in use by {_described(holder)}. {self._advice(holder)}")
            self._clock.sleep(_LOOK_S)

    def _advice(self, holder: Holder | None) -> str:
        raise NotImplementedError


class BenchLock(_Lock):
    """Holds every port of a bench; a context manager.

    Emulated ports live inside one process and need no lock. Names of one device, such as a link
    under ``/dev/serial/by-id``, lead to the same lock.

    Parameters
    ----------
    station : Station
        The bench.
    run_path : Path
        Run folder, or where it will be, told to whoever wants the bench as well.
    clock : Clock
        The run's clock, to wait on.
    command : str, optional
        What the holder calls itself; the command line without it.
    patience_s : float
        How long to wait for another holder to let go.

    Attributes
    ----------
    taken_over : list of str
        Whose locks were found although nobody held them any more, in words.

    Raises
    ------
    BenchInUseError
        Another process holds a port (when entered).
    GyrobenchError
        A lock file can't be opened.
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
            return "It is making the bench safe after the end of that run. Try again in a minute."
        if holder is not None and holder.command == JOG_COMMAND:
            return "Somebody uses it by hand; `quit` there lets go of it. Nothing was moved."
        return "Wait for its end, or end it with `gyrobench tell RUN abort`. Nothing was moved."


class RunLock(_Lock):
    """Holds a run folder; a context manager with the same attributes and errors as :class:`BenchLock`."""

    def __init__(self, run_path: Path, clock: Clock, command: str | None = None) -> None:
        paths = {f"the run folder {run_path}": run_path / LOCK}
        super().__init__(paths, lambda: _identity(run_path, command), clock)

    def _advice(self, holder: Holder | None) -> str:  # noqa: ARG002
        return "It goes on by itself; a run is resumed only after its end."


def holder_of(run_path: Path) -> Holder | None:
    """Find the process that holds a run folder; None where nobody does."""
    return _present_holder(run_path / LOCK)


def bench_holders(station: Station) -> list[Holder]:
    """Find the processes that hold ports of a bench, each once."""
    holders = (_present_holder(path) for path in _port_files(station).values())
    return list(dict.fromkeys(holder for holder in holders if holder is not None))


def _present_holder(path: Path) -> Holder | None:
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK)
    except OSError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return _parsed(os.pread(descriptor, _MOST_BYTES, 0))
    finally:
        os.close(descriptor)
    return None


def _port_files(station: Station) -> dict[str, Path]:
    """Lock file of each port, under the port's name for people."""
    folder = _lock_folder()
    # Two names of one port have one file: a station that gives it twice does not lock itself out.
    files = {_file_name(port): what for what, port in _ports(station)}
    return {what: folder / name for name, what in files.items()}


def _ports(station: Station) -> Iterator[tuple[str, str]]:
    file = station.file
    for what, url in (("rate table", file.rate_table.port), ("chamber", file.chamber.port)):
        if not url.startswith(f"{_EMULATED}://"):
            yield f"the {what}'s port {url}", _same_for_one_port(url)
    ins = file.ins
    if ins.interface != _EMULATED:
        name = f"the INS's port {ins.interface} {ins.channel}"
        if ins.interface == "slcan":
            yield name, _same_for_one_port(ins.channel.partition("@")[0])
        else:
            place = [str(ins.options[key]) for key in ("host", "port") if key in ins.options]
            yield name, ":".join([ins.interface, *place, ins.channel])


def _same_for_one_port(url: str) -> str:
    scheme, separator, rest = url.partition("://")
    address = rest.partition("?")[0] if separator else url
    if separator and scheme not in ("spy", "alt"):  # those two are serial devices, looked at or configured
        return address.lower()
    return os.path.realpath(address)


def _file_name(port: str) -> str:
    readable = re.sub(r"[^A-Za-z0-9]+", "-", port).strip("-")[-40:]
    return f"gyrobench-{readable}-{hashlib.sha256(port.encode()).hexdigest()[:12]}.lock"


def _lock_folder() -> Path:
    given = os.environ.get(LOCK_DIR_VARIABLE)
    if given:
        return Path(given)
    for folder in _SHARED_FOLDERS:
        with contextlib.suppress(OSError):
            if folder.stat().st_mode & _EVERYBODY_ADDS == _EVERYBODY_ADDS:
                return folder
    return _SHARED_FOLDERS[-1]


def _opened(path: Path) -> int:
    """Open a lock file, or make it; never through a link that somebody else put there."""
    flags = os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK
    try:
        for more in (0, os.O_CREAT | os.O_EXCL, 0):
            # Not O_CREAT alone: the kernel may refuse that for files of other users in shared folders.
            with contextlib.suppress(FileNotFoundError if not more else FileExistsError):
                descriptor = os.open(path, flags | more, 0o666)
                break
        else:
            raise FileNotFoundError(2, "comes and goes", str(path))
    except OSError as error:
        raise _can_not_lock(path, error.strerror or str(error)) from error
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode) or status.st_nlink > 1:  # a second name may be a trap as well
        os.close(descriptor)
        raise _can_not_lock(path, "is no ordinary file")
    if more:
        os.fchmod(descriptor, 0o666)  # whoever uses the bench next writes the name into it
    return descriptor


def _can_not_lock(path: Path, why: str) -> GyrobenchError:
    return GyrobenchError(
        f"{path}: can't be used as a lock: {why}. Remove it, or name another folder in {LOCK_DIR_VARIABLE}."
    )


def _identity(run_path: Path, command: str | None) -> Holder:
    if command is None:
        command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
    return Holder(
        os.getpid(), _user(), socket.gethostname(), command[:_LONGEST_TEXT],
        str(run_path.absolute())[:_LONGEST_TEXT * 5], WallClock().utc().isoformat(timespec="seconds"),
    )  # fmt: skip


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a user without an entry, as in containers
        return str(os.getuid())


def _parsed(data: bytes) -> Holder | None:
    """Identity out of a lock file, which any user may have written."""
    try:
        found = json.loads(data)
        values = {field.name: found[field.name] for field in fields(Holder)}
    except (ValueError, KeyError, TypeError):
        return None
    pid = values.pop("pid")
    if type(pid) is not int or not all(isinstance(value, str) for value in values.values()):
        return None
    return Holder(pid, **{name: _printable(value) for name, value in values.items()})


def _printable(text: str) -> str:
    return "".join(character if character.isprintable() else "?" for character in text)


def _described(holder: Holder | None) -> str:
    return "a process that has not said who it is" if holder is None else holder.describe()
