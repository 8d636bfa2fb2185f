"""Speed and memory of whole runs on the emulated bench, through pyserial and python-can."""

import os
import subprocess
import sys
import time

from gyrobench.bench.runs.can_log import read_can_log
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import read_journal

GYROBENCH = [sys.executable, "-c", "from gyrobench.bench.cli import main; main()"]


def run(procedure, out):
    """Run a procedure in a process of its own; returns real seconds, bench seconds, peak memory, frames."""
    begin = time.perf_counter()
    process = subprocess.Popen([*GYROBENCH, "run", procedure, "--out", str(out)], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    real_s = time.perf_counter() - begin
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0
    entries = list(read_journal(RunFolder(out).journal))
    frames = sum(len(part) for _, part in read_can_log(RunFolder(out).can))
    return real_s, entries[-1]["time_s"], usage.ru_maxrss / 1024.0, frames


def test_whole_runs(tmp_path):
    run("ten_minute_check", tmp_path / "warm")  # compiles the simulated INS once
    print(f"\n{'procedure':<26}{'bench h':>9}{'real s':>8}{'x real time':>13}{'frames':>10}{'peak MB':>9}")
    for procedure in ("ten_minute_check", "three_temperature_shift", "six_position_fig7"):
        real_s, bench_s, peak_mb, frames = run(procedure, tmp_path / procedure)
        row = f"{procedure:<26}{bench_s / 3600:>9.2f}{real_s:>8.1f}{bench_s / real_s:>13.0f}"
        print(f"{row}{frames:>10}{peak_mb:>9.0f}")


def test_help():
    subprocess.run([*GYROBENCH, "--help"], check=True, stdout=subprocess.DEVNULL)
    times_s = []
    for _ in range(5):
        begin = time.perf_counter()
        subprocess.run([*GYROBENCH, "--help"], check=True, stdout=subprocess.DEVNULL)
        times_s.append(time.perf_counter() - begin)
    begin = time.perf_counter()
    subprocess.run([sys.executable, "-c", "pass"], check=True)
    bare_s = time.perf_counter() - begin
    print(f"gyrobench --help: {min(times_s):.2f} s; python alone {bare_s:.2f} s")
