"""Whole campaigns over bytes and frames, in seconds: quick worlds with any undeclared effects."""

import io

import numpy as np
import yaml
from rich.console import Console

from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.foundations.arrays import DPH_TO_RADPS
from gyrobench.bench.foundations.documents import read_document
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.monitor.terminal_view import LinesView
from gyrobench.bench.station.instruments import Emulation
from gyrobench.drivers.emulators.bench import BenchAddress, bench_at

PROCEDURE, STATION, WORLD = "quick_campaign", "quick", "quick"

_KEYS = {
    "temperature_rate": {"sensitivity_dph_per_c_per_h": [8e-5, -6e-5, 5e-5]},
    "thermal_gradient": {"sensitivity_dph_per_c": [4e-3, -3e-3, 3.5e-3]},
    "attitude_thermal": {"sensitivity_dph_per_w": [0.035, -0.030, 0.028]},
    "thermal_hysteresis": {"half_width_c": 6.0, "sensitivity_dph_per_c": [1.6e-3, -1.2e-3, 1e-3]},
    "warm_up": {"bias_dph": [0.02, -0.015, 0.012], "time_constant_s": 3600.0},
    "time_drift": {"drift_dph_per_day": [0.06, -0.05, 0.04]},
    "g_sensitivity": {"sensitivity_dph_per_g": [0.008, -0.006, 0.005]},
    "chamber_state": {"bias_dph": [0.012, -0.010, 0.008]},
    "bias_jump": {"bias_dph": [0.010, -0.008, 0.006], "at_h": 1.9},
    "supply_ripple": {"amplitude_dph": [0.010, -0.008, 0.006], "period_h": 0.55},
    "mode_hop": {"bias_dph": [0.012, -0.010, 0.008], "first_reset_c": -12.0, "reset_every_c": 8.0},
    "loose_clamp": {"sensitivity_dph_per_c": [2.4e-3, -2e-3, 1.8e-3], "free_above_c": 36.0},
    "dither_crossing": {
        "gyros": ["x", "y"], "crossing_c": 28.0, "half_width_c": 3.0, "bias_dph": [0.016, -0.012],
    },
}  # fmt: skip
#: One effect of each kind, some hundredths or thousandths of a degree per hour in the campaign.
EFFECTS = {kind: {"kind": kind, **keys} for kind, keys in _KEYS.items()}


class TruthRecorder(LinesView):
    """Watches a run and keeps what is true in the emulated world while the INS navigates.

    Attributes
    ----------
    bias_dph, undeclared_dph : list of ndarray, shape (3,)
        Means over each dwell of all gyro biases, and of the undeclared effects' part of them.
    """

    def __init__(self, job):
        super().__init__(Console(file=io.StringIO(), width=80), job.plan)
        self.bias_dph, self.undeclared_dph = [], []
        self._emulation, self._world = job.emulation, None
        self._navigates = False
        self._now = []

    def step_started(self, planned, bench):
        super().step_started(planned, bench)
        if self._world is None:
            address = BenchAddress(bench.clock.name, self._emulation.world, self._emulation.seed)
            self._world = bench_at(address).world
        self._navigates = planned.step.name == "navigate"

    def ticked(self, bench, left_s):
        super().ticked(bench, left_s)
        if self._navigates:
            self._now.append(
                (self._world.true_gyro_bias() / DPH_TO_RADPS, self._world.undeclared_bias() / DPH_TO_RADPS)
            )

    def dwell_measured(self, row):
        super().dwell_measured(row)
        bias_dph, undeclared_dph = np.mean(self._now, axis=0)
        self.bias_dph.append(bias_dph)
        self.undeclared_dph.append(undeclared_dph)
        self._now = []


def write_world(folder, effects=(), **sections):
    """Write the quick world with undeclared effects and changed sections: ``gyro={"pulse_arcsec": 0.1}``."""
    data = read_document(find_document("worlds", WORLD)).data
    for section, changed in sections.items():
        data[section] = data[section] | changed
    path = folder / "world.yaml"
    path.write_text(yaml.safe_dump(data | {"undeclared_effects": list(effects)}))
    return path


def write_procedure(folder, power_on_each_cycle=False, cycles=3):
    """Write the quick campaign, with all cycles in one power-on or with one power-on for each."""
    data = read_document(find_document("procedures", PROCEDURE)).data
    data["steps"] = [
        step for step in data["steps"] if "repeat" not in step or step["repeat"]["over"]["cycle"][0] <= cycles
    ]
    if power_on_each_cycle:
        data["steps"] = [*_powered_on_again(data["steps"])]
    path = folder / "campaign.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


def _powered_on_again(steps):
    [power_on], cycle = [step for step in steps if "power_on" in step], 1
    for step in steps:
        if "repeat" in step and step["repeat"]["over"]["cycle"] != [cycle]:
            [cycle] = step["repeat"]["over"]["cycle"]
            yield from ("power_off", {"wait": {"duration_s": 600}}, power_on)
        yield step


def watched_campaign(folder, effects=(), *, power_on_each_cycle=False, cycles=3, seed=0, **sections):
    """Run the quick campaign as the command line does; ``folder`` is an empty folder for its files."""
    world = write_world(folder, effects, **sections)
    procedure = write_procedure(folder, power_on_each_cycle, cycles)
    job = prepare_job(str(procedure), STATION, Emulation(str(world), seed))
    with TruthRecorder(job) as truth:
        run, outcome = run_job(job, folder / "run", truth, ConsentingOperator())
    assert outcome.ended == "finished", outcome.reason
    return run, truth


def run_campaign(folder, effects=(), **options):
    """The same without the truth: what an analysis may see."""
    return watched_campaign(folder, effects, **options)[0]
