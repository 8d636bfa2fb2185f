"""Speed and memory of whole runs and commands, and the physical limits, each in a separate process.

With ``GYROBENCH_BEFORE``, the path of an older version's ``gyrobench``, that version is measured beside it.
"""

import os
import shutil
import subprocess
import sys
import time
import zlib
from pathlib import Path

import numpy as np
import yaml

from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.runs.can_log import read_can_log
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import read_journal
from tests.benchmarks.fleet_runs import PROCEDURE as SHORT_DWELLS

GYROBENCH = [sys.executable, "-c", "from gyrobench.bench.cli import main; main()"]
#: An older version to compare with; empty for none.
BEFORE = [path] if (path := os.environ.get("GYROBENCH_BEFORE", "")) else []
#: Samples of the simulated INS in a second.
SAMPLE_RATE = 100
#: Dwells of two runs whose peak memory is compared.
FEW, MANY = 40, 240
RUNS_OF_DWELLS = 4
COMMANDS = 3


#: A process's peak memory is not below that of the one that starts it: a small one does.
_START = """
import os, sys
silent = [(os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)]
child = os.posix_spawnp(sys.argv[1], sys.argv[1:], os.environ, file_actions=silent)
_, status, usage = os.wait4(child, 0)
print(os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime, usage.ru_maxrss)
"""


def processor(*command):
    """Run a command; gives its processor time in s and its peak memory in kB."""
    start = [sys.executable, "-S", "-c", _START, *map(str, command)]
    printed = subprocess.run(start, check=True, stdout=subprocess.PIPE, text=True).stdout
    returned, cpu_s, peak_kb = printed.split()
    assert returned == "0", command
    return float(cpu_s), int(peak_kb)


def run(procedure, out, *options):
    """Run a procedure; gives processor time in s, peak memory in kB, bench hours, and frames."""
    cpu_s, peak_kb = processor(*GYROBENCH, "run", procedure, "--out", out, *options)
    entries = list(read_journal(RunFolder(out).journal))
    frames = sum(len(part) for _, part in read_can_log(RunFolder(out).can))
    return cpu_s, peak_kb, entries[-1]["time_s"] / 3600.0, frames


