"""Faults of every kind, injected by the emulators and by the host, and what became of each.

Runs in this process on virtual time, one kind of fault in a run. A run that ends is resumed. Half of the
injections meet a procedure that repeats disturbed dwells, the other half one that flags them.
"""

from __future__ import annotations

import itertools
import json
import shutil
import signal
import sys
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.operator import ConsentingOperator, Operator
from gyrobench.bench.engine.resume import Resumption, prepare_resumption
from gyrobench.bench.engine.run import resume_run, run_job
from gyrobench.bench.engine.run_outcome import RunOutcome
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import facts_of, read_journal
from gyrobench.bench.station.instruments import Emulation
from tests.soak.results import PartResult, PartTable, machine
from tests.soak.truth import WORLD, WRONG_C, TruthWatcher, compare, true_bias_dph

PROCEDURE = Path(__file__).with_name("faults.yaml")
#: Outcomes from the gravest on.
OUTCOMES = ("ended safely, resumed", "held, continued", "repeated", "flagged", "retried", "none")
ENDED, HELD, REPEATED, FLAGGED, RETRIED, NONE = OUTCOMES
_EVERY_S = 180.0
#: Two of them wait in real time for a while.
_WORKERS = 4
#: A run counts as lost after this number of resumes.
_MAX_RESUMES = 40
SAFE_C = 23.0

#: Each kind of the emulators with the ways in which it comes; ``docs/faults.md`` says what they do.
LISTED: Mapping[str, Sequence[Mapping[str, Any]]] = {
    "lost_reply": [{"target": "table", "replies": 2}, {"target": "chamber", "replies": 2}],
    "lost_request": [{"target": "table"}, {"target": "chamber"}],
    "late_reply": [{"target": "table", "delay_s": 3}, {"target": "chamber", "delay_s": 3}],
    "half_reply": [{"target": "table"}, {"target": "chamber"}],
    "earlier_reply": [{"target": "table"}, {"target": "chamber"}],
    "garbage": [{"target": "table"}, {"target": "chamber", "bytes": 20, "instead": True}],
    "damaged_reply": [{"target": "table"}, {"target": "chamber", "bytes": 2}],
    "wrong_crc": [{"replies": 2}],
    "exception_code": [{"code": 6}, {"code": 4, "replies": 3}],
    "error_word": [{"error": "not_available"}, {"error": "syntax", "replies": 2}],
    "port_gone": [{"target": "table", "for_s": 20}, {"target": "chamber", "for_s": 60}],
    "instrument_restarts": [{"target": "table", "for_s": 15}, {"target": "chamber", "for_s": 15}],
    "frames_lost": [{"frames": 1}, {"for_s": 60, "share": 0.01}, {"for_s": 1}, {"for_s": 600}],
    "frames_repeated": [{"frames": 3}, {"for_s": 60, "share": 0.1}],
    "frames_out_of_order": [{"frames": 2}, {"for_s": 60, "share": 0.1}],
    "frames_corrupted": [{"bits": 1}, {"for_s": 60, "share": 0.05, "bits": 2}],
    "counter_jump": [{"by": 1000}, {"by": 1}],
    "time_stamp_jump": [{"for_s": 30, "by_s": -3600}, {"for_s": 90, "by_s": 0.4}],
    "bus_off": [{"for_s": 3}, {"for_s": 60}],
    "second_node": [{"for_s": 10}, {"for_s": 60}],
    "foreign_frames": [{"for_s": 10}],
    "ins_restarts": [{}],
    "ins_supply_lost": [{"for_s": 30}, {"for_s": 600}],
    "falls_back_to_alignment": [{}],
    "alignment_never_done": [{"for_s": 120}],
    "stuck_output": [{"for_s": 30}, {"for_s": 60, "signals": ["velocity_east"]}, {"for_s": 5}],
    "invalid_output": [{"for_s": 5, "signals": ["heading"]}, {"for_s": 2}],
    "saturated_output": [{"for_s": 5, "signals": ["velocity_north"]}, {"for_s": 2}],
    "temperature_sensor_broken": [
        {"for_s": 60, "sensor": "optics_x"},
        {"for_s": 30, "sensor": "case", "end": "low"},
    ],
    "temperature_sensor_frozen": [
        {"for_s": 900, "sensor": "optics_z"},
        {"for_s": 900, "sensor": "electronics_y"},
    ],
    "table_stalls": [{"for_s": 30, "axis": "inner"}, {"for_s": 30, "axis": "outer"}],
    "position_not_reached": [
        {"for_s": 120, "axis": "outer", "short_by_deg": 0.05},
        {"for_s": 120, "short_by_deg": 2},
    ],
    "moved_by_hand": [{"for_s": 10, "by_deg": 0.5}, {"for_s": 10, "by_deg": 20, "axis": "outer"}],
    "table_trips": [{"trip": "rate_trip", "axis": "outer"}, {"trip": "tracking_error"}],
    "interlock_opens": [{"for_s": 60}, {"for_s": 60, "axis": "outer"}],
    "temperature_not_reached": [{"for_s": 600, "by_c": 5}],
    "temperature_overshoots": [{"for_s": 600, "by_c": 6}],
    "chamber_sensor_error": [{"for_s": 30}],
    "chamber_sensor_stuck": [{"for_s": 600}],
    "chamber_alarm": [{"for_s": 30, "alarm": 2}, {"for_s": 30, "alarm": 1, "state": "low"}],
    "door_opened": [{"for_s": 60}, {"for_s": 300}],
    "switched_off_at_panel": [{"for_s": 120}],
    "set_point_changed_at_panel": [{"to_c": 40}],
}


