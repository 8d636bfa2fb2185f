"""What different compensations of one unit leave, side by side: ``comparison.csv``."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.closure.loadable_model import LoadableModel
from gyrobench.bench.closure.loop import Closure
from gyrobench.bench.dwells.check_dwell import CheckDwell
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.csv_tables import format_cell, format_csv, write_text
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.verification.residuals import ResidualCheck, check_residuals

#: The compensations that are compared, in this order.
NONE, DECLARED, EFFECT = "none", "declared", "effect"
#: Gyros this near to a dwell that was fitted are at a temperature that was fitted, K.
FITTED_WITHIN_K = 2.5
#: Number of the row that all stops share.
ALL_STOPS = 0


@dataclass(frozen=True)
class ComparisonRow:
    """What one compensation leaves at one stop of the chamber, or at all of them.

    What stands after a size under the name ``noise`` is what the noise alone would give in its place.

    Attributes
    ----------
    compensation : str
        :data:`NONE`, :data:`DECLARED` or :data:`EFFECT`.
    stop : int
        Number of the stop, from 1; 0 for all of them: rms over all dwells, and the largest of the rest.
    cycle, chamber_set_c, gyro_c : int or None, float or None, float or None
        Which stop it is, and the mean temperature of the gyros; None for all of them.
    fit : str
        Whether the model was fitted there: "fitted", "between" or "outside"; empty for all.
    dwells : int
        How many biases of each gyro there are.
    bias_rms_dph, bias_noise_dph : float
        Of all gyros, with the constant of the power-on.
    varying_rms_dph : float
        The same without each gyro's mean over all dwells of the run, which the constant is part of.
    varying_p_value : float
        Probability that noise alone varies as much, for all stops; NaN for one.
    spread_dph, spread_noise_dph, velocity_east_mps, velocity_noise_mps : float
        See :class:`gyrobench.bench.verification.residuals.ResidualCheck`.
    position_nmi, position_noise_nmi : float
        Largest position error within a day of a rotational INS with these biases; NaN without all
        six positions.
    """

    compensation: str
    stop: int
    cycle: int | None
    chamber_set_c: float | None
    gyro_c: float | None
    fit: str
    dwells: int
    bias_rms_dph: float
    bias_noise_dph: float
    varying_rms_dph: float
    varying_p_value: float
    spread_dph: float
    spread_noise_dph: float
    velocity_east_mps: float
    velocity_noise_mps: float
    position_nmi: float
    position_noise_nmi: float


@dataclass(frozen=True, eq=False)
class Leftover:
    """What one compensation leaves.

    Attributes
    ----------
    compensation : str
        As in the rows.
    stops : tuple of ResidualCheck
        In the order of time.
    rows : tuple of ComparisonRow
        One for each stop.
    total : ComparisonRow
        All stops.
    """

    compensation: str
    stops: tuple[ResidualCheck, ...]
    rows: tuple[ComparisonRow, ...]
    total: ComparisonRow


@dataclass(frozen=True, eq=False)
class Comparison:
    """What the compensations made from one campaign leave, on measurements that came after it.

    Attributes
    ----------
    source : str
        The campaign, for people.
    closure : Closure
        Outcome of the search in it.
    models : mapping of str to LoadableModel
        What was to be loaded, by the name of the compensation.
    leftovers : tuple of Leftover
        Of the compensations measured, at least one.
    new_attitudes, dwells : int
        Dwells of one run that began in a position and azimuth that no dwell of the campaign
        began in, of how many.
    is_same_seed : bool
        Whether all were measured in one emulated world with the same seed: with the same constants
        of the power-on.
    notes : tuple of str
        What a reader has to know beside; sentences.
    """

    source: str
    closure: Closure
    models: Mapping[str, LoadableModel]
    leftovers: tuple[Leftover, ...]
    new_attitudes: int
    dwells: int
    is_same_seed: bool
    notes: tuple[str, ...]


def leftover(
    compensation: str,
    dwells: Iterable[DwellRow],
    verifications: Iterable[CheckDwell],
    site: Site,
    fitted_c: FloatArray,
) -> Leftover:
    """Measure what one compensation leaves; dwells with flags are left out.

    Parameters
    ----------
    dwells, verifications : iterable of DwellRow, iterable of CheckDwell
        Of the run with that compensation.
    fitted_c : ndarray, shape (n, 3)
        Temperatures of the gyros in the dwells that the model was fitted to.
    """
    good = [row for row in dwells if not row.flags]
    stops = check_residuals(good, verifications, site)
    varying = _varying(good)
    rows = tuple(
        _row(compensation, number, stop, varying[[row.dwell in stop.dwells for row in good]], fitted_c)
        for number, stop in enumerate(stops, start=1)
    )
    return Leftover(compensation, tuple(stops), rows, _total(compensation, rows, good, varying))


def write_comparison(path: Path, leftovers: Iterable[Leftover]) -> None:
    """Write the table.

    Raises
    ------
    RunFolderError
        The file can't be written.
    """
    columns = [field.name for field in fields(ComparisonRow)]
    rows = [row for each in leftovers for row in (*each.rows, each.total)]
    write_text(path, format_csv(columns, ([format_cell(cell) for cell in astuple(row)] for row in rows)))


def _varying(rows: Sequence[DwellRow]) -> FloatArray:
    """Biases (n, 3) less each gyro's mean in its power-on, weighted by the uncertainties."""
    varying = np.array([row.bias_dph for row in rows]).reshape(-1, 3)
    weights = np.array([row.sigma_dph for row in rows]).reshape(-1, 3) ** -2.0
    for run in {row.run for row in rows}:
        mine = [row.run == run for row in rows]
        varying[mine] -= (weights[mine] * varying[mine]).sum(axis=0) / weights[mine].sum(axis=0)
    return varying


