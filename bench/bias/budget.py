"""Uncertainty budgets of measured biases, by dwell and by bin.

The error of a bias is a sum of independent contributions, whose variances add up to the stated one. In the
mean of several dwells, noise averages out. Errors that are the same in each dwell do not: those of scale
factor, misalignment, accelerometers, latitude and temperature slope add with their signs.

Two contributions are not part of the stated uncertainty, which applies to the power cycle measured and the
temperature indicated: the error of the gyro's temperature sensor, and the repeatability between power cycles.
If they are known, a second sum includes them.

References
----------
JCGM 100:2008, 5.1.2 (combined standard uncertainty), 6.2 and 6.3 (expanded uncertainty), G.4 (effective
degrees of freedom, Welch-Satterthwaite).
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrobench.bench.bias.bins import BiasBin, curve_of_dwells
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.error_sources import SOURCES
from gyrobench.bench.bias.error_split import (
    ErrorPart,
    SplitErrors,
    mean_error,
    scatter_variances,
    split_errors,
)
from gyrobench.bench.foundations.arrays import DPH_TO_RADPS, RADPS_TO_DPH, FloatArray
from gyrobench.bench.navigation.positions import AXES

#: Coverage probability of expanded uncertainties, and its factor for a normal distribution.
COVERAGE = 0.95
NORMAL_K = 1.959963984540054


_SETTLED_NOTE = "not significant in the data (p ≥ 0.01): taken as zero"


@dataclass(frozen=True, slots=True)
class Contribution:
    """Contribution of one source to the uncertainty of a result."""

    source: str  #: Key of :data:`~gyrobench.bench.bias.error_sources.SOURCES`.
    #: Standard uncertainty of the input quantity, in the unit of the source; NaN if it has none.
    input_sigma: float
    sigma: float  #: Standard uncertainty of the result by this source, in its unit; NaN if not evaluated.
    dof: float = math.inf  #: Degrees of freedom; infinite if declared.
    distribution: str = "normal"
    is_within: bool = True  #: Whether it is part of the stated uncertainty.
    note: str = ""

    @property
    def evaluation(self) -> str:
        """Type of evaluation: "A" from repeated observations, otherwise "B"."""
        return "A" if math.isfinite(self.dof) else "B"

    @property
    def sensitivity(self) -> float:
        """Sensitivity coefficient: unit of the result per unit of the input; NaN if there is no input.

        For a source with several components of equal uncertainty, such as one for each axis, it is the root
        sum of squares over them.
        """
        return self.sigma / self.input_sigma if self.input_sigma > 0.0 else math.nan


#: Effective degrees of freedom above this count as infinite.
_MANY_DOF = 1e9


@dataclass(frozen=True)
class CombinedUncertainty:
    """Combined and expanded uncertainty of several contributions."""

    sigma: float  #: Combined standard uncertainty.
    dof: float  #: Effective degrees of freedom.

    @classmethod
    def of(cls, contributions: Iterable[Contribution]) -> CombinedUncertainty:
        """Combine independent contributions; those not evaluated are left out."""
        evaluated = [each for each in contributions if each.sigma > 0.0]
        variance = math.fsum(each.sigma**2 for each in evaluated)
        fourth = math.fsum(each.sigma**4 / each.dof for each in evaluated)
        dof = variance**2 / fourth if fourth else math.inf
        return cls(math.sqrt(variance), dof if dof < _MANY_DOF else math.inf)

    @property
    def k(self) -> float:
        """Coverage factor for a probability of 95 %."""
        return coverage_factor(self.dof)

    @property
    def expanded(self) -> float:
        """Expanded uncertainty for a coverage probability of 95 %."""
        return self.k * self.sigma


def coverage_factor(dof: float) -> float:
    """Half-width of the 95 % interval of Student's distribution."""
    if math.isinf(dof):
        return NORMAL_K
    from scipy.special import stdtrit

    return float(stdtrit(dof, 0.5 * (1.0 + COVERAGE)))


@dataclass(frozen=True, slots=True)
class Budget:
    """Uncertainty budget of one result."""

    contributions: tuple[Contribution, ...]

    @property
    def stated(self) -> CombinedUncertainty:
        """The stated uncertainty."""
        return CombinedUncertainty.of(each for each in self.contributions if each.is_within)

    @property
    def any_power_cycle(self) -> CombinedUncertainty | None:
        """Uncertainty including the contributions outside the stated one; None if none of these is known."""
        if any(not each.is_within and not math.isnan(each.sigma) for each in self.contributions):
            return CombinedUncertainty.of(self.contributions)
        return None


