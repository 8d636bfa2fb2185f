"""Where the processor time of an emulated run goes: shares of its parts, sampled.

    python -m tests.benchmarks.profile_run [six_position_fig7] [--lines 20]

A timer of processor time interrupts the run up to 1000 times a second. A sample belongs to the innermost
function of a module in PARTS, together with all that this function calls: numpy, matplotlib, compiled steps,
files and tables.
With ``--lines``, the functions with the most samples follow.
"""

import argparse
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

INTERVAL_S = 0.001
#: Parts by the path of their modules, the first that matches counts; all else is the engine.
PARTS = {
    "results and figures": ("bench/dwells/run_results", "bench/report/", "bench/closure/"),
    "live estimate": ("bench/dwells/", "bench/bias/", "bench/navigation/", "bench/calibration/"),
    "log": ("bench/runs/can_log", "bench/runs/blf"),
    "journal and telemetry": ("bench/runs/", "bench/monitor/"),
    "interlocks": ("bench/engine/interlocks/", "bench/station/interlocks"),
    "frames": ("drivers/ins/", "drivers/frames", "drivers/emulators/can_"),
    "world": ("drivers/emulators/world/", "drivers/emulators/faults/", "drivers/emulators/bench"),
    "serial": ("drivers/",),
    "engine": ("bench/",),
}
#: Modules that work for the part that calls them.
CALLED = "bench/foundations/"
#: Work at the end of a run uses the modules of other parts.
OUTERMOST = "results and figures"


def part_of(frame):
    """Part of the program that a stack belongs to, and the function that decided it."""
    found = None
    while frame is not None:
        _, _, module = frame.f_code.co_filename.rpartition("/gyrobench/")
        part = (
            next((part for part, paths in PARTS.items() if module.startswith(paths)), None)
            if module and not module.startswith(CALLED)
            else None
        )
        if part == OUTERMOST:
            return part, f"{module}:{frame.f_code.co_name}"
        if part and not found:
            found = part, f"{module}:{frame.f_code.co_name}"
        if "importlib" in frame.f_code.co_filename and not found:
            found = "imports", "imports"
        frame = frame.f_back
    return found or ("start and end", "")


def sampled(program):
    """Run a program; gives the number of samples by part and function."""
    samples = Counter()
    signal.signal(signal.SIGPROF, lambda _, frame: samples.update([part_of(frame)]))
    signal.setitimer(signal.ITIMER_PROF, INTERVAL_S, INTERVAL_S)
    try:
        program()
    except SystemExit as end:
        if end.code:
            raise
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    return samples


def _run(procedure, out):
    from gyrobench.bench.cli import main

    sys.argv = ["gyrobench", "run", procedure, "--out", out]
    main()


def main():
    """Run a procedure and print the shares as a table in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("procedure", nargs="?", default="six_position_fig7")
    parser.add_argument("--lines", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        samples = sampled(lambda: _run(options.procedure, f"{folder}/run"))
    parts = Counter()
    for (part, _), count in samples.items():
        parts[part] += count
    total = parts.total()
    total_s = time.process_time()
    print(f"\n{total} samples of {total_s:.1f} s of processor time\n")
    print(f"| part of {options.procedure} | share | s |\n|---|---|---|")
    for part, count in parts.most_common():
        print(f"| {part} | {count / total:.0%} | {count / total * total_s:.2f} |")
    for (part, function), count in samples.most_common(options.lines):
        print(f"{count / total:6.1%}  {part:<22}{Path(function)}")


if __name__ == "__main__":
    main()
