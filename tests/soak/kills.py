"""Real processes of ``gyrobench run`` and ``resume``, killed at random instants until each run is through.

What is aimed at follows from the seed; where a kill hits depends on the machine, so the kills are counted by
what the journal says was under way.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

from scipy.stats import chi2 as chi2_distribution

from gyrobench.bench.bias.dwell import DwellPurpose
from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.dwells.measurement_setup import measurement_setup
from gyrobench.bench.dwells.run_dwells import measure_recorded
from gyrobench.bench.engine.job import Job, prepare_job
from gyrobench.bench.engine.resume import prepare_resumption
from gyrobench.bench.engine.resume_state import ResumeState
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.procedure.procedure_file import STEP_KINDS
from gyrobench.bench.runs.can_log import read_can_log
from gyrobench.bench.runs.folder import RunFolder, open_run_folder
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.runs.telemetry import read_telemetry
from gyrobench.bench.station.instruments import Emulation
from tests.soak.results import PartResult, counts, machine
from tests.soak.truth import WORLD, Agreement, true_bias_dph

PROCEDURE = Path(__file__).with_name("kills.yaml")
_GYROBENCH = str(Path(sys.executable).with_name("gyrobench"))
_LOOK_PERIOD_S = 0.0005
#: A run is left alone after this number of kills.
_KILLS_PER_RUN = 12
#: At one kill in this number, a separate process looks at the folder as well.
_LOOKS_BY_PROCESS = 5
_MAX_DURATION_S = 600.0
#: A kill is aimed at one of the next steps, this many; with at most this many left, at what follows them.
_NEXT_STEPS, _LAST_STEPS = 20, 8
START, RESULTS, BETWEEN, BACK = "start-up", "results and report", "between two steps", "way back: "


@dataclass
class Tally:
    """What came of the kills, of all runs together."""

    under_way: Counter[str] = field(default_factory=Counter)
    runs: int = 0
    guarded: int = 0
    looks: int = 0
    dwells: int = 0
    lost: int = 0
    double: int = 0
    truth: Agreement = field(default_factory=Agreement)
    problems: list[str] = field(default_factory=list)
    lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def kills(self) -> int:
        """How many so far."""
        return self.under_way.total()


class _Tail:
    """The lines of a journal that came since it was looked at last."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._read_bytes = path.stat().st_size if path.exists() else 0

    def new_lines(self) -> list[str]:
        try:
            if self._path.stat().st_size <= self._read_bytes:
                return []
        except FileNotFoundError:
            return []
        with self._path.open("rb") as file:
            file.seek(self._read_bytes)
            whole, _, _ = file.read().rpartition(b"\n")
        if not whole:
            return []
        self._read_bytes += len(whole) + 1
        return whole.decode().split("\n")


