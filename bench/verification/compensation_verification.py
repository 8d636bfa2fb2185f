"""Verification of a compensation loaded into the INS: the residual bias with each compensation, by plateau.

It is given in the units that matter to a rotational INS: bias, velocity, position.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, field, fields, replace
from pathlib import Path

import numpy as np
from scipy.stats import chi2, norm

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.loadable_model import LoadableModel
from gyrobench.bench.closure.outcome import Closure
from gyrobench.bench.closure.uncertainty import Draws
from gyrobench.bench.closure.validation import LACK_OF_FIT_P
from gyrobench.bench.dwells.measure_dwell import CheckDwell
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, rms
from gyrobench.bench.foundations.csv_tables import format_csv, write_text
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.text import format_cell
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.verification.coefficient_verification import CoefficientResult
from gyrobench.bench.verification.measured_change import MeasuredChange, measured_change, without_cycle_means
from gyrobench.bench.verification.paired_plateaus import in_all, pair_dwells
from gyrobench.bench.verification.run_residuals import AnyDwell, ResidualCheck, bias_rows, check_plateau
from gyrobench.drivers.ins.compensation import Compensation

#: The compensations, in this order.
NONE, DECLARED, EFFECT = "none", "declared", "effect"
#: A run with each of them, in a sentence.
IN_WORDS = {NONE: "without compensation", DECLARED: "with the declared model", EFFECT: "with the effects"}
#: Largest difference from a fitted dwell at which a gyro temperature counts as fitted, K.
_FITTED_WITHIN_K = 2.5
#: Number of the row for all plateaus.
_ALL_PLATEAUS = 0
#: Bias including its constant, over that without compensation, from which the constant is stated as wrong.
_WORSE_CONSTANT = 1.5


@dataclass(frozen=True)
class VerificationRow:
    """Residual bias with one compensation at one plateau, or at all of them.

    A ``noise`` is the value expected from the measurement noise alone.
    """

    compensation: str  #: :data:`NONE`, :data:`DECLARED` or :data:`EFFECT`.
    #: Number of the plateau, from 1 (column ``stop``), the same in all runs: one that a run lacks has no row.
    #: 0 for all: rms over all dwells that each run has, otherwise the maximum over the plateaus at which each
    #: run has a value.
    plateau: int
    #: cycle, chamber_set_c, gyro_c: Of the plateau, with the mean gyro temperature; None for all.
    cycle: int | None
    chamber_set_c: float | None
    gyro_c: float | None
    #: Position of the temperature relative to the fit: "fitted", "between" or "outside"; empty for all.
    fit: str
    dwells: int  #: Number of biases per gyro; only those of dwells that the other runs have too.
    #: bias_rms_dph, bias_noise_dph: Rms of all gyros, including the constant of the power cycle.
    bias_rms_dph: float
    bias_noise_dph: float
    #: The same without each gyro's mean over the run, which includes the constant: over the dwells that each
    #: run has.
    varying_rms_dph: float
    varying_p_value: float  #: p-value of the varying bias, for all plateaus; NaN for one.
    #: spread_dph, spread_noise_dph, velocity_east_mps, velocity_noise_mps: See
    #: :class:`gyrobench.bench.verification.run_residuals.ResidualCheck`.
    spread_dph: float
    spread_noise_dph: float
    velocity_east_mps: float
    velocity_noise_mps: float
    #: position_nmi, position_noise_nmi: Largest position error of a rotational INS with these biases within a
    #: day; NaN without all six positions.
    position_nmi: float
    position_noise_nmi: float
    #: Rms standard uncertainty of the compensation itself, in the varying bias; NaN without one.
    compensation_sigma_dph: float
    #: p-value of the varying bias, given the noise and that uncertainty, for all plateaus; NaN for one.
    agreement_p_value: float


@dataclass(frozen=True, eq=False)
class CompensationResult:
    """Residual bias with one compensation."""

    compensation: str  #: As in the rows.
    plateaus: tuple[ResidualCheck, ...]  #: In the order of time.
    rows: tuple[VerificationRow, ...]  #: One for each plateau.
    total: VerificationRow  #: All plateaus.
    #: Change of the biases from each earlier run to this one, by its compensation, where it can be evaluated.
    changes: Mapping[str, MeasuredChange] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class PairedPlateau:
    """One plateau in all runs."""

    #: rows, checks: Of each run, in the order of the runs; None where a run lacks the plateau.
    rows: tuple[VerificationRow | None, ...]
    checks: tuple[ResidualCheck | None, ...]

    @property
    def known(self) -> tuple[VerificationRow, ...]:
        """Rows of the runs that have the plateau, at least one."""
        return tuple(row for row in self.rows if row is not None)

    def noise_row(self, size: str) -> VerificationRow:
        """Row with the noise of a size: of the last run that has the size, else of the last one."""
        return next(
            (row for row in reversed(self.known) if not math.isnan(getattr(row, size))), self.known[-1]
        )


@dataclass(frozen=True, eq=False)
class VerificationResult:
    """Residual bias in new measurements with each compensation derived from a campaign."""

    source: str  #: The campaign, as displayed.
    closure: Closure  #: Outcome of the search in it.
    models: Mapping[str, LoadableModel]  #: The loadable models, by compensation.
    results: tuple[CompensationResult, ...]  #: One for each compensation measured, at least one.
    #: new_attitudes, dwells: Dwells of one run that began in a position and azimuth in which no dwell of the
    #: campaign began, and all dwells of the run.
    new_attitudes: int
    dwells: int
    #: Whether all runs had the same emulated world and seed, and so the same constants of the power cycle.
    is_same_seed: bool
    notes: tuple[str, ...]  #: Remarks; sentences.
    searches: tuple[Closure, ...] = ()  #: In the campaign, of coefficients beyond the gyros' biases.
    #: Coefficients with each compensation; empty if they were not asked for.
    coefficients: tuple[CoefficientResult, ...] = ()

    @property
    def plateaus(self) -> tuple[PairedPlateau, ...]:
        """Plateaus that any run has, in the order of the plan."""
        rows = [{row.plateau: row for row in each.rows} for each in self.results]
        checks = [
            {row.plateau: check for row, check in zip(each.rows, each.plateaus, strict=True)}
            for each in self.results
        ]
        return tuple(
            PairedPlateau(
                tuple(each.get(number) for each in rows), tuple(each.get(number) for each in checks)
            )
            for number in sorted({number for each in rows for number in each})
        )

    @property
    def is_complete(self) -> bool:
        """Whether all dwells are valid in all runs, and each has the same sizes at each plateau."""
        return all(each.total.dwells == self.dwells for each in self.results) and all(
            len({row is not None and math.isfinite(getattr(row, size)) for row in plateau.rows}) == 1
            for plateau in self.plateaus
            for size in ("bias_rms_dph", "spread_dph", "velocity_east_mps", "position_nmi")
        )


@dataclass(frozen=True, eq=False)
class MeasuredRun:
    """What one run of a verification measured."""

    compensation: str  #: :data:`NONE`, :data:`DECLARED` or :data:`EFFECT`.
    dwells: Sequence[DwellRow]
    check_dwells: Sequence[CheckDwell]
    #: Draws of the model that was loaded, and the effects that the INS subtracts; None without one.
    model: tuple[Draws, Collection[str]] | None = None
    loaded: Compensation | None = None  #: What was loaded; None without one.
    is_limited: bool = True  #: Whether the INS got the limits of temperature.


def compare_runs(
    runs: Sequence[MeasuredRun], site: Site, fitted_c: FloatArray
) -> tuple[CompensationResult, ...]:
    """Residual bias in each run of a verification, by what is comparable.

    A dwell with flags in one run counts in none, unless that run has no dwell at its plateau: the others keep
    their values there, and all plateaus together are those at which each run has a value. A day needs all
    six positions, so it takes all dwells of its run. ``fitted_c``: shape (n, 3), temperatures of the gyros in
    the dwells that the model was fitted to.
    """
    dwells: list[list[AnyDwell]] = [[*run.dwells, *run.check_dwells] for run in runs]
    plateaus = pair_dwells(dwells)
    numbers = [[{row.dwell for row in bias_rows(each)} for each in plateau] for plateau in plateaus]
    compared = [
        in_all(biases)
        | in_all([[each.dwell for each in one if isinstance(each, CheckDwell)] for one in plateau])
        for biases, plateau in zip(numbers, plateaus, strict=True)
    ]
    everywhere = {
        dwell for biases, some in zip(numbers, compared, strict=True) if all(biases) for dwell in some
    }
    measured = [
        _measured_rows(index, run, plateaus, compared, everywhere, site, fitted_c)
        for index, run in enumerate(runs)
    ]
    rows = [each.rows for each in measured]
    return tuple(
        replace(
            each,
            total=_with_largest(each.total, each.rows, rows),
            changes=_changes(runs[:index], runs[index], everywhere),
        )
        for index, each in enumerate(measured)
    )


def _changes(
    before: Sequence[MeasuredRun], after: MeasuredRun, compared: Collection[int]
) -> dict[str, MeasuredChange]:
    """Change from each of some runs to another, over the dwells that all have."""

    def rows(run: MeasuredRun) -> list[DwellRow]:
        good = (row for row in run.dwells if not row.flags and row.dwell in compared)
        return sorted(good, key=lambda row: row.dwell)

    found = {
        run.compensation: measured_change(
            rows(run), rows(after), (run.loaded, after.loaded), is_limited=after.is_limited
        )
        for run in before
    }
    return {name: each for name, each in found.items() if each is not None}


def _measured_rows(
    index: int,
    run: MeasuredRun,
    plateaus: Sequence[Sequence[Sequence[AnyDwell]]],
    compared: Sequence[Collection[int]],
    everywhere: Collection[int],
    site: Site,
    fitted_c: FloatArray,
) -> CompensationResult:
    """Rows of one run; that of all plateaus without its maxima."""
    good = [row for row in run.dwells if not row.flags]
    counts = np.array([row.dwell in everywhere for row in good], dtype=bool)
    varying = _varying(good, np.array([row.bias_dph for row in good]).reshape(-1, 3), counts)
    roots = _uncertainty(good, run, counts)
    checks, rows = [], []
    for number, (plateau, some) in enumerate(zip(plateaus, compared, strict=True), start=1):
        if plateau[index]:
            check = check_plateau(plateau[index], some, site)
            mine = [row.dwell in check.dwells for row in good]
            checks.append(check)
            rows.append(_row(run.compensation, number, check, varying[mine], roots[:, mine], fitted_c))
    chosen = [row for row, counted in zip(good, counts, strict=True) if counted]
    total = _total(run.compensation, chosen, varying[counts], roots[:, counts])
    return CompensationResult(run.compensation, tuple(checks), tuple(rows), total)


def is_worse(after: VerificationRow, before: VerificationRow) -> bool:
    """Whether the varying bias over all plateaus is larger than in another run, by more than the noise.

    Over the noise, each sum of squares has a noncentral chi2 distribution.
    """
    numbers = 3 * after.dwells
    sums = np.array([numbers * (each.varying_rms_dph / each.bias_noise_dph) ** 2 for each in (after, before)])
    sigma = math.sqrt(np.sum(2.0 * numbers + 4.0 * np.maximum(sums - numbers, 0.0)))
    return bool(sigma > 0.0 and norm.sf((sums[0] - sums[1]) / sigma) < LACK_OF_FIT_P)


def is_better(after: CompensationResult, before: CompensationResult) -> bool:
    """Whether the varying bias is smaller than in another run by more than the noise.

    Either the sums of squares show it, or the change follows what was loaded and makes the biases smaller.
    """
    if not after.total.varying_rms_dph < before.total.varying_rms_dph:
        return False
    change = after.changes.get(before.compensation)
    is_change = (
        change is not None and change.is_applied and change.is_smaller and not change.contradicts.any()
    )
    return is_change or is_worse(before.total, after.total)


def has_worse_constant(after: VerificationRow, before: VerificationRow) -> bool:
    """Whether the bias including the constant is larger than in another run by half, and beyond the noise."""
    if not after.bias_rms_dph > _WORSE_CONSTANT * before.bias_rms_dph:
        return False
    rows = [replace(each, varying_rms_dph=each.bias_rms_dph) for each in (after, before)]
    return is_worse(*rows)


#: Columns of the table; the number of the plateau is in ``stop``.
VERIFICATION_COLUMNS = tuple(
    "stop" if each.name == "plateau" else each.name for each in fields(VerificationRow)
)


def table_records(results: Iterable[CompensationResult]) -> list[dict[str, str | float | None]]:
    """Rows of the table by column: the plateaus of each compensation, then all of them together."""
    rows = [row for each in results for row in (*each.rows, each.total)]
    return [dict(zip(VERIFICATION_COLUMNS, astuple(row), strict=True)) for row in rows]


def write_verification_table(path: Path, results: Iterable[CompensationResult]) -> None:
    """Write the table. Raises RunFolderError if the file can't be written."""
    rows = [map(format_cell, record.values()) for record in table_records(results)]
    write_text(path, format_csv(VERIFICATION_COLUMNS, map(list, rows)))


