"""Stock methods of model selection over a hand-made library of columns, to compare the product with.

Each takes a dwell table, declares a cubic in each gyro's temperature with a constant per run and axis,
and chooses columns of the library on top of it. Nothing of the held-out cycle enters a fit.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import f as f_distribution
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LassoLarsIC

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.navigation.positions import POSITIONS

HINGE_C = 50.0
LAGS_S = (300.0, 600.0, 1800.0, 3600.0, 7200.0)
WARM_UPS_S = (900.0, 1800.0, 3600.0, 7200.0, 14400.0, 28800.0)
STEPS = 20
SIGNIFICANCE = 0.01
MAX_CHOSEN = 6

#: Columns of one candidate for one gyro, shape (n, k).
Columns = np.ndarray


@dataclass(frozen=True)
class Candidate:
    """Columns that enter together: one set for each gyro."""

    effect: str
    name: str
    columns: tuple[Columns, Columns, Columns]


@dataclass(frozen=True)
class StockResult:
    """What a method chose, and its predictions of all rows, deg/h, shape (n, 3)."""

    chosen: list[Candidate]
    before_dph: np.ndarray
    after_dph: np.ndarray

    @property
    def effects(self) -> list[str]:
        return list(dict.fromkeys(candidate.effect for candidate in self.chosen))


class Problem:
    """Weighted regression of each gyro on the declared columns and some of the library."""

    def __init__(self, rows: Sequence[DwellRow], hold_out_cycle: int | None) -> None:
        cycles = np.array([row.cycle for row in rows])
        self.searched = cycles != (cycles.max() if hold_out_cycle is None else hold_out_cycle)
        self.bias = np.array([row.bias_dph for row in rows])
        self.sigma = np.array([row.sigma_dph for row in rows])
        self.declared = [_declared(rows, axis, self.searched) for axis in range(3)]
        self.library = [each for each in library(rows) if self._adds_something(each)]

    def residuals(self, chosen: Sequence[Candidate]) -> list[np.ndarray]:
        """Of the searched rows, by gyro, over their sigma."""
        return [self._fit(axis, chosen)[1] for axis in range(3)]

    def chi_squared(self, chosen: Sequence[Candidate]) -> float:
        return float(sum(each @ each for each in self.residuals(chosen)))

    def parameters(self, chosen: Sequence[Candidate]) -> int:
        return sum(self._rank(self._design(axis, chosen)[self.searched]) for axis in range(3))

    def predictions(self, chosen: Sequence[Candidate]) -> np.ndarray:
        return np.column_stack([self._design(axis, chosen) @ self._fit(axis, chosen)[0] for axis in range(3)])

    def result(self, chosen: list[Candidate]) -> StockResult:
        return StockResult(chosen, self.predictions([]), self.predictions(chosen))

    @property
    def measured(self) -> int:
        return 3 * int(self.searched.sum())

    def _design(self, axis: int, chosen: Sequence[Candidate]) -> np.ndarray:
        return np.hstack([self.declared[axis], *(each.columns[axis] for each in chosen)])

    def _fit(self, axis: int, chosen: Sequence[Candidate]) -> tuple[np.ndarray, np.ndarray]:
        weight = 1.0 / self.sigma[self.searched, axis]
        design = self._design(axis, chosen)[self.searched] * weight[:, None]
        measured = self.bias[self.searched, axis] * weight
        coefficients = np.linalg.lstsq(design, measured, rcond=1e-9)[0]
        return coefficients, measured - design @ coefficients

    def _adds_something(self, candidate: Candidate) -> bool:
        if not all(np.isfinite(columns).all() for columns in candidate.columns):
            return False
        return any(
            self._rank(self._design(axis, [candidate])[self.searched])
            > self._rank(self.declared[axis][self.searched])
            for axis in range(3)
        )

    @staticmethod
    def _rank(design: np.ndarray) -> int:
        return int(
            np.linalg.matrix_rank(design / np.maximum(np.linalg.norm(design, axis=0), 1e-300), tol=1e-6)
        )


def forward_bic(rows: Sequence[DwellRow], hold_out_cycle: int | None = None) -> StockResult:
    """Add the candidate that lowers the Bayesian information criterion most, while one does."""
    problem = Problem(rows, hold_out_cycle)

    def criterion(chosen: Sequence[Candidate]) -> float:
        n = problem.measured
        return n * np.log(problem.chi_squared(chosen) / n) + problem.parameters(chosen) * np.log(n)

    chosen: list[Candidate] = []
    while len(chosen) < MAX_CHOSEN:
        left = [each for each in problem.library if each not in chosen]
        best = min(left, key=lambda each: criterion([*chosen, each]), default=None)
        if best is None or criterion([*chosen, best]) >= criterion(chosen):
            break
        chosen.append(best)
    return problem.result(chosen)


def stepwise_f(rows: Sequence[DwellRow], hold_out_cycle: int | None = None) -> StockResult:
    """Add the candidate with the smallest p-value of an F test, while significant after Bonferroni."""
    problem = Problem(rows, hold_out_cycle)
    chosen: list[Candidate] = []

    def p_value(candidate: Candidate) -> float:
        before, after = problem.chi_squared(chosen), problem.chi_squared([*chosen, candidate])
        k = problem.parameters([*chosen, candidate]) - problem.parameters(chosen)
        free = problem.measured - problem.parameters([*chosen, candidate])
        return float(f_distribution.sf((before - after) / k / (after / free), k, free)) if k else 1.0

    def strength(candidate: Candidate) -> tuple[float, float]:
        """p-values below the smallest number are ordered by chi2."""
        return p_value(candidate), problem.chi_squared([*chosen, candidate])

    while len(chosen) < MAX_CHOSEN:
        left = [each for each in problem.library if each not in chosen]
        best = min(left, key=strength, default=None)
        if best is None or p_value(best) * len(left) >= SIGNIFICANCE:
            break
        chosen.append(best)
    return problem.result(chosen)


def lasso_lars_ic(rows: Sequence[DwellRow], hold_out_cycle: int | None = None) -> StockResult:
    """Single columns by the lasso path, its point by BIC, gyro by gyro; refitted by least squares.

    What one gyro's columns were chosen from enters for that gyro alone.
    """
    problem = Problem(rows, hold_out_cycle)
    chosen: list[Candidate] = []
    nothing = np.zeros((len(rows), 0))
    for axis in range(3):
        weight = 1.0 / problem.sigma[problem.searched, axis][:, None]
        basis = np.linalg.qr(problem.declared[axis][problem.searched] * weight)[0]
        single = [(each, column[:, None]) for each in problem.library for column in each.columns[axis].T]
        design = np.hstack([column[problem.searched] * weight for _, column in single])
        design = design - basis @ (basis.T @ design)
        norms = np.linalg.norm(design, axis=0)
        useful = norms > 1e-9 * norms.max()
        measured = problem.residuals([])[axis]
        path = LassoLarsIC(criterion="bic", fit_intercept=False, noise_variance=1.0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # columns that others explain are dropped
            path.fit(design[:, useful] / norms[useful], measured)
        for index in np.flatnonzero(useful)[np.flatnonzero(path.coef_)]:
            candidate, column = single[index]
            columns = [nothing, nothing, nothing]
            columns[axis] = column
            chosen.append(Candidate(candidate.effect, candidate.name, tuple(columns)))
    return problem.result(chosen)


METHODS: dict[str, Callable[..., StockResult]] = {
    "forward BIC": forward_bic,
    "LassoLarsIC": lasso_lars_ic,
    "stepwise F": stepwise_f,
}


def library(rows: Sequence[DwellRow]) -> list[Candidate]:
    """What an engineer would write down: columns by effect."""
    T = np.array([row.gyro_c for row in rows])
    rate = np.array([row.gyro_rate_c_per_h for row in rows])
    heat = np.array([row.board_c for row in rows]) - T
    middle_s = np.array([0.5 * (row.start_s + row.end_s) for row in rows])
    since_s = np.array([row.since_power_on_s for row in rows]) + 0.5 * np.array(
        [row.end_s - row.start_s for row in rows]
    )
    runs = np.array([row.run for row in rows])
    up = np.array([POSITIONS[row.position].C_nb()[2] for row in rows])
    demand = np.array([row.chamber_set_c - row.chamber_c for row in rows])
    scale = (T - T.mean()) / max(T.std(), 1e-9)
    hinge = np.maximum(0.0, HINGE_C - T)

    def of_each(effect: str, name: str, values: np.ndarray) -> Candidate:
        x, y, z = (np.atleast_2d(values[:, axis].T).T for axis in range(3))
        return Candidate(effect, name, (x, y, z))

    def of_all(effect: str, name: str, values: np.ndarray) -> Candidate:
        columns = values.reshape(len(rows), -1)
        return Candidate(effect, name, (columns, columns, columns))

    candidates = [
        of_each("temperature_rate", "dT/dt", rate),
        of_each("temperature_rate", "dT/dt T", rate * scale),
        of_each("thermal_gradient", "board - optics", heat),
        of_all("g_sensitivity", "g", up),
        of_each("attitude_thermal", "g (board - optics)", up[:, None, :] * heat[:, :, None]),
        of_each("attitude_thermal", "g hinge", up[:, None, :] * hinge[:, :, None]),
        of_each("thermal_hysteresis", "leg", _legs(rate, runs)),
        of_all("time_drift", "time", middle_s - middle_s.mean()),
        of_all("chamber_state", "set - air", demand),
        *(
            of_each("thermal_hysteresis", f"lag {lag:g} s", lagged(T, middle_s, runs, lag) - T)
            for lag in LAGS_S
        ),
        *(of_all("warm_up", f"exp(-t/{tau:g} s)", np.exp(-since_s / tau)) for tau in WARM_UPS_S),
        *(
            of_all("bias_jump", f"step at {at:.0f} s", (middle_s > at).astype(float))
            for at in np.quantile(middle_s, np.arange(1, STEPS) / STEPS)
        ),
    ]
    return [each for each in candidates if all(np.ptp(columns) > 0.0 for columns in each.columns)]


def lagged(T: np.ndarray, time_s: np.ndarray, runs: np.ndarray, lag_s: float) -> np.ndarray:
    """Temperature through a first-order lag, by run, from equilibrium at its first dwell; shape as T."""
    out = T.copy()
    for index in range(1, len(T)):
        if runs[index] == runs[index - 1]:
            step_s = time_s[index] - time_s[index - 1]
            keep = np.exp(-step_s / lag_s)
            # Exact for a temperature that is linear between the two.
            slope = (T[index] - T[index - 1]) / step_s
            out[index] = T[index] - slope * lag_s * (1.0 - keep) + keep * (out[index - 1] - T[index - 1])
    return out


def _legs(rate: np.ndarray, runs: np.ndarray) -> np.ndarray:
    """+1 while the temperature rises or rose last, -1 while it falls or fell."""
    legs = np.sign(rate)
    moving = np.abs(rate) > 0.1 * np.abs(rate).max()
    for index in range(1, len(rate)):
        if runs[index] == runs[index - 1]:
            legs[index] = np.where(moving[index], legs[index], legs[index - 1])
    return legs


def _declared(rows: Sequence[DwellRow], axis: int, searched: np.ndarray) -> np.ndarray:
    """Cubic, and a constant per run; a run that was not searched gets the mean of the others' constants."""
    T = np.array([row.gyro_c[axis] for row in rows])
    scaled = (T - T[searched].mean()) / max(T[searched].std(), 1e-9)
    runs = np.array([row.run for row in rows])
    known = list(dict.fromkeys(runs[searched]))
    constants = np.array([[float(run == each) for each in known] for run in runs])
    constants[constants.sum(axis=1) == 0.0] = 1.0 / len(known)
    return np.column_stack([scaled, scaled**2, scaled**3, constants])


