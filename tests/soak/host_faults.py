"""Faults of the machine that the bench runs on, and of the program itself."""

from __future__ import annotations

import contextlib
import errno
import os
import pty
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from random import Random
from typing import Any
from unittest import mock

from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.operator import ConsentingOperator, RunCommand
from gyrobench.bench.procedure.plan import PlannedStep
from gyrobench.bench.procedure.procedure_file import STEP_KINDS
from gyrobench.bench.runs.journal import read_journal
from tests.soak.faults import FaultyRun, InjectedError, KindTally
from tests.soak.truth import TruthWatcher

_GYROBENCH = str(Path(sys.executable).with_name("gyrobench"))
_EVERY_TICKS = 120


class Deeds(TruthWatcher):
    """Does something to the host at random ticks, and notes when.

    Parameters
    ----------
    deed : callable
        What to do; gets the run's bench and how many deeds were done before.
    """

    def __init__(
        self, run: FaultyRun, deed: Callable[[LiveBench, int], None], count: int, random: Random
    ) -> None:
        super().__init__(run.job)
        self._run = run
        self._deed = deed
        self._left = count
        self._random = random
        self._ticks = self._gap()

    def _gap(self) -> int:
        return self._random.randint(1, 2 * _EVERY_TICKS)

    def is_due(self) -> bool:
        """Whether it is time for the next deed."""
        self._ticks -= 1
        return self._ticks <= 0

    def ticked(self, bench: LiveBench, left_s: float) -> None:
        """Do the deed when it is time."""
        super().ticked(bench, left_s)
        if self._left and self.is_due():
            self._left -= 1
            self._ticks = self._gap()
            self._run.injected_s.append(round(bench.clock.now(), 6))
            self._deed(bench, self._left)


class DeedsByStep(Deeds):
    """Does the deed once in each kind of step, and again until the count is used up."""

    def __init__(
        self, run: FaultyRun, deed: Callable[[LiveBench, int], None], count: int, random: Random
    ) -> None:
        super().__init__(run, deed, count, random)
        self._kinds = [list(STEP_KINDS)[number % len(STEP_KINDS)] for number in range(count)]

    def step_started(self, planned: PlannedStep, bench: LiveBench) -> None:
        """Wait some ticks within a step of a kind that is still due."""
        super().step_started(planned, bench)
        self._ticks = 1 + self._random.randint(0, 3 if self.step in ("navigate", "soak", "align") else 0)

    def is_due(self) -> bool:
        """In a step of a kind that is due."""
        if self.step in self._kinds and super().is_due():
            self._kinds.remove(self.step)
            return True
        return False


class PatientOperator(ConsentingOperator):
    """Leaves a pause alone for some ticks, then continues by signal."""

    def __init__(self) -> None:
        super().__init__()
        self._ticks = 0

    def ask(self, question: str, answers: Sequence[str]) -> None:
        """Only a pause waits."""
        super().ask(question, answers)
        self._ticks = 20 if "paused" in question and answers[0] == RunCommand.CONTINUE else 0

    def answer(self) -> str | None:
        """None while it waits."""
        if self._ticks == 0:
            return super().answer()
        self._ticks -= 1
        if self._ticks == 0:
            os.kill(os.getpid(), signal.SIGRTMAX)
            self._ticks = -1
        return None


def _signal(number: signal.Signals) -> Callable[[LiveBench, int], None]:
    return lambda bench, left: os.kill(os.getpid(), number)


def _raise(bench: LiveBench, left: int) -> None:
    raise InjectedError("a mistake in the program")


class FullDisk:
    """No file of this process can grow beyond what the journal has now, until there is room again."""

    def __call__(self, bench: LiveBench, left: int) -> None:
        """Fill the disk."""
        _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (100, hard))

    @staticmethod
    def repair() -> None:
        """Make room."""
        _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))


class SmallDisk:
    """A separate disk that is filled by another file; needs the right to mount one."""

    def __init__(self, folder: Path) -> None:
        self._ballast = folder / "ballast"

    def __call__(self, bench: LiveBench, left: int) -> None:
        """Fill it."""
        with contextlib.suppress(OSError), self._ballast.open("wb", buffering=0) as file:
            for size_bytes in (1 << 16, 1 << 10, 1):
                with contextlib.suppress(OSError):
                    while True:
                        file.write(b"x" * size_bytes)

    def repair(self) -> None:
        """Make room."""
        self._ballast.unlink(missing_ok=True)


class BadDisk:
    """Bringing files to the disk fails, a random time on."""

    def __init__(self, random: Random) -> None:
        self._random = random
        self._broken: contextlib.ExitStack | None = None

    def __call__(self, bench: LiveBench, left: int) -> None:
        """Let the next calls fail; some failures pass by themselves, others last."""
        self.repair()
        real, failing = os.fsync, self._random.choice([1, 2, 1_000_000])

        def fsync(descriptor: int) -> None:
            nonlocal failing
            failing -= 1
            if failing >= 0:
                raise OSError(errno.EIO, os.strerror(errno.EIO))
            real(descriptor)

        self._broken = contextlib.ExitStack()
        self._broken.enter_context(mock.patch("os.fsync", fsync))

    def repair(self) -> None:
        """Put another disk in."""
        if self._broken:
            self._broken.close()
            self._broken = None


