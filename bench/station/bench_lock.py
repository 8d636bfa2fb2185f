"""The lock on a bench: one run at a time holds it.

A bench has one lock file for each port, in a folder that all users of the machine share: ``/run/lock`` if
all may write there, otherwise ``/tmp``, or the folder in the environment variable GYROBENCH_LOCK_DIR. A bench
that several machines reach, for instance over TCP, is locked on each machine separately.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import shlex
import socket
import stat
from collections.abc import Iterator
from ipaddress import ip_address
from pathlib import Path

from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.runs.locks import LOCK_DIR_VARIABLE, Holder, Lock, identity_of, present_holder
from gyrobench.bench.station.station import Station

#: Command of a guard in its locks.
GUARD_COMMAND = "guard of this run"
#: Command of a session of manual control.
JOG_COMMAND = "gyrobench jog"

_SHARED_FOLDERS = (Path("/run/lock"), Path("/tmp"))  # noqa: S108 - files there are opened with care
_WRITABLE_BY_ALL = stat.S_ISVTX | stat.S_IRWXO


class BenchLock(Lock):
    """Holds every port of a bench; a context manager.

    Emulated ports exist inside one process and need no lock. All names of one device, such as a link under
    ``/dev/serial/by-id`` or two names of a host, give the same lock; a link has another one, which stays when
    the device comes back under another name. ``run_path`` is the present or future
    path of the run folder. ``command`` is by default the command line, and ``patience_s`` the time to wait
    for another holder's release. When entered, raises BenchInUseError if another process holds a port, and
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
        super().__init__(_port_files(station), lambda: identity_of(run_path, command), clock, patience_s)
        self._command = command

    def sign(self, run_path: Path) -> None:
        """Write the run folder to the lock files, once it exists."""
        for file in self._files:
            file.sign(identity_of(run_path, self._command))

    def _advice(self, holder: Holder | None) -> str:
        if holder is not None and holder.command == GUARD_COMMAND:
            return "Try again in a minute: it is bringing the bench to its safe state after that run."
        if holder is not None and holder.command == JOG_COMMAND:
            return "Nothing was moved: an operator controls it manually; `quit` there releases it."
        run = "RUN" if holder is None else shlex.quote(f"{holder.run}")
        return f"Nothing was moved: wait for its end, or end it with `gyrobench control {run} abort`."


def bench_holders(station: Station) -> list[Holder]:
    """Find the processes that hold ports of a bench, without duplicates."""
    holders = (present_holder(path) for path in _port_files(station).values())
    return list(dict.fromkeys(holder for holder in holders if holder is not None))


def _port_files(station: Station) -> dict[str, Path]:
    """Lock file of each port, by the port's name in messages."""
    folder = _lock_folder()
    # Two names of a port have one file: a station that gives a port twice does not block itself.
    files = {_file_name(port): name for name, port in _lock_names(station)}
    return {name: folder / file_name for file_name, name in files.items()}


def _lock_names(station: Station) -> Iterator[tuple[str, str]]:
    file = station.file
    for what, section in (("rate table", file.rate_table), ("chamber", file.chamber)):
        if not section.is_emulated:
            url = section.installed_dialect.line.complete_url(section.port)
            yield from _lock_names_of(f"the {what}'s port {section.port}", url)
    for ins in file.ins_sections:
        name = f"the INS's port {ins.interface} {ins.channel}"
        if ins.interface == "slcan":
            yield from _lock_names_of(name, ins.channel.partition("@")[0])
        elif not ins.is_emulated:
            host = [_canonical_host(str(ins.options["host"]))] if "host" in ins.options else []
            port = [str(ins.options["port"])] if "port" in ins.options else []
            yield name, ":".join([ins.interface, *host, *port, ins.channel])


def _lock_names_of(name: str, url: str) -> Iterator[tuple[str, str]]:
    """Names of a port: its device, and a link to it, which may lead to another device after a replug."""
    canonical = _canonical_port(url)
    yield name, canonical
    if "://" not in url and (link := str(Path(url).absolute())) != canonical:
        yield f"{name} by its name", link


def _canonical_port(url: str) -> str:
    scheme, separator, rest = url.partition("://")
    address = rest.partition("?")[0] if separator else url
    if separator and scheme not in ("spy", "alt"):  # those two are serial devices
        host, colon, port = address.lower().rpartition(":")
        return f"{_canonical_host(host)}:{port}" if colon else _canonical_host(address)
    return os.path.realpath(address)


def _canonical_host(name: str) -> str:
    """Lowest address of a host, "localhost" for this machine; the name if it can't be resolved."""
    name = name.lower().strip("[]")
    try:
        addresses = {ip_address(str(each[4][0])) for each in socket.getaddrinfo(name, None)}
    except (OSError, ValueError):
        return name
    if any(each.is_loopback or each.is_unspecified for each in addresses):
        return "localhost"
    return min(map(str, addresses))


def _file_name(port: str) -> str:
    readable = re.sub(r"[^A-Za-z0-9]+", "-", port).strip("-")[-40:]
    return f"gyrobench-{readable}-{hashlib.sha256(port.encode()).hexdigest()[:12]}.lock"


def _lock_folder() -> Path:
    configured = os.environ.get(LOCK_DIR_VARIABLE)
    if configured:
        return Path(configured)
    for folder in _SHARED_FOLDERS:
        with contextlib.suppress(OSError):
            if folder.stat().st_mode & _WRITABLE_BY_ALL == _WRITABLE_BY_ALL:
                return folder
    return _SHARED_FOLDERS[-1]