class KilledRun:
    """One run from its begin to its end, with kills in between."""

    def __init__(self, path: Path, random: Random, tally: Tally, job: Job) -> None:
        self._path = path
        self._random = random
        self._tally = tally
        self._job = job
        self._kills = 0
        self._start_s = 2.0

    def go(self, most_kills: int) -> bool:
        """Run, kill and resume until it is finished; returns whether it was."""
        code = None
        while code is None:
            code = self._attempt(self._aim() if self._kills < most_kills else None)
        if code:
            self._problem(f"ended with exit code {code}: {self._printed.read_text()[-300:]}")
        return code == 0

    @property
    def _printed(self) -> Path:
        return self._path.with_suffix(".txt")

    def _command(self) -> list[str]:
        if not (self._path / "journal.jsonl").exists():
            job = self._job
            world, seed = job.emulation.world, job.emulation.seed
            options = {"station": job.station.path, "world": world, "seed": seed, "out": self._path}
            return ["run", str(job.document.path), *(f"--{key}={value}" for key, value in options.items())]
        if self._is_finished():  # what is left is to evaluate it
            return ["bins", str(self._path)]
        return ["resume", str(self._path), *(["--anyway"] if self._is_guarded() else [])]

    def _is_finished(self) -> bool:
        return "nothing to resume" in self._look()

    def _look(self, anyway: bool = True) -> str:
        try:
            return prepare_resumption(self._path, anyway).describe()
        except RunFolderError as error:
            return str(error)

    def _is_guarded(self) -> bool:
        guarded = "--anyway" in self._look(anyway=False)
        with self._tally.lock:
            self._tally.guarded += guarded
        return guarded

    def _aim(self) -> str:
        """Where to hit: rather what has been hit less."""
        ahead = self._ahead()
        aims = [START, *sorted(set(ahead))]
        if len(ahead) < len(self._job.plan.steps):
            aims += [f"{BACK}{kind}" for kind in ("power_on", "chamber", "soak", "go_to")]
        if len(ahead) <= _LAST_STEPS:
            aims += [RESULTS]
        with self._tally.lock:
            weights = [1.0 / (1.0 + self._tally.under_way[aim]) for aim in aims]
        return self._random.choices(aims, weights)[0]

    def _ahead(self) -> list[str]:
        """Kinds of the next steps; all of them where nothing is done yet."""
        journal, steps = self._path / "journal.jsonl", self._job.plan.steps
        done = (
            ResumeState.of_journal(read_journal(journal), self._job.plan).next_index
            if journal.exists()
            else 0
        )
        return [planned.step.name for planned in (steps[done : done + _NEXT_STEPS] if done else steps)]

    def _attempt(self, aim: str | None) -> int | None:
        """Start a process and kill it where aimed; its exit code if it was through before."""
        if (self._path / "procedure.yaml").exists() and not (self._path / "journal.jsonl").exists():
            # Killed before the run began: nothing was done, and a run begins in a new folder.
            self._path = self._path.with_name(f"{self._path.name}_again")
        tail = _Tail(self._path / "journal.jsonl")
        command = self._command()
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
        with (
            self._printed.open("a") as output,
            subprocess.Popen(
                [_GYROBENCH, *command], stdout=output, stderr=output, env=environment
            ) as process,
        ):
            seen = list(self._until_aim(process, tail, aim, time.monotonic()))
            if process.poll() is None:
                process.kill()
        seen += tail.new_lines()
        if process.returncode >= 0:
            return process.returncode
        self._kills += 1
        where = RESULTS if command[0] == "bins" else under_way(seen)
        with self._tally.lock:
            self._tally.under_way[where] += 1
            number = self._tally.kills
        sys.stdout.write(f"kill {number}: {self._path.name}, {where}\n")
        sys.stdout.flush()
        self._check_folder()
        return None

    def _until_aim(
        self, process: subprocess.Popen[bytes], tail: _Tail, aim: str | None, begin_s: float
    ) -> Iterator[str]:
        """New lines of the journal until it is time to kill the process, or until it ends by itself."""
        due_s = begin_s + (
            self._random.uniform(0.0, 1.2 * self._start_s) if aim == START else _MAX_DURATION_S
        )
        left = self._random.randint(1, max(1, min(2, self._ahead().count(aim or ""))))
        is_begun = False
        while process.poll() is None and time.monotonic() < due_s:
            for line in tail.new_lines():
                if not is_begun:
                    is_begun, self._start_s = True, time.monotonic() - begin_s
                yield line
                if aim is not None and _is_hit(line, aim):
                    left -= 1
                    if left == 0:
                        due_s = time.monotonic() + self._delay_s(aim)
            time.sleep(_LOOK_PERIOD_S)
        if process.poll() is None and aim is None:
            self._problem(f"was not over after {_MAX_DURATION_S:g} s")

    def _delay_s(self, aim: str) -> float:
        if aim == RESULTS:
            return self._random.uniform(0.0, 2.0 * self._start_s)
        kind = aim.removeprefix(BACK)
        longest_s = 0.15 if kind in ("navigate", "soak", "align", "chamber", "wait") else 0.01
        return self._random.uniform(0.0, longest_s)

    def _check_folder(self) -> None:
        """The folder of a killed run is readable, and says what is to be done."""
        if not (self._path / "journal.jsonl").exists():
            return
        try:
            readable(open_run_folder(self._path), self._job)
            words = self._look()
        except Exception as error:  # noqa: BLE001 - every exception is a finding
            self._problem(f"the folder can't be read: {type(error).__name__}: {error}")
            return
        if "dwells are finished" not in words and "nothing to resume" not in words:
            self._problem(f"`resume --look` says: {words}")
        if self._kills % _LOOKS_BY_PROCESS == 0 and "nothing to resume" not in words:
            self._look_by_process()

    def _look_by_process(self) -> None:
        command = [_GYROBENCH, "resume", str(self._path), "--look", "--anyway"]
        looked = subprocess.run(command, capture_output=True, text=True, check=False)
        with self._tally.lock:
            self._tally.looks += 1
        if looked.returncode or not re.search("It resumes with|All steps are finished", looked.stdout):
            self._problem(f"`resume --look` gave {looked.returncode}: {looked.stdout}{looked.stderr}")

    def _problem(self, text: str) -> None:
        with self._tally.lock:
            self._tally.problems.append(f"{self._path.name}: {text}")

    def judge(self) -> None:
        """Compare the dwells of the finished run with the plan and the truth."""
        folder, tally, name = open_run_folder(self._path), self._tally, self._path.name
        readable(folder, self._job)
        rows = read_dwells(folder.dwells)
        numbers = Counter(row.dwell for row in rows)
        # Rotations have no row of their own: they are measured where the journal has their end.
        rotated = {
            planned.dwell
            for planned in self._job.plan.steps
            if planned.dwell and planned.purpose is DwellPurpose.ROTATIONS
        }
        ended = Counter(
            entry["marks"]["dwell"]
            for entry in read_journal(folder.journal)
            if entry["event"] == "dwell_finished"
        )
        numbers.update({number: ended[number] for number in rotated if ended[number]})
        with tally.lock:
            tally.runs += 1
            tally.dwells += len(numbers)
            tally.lost += sum(number not in numbers for number in range(1, self._job.plan.dwell_count + 1))
            tally.double += sum(count > 1 for count in numbers.values())
            for row in rows:
                tally.truth.add(row, true_bias_dph(row.gyro_c), name)
            missing = [
                each.name for each in (folder.bias_bins, folder.joint, folder.report) if not each.exists()
            ]
            if missing:
                tally.problems.append(f"{name}: lacks {', '.join(missing)}")