def _varying(rows: Sequence[DwellRow], bias_dph: FloatArray, counts: BoolArray) -> FloatArray:
    """Biases (..., n, 3) of a run without its constants; see :func:`without_cycle_means`."""
    weights = np.array([row.sigma_dph for row in rows]).reshape(-1, 3) ** -2.0
    return without_cycle_means(bias_dph, weights, np.array([row.run for row in rows]), counts)


def _uncertainty(rows: Sequence[DwellRow], run: MeasuredRun, counts: BoolArray) -> FloatArray:
    """Varying bias (N, n, 3) of draws of a compensation; the sum of their squares is its variance.

    At temperatures that the INS clips to those fitted it is that at the limit. None (N = 0) without a
    compensation, or where temperatures are missing that the model needs.
    """
    if run.model is None:
        return np.zeros((0, len(rows), 3))
    draws, effects = run.model
    try:
        campaign = campaign_of(rows)
    except MeasurementError:
        return np.zeros((0, len(rows), 3))
    if len(campaign) < len(rows):
        return np.zeros((0, len(rows), 3))
    if run.loaded is not None and run.is_limited:
        gyro_c = np.clip(campaign.gyro_c, run.loaded.low_c, run.loaded.high_c)
        board_c = campaign.board_c + gyro_c - campaign.gyro_c
        campaign = replace(campaign, gyro_c=gyro_c, board_c=board_c)
    order = np.argsort(np.argsort([row.start_s for row in rows], kind="stable"))
    varying = _varying(rows, draws.bias_dph(campaign, effects)[:, order], counts)
    return np.asarray((varying - varying.mean(axis=0)) / math.sqrt(len(varying)))