@dataclass
class KindTally:
    """What became of the injections of one kind."""

    kind: str
    outcomes: Counter[str] = field(default_factory=Counter)
    dwells: int = 0
    lost: int = 0
    flagged: int = 0
    wrong: list[str] = field(default_factory=list)
    wrong_temperature: list[str] = field(default_factory=list)
    unsafe: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    took_s: float = 0.0

    @property
    def injected(self) -> int:
        """How many injections took effect."""
        return self.outcomes.total()

    def merge(self, other: KindTally) -> None:
        """Add another tally of the same kind."""
        self.outcomes += other.outcomes
        for name in ("dwells", "lost", "flagged", "took_s"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        for name in ("wrong", "wrong_temperature", "unsafe", "problems"):
            getattr(self, name).extend(getattr(other, name))


class FaultyRun:
    """A run with faults, from its begin through all resumes to its end.

    Parameters
    ----------
    folder : Path
        For the procedure, the list of faults and the run folder.
    kind : str
        Of the faults, for the tally.
    disturbed_dwell : str
        The procedure's rule for disturbed dwells.
    faults : list of dict, optional
        The list of the emulators.
    procedure, station : str, optional
        Text of the procedure without its rule for disturbed dwells; name or path of the station.
    seed : int
        Seed of the emulated world and its faults.
    """

    def __init__(
        self,
        folder: Path,
        kind: str,
        disturbed_dwell: str,
        faults: Sequence[Mapping[str, Any]] = (),
        procedure: str = PROCEDURE.read_text(),
        station: str = "quick",
        seed: int = 0,
    ) -> None:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        self.folder = folder
        self.tally = KindTally(kind)
        self.run = RunFolder(folder / "run")
        path = folder / "procedure.yaml"
        path.write_text(f"disturbed_dwell: {disturbed_dwell}\n{procedure}")
        self._list = folder / "faults.yaml"
        self._write(faults)
        self.job = prepare_job(str(path), station, Emulation(str(WORLD), seed, str(self._list)))
        self.watcher = TruthWatcher(self.job)
        self.injected_s: list[float] = []

    def _write(self, faults: Sequence[Mapping[str, Any]]) -> None:
        listed = {"log": "injected.jsonl", "faults": [dict(each) for each in faults]}
        self._list.write_text(yaml.safe_dump(listed))

    def go(self, operator: Operator | None = None, most: int | None = None) -> KindTally:
        """Run, resume until it is finished, and judge; no faults after ``most`` injections."""
        begin_s = time.process_time()
        operator = operator or ConsentingOperator()
        outcome = None if self.run.journal.exists() else self._once(None, operator)
        resumes = 0
        while facts_of(read_journal(self.run.journal)).ended != "finished":
            if resumes == _MAX_RESUMES:
                self.tally.problems.append(f"{self.tally.kind}: never finished: {outcome and outcome.reason}")
                break
            resumes += 1
            if most is not None and len(self._injections()) >= most:
                self._write(())
            self.before_resume()
            outcome = self._once(prepare_resumption(self.run.path, anyway=True), operator)
        self._judge()
        self.tally.took_s = time.process_time() - begin_s
        return self.tally

    def before_resume(self) -> None:
        """What an operator repairs before a run is resumed."""

    def _once(self, resumption: Resumption | None, operator: Operator) -> RunOutcome | None:
        """Run or resume; None where an exception came out of it, which the journal records as well."""
        try:
            if resumption is None:
                _, outcome = run_job(self.job, self.run.path, self.watcher, operator)
            else:
                _, outcome = resume_run(resumption, self.watcher, operator)
        except InjectedError:
            outcome = None
        self._inspect(outcome)
        return outcome

    def _inspect(self, outcome: RunOutcome | None) -> None:
        """The table is at rest and the chamber at its safe set point, or the outcome reports it."""
        bench = self.watcher.bench
        if bench is None:
            return
        bench.clock.sleep(60.0)
        bench.advance()
        reported = outcome is not None and any(action.problem for action in outcome.safe_state)
        if reported:
            return
        if any(axis.is_moving(bench.clock.now()) for axis in bench.world.axes.values()):
            self.tally.unsafe.append(f"{self.tally.kind}: the table turns after the end")
        air = bench.world.air
        if air.set_point_c != SAFE_C:
            self.tally.unsafe.append(f"{self.tally.kind}: the chamber is set to {air.set_point_c:g} degC")

    def _injections(self) -> list[float]:
        log = self.folder / "injected.jsonl"
        lines = log.read_text().splitlines() if log.exists() else []
        return [json.loads(line)["time_s"] for line in lines] + self.injected_s

    def _judge(self) -> None:
        tally, watcher = self.tally, self.watcher
        rows = read_dwells(self.run.dwells)
        numbers = Counter(row.dwell for row in rows)
        tally.dwells = len(numbers)
        tally.lost = sum(number not in numbers for number in range(1, self.job.plan.dwell_count + 1))
        if any(count > 1 for count in numbers.values()):
            tally.problems.append(f"{tally.kind}: double dwells {numbers}")
        true_dph = {row.dwell: true_bias_dph(row.gyro_c) for row in rows} | watcher.true_dph
        agreement = compare(rows, true_dph, tally.kind)
        tally.wrong, tally.flagged = agreement.wrong, agreement.flagged
        for row in rows:
            off_c = np.subtract(row.gyro_c, watcher.true_c.get(row.dwell, row.gyro_c))
            if not row.flags and not np.all(np.abs(off_c) <= WRONG_C):
                text = f"{tally.kind}, dwell {row.dwell}: off by {np.round(off_c, 1).tolist()} K"
                tally.wrong_temperature.append(text)
        tally.outcomes = Counter(outcomes_of(self._injections(), list(read_journal(self.run.journal))))


class InjectedError(Exception):
    """Stands for a mistake in the program."""


def outcomes_of(injected_s: Iterable[float], entries: Sequence[Mapping[str, Any]]) -> list[str]:
    """The gravest outcome in the journal between each injection and the next one."""
    first = np.searchsorted([entry["time_s"] for entry in entries], sorted(injected_s))
    return [_outcome(entries[begin:end]) for begin, end in itertools.pairwise([*first, len(entries)])]


def _outcome(entries: Sequence[Mapping[str, Any]]) -> str:
    found = NONE
    for entry in entries:
        match entry["event"]:
            case "run_ended" if entry["ended"] != "finished":
                seen = ENDED
            case "run_resumed":
                seen = ENDED
            case "tripped":
                seen = HELD
            case "dwell_given_up":
                seen = REPEATED
            case "dwell_finished" if entry["flags"]:
                seen = FLAGGED
            case "held":
                seen = HELD
            case "retry" | "answers_again":
                seen = RETRIED
            case "note" if "has restarted" in entry["text"]:
                seen = REPEATED
            case _:
                continue
        found = min(found, seen, key=OUTCOMES.index)
    return found


def listed_faults(folder: Path, kind: str, count: int, seed: int) -> KindTally:
    """Inject ``count`` faults of one of the emulators' kinds, in two runs."""
    ways = LISTED[kind]
    whole = KindTally(kind)
    for rule, share in (("repeat", count - count // 2), ("flag", count // 2)):
        if not share:
            continue
        faults = [
            {"fault": kind, "every_s": _EVERY_S * len(ways), "times": max(1, round(share / len(ways))), **way}
            for way in ways
        ]
        whole.merge(
            FaultyRun(folder / f"{kind}_{rule}", kind, rule, faults, seed=seed + (rule == "flag")).go(
                most=share
            )
        )
    return whole


def _one(task: tuple[Path, str, int, int]) -> KindTally:
    from tests.soak.host_faults import HOST, host_faults

    folder, kind, count, seed = task
    # A process in the background may have been started with these ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    tally = (
        host_faults(folder, kind, count, seed) if kind in HOST else listed_faults(folder, kind, count, seed)
    )
    sys.stdout.write(_line(tally) + "\n")
    sys.stdout.flush()
    return tally


def _line(tally: KindTally) -> str:
    outcomes = ", ".join(f"{name} {tally.outcomes[name]}" for name in OUTCOMES if tally.outcomes[name])
    problems = [*tally.wrong, *tally.wrong_temperature, *tally.unsafe, *tally.problems]
    text = f"{tally.kind:28}{tally.injected:4}  {outcomes}  (dwells {tally.dwells}, {tally.took_s:.0f} s)"
    return "\n".join([text, *(f"    {each}" for each in problems)])


def inject_faults(folder: Path, count: int, seed: int, only: Sequence[str] = ()) -> PartResult:
    """Inject ``count`` faults at least, over all kinds, some kinds at a time."""
    from tests.soak.host_faults import HOST

    begin_s = time.monotonic()
    kinds = [kind for kind in (*HOST, *LISTED) if not only or kind in only]
    each = -(-count // len(kinds))
    tasks = [(folder, kind, each, seed) for kind in kinds]
    if len(kinds) > 2:
        with ProcessPoolExecutor(_WORKERS, mp_context=get_context("spawn")) as pool:
            tallies = list(pool.map(_one, tasks))
    else:
        tallies = [_one(task) for task in tasks]
    return _result(tallies, time.monotonic() - begin_s)


def _result(tallies: Sequence[KindTally], took_s: float) -> PartResult:
    def of(name: str) -> list[str]:
        return [text for tally in tallies for text in getattr(tally, name)]

    injected = sum(tally.injected for tally in tallies)
    lost = sum(tally.lost for tally in tallies)
    rows = [
        [
            tally.kind,
            str(tally.injected),
            *(str(tally.outcomes[name] or "") for name in reversed(OUTCOMES)),
            str(tally.dwells),
            str(tally.flagged),
            str(len(tally.wrong)),
        ]
        for tally in tallies
    ]
    without = [tally.kind for tally in tallies if not tally.injected]
    return PartResult(
        "faults",
        "Faults",
        {
            "faults injected": str(injected),
            "kinds": str(len(tallies) - len(without)),
            "dwells finished": str(sum(tally.dwells for tally in tallies)),
            "dwells flagged": str(sum(tally.flagged for tally in tallies)),
            "dwells lost": str(lost),
            "wrong results let through": str(len(of("wrong"))),
            f"temperatures off by more than {WRONG_C:g} K without a flag": str(len(of("wrong_temperature"))),
            "ends with the bench not safe without a report": str(len(of("unsafe"))),
        },
        "One kind in a run, at random times; half of the injections under a procedure that repeats "
        "disturbed dwells, half under one that flags them. A run that ended was resumed. An injection's "
        "outcome is the gravest entry of the journal before the next one; a retry inside a "
        "driver's exchange leaves no trace there. "
        f"Took {took_s / 60.0:.0f} min.",
        [PartTable(["kind", "injected", *reversed(OUTCOMES), "dwells", "of them flagged", "wrong"], rows)],
        [
            *of("wrong"),
            *of("wrong_temperature"),
            *of("unsafe"),
            *of("problems"),
            *(f"{kind}: never took effect" for kind in without),
        ],
        machine(),
    )