@dataclass(frozen=True, slots=True)
class BiasBudget:
    """Budget of the bias of one gyro, in deg/h, in a dwell or in a bin."""

    gyro: str  #: "x", "y" or "z".
    position: str
    budget: Budget
    dwell: int | None  #: Number of the dwell; None for a bin.
    #: bin_low_c, bin_high_c: Range of the gyro's temperature; NaN for a dwell.
    bin_low_c: float = math.nan
    bin_high_c: float = math.nan


@dataclass(frozen=True, eq=False, slots=True)
class BudgetedDwell:
    """A dwell with the errors of its biases by source."""

    row: DwellRow
    parts: Mapping[str, ErrorPart]


@dataclass(frozen=True)
class BudgetInputs:
    """Inputs of budgets in addition to the dwells."""

    #: velocity_resolution_mps, heading_resolution_rad: Standard uncertainties due to the outputs' resolution.
    velocity_resolution_mps: float = 0.0
    heading_resolution_rad: float = 0.0
    #: Standard uncertainty of a gyro's temperature sensor, K; None if not declared.
    temperature_c: float | None = None


def dwell_budgets(dwells: Sequence[BudgetedDwell], inputs: BudgetInputs) -> Iterator[BiasBudget]:
    """Budgets of the biases of the dwells of a run, one after the other."""
    external = _external_errors(dwells, inputs)
    for each in dwells:
        for axis, gyro in enumerate(AXES):
            budget = _budget(axis, [each], [1.0], inputs, external[axis])
            yield BiasBudget(gyro, each.row.position, budget, each.row.dwell)


def bin_budgets(
    dwells: Sequence[BudgetedDwell], bins: Sequence[BiasBin], inputs: BudgetInputs
) -> list[BiasBudget]:
    """Budgets of the bins that contain dwells without flags."""
    external, result = _external_errors(dwells, inputs), []
    for each in bins:
        axis = AXES.index(each.gyro)
        members = [
            dwell
            for dwell in dwells
            if dwell.row.position == each.position
            and not dwell.row.flags
            and each.bin_low_c <= dwell.row.gyro_c[axis] < each.bin_high_c
        ]
        if members:
            weights = np.array([dwell.row.sigma_dph[axis] ** -2.0 for dwell in members])
            budget = _budget(axis, members, (weights / weights.sum()).tolist(), inputs, external[axis])
            result.append(BiasBudget(each.gyro, each.position, budget, None, each.bin_low_c, each.bin_high_c))
    return result


def coefficient_budget(
    variances: Mapping[str, float], inputs: Mapping[str, float], misfit_dof: float
) -> Budget:
    """Budget of a coefficient.

    ``variances``: by key of :data:`SOURCES`, in the square of the coefficient's unit; ``inputs``: standard
    uncertainty of the inputs that have one, SI; ``misfit_dof``: degrees of freedom of the residuals.
    """
    contributions = [
        Contribution(
            name,
            inputs.get(name, math.nan) * SOURCES[name].per_si,
            math.sqrt(max(variances[name], 0.0)),
            misfit_dof if name == "misfit" and variances[name] > 0.0 else math.inf,
            "rectangular" if name == "temperature_change" else "normal",
            note=SOURCES[name].note or "noise of the increments at rest, or declared in ins.noise",
        )
        for name in SOURCES
        if name in variances
    ]
    note = "not evaluated: the coefficients are those of one power cycle"
    external = Contribution("power_cycles", math.nan, math.nan, is_within=False, note=note)
    return Budget((*contributions, external))


def with_budgets(bins: Sequence[BiasBin], budgets: Iterable[BiasBudget]) -> list[BiasBin]:
    """Bins with the uncertainties of their budgets, in which common errors do not average out."""
    sigmas = {(each.gyro, each.position, each.bin_low_c): each.budget.stated.sigma for each in budgets}
    return [
        replace(each, sigma_dph=sigmas.get((each.gyro, each.position, each.bin_low_c), each.sigma_dph))
        for each in bins
    ]


@dataclass(frozen=True, eq=False)
class _ExternalErrors:
    """Errors of one gyro's bias that are not part of the stated uncertainty."""

    #: Repeatability between power cycles: standard deviation, deg/h, NaN if not evaluated; its degrees of
    #: freedom; and a note.
    sigma_dph: float
    dof: float
    note: str
    #: For each position: polynomial of the bias over the gyro's temperature; None with fewer than two
    #: temperatures.
    curves: Mapping[str, np.poly1d | None]


