"""A folder of emulated runs: batches of units whose biases differ, measured again and again over months.

    python -m tests.benchmarks.fleet_runs --runs 1000 --out DIR

Two units are not like the others of their batch, so that what is said of the fleet can be checked: one has
another bias, one drifts. Runs that are there already are kept, so that making them can be interrupted.
"""

import argparse
import json
import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import yaml

from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.observers import RunObserver
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.station.instruments import Emulation

PROCEDURE = Path(__file__).parent / "fleet_sample.yaml"
WORLD = Path(__file__).parents[2] / "worlds" / "quick.yaml"

BATCHES = ("A", "B", "C", "D", "E")
FIRST_DAY = datetime(2026, 1, 5, 8, tzinfo=UTC)
DAYS_BETWEEN_RUNS = 14.0
SPREAD_DPH = 0.003
#: The unit with another bias of its y gyro, and the one whose x gyro drifts.
OUTLIER, OUTLYING_DPH = 7, 0.02
DRIFTING, DRIFT_DPH_PER_DAY = 12, 5e-5


def make_runs(out, runs, units, outlying_dph=OUTLYING_DPH):
    """Make the runs and the table of the units; returns how long each new run took, s."""
    out.mkdir(parents=True, exist_ok=True)
    lines = [f"{2000 + unit},{BATCHES[unit % len(BATCHES)]},emulated," for unit in range(units)]
    (out / "units.csv").write_text("\n".join(["unit,batch,hardware,note", *lines]) + "\n")
    clock = WallClock()
    took_s = []
    for number in range(runs):
        folder = out / f"run-{number:05d}"
        if (folder / "bias_bins.csv").exists():
            continue
        began_s = clock.now()
        shutil.rmtree(folder, ignore_errors=True)
        _make_run(folder, number % units, number // units, number, outlying_dph)
        took_s.append(clock.now() - began_s)
    return took_s


def _make_run(folder, unit, repetition, seed, outlying_dph):
    days = DAYS_BETWEEN_RUNS * repetition
    world = folder.parent / "worlds" / f"{folder.name}.yaml"
    world.parent.mkdir(exist_ok=True)
    world.write_text(yaml.safe_dump(_world(unit, days, outlying_dph), sort_keys=False))
    job = prepare_job(str(PROCEDURE), "quick", Emulation(str(world), seed))
    _, outcome = run_job(job, folder, RunObserver(), ConsentingOperator())
    if outcome.ended != "finished":
        raise RuntimeError(f"{folder}: {outcome.reason}")
    _date(folder / "provenance.json", FIRST_DAY + timedelta(days=days))


def _world(unit, days, outlying_dph):
    """World of one unit ``days`` after the first run."""
    world = yaml.safe_load(WORLD.read_text())
    world["ins"]["serial_number"] = 2000 + unit
    own_dph = np.random.default_rng(unit).normal(0.0, SPREAD_DPH, 3)
    if unit == OUTLIER:
        own_dph[1] += outlying_dph
    if unit == DRIFTING:
        own_dph[0] += DRIFT_DPH_PER_DAY * days
    for gyro, own in zip("xyz", own_dph, strict=True):
        world["gyro"]["bias_dph"][gyro][0] += float(own)
    return world


def _date(provenance, started):
    """Date a run: on virtual time all begin on the same day."""
    content = json.loads(provenance.read_text())
    content["started_utc"] = started.isoformat()
    provenance.write_text(json.dumps(content, indent=2) + "\n")


def main():
    """Make runs as the command line says."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--units", type=int, default=50)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    took_s = make_runs(options.out, options.runs, options.units)
    if took_s:
        print(f"{len(took_s)} runs made, {np.median(took_s):.2f} s each (median)")


if __name__ == "__main__":
    main()
