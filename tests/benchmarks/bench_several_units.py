"""Cost of several units in one chamber: bench hours and processor time of four in one run, against one."""

from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import facts_of, read_journal
from tests.benchmarks.bench_whole_run import GYROBENCH, processor

MAX_HOURS, MAX_PROCESSOR = 1.1, 3.0


def test_four_units_cost_little_more_than_one(tmp_path):
    """The table of docs/performance.md: `gyrobench run quick_campaign`, with results and reports."""
    found = {}
    for name, station, world in (
        ("warm", "quick", "quick"),
        ("1", "quick", "quick"),
        ("4", "four_units", "four_units"),
    ):
        out, options = tmp_path / name, ("--station", station, "--world", world)
        procedure = "ten_minute_check" if name == "warm" else "quick_campaign"  # compiles the simulated INS
        cpu_s, peak_kb = processor(*GYROBENCH, "run", procedure, "--out", out, *options)
        hours = facts_of(read_journal(RunFolder(out).journal)).last_s / 3600.0
        found[name] = hours, cpu_s
        print(f"| {name:<5} | {hours:6.3f} h | {cpu_s:6.1f} s | {peak_kb / 1024:5.0f} MB |", flush=True)
    hours, cpu = (four / one for four, one in zip(found["4"], found["1"], strict=True))
    print(f"| ratio | {hours:8.3f} | {cpu:8.2f} | |")
    assert hours < MAX_HOURS
    assert cpu < MAX_PROCESSOR