def _external_errors(dwells: Sequence[BudgetedDwell], inputs: BudgetInputs) -> list[_ExternalErrors]:
    good = [each for each in dwells if not each.row.flags]
    errors = split_errors({each.row.dwell: each.parts for each in good})
    of_positions: dict[str, list[DwellRow]] = defaultdict(list)
    for each in good if inputs.temperature_c else ():
        of_positions[each.row.position].append(each.row)
    return [
        _ExternalErrors(
            *_between_power_cycles(axis, [each.row for each in good], errors),
            {position: _curve(rows, axis) for position, rows in of_positions.items()},
        )
        for axis in range(3)
    ]


#: Range of temperatures within which power cycles are compared, K.
_PLATEAU_C = 5.0


def _between_power_cycles(
    axis: int, rows: Sequence[DwellRow], errors: SplitErrors
) -> tuple[float, float, str]:
    """Standard deviation of a gyro's bias between power cycles without noise, deg/h, its dof, and a note.

    Power cycles are compared by position at one temperature, to which the curve of the gyro reduces them. Its
    uncertainty counts as noise.
    """
    cells: list[dict[str, list[DwellRow]]] = []
    lowest: DwellRow | None = None
    for row in sorted(rows, key=lambda each: (each.position, each.gyro_c[axis])):
        if (
            lowest is None
            or row.position != lowest.position
            or row.gyro_c[axis] - lowest.gyro_c[axis] > _PLATEAU_C
        ):
            lowest = row
            cells.append(defaultdict(list))
        cells[-1][row.run].append(row)
    repeated = [by_run for by_run in cells if len(by_run) > 1]
    if not repeated:
        return (
            math.nan,
            math.inf,
            "not evaluated: no position and temperature was measured in two power cycles",
        )
    runs = {run for by_run in repeated for run in by_run}
    curve = curve_of_dwells(axis, rows)
    squares, noise, dof = 0.0, 0.0, 0
    for by_run in repeated:
        gyro_c, bias_dph = (
            np.array([np.mean([getattr(row, name)[axis] for row in each]) for each in by_run.values()])
            for name in ("gyro_c", "bias_dph")
        )
        mean_errors = [
            mean_error([errors[row.dwell] for row in each], np.full((len(each), 3), 1.0 / len(each)))
            for each in by_run.values()
        ]
        variances = scatter_variances(mean_errors)[:, axis]
        means, by_curve, _ = curve.reduce(bias_dph, np.sqrt(variances), gyro_c, float(gyro_c.mean()))
        squares += float(np.sum((means - means.mean()) ** 2))
        noise += float(np.mean(variances)) * (len(means) - 1)
        noise += float(np.trace(by_curve)) - float(by_curve.mean(axis=0).sum())
        dof += len(means) - 1
    sigma = math.sqrt(max(squares - noise, 0.0) / dof)
    note = f"{len(runs)} power cycles" + ("" if sigma else ": no more than the noise")
    return sigma, len(runs) - 1.0, note


def _curve(rows: Sequence[DwellRow], axis: int) -> np.poly1d | None:
    temperatures = [row.gyro_c[axis] for row in rows]
    distinct = len({round(each / _PLATEAU_C) for each in temperatures})
    if distinct < 2:
        return None
    return np.poly1d(np.polyfit(temperatures, [row.bias_dph[axis] for row in rows], min(2, distinct - 1)))


def _budget(
    axis: int,
    dwells: Sequence[BudgetedDwell],
    weights: Sequence[float],
    inputs: BudgetInputs,
    external: _ExternalErrors,
) -> Budget:
    """Budget of a weighted mean of dwells."""
    parts = [_parts_as_stated(axis, dwell) for dwell in dwells]
    names = [name for name in SOURCES if any(name in each for each in parts)]
    resolutions = {
        "velocity_output": inputs.velocity_resolution_mps,
        "heading_output": inputs.heading_resolution_rad,
    }
    contributions = []
    for name in names:
        of_source = [
            (each[name], weight) for each, weight in zip(parts, weights, strict=True) if name in each
        ]
        combine = _common_sigma if SOURCES[name].is_common else _independent_sigma
        sigma, dof = combine([(part.columns[axis] * RADPS_TO_DPH, part.dof, w) for part, w in of_source])
        input_sigma = math.sqrt(float(np.mean([part.sigma**2 for part, _ in of_source])))
        is_resolution = math.isinf(dof) and 0.0 < input_sigma <= 1.001 * resolutions.get(name, 0.0)
        note = SOURCES[name].note or "declared in ins.noise"
        if is_resolution:
            note = "resolution of the output"
        elif math.isfinite(dof):
            note = "estimated from the output of the dwell"
        contributions.append(
            Contribution(
                name,
                input_sigma * SOURCES[name].per_si,
                sigma,
                dof,
                "rectangular" if is_resolution else "normal",
                note=note,
            )
        )
    if "accelerometer_settling" not in names:
        contributions.append(Contribution("accelerometer_settling", math.nan, math.nan, note=_SETTLED_NOTE))
    return Budget((*contributions, *_external_contributions(dwells, inputs, external, axis, weights)))