def _sigma_dph(roots: FloatArray) -> float:
    return rms(np.sqrt(np.sum(roots**2, axis=0))) if len(roots) else math.nan


def _row(
    compensation: str,
    number: int,
    plateau: ResidualCheck,
    varying: FloatArray,
    roots: FloatArray,
    fitted_c: FloatArray,
) -> VerificationRow:
    return VerificationRow(
        compensation=compensation,
        plateau=number,
        cycle=plateau.cycle,
        chamber_set_c=plateau.chamber_set_c,
        gyro_c=plateau.gyro_c,
        fit=_fit(plateau.gyro_c, fitted_c),
        dwells=len(varying),
        bias_rms_dph=plateau.bias_rms_dph,
        bias_noise_dph=plateau.sigma_rms_dph,
        varying_rms_dph=rms(varying),
        varying_p_value=math.nan,
        spread_dph=plateau.spread_dph,
        spread_noise_dph=plateau.spread_noise_dph,
        velocity_east_mps=plateau.velocity_east_mps,
        velocity_noise_mps=plateau.velocity_noise_mps,
        position_nmi=plateau.day.error.max_nmi if plateau.day else math.nan,
        position_noise_nmi=plateau.day.noise_nmi if plateau.day else math.nan,
        compensation_sigma_dph=_sigma_dph(roots),
        agreement_p_value=math.nan,
    )


