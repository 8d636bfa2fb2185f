"""Verification of a compensation loaded into the INS: the residual bias with each compensation."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.loadable_model import LoadableModel
from gyrobench.bench.closure.loop import Closure
from gyrobench.bench.closure.uncertainty import Draws
from gyrobench.bench.dwells.check_dwell import CheckDwell
from gyrobench.bench.foundations.arrays import FloatArray, rms
from gyrobench.bench.foundations.csv_tables import format_csv, write_text
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.text import format_cell
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.verification.coefficient_verification import CoefficientResult
from gyrobench.bench.verification.residuals import ResidualCheck, check_residuals

#: The compensations, in this order.
NONE, DECLARED, EFFECT = "none", "declared", "effect"
#: Largest difference from a fitted dwell at which a gyro temperature counts as fitted, K.
FITTED_WITHIN_K = 2.5
#: Number of the row for all plateaus.
ALL_PLATEAUS = 0


@dataclass(frozen=True)
class VerificationRow:
    """Residual bias with one compensation at one plateau, or at all of them.

    A ``noise`` is the value expected from the measurement noise alone.
    """

    compensation: str  #: :data:`NONE`, :data:`DECLARED` or :data:`EFFECT`.
    #: Number of the plateau, from 1 (column ``stop``); 0 for all: rms over all dwells, otherwise maximum.
    plateau: int
    #: cycle, chamber_set_c, gyro_c: Of the plateau, with the mean gyro temperature; None for all.
    cycle: int | None
    chamber_set_c: float | None
    gyro_c: float | None
    #: Position of the temperature relative to the fit: "fitted", "between" or "outside"; empty for all.
    fit: str
    dwells: int  #: Number of biases per gyro.
    #: bias_rms_dph, bias_noise_dph: Rms of all gyros, including the constant of the power cycle.
    bias_rms_dph: float
    bias_noise_dph: float
    varying_rms_dph: float  #: The same without each gyro's mean over the run, which includes the constant.
    varying_p_value: float  #: p-value of the varying bias, for all plateaus; NaN for one.
    #: spread_dph, spread_noise_dph, velocity_east_mps, velocity_noise_mps: See
    #: :class:`gyrobench.bench.verification.residuals.ResidualCheck`.
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
    #: Coefficients with each compensation; empty if they were not asked for.
    coefficients: tuple[CoefficientResult, ...] = ()


def compensation_result(
    compensation: str,
    dwells: Iterable[DwellRow],
    verifications: Iterable[CheckDwell],
    site: Site,
    fitted_c: FloatArray,
    model: tuple[Draws, Collection[str]] | None = None,
) -> CompensationResult:
    """Residual bias with one compensation, without flagged dwells.

    Parameters
    ----------
    dwells, verifications : iterable of DwellRow, iterable of CheckDwell
        Of the run with that compensation.
    fitted_c : ndarray, shape (n, 3)
        Temperatures of the gyros in the dwells that the model was fitted to.
    model : tuple of Draws and names, optional
        Draws of the model that was loaded, and the effects that the INS subtracts.
    """
    good = [row for row in dwells if not row.flags]
    plateaus = check_residuals(good, verifications, site)
    varying = _varying(good, np.array([row.bias_dph for row in good]).reshape(-1, 3))
    roots = _uncertainty(good, model)
    rows = []
    for number, plateau in enumerate(plateaus, start=1):
        mine = [row.dwell in plateau.dwells for row in good]
        rows.append(_row(compensation, number, plateau, varying[mine], roots[:, mine], fitted_c))
    total = _total(compensation, rows, good, varying, roots)
    return CompensationResult(compensation, tuple(plateaus), tuple(rows), total)


#: Columns of the table; the number of the plateau is in ``stop``.
COLUMNS = tuple("stop" if each.name == "plateau" else each.name for each in fields(VerificationRow))


def table_records(results: Iterable[CompensationResult]) -> list[dict[str, str | float | None]]:
    """Rows of the table by column: the plateaus of each compensation, then all of them together."""
    rows = [row for each in results for row in (*each.rows, each.total)]
    return [dict(zip(COLUMNS, astuple(row), strict=True)) for row in rows]


def write_verification_table(path: Path, results: Iterable[CompensationResult]) -> None:
    """Write the table. Raises RunFolderError if the file can't be written."""
    rows = [map(format_cell, record.values()) for record in table_records(results)]
    write_text(path, format_csv(COLUMNS, map(list, rows)))