def _parts_as_stated(axis: int, dwell: BudgetedDwell) -> Mapping[str, ErrorPart]:
    """Parts whose variances add up to the stated variance of a gyro.

    The original ones do, except for a vertical gyro whose bias was corrected for a wrong latitude: there, the
    difference from the stated variance is attributed to the latitude.
    """
    stated = (dwell.row.sigma_dph[axis] * DPH_TO_RADPS) ** 2
    variances = {name: float(np.sum(part.columns[axis] ** 2)) for name, part in dwell.parts.items()}
    total = math.fsum(variances.values())
    if "latitude" not in variances or abs(stated - total) <= 1e-6 * total:
        return dwell.parts
    others = total - variances["latitude"]
    factors, latitude_sigma = np.ones(3), math.sqrt(max(stated - others, 0.0))
    factors[axis] = math.sqrt(min(stated / others, 1.0))
    changed = {name: part.scaled(factors) for name, part in dwell.parts.items()}
    latitude_column, latitude = np.zeros((3, 1)), dwell.parts["latitude"]
    latitude_column[axis] = latitude_sigma
    is_corrected = variances["latitude"] > 1e-6 * total
    factor = latitude_sigma / math.sqrt(variances["latitude"]) if is_corrected else 1.0
    return changed | {"latitude": replace(latitude, columns=latitude_column, sigma=factor * latitude.sigma)}


_Weighted = Sequence[tuple[FloatArray, float, float]]


def _common_sigma(errors: _Weighted) -> tuple[float, float]:
    """Standard uncertainty and dof of a mean, due to components (m,) that are the same in all dwells."""
    total = np.zeros(max(len(columns) for columns, _, _ in errors))
    for columns, _, weight in errors:
        total[: len(columns)] += weight * columns
    return float(np.linalg.norm(total)), min(dof for _, dof, _ in errors)


def _independent_sigma(errors: _Weighted) -> tuple[float, float]:
    """Standard uncertainty and dof of a mean, due to components that are independent between dwells."""
    variances = [float(np.sum((weight * columns) ** 2)) for columns, _, weight in errors]
    total = math.fsum(variances)
    fourth = math.fsum(variance**2 / dof for variance, (_, dof, _) in zip(variances, errors, strict=True))
    return math.sqrt(total), total**2 / fourth if fourth else math.inf


def _external_contributions(
    dwells: Sequence[BudgetedDwell],
    inputs: BudgetInputs,
    external: _ExternalErrors,
    axis: int,
    weights: Sequence[float],
) -> tuple[Contribution, Contribution]:
    by_run: dict[str, float] = defaultdict(float)
    for dwell, weight in zip(dwells, weights, strict=True):
        by_run[dwell.row.run] += weight
    repeated = external.sigma_dph * math.sqrt(math.fsum(weight**2 for weight in by_run.values()))
    cycles = Contribution(
        "power_cycles", external.sigma_dph, repeated, external.dof, is_within=False, note=external.note
    )
    curve = external.curves.get(dwells[0].row.position)
    if inputs.temperature_c is None:
        note = "not evaluated: ins.uncertainty.gyro_temperature_c is not declared"
    elif curve is None:
        note = "not evaluated: the bias's slope needs two temperatures in this position"
    else:
        slopes = [abs(float(curve.deriv()(dwell.row.gyro_c[axis]))) for dwell in dwells]
        slope = math.fsum(weight * each for weight, each in zip(weights, slopes, strict=True))
        sensor = Contribution(
            "temperature_sensor",
            inputs.temperature_c,
            slope * inputs.temperature_c,
            is_within=False,
            note="declared in ins.uncertainty; sensitivity is the slope of the measured biases",
        )
        return sensor, cycles
    input_sigma = math.nan if inputs.temperature_c is None else inputs.temperature_c
    return Contribution("temperature_sensor", input_sigma, math.nan, is_within=False, note=note), cycles
