"""Speed and memory of whole runs and commands, and the physical limits, each in processes of its own."""

import os
import shutil
import subprocess
import sys
import time
import zlib
from pathlib import Path

import numpy as np
import yaml

from gyrobench.bench.runs.can_log import read_can_log
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import read_journal
from tests.benchmarks.fleet_runs import PROCEDURE as SHORT_DWELLS

GYROBENCH = [sys.executable, "-c", "from gyrobench.bench.cli import main; main()"]
#: Samples of the simulated INS in a second.
SAMPLE_RATE = 100
#: Dwells of two runs whose peak memory is compared.
FEW, MANY = 40, 240
COMMANDS = 3


def processor(*command):
    """Run a command; gives its processor time in s and its peak memory in kB."""
    process = subprocess.Popen([str(each) for each in command], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0, command
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss


def run(procedure, out, *options):
    """Run a procedure; gives processor time in s, peak memory in kB, bench hours, and frames."""
    cpu_s, peak_kb = processor(*GYROBENCH, "run", procedure, "--out", out, *options)
    entries = list(read_journal(RunFolder(out).journal))
    frames = sum(len(part) for _, part in read_can_log(RunFolder(out).can))
    return cpu_s, peak_kb, entries[-1]["time_s"] / 3600.0, frames


def many_dwells(path, dwells):
    """A procedure of so many dwells of two minutes at one temperature."""
    procedure = yaml.safe_load(SHORT_DWELLS.read_text(encoding="utf-8"))
    first, *_ = (step for step in procedure["steps"] if "repeat" in step)
    first["repeat"]["over"] = {"cycle": list(range(1, dwells // 5 + 1)), "temperature_c": [35]}
    last = procedure["steps"].index(first) + 1
    procedure["steps"] = [*procedure["steps"][:last], "power_off", "chamber_off"]
    path.write_text(yaml.safe_dump(procedure), encoding="utf-8")
    return path


def limits_s(samples, frames, folder):
    """Processor time in s of what no implementation can leave out, for so many samples and frames."""
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


def row(what, value, limit=""):
    print(f"| {what:<62} | {value:>15} | {limit:<26} |", flush=True)


def test_table(tmp_path):
    """The table of docs/performance.md."""
    run("ten_minute_check", tmp_path / "warm")  # compiles the simulated INS once
    print()
    row("what", "measured", "limit in the same run")
    row("---", "---:", "---")
    fig7 = tmp_path / "fig7"
    cpu_s, peak_kb, bench_h, frames = run("six_position_fig7", fig7)
    limits = limits_s(round(bench_h * 3600 * SAMPLE_RATE), frames, tmp_path)
    floor_s = sum(limits.values())
    row(
        f"Fig. 7, {bench_h:.2f} h, {frames / 1e6:.2f} million frames, processor time",
        f"{cpu_s:.1f} s",
        f"{floor_s:.1f} s: {cpu_s / floor_s:.1f} times",
    )
    row("Fig. 7, times real time", f"{bench_h * 3600 / cpu_s:.0f}")
    row("Fig. 7, per frame, all parts of the run", f"{1e6 * cpu_s / frames:.2f} us")
    for name, limit_s in limits.items():
        row(f"limit: {name}", f"{limit_s:.2f} s", f"{cpu_s / limit_s:.0f} times")
    shift_s, _, shift_h, _ = run("three_temperature_shift", tmp_path / "shift")
    row(f"three_temperature_shift, {shift_h:.2f} h, processor time", f"{shift_s:.1f} s")
    row("Fig. 7, peak memory", f"{peak_kb / 1024:.0f} MB")
    quick = ("--station", "quick", "--world", "quick")
    peaks_kb = [
        run(many_dwells(tmp_path / f"{dwells}.yaml", dwells), tmp_path / str(dwells), *quick)[1]
        for dwells in (FEW, MANY)
    ]
    row(
        f"peak memory, growth from {FEW} to {MANY} dwells",
        f"{(peaks_kb[1] - peaks_kb[0]) / (MANY - FEW):.1f} kB/dwell",
    )
    processor(*GYROBENCH, "close", fig7)
    row("gyrobench close on Fig. 7, processor time", f"{least(*GYROBENCH, 'close', fig7):.2f} s")
    shutil.rmtree(fig7)
    checks_s = [run("ten_minute_check", tmp_path / f"check{number}")[0] for number in range(COMMANDS)]
    row("gyrobench run ten_minute_check, processor time", f"{min(checks_s):.2f} s")
    bare_s = least(sys.executable, "-c", "pass")
    row("gyrobench --help, processor time", f"{least(*GYROBENCH, '--help'):.2f} s", f"python: {bare_s:.2f} s")


def least(*command):
    """Least processor time of a command over some calls, s."""
    return min(processor(*command)[0] for _ in range(COMMANDS))