def _varying(rows: Sequence[DwellRow], bias_dph: FloatArray) -> FloatArray:
    """Biases (..., n, 3) minus each gyro's weighted mean in its power cycle."""
    varying = bias_dph.copy()
    weights = np.array([row.sigma_dph for row in rows]).reshape(-1, 3) ** -2.0
    for run in {row.run for row in rows}:
        mine = [row.run == run for row in rows]
        means = (weights[mine] * varying[..., mine, :]).sum(axis=-2) / weights[mine].sum(axis=0)
        varying[..., mine, :] -= means[..., np.newaxis, :]
    return varying


def _uncertainty(rows: Sequence[DwellRow], model: tuple[Draws, Collection[str]] | None) -> FloatArray:
    """Varying bias (N, n, 3) of draws of a compensation; the sum of their squares is its variance.

    None (N = 0) without a compensation, or where temperatures are missing that the model needs.
    """
    if model is None:
        return np.zeros((0, len(rows), 3))
    draws, effects = model
    try:
        campaign = campaign_of(rows)
    except MeasurementError:
        return np.zeros((0, len(rows), 3))
    if len(campaign) < len(rows):
        return np.zeros((0, len(rows), 3))
    order = np.argsort(np.argsort([row.start_s for row in rows], kind="stable"))
    varying = _varying(rows, draws.bias_dph(campaign, effects)[:, order])
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
    compensation: str,
    rows: Sequence[VerificationRow],
    good: Sequence[DwellRow],
    varying: FloatArray,
    roots: FloatArray,
) -> VerificationRow:
    sigma = np.array([row.sigma_dph for row in good]).reshape(-1, 3)
    dof = varying.size - varying.shape[1] * len({row.run for row in good})
    spread, spread_noise = _largest(rows, lambda row: (row.spread_dph, row.spread_noise_dph))
    velocity, velocity_noise = _largest(rows, lambda row: (row.velocity_east_mps, row.velocity_noise_mps))
    position, position_noise = _largest(rows, lambda row: (row.position_nmi, row.position_noise_nmi))
    return VerificationRow(
        compensation=compensation,
        plateau=ALL_PLATEAUS,
        cycle=None,
        chamber_set_c=None,
        gyro_c=None,
        fit="",
        dwells=len(good),
        bias_rms_dph=rms(np.array([row.bias_dph for row in good])),
        bias_noise_dph=rms(sigma),
        varying_rms_dph=rms(varying),
        varying_p_value=float(chi2.sf(np.sum((varying / sigma) ** 2), dof)) if dof > 0 else math.nan,
        spread_dph=spread,
        spread_noise_dph=spread_noise,
        velocity_east_mps=velocity,
        velocity_noise_mps=velocity_noise,
        position_nmi=position,
        position_noise_nmi=position_noise,
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


def _largest(
    rows: Sequence[VerificationRow], of: Callable[[VerificationRow], tuple[float, float]]
) -> tuple[float, float]:
    """Largest value with its noise; both NaN without any."""
    known = [of(row) for row in rows if not math.isnan(of(row)[0])]
    return max(known, default=(math.nan, math.nan))


def _fit(gyro_c: float, fitted_c: FloatArray) -> str:
    means_c = fitted_c.mean(axis=1)
    if np.abs(means_c - gyro_c).min() <= FITTED_WITHIN_K:
        return "fitted"
    return "between" if means_c.min() < gyro_c < means_c.max() else "outside"
