"""Runs of six positions with something wrong, measured by the real decode path, and what was flagged.

A :class:`Row` of the table is a fault, or nothing, and how often it is tried. Its ``case`` makes what it
changes: the unit, the place, the schedule and the station file. Everything that it does not change is drawn
at random for each run (:func:`any_unit`, a latitude of five). To add a row::

    Row("noise 1.3 times what is declared",
        lambda case: replace(case, unit=replace(case.unit, angle_random_walk=0.00078)),
        cause="noise")
"""

from __future__ import annotations

import math
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.bias.vertical_pairs import Finding
from gyrobench.bench.dwells.measure_dwell import MeasuredDwell, measure_dwell
from gyrobench.bench.dwells.measurement_setup import MeasurementSetup, measurement_setup
from gyrobench.bench.dwells.run_dwells import add_dwell
from gyrobench.bench.dwells.run_results import evaluate
from gyrobench.bench.foundations.arrays import RAD_TO_ARCMIN
from gyrobench.bench.foundations.text import flag_text
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.station.station import Station
from tests.adversarial.frames import dwell_frames
from tests.adversarial.strapdown import Angles, Floats, Place, Schedule, Unit, simulate

STATION = Path(__file__).parents[2] / "stations" / "emulated.yaml"
LATITUDES_DEG = (36.4, -35.0, 52.0, 20.0, 60.0)
ALL = tuple(POSITIONS)
#: A result this many of its sigma off the truth and not flagged is silent.
SILENT_SIGMAS = 4.0


@dataclass(frozen=True)
class Case:
    """One run: what is measured, where, for how long, and what the station file says of it."""

    unit: Unit
    place: Place
    schedule: Schedule = field(default_factory=Schedule)
    #: What the station file says otherwise, by dotted key: ``{"ins.noise": "estimated"}``.
    station: Mapping[str, Any] = field(default_factory=dict)
    positions: Sequence[str] = ALL
    #: arrival_jitter_s, arrival_drift: Of the times at which the bench receives the frames: standard
    #: deviation, s, and rate of its clock less that of the INS.
    arrival_jitter_s: float = 0.0
    arrival_drift: float = 0.0


@dataclass(frozen=True)
class Row:
    """A row of the table."""

    name: str  #: What was done.
    change: Callable[[Case], Case]  #: Makes the case of one run from one with nothing wrong.
    cause: str = ""  #: Regular expression that the flags must match to have named the cause; empty for any.
    runs: int = 3  #: Of six dwells each.


@dataclass(frozen=True)
class MeasuredRun:
    """What became of the dwells of one run."""

    #: Shape (m, 3). Error over stated sigma of each dwell's biases; NaN where there is none.
    normalised: Floats
    flags: list[str]  #: Of each dwell; empty where nothing was found.
    is_level: Floats  #: Shape (m, 3). Which gyros are level.
    error_dph: Floats  #: Shape (m, 3).
    noted: str = ""  #: What terminal and report say of the whole run.

    @property
    def is_silent(self) -> Floats:
        """Shape (m,). Which dwells are off by more than :data:`SILENT_SIGMAS` without a flag."""
        off = (np.abs(self.normalised) > SILENT_SIGMAS).any(axis=1)
        return off & np.array([not flags for flags in self.flags])


@dataclass(frozen=True)
class RowResult:
    """A row of the table with its counts."""

    row: Row
    runs: list[MeasuredRun]

    def _of_all(self, name: str) -> Floats:
        return np.concatenate([getattr(run, name) for run in self.runs])

    @property
    def flags(self) -> list[str]:
        """Flags of each dwell."""
        return [flags for run in self.runs for flags in run.flags]

    @property
    def dwells(self) -> int:
        """Number of dwells."""
        return len(self.flags)

    @property
    def flagged(self) -> int:
        """Number of dwells with a flag."""
        return sum(map(bool, self.flags))

    @property
    def silent(self) -> int:
        """Number of dwells that are off without a flag."""
        return int(self._of_all("is_silent").sum())

    @property
    def named(self) -> int:
        """Number of dwells whose flags, or the finding of their run, name the cause."""
        texts = [f"{flags} {run.noted}".strip() for run in self.runs for flags in run.flags]
        return sum(bool(text and re.search(self.row.cause, text)) for text in texts)

    def rms(self, level: bool) -> float:
        """Error over stated sigma, rms over the dwells without a flag; NaN without any."""
        chosen = np.array([not flags for flags in self.flags])[:, np.newaxis] & (
            self._of_all("is_level").astype(bool) == level
        )
        values = self._of_all("normalised")[chosen]
        return float(np.sqrt(np.mean(values**2))) if len(values) else math.nan

    def coverage(self) -> float:
        """Share of 95 % intervals of dwells without a flag that hold the truth; NaN without any."""
        values = self._of_all("normalised")[[not flags for flags in self.flags]]
        return float(np.mean(np.abs(values) < 1.96)) if len(values) else math.nan

    @property
    def usual_flag(self) -> str:
        """The most frequent flag, without its numbers."""
        texts = Counter(re.sub(r"[-+]?\d+(\.\d+)?(e-?\d+)?", "#", flags) for flags in self.flags if flags)
        return texts.most_common(1)[0][0] if texts else ""


