"""Uncertainty budgets as a table: ``budget.csv``, a row for each contribution and for each sum."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import groupby
from operator import attrgetter
from typing import Any

from gyrobench.bench.bias.budget import BiasBudget, Budget, CombinedUncertainty
from gyrobench.bench.bias.error_sources import SOURCES
from gyrobench.bench.calibration.coefficients import SensorCoefficient
from gyrobench.bench.foundations.arrays import RAD_TO_ARCMIN
from gyrobench.bench.foundations.csv_tables import CsvTable, RecordTable
from gyrobench.bench.navigation.positions import AXES, POSITIONS

#: Names of the sums in the column ``contribution``: the stated uncertainty, and that for any power cycle.
COMBINED, ANY_POWER_CYCLE = "combined", "combined_any_power_cycle"


@dataclass(frozen=True, kw_only=True, slots=True)
class BudgetRow:
    """A contribution to the uncertainty of one result, or a sum."""

    result: str  #: ``dwell``, ``bin`` or ``coefficient``.
    quantity: str  #: ``gyro_bias``, or the name of the coefficient.
    axis: str  #: "x", "y" or "z"; of a misalignment the sensor and the axis that it senses.
    dwell: int | None = None  #: Number of the dwell; None for other results.
    plateau: int | None = None  #: Number of the plateau; None except for coefficients.
    position: str = ""  #: Position of the unit; empty for coefficients.
    #: bin_low_c, bin_high_c: Range of the gyro's temperature; NaN except for bins.
    bin_low_c: float = math.nan
    bin_high_c: float = math.nan
    contribution: str  #: Key of :data:`gyrobench.bench.bias.budget.SOURCES`, or name of a sum.
    type: str = ""  #: "A" or "B"; empty for a sum.
    distribution: str  #: ``normal`` or ``rectangular``; ``t`` for a sum with finite degrees of freedom.
    #: input_sigma, input_unit: Standard uncertainty of the input quantity; NaN if there is none.
    input_sigma: float = math.nan
    input_unit: str = ""
    sensitivity: float = math.nan  #: Unit of the result per unit of the input; NaN likewise.
    sigma: float  #: Standard uncertainty of the result due to this contribution; NaN if not evaluated.
    unit: str  #: Of the result.
    share: float  #: Share of the stated variance; NaN if not included in it.
    dof: float  #: Degrees of freedom, effective ones of a sum; infinite for declared values.
    #: k, expanded: Coverage factor for 95 % and expanded uncertainty of a sum; NaN for contributions.
    k: float = math.nan
    expanded: float = math.nan
    note: str = ""

    @property
    def is_sum(self) -> bool:
        """Whether this is a sum of contributions."""
        return self.contribution in (COMBINED, ANY_POWER_CYCLE)


def budget_rows(budgets: Iterable[BiasBudget]) -> list[BudgetRow]:
    """Rows of biases, in deg/h."""
    return [
        row
        for each in budgets
        for row in _rows_of(
            each.budget,
            "deg/h",
            result="bin" if each.dwell is None else "dwell",
            quantity="gyro_bias",
            axis=each.gyro,
            dwell=each.dwell,
            position=each.position,
            bin_low_c=each.bin_low_c,
            bin_high_c=each.bin_high_c,
        )
    ]


def coefficient_budget_rows(
    plateau: int, budgets: Iterable[tuple[SensorCoefficient, Budget]]
) -> list[BudgetRow]:
    """Rows of the coefficients of one plateau, in their units."""
    return [
        row
        for coefficient, budget in budgets
        for row in _rows_of(
            budget,
            coefficient.unit,
            result="coefficient",
            quantity=coefficient.name,
            axis=coefficient.axis,
            plateau=plateau,
        )
    ]


def _rows_of(budget: Budget, unit: str, **result: Any) -> Iterator[BudgetRow]:
    """Rows of one budget, in ``unit``; ``result``: fields that identify the result."""
    stated = budget.stated
    for each in budget.contributions:
        yield BudgetRow(
            **result,
            contribution=each.source,
            type=each.evaluation,
            distribution=each.distribution,
            input_sigma=each.input_sigma,
            input_unit=SOURCES[each.source].unit,
            sensitivity=each.sensitivity,
            sigma=each.sigma,
            unit=unit,
            share=(each.sigma / stated.sigma) ** 2 if each.is_within else math.nan,
            dof=each.dof,
            note=each.note,
        )
    yield _sum_row(COMBINED, stated, unit, 1.0, "", result)
    if budget.any_power_cycle:
        note = "with temperature sensor and repeatability, as far as evaluated"
        yield _sum_row(ANY_POWER_CYCLE, budget.any_power_cycle, unit, math.nan, note, result)


def _sum_row(
    name: str, combined: CombinedUncertainty, unit: str, share: float, note: str, result: Mapping[str, Any]
) -> BudgetRow:
    return BudgetRow(
        **result,
        contribution=name,
        distribution="normal" if math.isinf(combined.dof) else "t",
        sigma=combined.sigma,
        unit=unit,
        share=share,
        dof=combined.dof,
        k=combined.k,
        expanded=combined.expanded,
        note=note,
    )


#: Note for a latitude whose error, by the data, exceeds the declared uncertainty.
_ESTIMATED_LATITUDE = "estimated from the data, in place of location.latitude_uncertainty_arcmin"


def note_estimated_latitude(rows: Iterable[BudgetRow], declared_rad: float) -> Iterator[BudgetRow]:
    """The rows, with a note on an uncertainty of the latitude that differs from the declared one."""
    for row in rows:
        is_estimated = row.contribution == "latitude" and not math.isclose(
            row.input_sigma, declared_rad * RAD_TO_ARCMIN, rel_tol=1e-3
        )
        yield replace(row, note=_ESTIMATED_LATITUDE) if is_estimated else row


def _dof(table: CsvTable, index: int, name: str) -> float:
    is_infinite = table.text(index, name) == "inf"
    return math.inf if is_infinite else table.number(index, name, may_be_empty=True)


#: ``budget.csv``.
BUDGET_TABLE = RecordTable(BudgetRow, {"dof": _dof})


@dataclass
class ContributionSummary:
    """Statistics of one contribution to several results, or of their sum."""

    example: BudgetRow  #: First row; the first with a known uncertainty if there is one.
    count: int = 0  #: Number of results.
    #: known_count, variance: Number of known uncertainties, and the sum of their squares.
    known_count: int = 0
    variance: float = 0.0
    expanded_square: float = 0.0  #: Sum of the squares of the expanded uncertainties.
    #: sensitivity_count, sensitivity_square, share_count, share: Numbers of known values, and sums of squared
    #: sensitivities and of shares.
    sensitivity_count: int = 0
    sensitivity_square: float = 0.0
    share_count: int = 0
    share: float = 0.0
    #: Smallest degrees of freedom of known uncertainties.
    dof: float = math.inf
    #: input_sigma, k: Smallest and largest value; (infinity, -infinity) without values.
    input_sigma: tuple[float, float] = (math.inf, -math.inf)
    k: tuple[float, float] = (math.inf, -math.inf)
    is_estimated: bool = True  #: Whether all are estimated from the data.
    is_declared: bool = True  #: Whether none is estimated from the data.

    def add(self, row: BudgetRow) -> None:
        """Add one result."""
        self.count += 1
        is_estimated = row.type == "A" or row.note == _ESTIMATED_LATITUDE
        self.is_estimated &= is_estimated
        self.is_declared &= not is_estimated
        if row.input_sigma > 0.0:
            self.input_sigma = _extend(self.input_sigma, row.input_sigma)
        if math.isnan(row.sigma):
            return
        if not self.known_count:
            self.example = row
        self.known_count += 1
        self.variance += row.sigma**2
        self.dof = min(self.dof, row.dof)
        if not math.isnan(row.sensitivity):
            self.sensitivity_count += 1
            self.sensitivity_square += row.sensitivity**2
        if not math.isnan(row.share):
            self.share_count += 1
            self.share += row.share
        if not math.isnan(row.k):
            self.k = _extend(self.k, row.k)
            self.expanded_square += row.expanded**2


def _extend(limits: tuple[float, float], value: float) -> tuple[float, float]:
    return min(limits[0], value), max(limits[1], value)


@dataclass(frozen=True)
class BudgetSummary:
    """Budgets of a run, those of its many dwells summarised."""

    #: Biases in dwells, by gyro and whether it was vertical, and by contribution.
    dwells: dict[tuple[str, bool], dict[str, ContributionSummary]] = field(default_factory=dict)
    #: The same for all three gyros together.
    all_gyros: dict[bool, dict[str, ContributionSummary]] = field(default_factory=dict)
    #: Stated uncertainties of bins and coefficients.
    stated: list[BudgetRow] = field(default_factory=list)

    @classmethod
    def of(cls, rows: Iterable[BudgetRow]) -> BudgetSummary:
        """Summarise a table."""
        result = cls()
        for row in rows:
            groups = []
            if row.result == "dwell":
                is_vertical = AXES[POSITIONS[row.position].up_axis] == row.axis
                groups.append(result.dwells.setdefault((row.axis, is_vertical), {}))
                groups.append(result.all_gyros.setdefault(is_vertical, {}))
            elif row.contribution == COMBINED:
                result.stated.append(row)
            for group in groups:
                if row.contribution not in group:
                    group[row.contribution] = ContributionSummary(row)
                group[row.contribution].add(row)
        return result

    def dwells_dof(self, gyro: str) -> float:
        """Smallest degrees of freedom of a gyro's biases in dwells; infinite if there is none."""
        dofs = [
            contributions[COMBINED].dof for (axis, _), contributions in self.dwells.items() if axis == gyro
        ]
        return min(dofs, default=math.inf)


