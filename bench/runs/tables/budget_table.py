"""Uncertainty budgets as a table: ``budget.csv``, a row for each contribution and for each sum."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any

from gyrobench.bench.bias.budget import SOURCES, BiasBudget, Budget, Combined
from gyrobench.bench.calibration.coefficients import Coefficient
from gyrobench.bench.foundations.csv_tables import CsvTable, format_rows, read_rows, write_text

#: Names of the sums in the column ``contribution``: the stated uncertainty, and that with what lies outside.
COMBINED, ANY_POWER_CYCLE = "combined", "combined_any_power_cycle"


@dataclass(frozen=True, kw_only=True, slots=True)
class BudgetRow:
    """A contribution to the uncertainty of one result, or a sum."""

    result: str  #: ``dwell``, ``bin`` or ``coefficient``.
    quantity: str  #: ``gyro_bias``, or the name of the coefficient.
    axis: str  #: "x", "y" or "z"; of misalignments the sensor and the axis that it senses.
    dwell: int | None = None  #: Number of the dwell; None for other results.
    plateau: int | None = None  #: Number of the plateau; None but for coefficients.
    position: str = ""  #: Position of the unit; empty for coefficients.
    #: bin_low_c, bin_high_c: Range of the gyro's temperature; NaN but for bins.
    bin_low_c: float = math.nan
    bin_high_c: float = math.nan
    contribution: str  #: Key of :data:`gyrobench.bench.bias.budget.SOURCES`, or name of a sum.
    type: str = ""  #: "A" or "B"; empty for a sum.
    distribution: str  #: ``normal`` or ``rectangular``; ``t`` for a sum with finite degrees of freedom.
    #: input_sigma, input_unit: Standard uncertainty of the input quantity; NaN where it has none.
    input_sigma: float = math.nan
    input_unit: str = ""
    sensitivity: float = math.nan  #: Unit of the result per unit of the input; NaN likewise.
    sigma: float  #: Standard uncertainty of the result by this; NaN where not evaluated.
    unit: str  #: Of the result.
    share: float  #: Share of the stated variance; NaN for what lies outside.
    dof: float  #: Degrees of freedom, of a sum the effective ones; infinite where declared.
    #: k, expanded: Coverage factor for 95 % and expanded uncertainty of a sum; NaN for contributions.
    k: float = math.nan
    expanded: float = math.nan
    note: str = ""

    @property
    def is_sum(self) -> bool:
        """Whether this is a sum of contributions."""
        return self.contribution in (COMBINED, ANY_POWER_CYCLE)


_COLUMNS = tuple(field.name for field in fields(BudgetRow))


def budget_rows(budgets: Iterable[BiasBudget]) -> list[BudgetRow]:
    """Rows of biases, in deg/h."""
    return [
        row
        for each in budgets
        for row in rows_of(
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


def coefficient_budget_rows(plateau: int, budgets: Iterable[tuple[Coefficient, Budget]]) -> list[BudgetRow]:
    """Rows of the coefficients of one plateau, in their units."""
    return [
        row
        for coefficient, budget in budgets
        for row in rows_of(
            budget,
            coefficient.unit,
            result="coefficient",
            quantity=coefficient.name,
            axis=coefficient.axis,
            plateau=plateau,
        )
    ]


def rows_of(budget: Budget, unit: str, **result: Any) -> Iterator[BudgetRow]:
    """Rows of one budget in a unit; ``result`` is the fields that say of what."""
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
    yield _sum(COMBINED, stated, unit, 1.0, "", result)
    if budget.any_power_cycle:
        note = "with temperature sensor and repeatability, as far as evaluated"
        yield _sum(ANY_POWER_CYCLE, budget.any_power_cycle, unit, math.nan, note, result)


def _sum(
    name: str, combined: Combined, unit: str, share: float, note: str, result: Mapping[str, Any]
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


def write_budget(path: Path, rows: Iterable[BudgetRow]) -> None:
    """Write ``budget.csv``. Raises RunFolderError if the file can't be written."""
    write_text(path, format_rows(_COLUMNS, rows))


def read_budget(path: Path) -> list[BudgetRow]:
    """Read ``budget.csv``; errors as for :func:`gyrobench.bench.foundations.csv_tables.read_rows`."""
    return read_rows(path, BudgetRow, {"dof": _dof})


#: Coverage factor and expanded uncertainty by quantity, axis, and position and lower end of the bin in degC,
#: or number of the plateau.
Coverage = Mapping[tuple[str, str, str | int | None, float], tuple[float, float]]


def coverage(rows: Iterable[BudgetRow]) -> Coverage:
    """Coverage of the results of bins and plateaus, in their units."""
    return {
        (row.quantity, row.axis, row.position or row.plateau, row.bin_low_c if row.position else 0.0): (
            row.k,
            row.expanded,
        )
        for row in rows
        if row.contribution == COMBINED and row.result != "dwell"
    }


def _dof(table: CsvTable, index: int, name: str) -> float:
    is_infinite = table.text(index, name) == "inf"
    return math.inf if is_infinite else table.number(index, name, may_be_empty=True)


def budget_records(rows: Sequence[BudgetRow]) -> list[dict[str, Any]]:
    """One object for each result, with its sums and its contributions; what is not known is left out."""
    of = attrgetter("result", "quantity", "axis", "dwell", "plateau", "position", "bin_low_c", "unit")
    records = []
    for _, group in groupby(rows, key=lambda row: str(of(row))):
        members = list(group)
        first = members[0]
        head = (
            *("result", "quantity", "axis", "dwell", "plateau", "position", "bin_low_c", "bin_high_c"),
            "unit",
        )
        record = _known({name: getattr(first, name) for name in head})
        rest = [name for name in _COLUMNS if name not in (*head, "contribution")]
        named = {row.contribution: _known({name: getattr(row, name) for name in rest}) for row in members}
        sums = {name: named.pop(name) for name in (COMBINED, ANY_POWER_CYCLE) if name in named}
        records.append(record | sums | {"contributions": named})
    return records


def _known(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values that are known; infinite degrees of freedom, which JSON has no number for, are left out."""
    return {
        name: value
        for name, value in values.items()
        if value not in (None, "") and not (isinstance(value, float) and not math.isfinite(value))
    }
