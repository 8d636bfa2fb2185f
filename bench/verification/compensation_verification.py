"""Verification of a compensation loaded into the INS: the residual bias with each compensation, by plateau.

Stated as bias, velocity and position error of a rotational INS.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.stats import chi2, norm

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.loadable_model import LoadableModel
from gyrobench.bench.closure.outcome import Closure
from gyrobench.bench.closure.uncertainty import Draws
from gyrobench.bench.dwells.measure_dwell import CheckDwell
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, rms
from gyrobench.bench.foundations.csv_tables import RecordTable
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.verification.coefficient_verification import CoefficientResult
from gyrobench.bench.verification.measured_change import (
    SIGNIFICANT_P,
    BiasGrowth,
    MeasuredChange,
    bias_growth,
    error_parts,
    measured_change,
    sum_of_squares_metric,
    without_cycle_means,
)
from gyrobench.bench.verification.paired_plateaus import comparable_dwells, pair_dwells
from gyrobench.bench.verification.run_residuals import AnyDwell, VerificationRow, bias_rows, check_plateau
from gyrobench.drivers.ins.compensation import Compensation

#: The compensations, in the order of the runs.
NONE, DECLARED, EFFECT = "none", "declared", "effect"
#: Phrase for a run with each compensation, in sentences.
IN_WORDS = {NONE: "without compensation", DECLARED: "with the declared model", EFFECT: "with the effects"}
#: A gyro temperature counts as fitted if it differs by at most this from that of a fitted dwell, K.
_FITTED_WITHIN_K = 2.5
#: Number of the row for all plateaus.
_ALL_PLATEAUS = 0
#: A growth of the biases beyond this many standard deviations is significant.
_SIGNIFICANT_SIGMAS = float(norm.isf(SIGNIFICANT_P))
#: The constant is stated as wrong if the bias including it exceeds that without compensation by this factor.
_WORSE_CONSTANT = 1.5


@dataclass(frozen=True, eq=False)
class CompensationResult:
    """Residual bias with one compensation."""

    compensation: str  #: As in :class:`VerificationRow`.
    rows: tuple[VerificationRow, ...]  #: One for each plateau, in the order of time.
    total: VerificationRow  #: All plateaus.
    #: Change of the biases from each earlier run to this one, by the compensation of the earlier run; only if
    #: it can be evaluated.
    changes: Mapping[str, MeasuredChange] = field(default_factory=dict)
    #: Growth of the biases from each earlier run to this one, by the compensation of the earlier run.
    growths: Mapping[str, BiasGrowth] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class PairedPlateau:
    """One plateau in all runs."""

    rows: tuple[VerificationRow | None, ...]  #: In the order of the runs; None if a run lacks the plateau.

    @property
    def measured_rows(self) -> tuple[VerificationRow, ...]:
        """Rows of the runs that have the plateau; at least one."""
        return tuple(row for row in self.rows if row is not None)

    def noise_row(self, size: str) -> VerificationRow:
        """Row that gives the noise of a size: that of the last run with the size, else of the last run."""
        return next(
            (row for row in reversed(self.measured_rows) if not math.isnan(getattr(row, size))),
            self.measured_rows[-1],
        )


@dataclass(frozen=True, eq=False)
class VerificationResult:
    """Residual bias in new measurements with each compensation derived from a campaign."""

    source: str  #: Displayed name of the campaign.
    closure: Closure  #: Outcome of the search in the campaign.
    models: Mapping[str, LoadableModel]  #: The loadable models, by compensation.
    results: tuple[CompensationResult, ...]  #: One for each compensation measured, at least one.
    #: new_attitudes, dwells: Number of dwells of one run that began in a position and azimuth in which no
    #: dwell of the campaign began; number of all dwells of the run.
    new_attitudes: int
    dwells: int
    #: Whether all runs had the same emulated world and seed, and therefore the same constants of power
    #: cycles.
    is_same_seed: bool
    notes: tuple[str, ...]  #: Remarks; sentences.
    searches: tuple[Closure, ...] = ()  #: Searches of the campaign for coefficients other than gyro biases.
    #: Coefficients with each compensation; empty if not requested.
    coefficients: tuple[CoefficientResult, ...] = ()

    @property
    def plateaus(self) -> tuple[PairedPlateau, ...]:
        """Plateaus that any run has, in the order of the plan."""
        rows = [{row.plateau: row for row in each.rows} for each in self.results]
        return tuple(
            PairedPlateau(tuple(each.get(number) for each in rows))
            for number in sorted({number for each in rows for number in each})
        )

    @property
    def is_complete(self) -> bool:
        """Whether all dwells are valid in all runs, and all runs have the same sizes at each plateau."""
        return all(each.total.dwells == self.dwells for each in self.results) and all(
            len({row is not None and math.isfinite(getattr(row, size)) for row in plateau.rows}) == 1
            for plateau in self.plateaus
            for size in ("bias_rms_dph", "spread_dph", "velocity_east_mps", "position_nmi")
        )


@dataclass(frozen=True, eq=False)
class MeasuredRun:
    """Measurements of one run of a verification."""

    compensation: str  #: :data:`NONE`, :data:`DECLARED` or :data:`EFFECT`.
    dwells: Sequence[DwellRow]
    check_dwells: Sequence[CheckDwell]
    #: Draws of the loaded model, and names of the effects that the INS subtracts; None without a
    #: compensation.
    model: tuple[Draws, Collection[str]] | None = None
    loaded: Compensation | None = None  #: The compensation that was loaded; None without one.
    is_limited: bool = True  #: Whether the INS got the temperature limits.


def compare_runs(
    runs: Sequence[MeasuredRun], site: Site, fitted_c: FloatArray
) -> tuple[CompensationResult, ...]:
    """Residual bias in each run of a verification, from comparable dwells.

    A dwell with flags in one run is omitted in all runs, unless that run has no dwell at its plateau: the
    other runs then keep their values for the plateau, but it is omitted from the total. The day of navigation
    needs all six positions, so it uses all dwells of its run. ``fitted_c``: shape (n, 3), temperatures of the
    gyros in the dwells to which the model was fitted.
    """
    dwells: list[list[AnyDwell]] = [[*run.dwells, *run.check_dwells] for run in runs]
    checks: list[list[VerificationRow]] = [[] for _ in runs]
    in_all_runs: set[int] = set()
    for number, plateau in enumerate(pair_dwells(dwells), start=1):
        biases = [{row.dwell for row in bias_rows(each)} for each in plateau]
        check_dwells = [[each.dwell for each in one if isinstance(each, CheckDwell)] for one in plateau]
        compared = comparable_dwells(biases) | comparable_dwells(check_dwells)
        if all(biases):
            in_all_runs |= compared
        for run, run_checks, members in zip(runs, checks, plateau, strict=True):
            if members:
                run_checks.append(check_plateau(members, compared, site, run.compensation, number))
    measured = [
        _measured_rows(run, run_checks, in_all_runs, fitted_c)
        for run, run_checks in zip(runs, checks, strict=True)
    ]
    rows = [each.rows for each in measured]
    return tuple(
        replace(
            each,
            total=_with_largest(each.total, each.rows, rows),
            **_compared_with(runs[:index], runs[index], in_all_runs),
        )
        for index, each in enumerate(measured)
    )


def _compared_with(
    before: Sequence[MeasuredRun], after: MeasuredRun, compared: Collection[int]
) -> dict[str, Any]:
    """Changes and growths from each earlier run to a later one, over the dwells that all runs have."""

    def rows(run: MeasuredRun) -> list[DwellRow]:
        usable = (row for row in run.dwells if not row.flags and row.dwell in compared)
        return sorted(usable, key=lambda row: row.dwell)

    changes = {
        run.compensation: measured_change(
            rows(run), rows(after), (run.loaded, after.loaded), is_limited=after.is_limited
        )
        for run in before
    }
    return {
        "changes": {name: each for name, each in changes.items() if each is not None},
        "growths": {run.compensation: bias_growth(rows(run), rows(after)) for run in before},
    }


def _measured_rows(
    run: MeasuredRun, checks: Iterable[VerificationRow], in_all_runs: Collection[int], fitted_c: FloatArray
) -> CompensationResult:
    """Rows of one run with its varying biases; the total is without maxima, see :func:`_with_largest`."""
    usable = [row for row in run.dwells if not row.flags]
    counts = np.array([row.dwell in in_all_runs for row in usable], dtype=bool)
    varying = _varying_bias(usable, np.array([row.bias_dph for row in usable]).reshape(-1, 3), counts)
    deviations = _compensation_deviations(usable, run, counts)
    rows = []
    for check in checks:
        is_included = [row.dwell in check.members for row in usable]
        row = replace(
            check,
            fit=_relation_to_fit(check.gyro_c, fitted_c),
            varying_rms_dph=rms(varying[is_included]),
            compensation_sigma_dph=_sigma_dph(deviations[:, is_included]),
        )
        rows.append(row)
    total_rows = [each for each, is_counted in zip(usable, counts, strict=True) if is_counted]
    total = _total_row(run.compensation, total_rows, varying[counts], deviations[:, counts])
    return CompensationResult(run.compensation, tuple(rows), total)


def is_worse(after: CompensationResult, before: CompensationResult) -> bool:
    """Whether the varying bias over all plateaus is larger than in an earlier run, by more than the noise."""
    is_larger = after.total.varying_rms_dph > before.total.varying_rms_dph
    return is_larger and after.growths[before.compensation].varying > _SIGNIFICANT_SIGMAS


def is_better(after: CompensationResult, before: CompensationResult) -> bool:
    """Whether the varying bias is smaller than in an earlier run by more than the noise.

    Either the sums of squares show it, or the change agrees with the loaded one and makes the biases smaller.
    """
    if not after.total.varying_rms_dph < before.total.varying_rms_dph:
        return False
    change = after.changes.get(before.compensation)
    is_change = (
        change is not None and change.is_applied and change.is_smaller and not change.contradicts.any()
    )
    return is_change or after.growths[before.compensation].varying < -_SIGNIFICANT_SIGMAS


def has_worse_constant(after: CompensationResult, before: CompensationResult) -> bool:
    """Whether the bias with its constant is more than 1.5 times that in an earlier run, beyond the noise."""
    is_larger = after.total.bias_rms_dph > _WORSE_CONSTANT * before.total.bias_rms_dph
    return is_larger and after.growths[before.compensation].whole > _SIGNIFICANT_SIGMAS


#: ``comparison.csv``; the number of the plateau is in ``stop``.
COMPARISON_TABLE = RecordTable(VerificationRow, names={"plateau": "stop"}, left_out=["members", "day"])


def table_rows(results: Iterable[CompensationResult]) -> list[VerificationRow]:
    """Rows of the table: the plateaus of each compensation, then all of them together."""
    return [row for each in results for row in (*each.rows, each.total)]


def _varying_bias(rows: Sequence[DwellRow], bias_dph: FloatArray, counts: BoolArray) -> FloatArray:
    """Varying biases (..., n, 3) of a run, without its constants; see :func:`without_cycle_means`."""
    weights = np.array([row.sigma_dph for row in rows]).reshape(-1, 3) ** -2.0
    return without_cycle_means(bias_dph, weights, np.array([row.run for row in rows]), counts)


def _compensation_deviations(rows: Sequence[DwellRow], run: MeasuredRun, counts: BoolArray) -> FloatArray:
    """Deviations (N, n, 3) of the varying bias in draws of a compensation, whose squares sum to its variance.

    Temperatures are clipped to those fitted, as by the INS. N = 0 without a compensation, or if temperatures
    that the model needs are missing.
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
    varying = _varying_bias(rows, draws.bias_dph(campaign, effects)[:, order], counts)
    return np.asarray((varying - varying.mean(axis=0)) / math.sqrt(len(varying)))