#: Coverage factor and expanded uncertainty by quantity, axis, and position and lower end of the bin in degC,
#: or number of the plateau.
Coverage = Mapping[tuple[str, str, str | int | None, float], tuple[float, float]]


def coverage(budget: BudgetSummary) -> Coverage:
    """Coverage of the results of bins and plateaus, in their units."""
    return {
        (row.quantity, row.axis, row.position or row.plateau, row.bin_low_c if row.position else 0.0): (
            row.k,
            row.expanded,
        )
        for row in budget.stated
    }


def budget_records(rows: Iterable[BudgetRow]) -> list[dict[str, Any]]:
    """One object for each result, with its sums and its contributions; unknown values are omitted."""
    identity = (
        "result", "quantity", "axis", "dwell", "plateau", "position", "bin_low_c", "bin_high_c", "unit",
    )  # fmt: skip
    result_of, records = attrgetter(*identity), []
    for _, group in groupby(rows, key=lambda row: str(result_of(row))):
        members = list(group)
        first = members[0]
        record = _without_unknown({name: getattr(first, name) for name in identity})
        details = [name for name in BUDGET_TABLE.columns if name not in (*identity, "contribution")]
        contributions = {
            row.contribution: _without_unknown({name: getattr(row, name) for name in details})
            for row in members
        }
        sums = {
            name: contributions.pop(name) for name in (COMBINED, ANY_POWER_CYCLE) if name in contributions
        }
        records.append(record | sums | {"contributions": contributions})
    return records


def _without_unknown(values: Mapping[str, Any]) -> dict[str, Any]:
    """Known values, without infinite degrees of freedom, which JSON can't represent."""
    return {
        name: value
        for name, value in values.items()
        if value not in (None, "") and not (isinstance(value, float) and not math.isfinite(value))
    }
