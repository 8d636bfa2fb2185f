"""What runs say of a gyro in a temperature bin: its level, and each position's difference from that.

Runs are compared by the positions that they have in common: a mean over other positions would be
another number, although nothing changed.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np

from gyrobench.bench.foundations.text import bin_label
from gyrobench.bench.navigation.positions import POSITIONS, gyro_label, position_label
from gyrobench.bench.runs.index import RunIndex

#: The quantity that is no position's: the mean over the positions.
LEVEL = "level"


@dataclass(frozen=True)
class RunBias:
    """One quantity in one run.

    Attributes
    ----------
    path, unit : str
        The run, and its INS.
    started_utc : datetime
        Its start.
    bias_dph, sigma_dph : float
        Value and standard uncertainty.
    """

    path: str
    unit: str
    started_utc: datetime
    bias_dph: float
    sigma_dph: float


@dataclass(frozen=True, order=True)
class Quantity:
    """What is compared between runs.

    Attributes
    ----------
    gyro : str
        "x", "y" or "z".
    bin_low_c, bin_high_c : float
        Range of the gyro's temperature.
    name : str
        :data:`LEVEL`, or the position whose bias less the level it is.
    positions : tuple of str
        Those that the level is the mean of.
    """

    gyro: str
    bin_low_c: float
    bin_high_c: float
    name: str
    positions: tuple[str, ...]

    @property
    def label(self) -> str:
        """Say what it is: "X gyro at 20 to 40 °C", "X gyro at 20 to 40 °C, Z-Up less the mean"."""
        place = f"{gyro_label(self.gyro)} at {bin_label(self.bin_low_c, self.bin_high_c)} °C"
        return place if self.name == LEVEL else f"{place}, {position_label(self.name)} less the mean"


def read_run_biases(index: RunIndex, paths: Sequence[str]) -> dict[Quantity, list[RunBias]]:
    """Read levels and differences of some runs, each quantity in the order of time.

    Runs in which the INS subtracted biases are left out: theirs are what that left.
    """
    sql = (
        "SELECT path, unit, started_utc, gyro, bin_low_c, bin_high_c, position, bias_dph, sigma_dph "
        "FROM bins JOIN runs USING (path) WHERE bins.count > 0 AND NOT compensated "
        "AND path IN (SELECT unnest(?)) ORDER BY started_utc, path"
    )
    return run_biases(index.query(sql, [list(paths)]).records())


def run_biases(rows: Iterable[Mapping[str, Any]]) -> dict[Quantity, list[RunBias]]:
    """Form levels and differences from biases by run, gyro, bin and position.

    Of each gyro and bin the positions that most runs have together are taken; runs that lack one of
    them are left out there.
    """
    cells: dict[tuple[str, float, float], dict[str, dict[str, Mapping[str, Any]]]] = defaultdict(dict)
    for row in rows:
        of_bin = cells[row["gyro"], row["bin_low_c"], row["bin_high_c"]]
        of_bin.setdefault(row["path"], {})[row["position"]] = row
    result: dict[Quantity, list[RunBias]] = {}
    for (gyro, low_c, high_c), runs in sorted(cells.items()):
        positions = _common_positions(runs.values())
        whole = [run for run in runs.values() if set(positions) <= run.keys()]
        # Of two positions the one says what the other says, with the other sign.
        names = [LEVEL, *(positions if len(positions) > 2 else positions[1:])]
        for name in names:
            weights = np.full(len(positions), 1.0 / len(positions))
            if name != LEVEL:
                weights = np.eye(len(positions))[positions.index(name)] - weights
            quantity = Quantity(gyro, low_c, high_c, name, positions)
            result[quantity] = [_combined([run[each] for each in positions], weights) for run in whole]
    return result


def _common_positions(runs: Iterable[Mapping[str, object]]) -> tuple[str, ...]:
    """Positions of the set that serves best: number of its positions times that of runs that have them."""
    sets = Counter(frozenset(run) for run in runs)

    def serves(candidate: frozenset[str]) -> tuple[int, list[str]]:
        having = sum(count for each, count in sets.items() if candidate <= each)
        return having * len(candidate), sorted(candidate)

    common = max(sets, key=serves)
    return tuple(position for position in POSITIONS if position in common)


def _combined(rows: Sequence[Mapping[str, Any]], weights: np.ndarray[Any, np.dtype[np.float64]]) -> RunBias:
    bias_dph = np.array([row["bias_dph"] for row in rows])
    sigma_dph = np.array([row["sigma_dph"] for row in rows])
    first = rows[0]
    return RunBias(
        first["path"],
        first["unit"],
        first["started_utc"],
        float(weights @ bias_dph),
        float(np.sqrt(weights**2 @ sigma_dph**2)),
    )
