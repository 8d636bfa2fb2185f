"""Coefficients of the sensors over temperature in the report of a run."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial

from gyrobench.bench.calibration.results import NOT_OBSERVABLE
from gyrobench.bench.foundations.text import counted, decimals_of
from gyrobench.bench.report.figures.coefficients import COEFFICIENT_NAMES, coefficients_figure, unit_text
from gyrobench.bench.report.page import Section, SectionFigure, SectionTable
from gyrobench.bench.runs.tables.budget_table import BudgetSummary
from gyrobench.bench.runs.tables.coefficient_table import (
    FRAME_TEXT,
    TEMPERATURE_TEXT,
    PlateauCoefficientRow,
    plateau_findings,
    plateau_heads,
    plateau_notes,
)

_TITLE = "Coefficients of gyros and accelerometers"
_TABLE = "Value ± standard uncertainty (k = 1) at each plateau"
_TEXT = (
    "Biases, scale factor errors and misalignments at each plateau, from its dwells and its rotations "
    f"together, with standard uncertainties. {FRAME_TEXT} {TEMPERATURE_TEXT}"
)
_NONE = "The rotations of this run give no coefficients."
_OVERVIEW = "Coefficients at {}{}: values of all axes, largest change of one between plateaus (its axis)"
_WITHOUT_FORCE = (
    "The INS sends no specific forces: rotations are evaluated from its velocity and attitude, which do not "
    "show the vertical specific force. The last table has the standard uncertainties expected with specific "
    "forces."
)
_CAPTION = (
    "Coefficients over the temperature of the gyro, for accelerometers that of the case; lines join the "
    "plateaus of a cycle in the order of time. Bars are expanded uncertainties (95 %), where they are larger "
    "than the marker."
)
_NOT_OBSERVED = "–"
#: Plateaus side by side; of more than these the uncertainties stand below the values.
_PER_TABLE, _PER_WIDE_TABLE = 5, 3


def has_rotations(rows: Sequence[PlateauCoefficientRow]) -> bool:
    """Whether there is more than dwells alone show."""
    return any(
        not math.isnan(row.sigma_with_force)
        or (row.coefficient == "accelerometer_scale_factor" and not math.isnan(row.value))
        for row in rows
    )


def coefficients_section(
    rows: Sequence[PlateauCoefficientRow], budget: BudgetSummary | None = None
) -> Section | None:
    """Tables and figure with the expanded uncertainties of the budget; None without rotations.

    Of rotations that give nothing at any plateau it states why.
    """
    if not has_rotations(rows):
        why = plateau_findings(rows)
        return Section(_TITLE, [_NONE, *why]) if why else None
    tables = list(_tables(rows))
    missing = _not_observable(rows).items()
    open_axes = "; ".join(f"{COEFFICIENT_NAMES[name]} {', '.join(axes)}" for name, axes in missing)
    notes = [f"Not observable ({_NOT_OBSERVED}): {open_axes}."] if open_axes else []
    notes += [*plateau_findings(rows), *plateau_notes(rows)]
    if any(not math.isnan(row.sigma_with_force) for row in rows):
        notes.insert(0, _WITHOUT_FORCE)
        tables.append(_cost_table(rows))
    figure = SectionFigure("coefficients", _CAPTION, partial(coefficients_figure, rows, budget))
    return Section(_TITLE, [_TEXT, *notes], [figure], tables)


def coefficients_overview(rows: Sequence[PlateauCoefficientRow]) -> SectionTable:
    """Each kind of coefficient in a row: its values, change between plateaus and uncertainty."""
    observed = [row for row in rows if not math.isnan(row.value)]
    gyros_c = [row.temperature_c for row in observed if row.coefficient.startswith("gyro")]
    known_c = [f"{end(gyros_c):z.0f}" for end in (min, max) if gyros_c and not any(map(math.isnan, gyros_c))]
    range_c = f" (gyros {' to '.join(dict.fromkeys(known_c))} °C)" if known_c else ""
    where = counted(len({row.plateau for row in observed}), "plateau")
    open_axes = _not_observable(rows)
    return SectionTable(
        _OVERVIEW.format(where, range_c),
        ["coefficients", "unit", "values", "largest change", "largest standard uncertainty"],
        [
            _overview_cells(name, [row for row in observed if row.coefficient == kind], open_axes.get(kind))
            for kind, name in COEFFICIENT_NAMES.items()
        ],
        words=2,
    )


def _overview_cells(
    name: str, observed: Sequence[PlateauCoefficientRow], open_axes: Sequence[str] | None
) -> list[str]:
    if not observed:
        return [name, NOT_OBSERVABLE]
    by_axis: dict[str, list[float]] = {}
    for row in observed:
        by_axis.setdefault(row.axis, []).append(row.value)
    change, axis = max((max(values) - min(values), axis) for axis, values in by_axis.items())
    sigma = max(row.sigma for row in observed)
    ends = min(map(min, by_axis.values())), max(map(max, by_axis.values()))
    low, high, changed, uncertainty = (f"{each:z.{decimals_of(sigma)}f}" for each in (*ends, change, sigma))
    note = f"\n{', '.join(open_axes)} {NOT_OBSERVABLE}" if open_axes else ""
    has_change = any(len(values) > 1 for values in by_axis.values())
    return [
        f"{name}{note}",
        unit_text(observed[0].unit),
        " to ".join(dict.fromkeys((low, high))),
        f"{changed} ({axis})" if has_change else "",
        uncertainty,
    ]


def _not_observable(rows: Sequence[PlateauCoefficientRow]) -> dict[str, list[str]]:
    """Axes by coefficient that are not observable at any of the plateaus that are estimated."""
    estimated = {row.plateau for row in rows if not math.isnan(row.value)}
    observed = {(row.coefficient, row.axis) for row in rows if not math.isnan(row.value)}
    axes: dict[str, list[str]] = {}
    for row in _at_plateau(rows, min(estimated, default=0)):
        if (row.coefficient, row.axis) not in observed:
            axes.setdefault(row.coefficient, []).append(row.axis)
    return axes


def _tables(rows: Sequence[PlateauCoefficientRow]) -> Iterator[SectionTable]:
    heads = plateau_heads(rows)
    for begin in range(0, len(heads), _PER_TABLE):
        plateaus = list(heads)[begin : begin + _PER_TABLE]
        columns = [_at_plateau(rows, plateau) for plateau in plateaus]
        between = "\n±" if len(plateaus) > _PER_WIDE_TABLE else " ±"
        header = ["coefficient", "axis", "unit", *(heads[plateau] for plateau in plateaus)]
        cells = [
            [COEFFICIENT_NAMES[first.coefficient], first.axis, unit_text(first.unit)]
            + [_cell(each).replace(" ±", between) for each in (first, *others)]
            for first, *others in zip(*columns, strict=True)
        ]
        yield SectionTable(_TABLE, header, cells, words=3)


def _at_plateau(rows: Sequence[PlateauCoefficientRow], plateau: int) -> list[PlateauCoefficientRow]:
    """Its rows, those of one kind of coefficient together."""
    kinds = list(COEFFICIENT_NAMES)
    return sorted(
        (row for row in rows if row.plateau == plateau), key=lambda row: kinds.index(row.coefficient)
    )


def _cell(row: PlateauCoefficientRow) -> str:
    if math.isnan(row.value):
        return _NOT_OBSERVED
    digits = max(0, 1 - math.floor(math.log10(row.sigma)))
    return f"{row.value:.{digits}f} ± {row.sigma:.{digits}f}"


def _cost_table(rows: Sequence[PlateauCoefficientRow]) -> SectionTable:
    first = next(row.plateau for row in rows if not math.isnan(row.sigma_with_force))
    cells = [
        [
            COEFFICIENT_NAMES[row.coefficient],
            row.axis,
            unit_text(row.unit),
            _NOT_OBSERVED if math.isnan(row.sigma) else f"{row.sigma:.2g}",
            f"{row.sigma_with_force:.2g}",
        ]
        for row in _at_plateau(rows, first)
    ]
    return SectionTable(
        f"Standard uncertainties at plateau {first}",
        ["coefficient", "axis", "unit", "as measured", "with specific forces"],
        cells,
        words=3,
    )