class HostRun(FaultyRun):
    """A faulty run whose cause is repaired before it is resumed."""

    repair: Callable[[], None] | None = None

    def before_resume(self) -> None:
        """Repair it."""
        if self.repair:
            self.repair()

    def _judge(self) -> None:
        self.before_resume()
        super()._judge()


def _in_process(folder: Path, kind: str, count: int, seed: int) -> KindTally:
    whole = KindTally(kind)
    random = Random(f"{seed}/{kind}")  # noqa: S311
    for rule, share in (("repeat", count - count // 2), ("flag", count // 2)):
        if share:
            whole.merge(_host_run(folder / f"{kind.replace(' ', '_')}_{rule}", kind, rule, share, random))
    return whole


def _host_run(folder: Path, kind: str, rule: str, count: int, random: Random) -> KindTally:
    with contextlib.ExitStack() as mounted:
        disk = _small_disk(folder, mounted) if kind == "disk full" else None
        run = HostRun(disk / "run" if disk else folder, kind, rule)
        deed: Any = _DEEDS.get(kind)
        watcher: type[Deeds] = DeedsByStep if kind == "exception in a step" else Deeds
        if kind == "disk full":
            deed = SmallDisk(disk) if disk else FullDisk()
            run.repair = deed.repair
        elif kind == "write error":
            deed = BadDisk(random)
            run.repair = deed.repair
        run.watcher = watcher(run, deed, count, random)
        try:
            return run.go(PatientOperator() if kind == "SIGTSTP, SIGRTMAX" else None)
        finally:
            run.before_resume()


def _small_disk(folder: Path, mounted: contextlib.ExitStack) -> Path | None:
    """A file system of some megabytes, where that is allowed."""
    disk = folder.with_name(f"{folder.name}_disk")
    disk.mkdir(parents=True, exist_ok=True)
    made = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=12m", "tmpfs", str(disk)], capture_output=True, check=False
    )
    if made.returncode:
        return None
    mounted.callback(subprocess.run, ["umount", "-l", str(disk)], check=False)
    return disk


def _terminal_closed(folder: Path, kind: str, count: int, seed: int) -> KindTally:
    """Real processes on a pseudo-terminal that goes away under them."""
    random = Random(f"{seed}/{kind}")  # noqa: S311
    run = FaultyRun(folder / "terminal_closed", kind, "repeat")
    path = run.run.path
    for _ in range(count):
        journal = run.run.journal
        begun = journal.stat().st_size if journal.exists() else 0
        arguments = ["resume", str(path), "--anyway"] if begun else _run_command(run)
        closed_s = _on_terminal(arguments, journal, begun, random)
        if closed_s is None:
            break
        run.injected_s.append(closed_s)
    return run.go()


def _run_command(run: FaultyRun) -> list[str]:
    emulation = run.job.emulation
    options = {
        "station": "quick",
        "world": emulation.world,
        "faults": emulation.faults,
        "out": str(run.run.path),
    }
    return ["run", str(run.job.document.path), *(f"--{key}={value}" for key, value in options.items())]


def _on_terminal(arguments: Sequence[str], journal: Path, begun: int, random: Random) -> float | None:
    """Take the terminal away; the time of the journal's last entry then, None if the run was over before."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.environ["OPENBLAS_NUM_THREADS"] = "1"
        os.execv(_GYROBENCH, [_GYROBENCH, *arguments])  # noqa: S606
    os.set_blocking(terminal, False)
    end_s = time.monotonic() + 120.0
    due_s = end_s
    code: int | None = None
    while time.monotonic() < due_s and code is None:
        with contextlib.suppress(BlockingIOError, OSError):
            os.read(terminal, 65536)
        if due_s == end_s and journal.exists() and journal.stat().st_size > begun + 300:
            due_s = time.monotonic() + random.uniform(0.0, 0.5)
        done, status = os.waitpid(pid, os.WNOHANG)
        code = os.waitstatus_to_exitcode(status) if done else None
        time.sleep(0.002)
    entries = list(read_journal(journal)) if journal.exists() else []
    os.close(terminal)
    if code is not None or not entries:
        return None
    os.waitpid(pid, 0)
    return float(entries[-1]["time_s"])


def _calendar(folder: Path, kind: str, count: int, seed: int) -> KindTally:
    """A run on a wall clock whose calendar jumps; see :mod:`.calendar_run`."""
    from tests.soak.calendar_run import calendar_jumps

    return calendar_jumps(folder / kind.replace(" ", "_"), kind, count, seed)


_DEEDS: Mapping[str, Callable[[LiveBench, int], None]] = {
    "SIGTERM": _signal(signal.SIGTERM),
    "SIGHUP": _signal(signal.SIGHUP),
    "SIGINT": _signal(signal.SIGINT),
    "SIGTSTP, SIGRTMAX": _signal(signal.SIGTSTP),
    "exception in a step": _raise,
}

#: Every kind of host fault.
HOST: Mapping[str, Callable[[Path, str, int, int], KindTally]] = {
    "calendar set forward": _calendar,
    "calendar set back": _calendar,
    "terminal closed": _terminal_closed,
    "disk full": _in_process,
    "write error": _in_process,
    **dict.fromkeys(_DEEDS, _in_process),
}


def host_faults(folder: Path, kind: str, count: int, seed: int) -> KindTally:
    """Inject ``count`` faults of one of the host's kinds."""
    return HOST[kind](folder, kind, count, seed)
