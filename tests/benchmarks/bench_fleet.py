"""How a fleet of runs scales with workers: time, memory, overhead, and where it stops.

    python -m tests.benchmarks.bench_fleet --runs 1000 --out DIR

makes the emulated runs that DIR lacks, evaluates them with one worker and more, each number of workers in
a process of its own, and writes docs/fleet_benchmark.md. `make benchmark` does the same with a few runs and
writes nothing.
"""

import argparse
import json
import os
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import psutil

from gyrobench.bench.fleet.jobs import FleetRecord, JobKind
from gyrobench.bench.fleet.workers import Workers, connect_workers, work_through
from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.runs.index.store import find_run_folders
from tests.benchmarks.fleet_runs import make_runs

TABLE = Path(__file__).parents[2] / "docs" / "fleet_benchmark.md"


@dataclass
class Case:
    """One kind of job with one set of workers."""

    kind: str
    workers: int
    are_threads: bool
    runs: int
    failed: int
    start_s: float
    wall_s: float
    cpu_s: float
    peak_mb: float
    speed_up: float = 1.0


def usage():
    """CPU time of each process of the fleet, and its memory in MB."""
    own = psutil.Process()
    found = {}
    for process in (own, *own.children(recursive=True)):
        times, memory = process.cpu_times(), process.memory_info()
        found[process.pid] = (times.user + times.system, memory.rss / 1e6)
    return found


def measure(kind, paths, workers, are_threads, folder):
    """Do the job with all runs once, workers warm from one run each."""
    clock = WallClock()
    with connect_workers(Workers(workers, are_threads)) as pool:
        warm = FleetRecord(JobKind(kind), folder / "warm")
        list(work_through(pool, warm, paths[: 2 * workers]))
        start_s = clock.now()
        before = usage()
        began_s = clock.now()
        record = FleetRecord(JobKind(kind), folder / "measured")
        results = list(work_through(pool, record, paths))
        wall_s = clock.now() - began_s
        after = usage()
    return Case(
        kind=kind,
        workers=workers,
        are_threads=are_threads,
        runs=len(paths),
        failed=sum(result.state != "done" for result in results),
        start_s=start_s,
        wall_s=wall_s,
        cpu_s=sum(after[pid][0] - before.get(pid, (0.0,))[0] for pid in after),
        peak_mb=max(each[1] for each in after.values()),
    )


def measure_apart(kind, runs, count, workers, are_threads, folder):
    """Measure in a process of its own, so that no case finds memory or imports of another."""
    command = [
        sys.executable,
        "-m",
        "tests.benchmarks.bench_fleet",
        "--case",
        kind,
        str(workers),
        str(int(are_threads)),
    ]
    command += ["--runs", str(count), "--out", str(runs), "--record", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=Path(__file__).parents[2])
    return Case(**json.loads(done.stdout.splitlines()[-1]))


