"""One run of a thousand hours with a fault every few minutes: all dwells finish, memory stays bounded."""

from __future__ import annotations

import os
import sys
import threading
import time
from pathlib import Path

import numpy as np

from gyrobench.bench.engine.job import Job
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.foundations.shipped import find_document
from tests.soak.faults import OUTCOMES, FaultyRun
from tests.soak.results import PartResult, PartTable, counts, machine
from tests.soak.truth import TruthWatcher

PROCEDURE = Path(__file__).with_name("long.yaml")
#: Length of a cycle of the procedure with soaks of this length; a run that is shorter has shorter soaks.
_CYCLE_H, _SOAK_S = 9.2, 7200.0
_MAX_PERIOD_S, _MIN_SAMPLES = 3600.0, 20
#: Share of the run in which the program still grows to its size.
_WARM_UP = 0.1
_SAMPLES_SHOWN = 10

#: Small faults every few minutes, and a grave one every few hours; spacings in s.
FAULTS = (
    {"fault": "lost_reply", "target": "table", "every_s": 1800},
    {"fault": "lost_reply", "target": "chamber", "every_s": 1800},
    {"fault": "half_reply", "target": "chamber", "every_s": 3600},
    {"fault": "earlier_reply", "target": "table", "every_s": 3600},
    {"fault": "garbage", "target": "table", "every_s": 3600},
    {"fault": "damaged_reply", "target": "chamber", "every_s": 3600},
    {"fault": "late_reply", "target": "table", "delay_s": 3, "every_s": 3600},
    {"fault": "wrong_crc", "every_s": 3600},
    {"fault": "exception_code", "every_s": 3600},
    {"fault": "frames_lost", "every_s": 900},
    {"fault": "frames_repeated", "every_s": 1800},
    {"fault": "frames_out_of_order", "every_s": 1800},
    {"fault": "frames_corrupted", "every_s": 1800},
    {"fault": "time_stamp_jump", "by_s": -3600, "for_s": 30, "every_s": 14400},
    {"fault": "bus_off", "for_s": 1, "every_s": 14400},
    {"fault": "falls_back_to_alignment", "every_s": 54000},
    {"fault": "port_gone", "target": "chamber", "for_s": 20, "every_s": 72000},
    {"fault": "counter_jump", "by": 1000, "every_s": 72000},
    {"fault": "ins_restarts", "every_s": 144000},
    {"fault": "table_trips", "axis": "outer", "trip": "tracking_error", "every_s": 216000},
    {"fault": "moved_by_hand", "by_deg": 20, "for_s": 10, "every_s": 216000},
    {"fault": "door_opened", "for_s": 60, "every_s": 216000},
    {"fault": "chamber_alarm", "alarm": 2, "for_s": 30, "every_s": 288000},
    {"fault": "instrument_restarts", "target": "table", "for_s": 15, "every_s": 360000},
)


class Sampler(TruthWatcher):
    """Looks at the size of this process now and then."""

    def __init__(self, job: Job, period_s: float) -> None:
        super().__init__(job)
        self._period_s = period_s
        self.samples: list[tuple[float, float, int, int]] = []
        self._next_s = 0.0

    def ticked(self, bench: LiveBench, left_s: float) -> None:
        """Take a sample when it is time."""
        super().ticked(bench, left_s)
        now_s = bench.clock.now()
        if now_s >= self._next_s:
            self._next_s = now_s + self._period_s
            self.samples.append((now_s / 3600.0, rss_mb(), open_descriptors(), threading.active_count()))
            if len(self.samples) % 50 == 0:
                h, mb, descriptors, threads = self.samples[-1]
                sys.stdout.write(f"{h:7.0f} h  {mb:6.1f} MB  {descriptors} descriptors  {threads} threads\n")
                sys.stdout.flush()


def rss_mb() -> float:
    """Memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def open_descriptors() -> int:
    """Open files and sockets of this process."""
    return len(list(Path("/proc/self/fd").iterdir()))


def slope(samples: np.ndarray) -> tuple[float, float]:
    """Growth of memory in MB per 100 h after the warm-up, and the spread about it; rows begin with h, MB."""
    settled = samples[samples[:, 0] >= _WARM_UP * samples[-1, 0]]
    growth, offset = np.polyfit(settled[:, 0], settled[:, 1], 1)
    return 100.0 * growth, float(np.std(settled[:, 1] - growth * settled[:, 0] - offset))


def long_run(folder: Path, hours: float, seed: int) -> PartResult:
    """Run for some ``hours`` of bench time."""
    begin_s = time.monotonic()
    cycles = ", ".join(map(str, range(1, 1 + max(1, round(hours / _CYCLE_H)))))
    soak_s = round(_SOAK_S * min(1.0, hours / _CYCLE_H))
    procedure = PROCEDURE.read_text().replace("CYCLES", cycles).replace("SOAK_S", str(max(soak_s, 240)))
    station = folder.with_name(f"{folder.name}_station.yaml")
    station.parent.mkdir(parents=True, exist_ok=True)
    text = find_document("stations", "quick").read_text()
    station.write_text(text.replace("instruments_period_s: 20.0", "instruments_period_s: 28.0"))
    run = FaultyRun(folder, "long", "repeat", FAULTS, procedure, str(station), seed)
    run.watcher = sampler = Sampler(run.job, min(_MAX_PERIOD_S, 3600.0 * hours / _MIN_SAMPLES))
    tally = run.go(ConsentingOperator(patience=1_000_000))
    samples = np.array(sampler.samples)
    growth_mb, spread_mb = slope(samples)
    rss, descriptors, threads = samples[:, 1], samples[:, 2], samples[:, 3]
    settled = samples[:, 0] >= _WARM_UP * samples[-1, 0]
    every_min = 60.0 * samples[-1, 0] / max(tally.injected, 1)
    problems = [*tally.wrong, *tally.wrong_temperature, *tally.unsafe, *tally.problems]
    if tally.lost:
        problems.append(f"{tally.lost} dwells lost")
    shown = samples[np.linspace(0, len(samples) - 1, min(_SAMPLES_SHOWN, len(samples))).astype(int)]
    return PartResult(
        "long",
        "Long run",
        {
            "bench time": f"{samples[-1, 0]:.0f} h",
            "faults injected": f"{tally.injected}, one in {every_min:.1f} min",
            "dwells finished": str(tally.dwells),
            "dwells flagged": str(tally.flagged),
            "dwells lost": str(tally.lost),
            "wrong results let through": str(len(tally.wrong)),
            "memory after warm-up": f"{rss[settled].min():.0f} to {rss[settled].max():.0f} MB",
            "its growth": f"{growth_mb:+.2f} MB in 100 h, spread {spread_mb:.1f} MB",
            "open descriptors": f"{descriptors[settled].min():.0f} to {descriptors[settled].max():.0f}",
            "threads": f"{threads[settled].min():.0f} to {threads[settled].max():.0f}",
        },
        "One run on virtual time with soaks of two hours, in one process together with the emulated bench. "
        f"Took {(time.monotonic() - begin_s) / 60.0:.0f} min.",
        [
            PartTable(
                ["h", "MB", "descriptors", "threads"],
                [[f"{h:.0f}", f"{mb:.1f}", f"{files:.0f}", f"{n:.0f}"] for h, mb, files, n in shown],
            ),
            counts("outcome of a fault", {name: tally.outcomes[name] for name in reversed(OUTCOMES)}),
        ],
        problems,
        machine(),
    )
