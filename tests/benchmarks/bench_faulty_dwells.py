"""Faults put into every few dwells of a whole run: how many give right numbers, flags, or wrong numbers.

    python -m tests.benchmarks.bench_faulty_dwells [procedure station world] [--every N]

A number is wrong if it has no flag and lies more than five of its stated sigmas from the bias of the
emulated world, or a gyro's temperature more than 1 K from that without the fault.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import defaultdict
from pathlib import Path

import numpy as np

from gyrobench.bench.dwells.measure_dwell import measure_dwell
from gyrobench.bench.dwells.measurement_setup import measurement_setup
from gyrobench.bench.runs.can_log import read_can_log
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.runs.marks import DwellMarks
from gyrobench.bench.station.station import Station
from tests.bench.conftest import watched_run
from tests.bench.dwells.fault_kinds import FAULTS
from tests.bench.dwells.frame_faults import Recording

RIGHT, FLAGGED, WRONG = range(3)


def recorded_dwells(folder):
    """Recordings of a run's dwells, in the order of its log."""
    finished = [
        DwellMarks.from_json(entry["marks"])
        for entry in read_journal(folder.journal)
        if entry["event"] == "dwell_finished"
    ]
    by_part = {marks.log_part: marks for marks in finished}
    for number, frames in read_can_log(folder.can):
        if number in by_part:
            yield Recording(by_part[number], frames.data_frames())


def outcome(row, clean, truth_dph):
    """What became of a dwell, and its largest error in sigmas."""
    if row.flags:
        return FLAGGED, 0.0
    off = float((np.abs(np.subtract(row.bias_dph, truth_dph)) / row.sigma_dph).max())
    off_k = np.abs(np.subtract(row.gyro_c, clean.gyro_c)).max()
    return (RIGHT if off < 5.0 and off_k < 1.0 else WRONG), off


def main():
    """Run, inject, and print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("run", nargs="*", default=["quick_campaign", "quick", "quick"])
    parser.add_argument("--every", type=int, default=6)
    asked = parser.parse_args()
    procedure, station, world = asked.run
    counts, largest = defaultdict(lambda: [0, 0, 0]), defaultdict(float)
    with tempfile.TemporaryDirectory() as out:
        folder, _, watcher, _ = watched_run(procedure, Path(out) / "run", world, station=station)
        setup = measurement_setup(Station(folder.station))
        for number, recording in enumerate(recorded_dwells(folder)):
            if number % asked.every:
                continue
            clean = measure_dwell(recording.marks, recording.frames, setup).row
            for index, (kind, size, make) in enumerate(FAULTS):
                faulty = make(recording, np.random.default_rng([number, index]))
                row = measure_dwell(faulty.marks, faulty.frames, setup).row
                what, off = outcome(row, clean, watcher.true_bias_dph[number])
                counts[kind, size][what] += 1
                largest[kind, size] = max(largest[kind, size], off)
    print(f"{'fault':32}{'size':28}{'right':>7}{'flagged':>9}{'WRONG':>7}{'largest error':>16}")
    for (kind, size), each in counts.items():
        right, flagged, wrong = each
        print(f"{kind:32}{size:28}{right:7}{flagged:9}{wrong:7}{largest[kind, size]:10.1f} sigma")
    right, flagged, wrong = np.sum(list(counts.values()), axis=0)
    print(f"{'all':60}{right:7}{flagged:9}{wrong:7}")


if __name__ == "__main__":
    main()
