"""The measured dwells of a run beside what is true in the emulated world."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.engine.job import Job
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.observers import RunObserver
from gyrobench.bench.foundations.arrays import DPH_TO_RADPS
from gyrobench.bench.procedure.plan import PlannedStep
from gyrobench.drivers.emulators.bench import BenchAddress, EmulatedBench, bench_at
from gyrobench.drivers.emulators.world.sensor_errors import gyro_errors
from gyrobench.drivers.emulators.world.world_file import load_world

WORLD = Path(__file__).with_name("world.yaml")
#: A result that is off by more than this many of its sigma, and not flagged, is wrong.
WRONG_SIGMAS = 5.0
#: A temperature that is off by more than this, and not flagged, puts a dwell into the wrong bin.
WRONG_C = 1.0


def true_bias_dph(gyro_c: Iterable[float], world: Path = WORLD) -> np.ndarray:
    """Biases of a world's gyros at these temperatures, shape (3,)."""
    file = load_world(world)
    biases, _ = gyro_errors(file.gyro).at(np.array(list(gyro_c)) - file.reference_temperature_c)
    return biases / DPH_TO_RADPS


def errors_in_sigmas(row: DwellRow, true_dph: np.ndarray) -> np.ndarray:
    """How far the biases of a dwell are off, shape (3,); NaN where it is without result."""
    return (np.array(row.bias_dph) - true_dph) / np.array(row.sigma_dph)


@dataclass
class Agreement:
    """How well dwells without flags agree with the truth.

    Attributes
    ----------
    chi2, count : float, int
        Sum of squared errors in sigmas, and how many.
    wrong : list of str
        Those that are wrong, in words.
    """

    chi2: float = 0.0
    count: int = 0
    flagged: int = 0
    wrong: list[str] = field(default_factory=list)

    def add(self, row: DwellRow, true_dph: np.ndarray, where: str) -> None:
        """Compare one dwell."""
        if row.flags:
            self.flagged += 1
            return
        off = errors_in_sigmas(row, true_dph)
        self.chi2 += float(np.sum(off**2))
        self.count += len(off)
        if not np.all(np.abs(off) <= WRONG_SIGMAS):
            self.wrong.append(f"{where}, dwell {row.dwell}: off by {np.round(off, 1).tolist()} sigma")

    def merge(self, other: Agreement) -> None:
        """Add another comparison."""
        self.chi2 += other.chi2
        self.count += other.count
        self.flagged += other.flagged
        self.wrong += other.wrong


class TruthWatcher(RunObserver):
    """Keeps what is true in the emulated world while the INS navigates, dwell by dwell.

    Attributes
    ----------
    true_dph, true_c : dict of int to ndarray, shape (3,)
        Mean biases, and temperatures of the gyros, of the last time that each dwell was measured.
    bench : EmulatedBench or None
        The emulated bench that was seen last.
    """

    def __init__(self, job: Job) -> None:
        self.true_dph: dict[int, np.ndarray] = {}
        self.true_c: dict[int, np.ndarray] = {}
        self.bench: EmulatedBench | None = None
        self.step = ""
        self._emulation = job.emulation
        self._seen: list[tuple[np.ndarray, np.ndarray]] = []

    def step_started(self, planned: PlannedStep, bench: LiveBench) -> None:
        """A dwell begins with its alignment."""
        self.step = planned.step.name
        if self.step == "align":
            self._seen.clear()

    def ticked(self, bench: LiveBench, left_s: float) -> None:
        """Look at the world."""
        emulation = self._emulation
        address = BenchAddress(bench.clock.name, emulation.world, emulation.seed, emulation.faults)
        self.bench = bench_at(address)
        if self.step == "navigate":
            world = self.bench.world
            self._seen.append((world.true_gyro_bias() / DPH_TO_RADPS, world.thermal.optics_c.copy()))

    def dwell_measured(self, row: DwellRow) -> None:
        """Keep the truth of this dwell."""
        if self._seen:
            biases, temperatures = zip(*self._seen, strict=True)
            self.true_dph[row.dwell] = np.mean(biases, axis=0)
            self.true_c[row.dwell] = np.mean(temperatures, axis=0)


def compare(rows: Iterable[DwellRow], true_dph: Mapping[int, np.ndarray], where: str) -> Agreement:
    """Compare dwells with the truth of their numbers."""
    agreement = Agreement()
    for row in rows:
        agreement.add(row, true_dph[row.dwell], where)
    return agreement