def many_dwells(path, dwells):
    """A procedure of ``dwells`` dwells of two minutes at one temperature."""
    procedure = yaml.safe_load(SHORT_DWELLS.read_text(encoding="utf-8"))
    first, *_ = (step for step in procedure["steps"] if "repeat" in step)
    first["repeat"]["over"] = {"cycle": list(range(1, dwells // 5 + 1)), "temperature_c": [35]}
    last = procedure["steps"].index(first) + 1
    procedure["steps"] = [*procedure["steps"][:last], "power_off", "chamber_off"]
    path.write_text(yaml.safe_dump(procedure), encoding="utf-8")
    return path


def mean_peak_kb(dwells, folder, *options):
    """Peak memory in kB of several runs: Python takes memory by 1 MB, so that one alone decides nothing."""
    procedure = many_dwells(folder / f"{dwells}.yaml", dwells)
    return np.mean(
        [run(procedure, folder / f"{dwells}-{turn}", *options)[1] for turn in range(RUNS_OF_DWELLS)]
    )


def first_cycle(path):
    """The Fig. 7 procedure without its second cycle: about as long as full_calibration."""
    procedure = yaml.safe_load(find_document("procedures", "six_position_fig7").read_text(encoding="utf-8"))
    procedure["steps"] = [
        step for step in procedure["steps"] if "repeat" not in step or step["repeat"]["over"]["cycle"] == [1]
    ]
    path.write_text(yaml.safe_dump(procedure), encoding="utf-8")
    return path


def limits_s(samples, frames, folder):
    """Processor time in s of what no implementation can leave out, for numbers of samples and frames."""
    program = folder / "strapdown"
    source = Path(__file__).with_name("strapdown.c")
    subprocess.run(["cc", "-O2", "-o", str(program), str(source), "-lm"], check=True)
    printed = subprocess.run([str(program), str(samples)], check=True, capture_output=True, text=True).stdout
    begin_s = time.process_time()
    data = np.zeros((frames, 8), np.uint8)
    data[:, ::3] = (np.arange(frames) % 251)[:, np.newaxis]
    copied_s = time.process_time()
    signals = data.view(">i2").astype(np.float64) * 1e-3
    decoded_s = time.process_time()
    assert signals.shape == (frames, 4)
    zlib.compress(data.tobytes(), 1)
    return {
        "C strapdown": float(printed.split()[0]),
        "numpy decode": decoded_s - copied_s,
        "bytes of the bus, in memory": copied_s - begin_s,
        "bytes of the bus, compressed by zlib": time.process_time() - decoded_s,
    }


def row(what, value, before="", limit=""):
    print(f"| {what:<62} | {before:>12} | {value:>12} | {limit:<26} |", flush=True)


def compared(what, unit, measure, limit=""):
    """Print a row of what ``measure(program)`` gives, with the older version and with this one."""
    earlier = measure(BEFORE) if BEFORE else None
    value = measure(GYROBENCH)
    ratio = f"{value / earlier:.2f} of the older" if earlier else ""
    before = f"{earlier:.2f} {unit}" if earlier else ""
    row(what, f"{value:.2f} {unit}", before, "; ".join(each for each in (ratio, limit) if each))


def test_table(tmp_path):
    """The table of docs/performance.md."""
    run("ten_minute_check", tmp_path / "warm")  # compiles the simulated INS once
    print()
    row("what", "this version", "older", "ratio, and limit in this run")
    row("---", "---:", "---:", "---")
    folders = {"".join(BEFORE): tmp_path / "before", "".join(GYROBENCH): tmp_path / "fig7"}
    earlier = processor(*BEFORE, "run", "six_position_fig7", "--out", tmp_path / "before") if BEFORE else None
    cpu_s, peak_kb, bench_h, frames = run("six_position_fig7", tmp_path / "fig7")
    limits = limits_s(round(bench_h * 3600 * SAMPLE_RATE), frames, tmp_path)
    floor_s = sum(limits.values())
    row(
        f"Fig. 7, {bench_h:.2f} h, {frames / 1e6:.2f} million frames, processor time",
        f"{cpu_s:.1f} s",
        f"{earlier[0]:.1f} s" if earlier else "",
        f"{floor_s:.1f} s: {cpu_s / floor_s:.1f} times",
    )
    row("Fig. 7, times real time", f"{bench_h * 3600 / cpu_s:.0f}")
    row("Fig. 7, per frame, all parts of the run", f"{1e6 * cpu_s / frames:.2f} us")
    for name, limit_s in limits.items():
        row(f"limit: {name}", f"{limit_s:.2f} s", limit=f"{cpu_s / limit_s:.0f} times")
    row("Fig. 7, peak memory", f"{peak_kb / 1024:.0f} MB", f"{earlier[1] / 1024:.0f} MB" if earlier else "")
    quick = ("--station", "quick", "--world", "quick")
    run(many_dwells(tmp_path / "compiles.yaml", FEW), tmp_path / "compiles", *quick)
    peaks_kb = [mean_peak_kb(dwells, tmp_path, *quick) for dwells in (FEW, MANY)]
    row(
        f"peak memory, growth from {FEW} to {MANY} dwells",
        f"{(peaks_kb[1] - peaks_kb[0]) / (MANY - FEW):.1f} kB/dwell",
    )

    def of_run(procedure):
        def measure(program):
            shutil.rmtree(tmp_path / "run", ignore_errors=True)
            return processor(*program, "run", procedure, "--out", tmp_path / "run")[0]

        return measure

    compared("three_temperature_shift, 7.75 h, processor time", "s", of_run("three_temperature_shift"))
    compared("gyrobench run ten_minute_check, processor time", "s", least(of_run("ten_minute_check")))
    compared(
        "gyrobench close on Fig. 7, processor time", "s",
        least(lambda program: processor(*program, "close", folders["".join(program)])[0]),
    )  # fmt: skip
    speeds, cycle = {}, first_cycle(tmp_path / "first_cycle.yaml")
    run("full_calibration", tmp_path / "warm_full")  # compiles what rotations need
    for name, procedure, world in (
        ("six_position_fig7", "six_position_fig7", "gyro_b"),
        ("its first cycle in the world of full_calibration", cycle, "all_coefficients"),
        ("full_calibration", "full_calibration", "all_coefficients"),
    ):
        used_s, _, bench_h, _ = run(procedure, tmp_path / name, "--world", world)
        speeds[name] = bench_h * 3600.0 / used_s
        ratio = f"{speeds[name] / speeds['six_position_fig7']:.2f} of six_position_fig7"
        row(f"{name}, times real time", f"{speeds[name]:.0f}", limit=ratio)
    bare_s = least(lambda program: processor(*program, "-c", "pass")[0])([sys.executable])
    for name in ("--help", "schema"):
        compared(
            f"gyrobench {name}, processor time", "s",
            least(lambda program, option=name: processor(*program, option)[0]),
            limit=f"python: {bare_s:.2f} s",
        )  # fmt: skip


def least(measure):
    """The same measurement, repeated for its smallest value."""
    return lambda program: min(measure(program) for _ in range(COMMANDS))