def _is_hit(line: str, aim: str) -> bool:
    if aim == RESULTS:
        return '"event": "run_ended"' in line
    event = "approach_started" if aim.startswith(BACK) else "step_started"
    return f'"event": "{event}"' in line and f'"kind": "{aim.removeprefix(BACK)}"' in line


def under_way(lines: list[str]) -> str:
    """What a process did last, by the lines that it wrote to the journal."""
    for line in reversed(lines):
        match = re.search(r'"event": "(\w+)"', line)
        event = match[1] if match else ""
        if event == "run_ended":
            return RESULTS
        if event in ("step_finished", "approach_finished", "dwell_finished"):
            return BETWEEN
        if event in ("step_started", "approach_started"):
            kind = re.search(r'"kind": "(\w+)"', line)
            return (BACK if event.startswith("approach") else "") + (kind[1] if kind else "?")
    return START


def readable(folder: RunFolder, job: Job) -> None:
    """Read everything in a run folder."""
    entries = list(read_journal(folder.journal))
    if not any(entry["event"] == "run_started" for entry in entries):
        return
    if any(folder.can.glob("*")):
        for _ in read_can_log(folder.can):
            pass
    if folder.telemetry.exists():
        read_telemetry(folder.telemetry)
    if any(entry["event"] == "dwell_finished" for entry in entries):
        measure_recorded(folder, measurement_setup(job.station))
    if folder.dwells.exists():
        read_dwells(folder.dwells)


def kill_runs(folder: Path, count: int, seed: int, procedure: Path = PROCEDURE) -> PartResult:
    """Kill ``count`` processes at least, on two runs at a time."""
    begin_s = time.monotonic()
    folder.mkdir(parents=True, exist_ok=True)
    tally = Tally()

    def one(number: int) -> None:
        random = Random(f"{seed}/{number}")  # noqa: S311
        # Runs of one seed would have the same noise.
        job = prepare_job(str(procedure), "quick", Emulation(str(WORLD), 1000 * seed + number))
        run = KilledRun(folder / f"run_{number:02d}", random, tally, job)
        if run.go(min(_KILLS_PER_RUN, count)):
            run.judge()

    def work(first: int) -> None:
        number = first
        while tally.kills < count:
            one(number)
            number += 2

    workers = 2 if count > _KILLS_PER_RUN else 1
    with ThreadPoolExecutor(workers) as pool:
        for done in [pool.submit(work, first) for first in range(1, workers + 1)]:
            done.result()
    return _result(tally, time.monotonic() - begin_s)


def _result(tally: Tally, took_s: float) -> PartResult:
    truth = tally.truth
    hit = {kind for kind in STEP_KINDS if tally.under_way[kind]}
    problems = [*tally.problems, *truth.wrong]
    if tally.lost or tally.double:
        problems.append(f"{tally.lost} dwells lost, {tally.double} double")
    order = [START, *STEP_KINDS, BETWEEN, *(f"{BACK}{kind}" for kind in STEP_KINDS), RESULTS]
    by_kind = {each: tally.under_way[each] for each in order if tally.under_way[each]}
    return PartResult(
        "kills",
        "Kills",
        {
            "SIGKILLs of `gyrobench run` and `resume`": str(tally.kills),
            "kinds of step hit": f"{len(hit)} of {len(STEP_KINDS)}",
            "runs finished in spite of them": str(tally.runs),
            "dwells finished": str(tally.dwells),
            "dwells lost": str(tally.lost),
            "dwells double": str(tally.double),
            "dwells flagged": str(truth.flagged),
            "wrong results let through": str(len(truth.wrong)),
            "chi2 per degree of freedom against the truth": _chi2(truth),
        },
        f"Runs of {tally.dwells // max(tally.runs, 1)} dwells on ramps and after soaks, in processes "
        f"of their own on virtual time, killed with SIGKILL up to {_KILLS_PER_RUN} times each, then left to "
        "finish. After each kill journal, raw log, telemetry and dwell table were read, the finished dwells "
        "measured again from the raw log, and what `resume --look` says was looked at "
        f"({tally.looks} times by a separate process). The limit on resumes without progress asked for "
        f"`--anyway` {tally.guarded} times. "
        f"Took {took_s / 60.0:.0f} min.",
        [counts("under way at the kill", by_kind)],
        problems,
        machine(),
    )


def _chi2(agreement: Agreement) -> str:
    if not agreement.count:
        return "-"
    p = float(chi2_distribution.sf(agreement.chi2, agreement.count))
    return f"{agreement.chi2 / agreement.count:.2f} over {agreement.count} biases (p = {p:.2g})"