def _total(
    compensation: str, compared: Sequence[DwellRow], varying: FloatArray, roots: FloatArray
) -> VerificationRow:
    """All plateaus together, without the maxima over them."""
    sigma = np.array([row.sigma_dph for row in compared]).reshape(-1, 3)
    dof = varying.size - varying.shape[1] * len({row.run for row in compared})
    return VerificationRow(
        compensation=compensation,
        plateau=_ALL_PLATEAUS,
        cycle=None,
        chamber_set_c=None,
        gyro_c=None,
        fit="",
        dwells=len(compared),
        bias_rms_dph=rms(np.array([row.bias_dph for row in compared])),
        bias_noise_dph=rms(sigma),
        varying_rms_dph=rms(varying),
        varying_p_value=float(chi2.sf(np.sum((varying / sigma) ** 2), dof)) if dof > 0 else math.nan,
        spread_dph=math.nan,
        spread_noise_dph=math.nan,
        velocity_east_mps=math.nan,
        velocity_noise_mps=math.nan,
        position_nmi=math.nan,
        position_noise_nmi=math.nan,
        compensation_sigma_dph=_sigma_dph(roots),
        agreement_p_value=_agreement(varying / sigma, roots / sigma, dof) if len(roots) else math.nan,
    )


def _agreement(varying: FloatArray, roots: FloatArray, dof: int) -> float:
    """p-value of a bias (n, 3), given the noise and draws of the compensation, in standard deviations."""
    if dof < 1:
        return math.nan
    columns = roots.reshape(len(roots), -1)
    covariance = np.eye(varying.size) + columns.T @ columns
    return float(chi2.sf(varying.ravel() @ np.linalg.solve(covariance, varying.ravel()), dof))