def measure_beside_one(kind, runs, count, workers, are_threads, folder):
    """Measure, and right after it one process with a tenth of the runs: the speed-up is over that.

    So what else the machine does at the time weighs on both alike.
    """
    case = measure_apart(kind, runs, count, workers, are_threads, folder)
    if workers > 1 or are_threads:
        alone = measure_apart(kind, runs, max(count // 10, 1), 1, False, folder)
        case.speed_up = (case.runs / case.wall_s) / (alone.runs / alone.wall_s)
    return case


def format_table(cases):
    """Markdown rows; speed-up over one process."""
    cores = len(os.sched_getaffinity(0))
    lines = [
        "| job | workers | time s | speed-up | cores busy | runs/s | CPU s a run | peak MB | start s |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for case in cases:
        who = f"{case.workers} {'thread' if case.are_threads else 'process'}"
        who += "" if case.workers == 1 else "s" if case.are_threads else "es"
        lines.append(
            f"| {case.kind} | {who} | {case.wall_s:.1f} | {case.speed_up:.2f} "
            f"| {case.cpu_s / case.wall_s / min(case.workers, cores):.0%} of {min(case.workers, cores)} "
            f"| {case.runs / case.wall_s:.1f} "
            f"| {case.cpu_s / case.runs:.3f} | {case.peak_mb:.0f} | {case.start_s:.1f} |"
        )
    return "\n".join(lines)


def conclusion(cases):
    """Where it stops scaling, as the numbers say."""
    cores = len(os.sched_getaffinity(0))
    sentences = []
    for kind in dict.fromkeys(case.kind for case in cases):
        processes = [case for case in cases if case.kind == kind and not case.are_threads]
        fastest = max(processes, key=lambda case: case.speed_up)
        enough = next(case for case in processes if case.speed_up >= 0.95 * fastest.speed_up)
        busy = enough.cpu_s / enough.wall_s
        sentences.append(
            f"`fleet {kind}` is within 5 % of its best with {enough.workers} workers: these keep "
            f"{busy:.2f} of {cores} cores busy and are {enough.speed_up:.2f} times as fast "
            "as one."
        )
        threads = [case for case in cases if case.kind == kind and case.are_threads]
        if threads:
            best = max(threads, key=lambda case: case.speed_up)
            sentences.append(
                f"Threads reach {best.speed_up:.2f} times one process at best, "
                f"with {best.workers}: they share one interpreter lock."
            )
    return " ".join(sentences)


def test_fleet_with_few_runs(tmp_path):
    """What `make benchmark` shows: a fleet of twelve runs with one and two workers."""
    os.environ["GYROBENCH_LOCK_DIR"] = str(tmp_path)
    make_runs(tmp_path / "runs", 12, 4)
    cases = [
        measure_beside_one(kind, tmp_path / "runs", 12, workers, False, tmp_path / f"{kind}-{workers}")
        for kind in ("bins", "close")
        for workers in (1, 2)
    ]
    print(f"\n{format_table(cases)}")
    assert not any(case.failed for case in cases)


def main():
    """Measure as the command line says."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--units", type=int, default=50)
    parser.add_argument("--out", type=Path, required=True, help="folder of the runs")
    parser.add_argument("--record", type=Path, default=Path("fleet-benchmark"))
    parser.add_argument("--kinds", nargs="+", default=["bins"])
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2, 4], help="numbers of processes")
    parser.add_argument("--threads", type=int, nargs="*", default=[2], help="numbers of threads")
    parser.add_argument("--case", nargs=3, help=argparse.SUPPRESS)
    parser.add_argument("--table", type=Path, default=TABLE)
    options = parser.parse_args()
    if options.case:
        kind, workers, are_threads = options.case
        paths = find_run_folders([str(options.out)])[: options.runs]
        case = measure(kind, paths, int(workers), are_threads == "1", options.record)
        print(json.dumps(asdict(case)))
        return
    make_runs(options.out, options.runs, options.units)
    cases = []
    workers_of = [(each, False) for each in options.workers] + [(each, True) for each in options.threads]
    for kind in options.kinds:
        for workers, are_threads in workers_of:
            folder = options.record / f"{kind}-{workers}-{'threads' if are_threads else 'processes'}"
            cases.append(measure_beside_one(kind, options.out, options.runs, workers, are_threads, folder))
            print(format_table([*cases]).splitlines()[-1], flush=True)
    options.table.write_text(
        f"# Fleet of {options.runs} emulated runs\n\n"
        f"Made by `python -m tests.benchmarks.bench_fleet --runs {options.runs} --out DIR` on a machine "
        f"with {len(os.sched_getaffinity(0))} cores. Each run has 12 dwells of two minutes. Time is that of "
        "all runs with workers that have started and done two runs each before; start is how long that "
        "takes. Speed-up is over one process, measured right after. "
        "Cores busy: processor time of all processes over that of the cores they may use. Peak memory is "
        "that of one worker's process.\n\n"
        f"{format_table(cases)}\n\n{conclusion(cases)}\n"
    )


if __name__ == "__main__":
    main()