def held_out_errors(
    rows: Sequence[DwellRow], predictions: np.ndarray, cycle: int | None = None
) -> np.ndarray:
    """Measured minus predicted on the held-out cycle, deg/h, shape (m, 3); unseen runs centred."""
    cycles = np.array([row.cycle for row in rows])
    held = cycles == (cycles.max() if cycle is None else cycle)
    runs = np.array([row.run for row in rows])
    errors = np.array([row.bias_dph for row in rows]) - predictions
    for run in set(runs[held]) - set(runs[~held]):
        errors[held & (runs == run)] -= errors[held & (runs == run)].mean(axis=0)
    return errors[held]


def write_closure(folder: Path, rows: Sequence[DwellRow], result: StockResult) -> None:
    """Write closure.json and predictions.csv as far as a scorer of closures needs them."""
    folder.mkdir(parents=True, exist_ok=True)
    verdict = "explained" if result.chosen else "clean"
    effects = [{"effect": name, "axes": ["x", "y", "z"], "tied_with": []} for name in result.effects]
    (folder / "closure.json").write_text(json.dumps({"verdict": verdict, "effects": effects}))
    header = ["dwell", *(f"bias_{axis}_{kind}_dph" for kind in ("before", "after") for axis in "xyz")]
    lines = [",".join(header)]
    for row, before, after in zip(rows, result.before_dph, result.after_dph, strict=True):
        lines.append(",".join([str(row.dwell), *(f"{value:.9g}" for value in (*before, *after))]))
    (folder / "predictions.csv").write_text("\n".join(lines) + "\n")