def _with_largest(
    total: VerificationRow, rows: Sequence[VerificationRow], runs: Sequence[Sequence[VerificationRow]]
) -> VerificationRow:
    """Total with the largest sizes of a run, over the plateaus at which all runs have a value.

    Each comes with the noise of its plateau; both stay NaN without any.
    """

    def largest(size: str, noise: str) -> tuple[float, float]:
        known = [{row.plateau for row in run if not math.isnan(getattr(row, size))} for run in runs]
        pairs = [
            (float(getattr(row, size)), float(getattr(row, noise)))
            for row in rows
            if row.plateau in set.intersection(*known)
        ]
        return max(pairs, default=(math.nan, math.nan))

    spread, spread_noise = largest("spread_dph", "spread_noise_dph")
    velocity, velocity_noise = largest("velocity_east_mps", "velocity_noise_mps")
    position, position_noise = largest("position_nmi", "position_noise_nmi")
    return replace(
        total,
        spread_dph=spread,
        spread_noise_dph=spread_noise,
        velocity_east_mps=velocity,
        velocity_noise_mps=velocity_noise,
        position_nmi=position,
        position_noise_nmi=position_noise,
    )


def _fit(gyro_c: float, fitted_c: FloatArray) -> str:
    means_c = fitted_c.mean(axis=1)
    if np.abs(means_c - gyro_c).min() <= _FITTED_WITHIN_K:
        return "fitted"
    return "between" if means_c.min() < gyro_c < means_c.max() else "outside"
