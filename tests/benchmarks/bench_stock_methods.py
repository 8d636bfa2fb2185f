"""Stock methods of model selection: on simulated benches with an undeclared effect, and on measured data."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.bias.tables.dwell_table import read_dwells
from bench.sensor_log.log_import import import_logs
from tests.benchmarks.stock_methods import METHODS, held_out_errors, write_closure

SHARED = Path(__file__).parents[3] / "shared"
CASES = SHARED / "cases"
IMU = SHARED / "data" / "imu_thermal" / "imu_raw_data.csv"


@pytest.mark.skipif(not CASES.exists(), reason="the simulated cases are not beside the checkout")
def test_stock_methods_on_simulated_benches(tmp_path):
    cases = sorted(path for path in (CASES / "dev").iterdir() if path.is_dir())
    for name, method in METHODS.items():
        for case in cases:
            rows = read_dwells(case / "dwells.csv")
            write_closure(tmp_path / name / case.name, rows, method(rows))
        command = [sys.executable, CASES / "score.py", tmp_path / name]
        scored = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        print(f"\n{name}\n" + "\n".join(scored.splitlines()[-3:]))
        assert f"of {len(cases)};" in scored


def rms(errors):
    return np.sqrt((np.concatenate(errors) ** 2).mean(axis=0))


def folds(rows, block_s):
    """Rows with the cycle that is held out: blocks in turn, both ways."""
    since_s = np.array([row.start_s - rows[0].start_s for row in rows])
    dealt = [replace(row, cycle=1 + int(s // block_s % 2)) for row, s in zip(rows, since_s, strict=True)]
    return [(dealt, 1), (dealt, 2)]


@pytest.mark.skipif(not IMU.exists(), reason="the measured log of an IMU is not beside the checkout")
def test_stock_methods_on_a_measured_imu():
    rows = import_logs([IMU], "tofupilot_imu").rows
    peak = max(range(len(rows)), key=lambda index: rows[index].gyro_c[0])
    last = [replace(row, cycle=1 if index <= peak else 2) for index, row in enumerate(rows)]
    tests = {
        "5-min blocks": folds(rows, 300.0),
        "10-min blocks": folds(rows, 600.0),
        "last cooling": [(last, 2)],
    }
    for name, method in METHODS.items():
        print(f"\n{name}: held-out rms in deg/h, x, y, z")
        for test, parts in tests.items():
            results = [(part, cycle, method(part, cycle)) for part, cycle in parts]
            before, after = (
                rms([held_out_errors(part, getattr(each, kind), cycle) for part, cycle, each in results])
                for kind in ("before_dph", "after_dph")
            )
            print(f"  {test:14s} before {before.round(0)}  after {after.round(0)}")
            for _, cycle, each in results:
                names = dict.fromkeys(candidate.name for candidate in each.chosen)
                print(f"    without part {cycle}: {', '.join(names)}")
            assert np.isfinite(after).all()