def _row(
    compensation: str, number: int, stop: ResidualCheck, varying: FloatArray, fitted_c: FloatArray
) -> ComparisonRow:
    return ComparisonRow(
        compensation=compensation,
        stop=number,
        cycle=stop.cycle,
        chamber_set_c=stop.chamber_set_c,
        gyro_c=stop.gyro_c,
        fit=_fit(stop.gyro_c, fitted_c),
        dwells=len(varying),
        bias_rms_dph=stop.bias_rms_dph,
        bias_noise_dph=stop.sigma_rms_dph,
        varying_rms_dph=_rms(varying),
        varying_p_value=math.nan,
        spread_dph=stop.spread_dph,
        spread_noise_dph=stop.spread_noise_dph,
        velocity_east_mps=stop.velocity_east_mps,
        velocity_noise_mps=stop.velocity_noise_mps,
        position_nmi=stop.day.error.max_nmi if stop.day else math.nan,
        position_noise_nmi=stop.day.noise_nmi if stop.day else math.nan,
    )


def _total(
    compensation: str, rows: Sequence[ComparisonRow], good: Sequence[DwellRow], varying: FloatArray
) -> ComparisonRow:
    sigma = np.array([row.sigma_dph for row in good]).reshape(-1, 3)
    dof = varying.size - varying.shape[1] * len({row.run for row in good})
    spread, spread_noise = _largest(rows, lambda row: (row.spread_dph, row.spread_noise_dph))
    velocity, velocity_noise = _largest(rows, lambda row: (row.velocity_east_mps, row.velocity_noise_mps))
    position, position_noise = _largest(rows, lambda row: (row.position_nmi, row.position_noise_nmi))
    return ComparisonRow(
        compensation=compensation,
        stop=ALL_STOPS,
        cycle=None,
        chamber_set_c=None,
        gyro_c=None,
        fit="",
        dwells=len(good),
        bias_rms_dph=_rms(np.array([row.bias_dph for row in good])),
        bias_noise_dph=_rms(sigma),
        varying_rms_dph=_rms(varying),
        varying_p_value=float(chi2.sf(np.sum((varying / sigma) ** 2), dof)) if dof > 0 else math.nan,
        spread_dph=spread,
        spread_noise_dph=spread_noise,
        velocity_east_mps=velocity,
        velocity_noise_mps=velocity_noise,
        position_nmi=position,
        position_noise_nmi=position_noise,
    )


def _largest(
    rows: Sequence[ComparisonRow], of: Callable[[ComparisonRow], tuple[float, float]]
) -> tuple[float, float]:
    """Largest size, and the noise in its place; both NaN where there is none."""
    known = [of(row) for row in rows if not math.isnan(of(row)[0])]
    return max(known, default=(math.nan, math.nan))


def _fit(gyro_c: float, fitted_c: FloatArray) -> str:
    means_c = fitted_c.mean(axis=1)
    if np.abs(means_c - gyro_c).min() <= FITTED_WITHIN_K:
        return "fitted"
    return "between" if means_c.min() < gyro_c < means_c.max() else "outside"


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else math.nan