def _sigma_dph(deviations: FloatArray) -> float:
    return rms(np.sqrt(np.sum(deviations**2, axis=0))) if len(deviations) else math.nan


def _total_row(
    compensation: str, compared: Sequence[DwellRow], varying: FloatArray, deviations: FloatArray
) -> VerificationRow:
    """Row for all plateaus together, without the maxima over them."""
    sigma = np.array([row.sigma_dph for row in compared]).reshape(-1, 3)
    return VerificationRow(
        compensation=compensation,
        plateau=_ALL_PLATEAUS,
        dwells=len(compared),
        bias_rms_dph=rms(np.array([row.bias_dph for row in compared])),
        bias_noise_dph=rms(sigma),
        varying_rms_dph=rms(varying),
        varying_p_value=_agreement_p_value(compared, deviations[:0]),
        compensation_sigma_dph=_sigma_dph(deviations),
        agreement_p_value=_agreement_p_value(compared, deviations) if len(deviations) else math.nan,
    )


def _agreement_p_value(rows: Sequence[DwellRow], deviations: FloatArray) -> float:
    """p-value of varying biases, given noise, errors in common, and other deviations (N, n, 3), deg/h."""
    runs = [row.run for row in rows]
    dof = 3 * (len(rows) - len(set(runs)))
    if dof < 1:
        return math.nan
    noise, common = error_parts(rows)
    cycles = np.array([runs.index(each) for each in runs])
    metric = sum_of_squares_metric(noise**2, np.concatenate([deviations, common]), cycles)
    biases_dph = np.array([row.bias_dph for row in rows]).ravel()
    return float(chi2.sf(biases_dph @ metric @ biases_dph, dof))


def _with_largest(
    total: VerificationRow, rows: Sequence[VerificationRow], runs: Sequence[Sequence[VerificationRow]]
) -> VerificationRow:
    """Total with the largest sizes of a run, over the plateaus at which all runs have a value.

    Each with the noise of its plateau; both stay NaN without such a plateau.
    """
    largest: dict[str, Any] = {}
    for size, noise in (
        ("spread_dph", "spread_noise_dph"),
        ("velocity_east_mps", "velocity_noise_mps"),
        ("position_nmi", "position_noise_nmi"),
    ):
        with_size = [{row.plateau for row in run if not math.isnan(getattr(row, size))} for run in runs]
        in_all = set.intersection(*with_size)
        pairs = [(getattr(row, size), getattr(row, noise)) for row in rows if row.plateau in in_all]
        largest[size], largest[noise] = max(pairs, default=(math.nan, math.nan))
    return replace(total, **largest)


def _relation_to_fit(gyro_c: float, fitted_c: FloatArray) -> str:
    means_c = fitted_c.mean(axis=1)
    if np.abs(means_c - gyro_c).min() <= _FITTED_WITHIN_K:
        return "fitted"
    return "between" if means_c.min() < gyro_c < means_c.max() else "outside"