def any_unit(random: np.random.Generator) -> Unit:
    """A unit within the default uncertainties of a station file."""
    return Unit(
        gyro_bias_dph=tuple(random.uniform(-0.02, 0.02, 3)),
        accelerometer_bias_ug=tuple(random.uniform(-100.0, 100.0, 3)),
        gyro_scale_ppm=tuple(3.0 * random.standard_normal(3)),
        gyro_misalignment_arcsec=tuple(1.5 * random.standard_normal(6)),
        accelerometer_misalignment_arcsec=tuple(4.0 * random.standard_normal(6)),
    )


def measure_row(row: Row, seed: int = 0, runs: int | None = None) -> RowResult:
    """Simulate and measure the runs of a row."""
    measured = []
    for number in range(row.runs if runs is None else runs):
        random = np.random.default_rng([seed, number, *row.name.encode()])
        place = Place(latitude_deg=LATITUDES_DEG[number % len(LATITUDES_DEG)])
        measured.append(measure_run(row.change(Case(any_unit(random), place)), random))
    return RowResult(row, measured)


def measure_run(case: Case, random: np.random.Generator) -> MeasuredRun:
    """Simulate one dwell in each position, and measure them as a run does."""
    dwells, setup = measured_dwells(case, random), setup_of(case)
    results = evaluate(dwells, setup, bin_width_c=5.0)
    finding = results.up_rate.finding if results.up_rate else None
    noted = finding.value if finding is Finding.LATITUDE_OFF else ""
    if any(each.scale_factor_ratio > 1.0 for each in results.joint):
        noted += " scale factors of the gyros"
    dwells = results.dwells
    bias_dph = np.array([dwell.row.bias_dph for dwell in dwells])
    sigma_dph = np.array([dwell.row.sigma_dph for dwell in dwells])
    error_dph = bias_dph - true_bias_dph(case)
    vertical = [POSITIONS[dwell.row.position].up_axis for dwell in dwells]
    return MeasuredRun(
        error_dph / sigma_dph,
        [flag_text(dwell.flags) for dwell in dwells],
        np.arange(3) != np.array(vertical)[:, np.newaxis],
        error_dph,
        noted,
    )


def measured_dwells(case: Case, random: np.random.Generator) -> list[MeasuredDwell]:
    """One dwell in each position, before they are evaluated together."""
    setup = setup_of(case)
    dwells: list[MeasuredDwell] = []
    for number, position in enumerate(case.positions, 1):
        angles = dwell_angles(setup, position)
        output = simulate(case.unit, case.place, case.schedule, angles, random)
        marks, frames = dwell_frames(output, position, angles, number, random)
        if case.arrival_jitter_s or case.arrival_drift:
            late_s = case.arrival_jitter_s * np.abs(random.standard_normal(len(frames)))
            arrival_s = (1.0 + case.arrival_drift) * frames.timestamp_s + late_s
            frames = frames.with_fields(time_s=arrival_s)
        add_dwell(dwells, measure_dwell(marks, frames, setup))
    return dwells


def true_bias_dph(case: Case) -> Floats:
    """Bias of each gyro, mean over the two windows."""
    unit, schedule = case.unit, case.schedule
    starts_s = np.array([0.0, schedule.window_s + schedule.turn_s + schedule.settle_s])
    after_s = np.clip(starts_s + schedule.window_s - unit.bias_step_s, 0.0, schedule.window_s)
    share = float(np.mean(after_s)) / schedule.window_s
    return np.array(unit.gyro_bias_dph) + share * np.array(unit.bias_step_dph)


def dwell_angles(setup: MeasurementSetup, position: str) -> list[Angles]:
    """Table angles of the two windows of a dwell."""
    start = setup.table.angles(POSITIONS[position].C_nb(), [180.0])
    return [start, setup.table.turn(start, 180.0)]


def setup_of(case: Case) -> MeasurementSetup:
    """Measurement by the station file, for the latitude that was entered, with the changes of the case."""
    latitude_deg = case.place.latitude_deg + case.place.latitude_error_arcmin / 60.0
    changes = {
        "location.latitude_deg": latitude_deg,
        "location.height_m": case.place.height_m,
        "location.latitude_uncertainty_arcmin": float(PriorKnowledge().latitude * RAD_TO_ARCMIN),
    }
    return _setup(yaml.safe_dump(changes | dict(case.station)))


@cache
def _setup(changes: str) -> MeasurementSetup:
    document = yaml.safe_load(STATION.read_text())
    for key, value in yaml.safe_load(changes).items():
        *parents, last = key.split(".")
        place = document
        for parent in parents:
            place = place.setdefault(parent, {})
        place[last] = value
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "station.yaml"
        path.write_text(yaml.safe_dump(document))
        return measurement_setup(Station(path))
