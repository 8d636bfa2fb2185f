"""Run folders for index and fleet: one emulated run, and copies of it for other units, dates, biases."""

import json
import shutil
from dataclasses import replace

from gyrobench.bench.bias.bins import BIAS_BINS_TABLE, bin_biases
from gyrobench.bench.bias.dwell_table import read_dwells, write_dwells
from gyrobench.bench.runs.folder import RunFolder
from tests.benchmarks.fleet_runs import make_runs


def emulated_run(folder):
    """Make one real run."""
    make_runs(folder, 1, 1)


def copy_run(source, path, unit="1001", started="2026-01-05T08:00:00+00:00", x_dph=0.0):
    """Copy a run as one of another unit at another time, with ``x_dph`` added to the bias of the x gyro."""
    shutil.copytree(source, path, ignore=shutil.ignore_patterns("closure"))
    folder = RunFolder(path)
    rows = [
        replace(row, unit=unit, bias_dph=(row.bias_dph[0] + x_dph, *row.bias_dph[1:]))
        for row in read_dwells(folder.dwells)
    ]
    write_dwells(folder.dwells, rows)
    BIAS_BINS_TABLE.write(folder.bias_bins, bin_biases(rows, 20.0))
    provenance = json.loads(folder.provenance.read_text())
    folder.provenance.write_text(json.dumps(provenance | {"started_utc": started}))
    return folder


def write_verdict(folder, verdict, effects=()):
    """Put what a search found into a run folder; effects as pairs of name and rms in deg/h."""
    folder.closure.mkdir(exist_ok=True)
    found = [{"effect": name, "rms_dph": rms, "p_value": 0.0, "axes": ["x"]} for name, rms in effects]
    content = {"verdict": verdict, "effects": found, "noise_dph": 0.001, "dwells_searched": 10}
    (folder.closure / "closure.json").write_text(json.dumps(content))
