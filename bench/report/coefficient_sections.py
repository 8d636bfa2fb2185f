"""Sensor coefficients over temperature in the report of a run."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial

from gyrobench.bench.calibration.coefficients import NOT_OBSERVABLE
from gyrobench.bench.foundations.text import counted, decimals_of
from gyrobench.bench.report.figures.coefficients import COEFFICIENT_NAMES, coefficients_figure
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
_TABLE_CAPTION = "Value ± standard uncertainty (k = 1) at each plateau"
_TEXT = (
    "Biases, scale factor errors and misalignments at each plateau, from its dwells and its rotations "
    f"together, with standard uncertainties. {FRAME_TEXT} {TEMPERATURE_TEXT}"
)
_NO_COEFFICIENTS = "The rotations of this run give no coefficients."
_OVERVIEW_CAPTION = (
    "Coefficients at {}{}: values of all axes, largest change of one between plateaus (its axis)"
)
_NO_SPECIFIC_FORCE = (
    "The INS sends no specific forces: rotations are evaluated from its velocity and attitude, which do not "
    "show the vertical specific force. The last table has the standard uncertainties expected with specific "
    "forces."
)
_FIGURE_CAPTION = (
    "Coefficients over the temperature of the gyro, for accelerometers that of the case; lines join the "
    "plateaus of a cycle in the order of time. Bars are expanded uncertainties (95 %), where they are larger "
    "than the marker."
)
_NOT_OBSERVABLE_SIGN = "–"
#: Largest number of plateaus in a table, and with uncertainties on the same line as the values.
_MAX_PLATEAUS_PER_TABLE, _MAX_PLATEAUS_ON_ONE_LINE = 5, 3


def has_rotations(rows: Sequence[PlateauCoefficientRow]) -> bool:
    """Whether the rows have coefficients that only rotations determine."""
    return any(
        not math.isnan(row.sigma_with_force)
        or (row.coefficient == "accelerometer_scale_factor" and not math.isnan(row.value))
        for row in rows
    )


def coefficients_section(
    rows: Sequence[PlateauCoefficientRow], budget: BudgetSummary | None = None
) -> Section | None:
    """Tables and figure with the expanded uncertainties of the budget; None without rotations.

    If the rotations give no coefficients at any plateau, the section states why.
    """
    if not has_rotations(rows):
        reasons = plateau_findings(rows)
        return Section(_TITLE, [_NO_COEFFICIENTS, *reasons]) if reasons else None
    tables = list(_tables(rows))
    unobservable_by_name = _unobservable_axes(rows).items()
    unobservable = "; ".join(
        f"{COEFFICIENT_NAMES[name]} {', '.join(axes)}" for name, axes in unobservable_by_name
    )
    notes = [f"Not observable ({_NOT_OBSERVABLE_SIGN}): {unobservable}."] if unobservable else []
    notes += [*plateau_findings(rows), *plateau_notes(rows)]
    if any(not math.isnan(row.sigma_with_force) for row in rows):
        notes.insert(0, _NO_SPECIFIC_FORCE)
        tables.append(_specific_force_table(rows))
    figure = SectionFigure("coefficients", _FIGURE_CAPTION, partial(coefficients_figure, rows, budget))
    return Section(_TITLE, [_TEXT, *notes], [figure], tables)


def coefficients_overview(rows: Sequence[PlateauCoefficientRow]) -> SectionTable:
    """Table with one row for each kind of coefficient: values, change between plateaus, uncertainty."""
    observed = [row for row in rows if not math.isnan(row.value)]
    gyros_c = [row.temperature_c for row in observed if row.coefficient.startswith("gyro")]
    end_texts = [
        f"{extreme(gyros_c):z.0f}" for extreme in (min, max) if gyros_c and not any(map(math.isnan, gyros_c))
    ]
    temperature_range = f" (gyros {' to '.join(dict.fromkeys(end_texts))} °C)" if end_texts else ""
    plateaus = counted(len({row.plateau for row in observed}), "plateau")
    unobservable = _unobservable_axes(rows)
    return SectionTable(
        _OVERVIEW_CAPTION.format(plateaus, temperature_range),
        ["coefficients", "unit", "values", "largest change", "largest standard uncertainty"],
        [
            _overview_cells(
                name, [row for row in observed if row.coefficient == kind], unobservable.get(kind)
            )
            for kind, name in COEFFICIENT_NAMES.items()
        ],
        words=2,
    )


def _overview_cells(
    name: str, observed: Sequence[PlateauCoefficientRow], unobservable: Sequence[str] | None
) -> list[str]:
    if not observed:
        return [name, NOT_OBSERVABLE]
    by_axis: dict[str, list[float]] = {}
    for row in observed:
        by_axis.setdefault(row.axis, []).append(row.value)
    change, axis = max((max(values) - min(values), axis) for axis, values in by_axis.items())
    sigma = max(row.sigma for row in observed)
    extremes = min(map(min, by_axis.values())), max(map(max, by_axis.values()))
    low, high, change_text, uncertainty = (
        f"{each:z.{decimals_of(sigma)}f}" for each in (*extremes, change, sigma)
    )
    note = f"\n{', '.join(unobservable)} {NOT_OBSERVABLE}" if unobservable else ""
    has_change = any(len(values) > 1 for values in by_axis.values())
    return [
        f"{name}{note}",
        observed[0].unit,
        " to ".join(dict.fromkeys((low, high))),
        f"{change_text} ({axis})" if has_change else "",
        uncertainty,
    ]


def _unobservable_axes(rows: Sequence[PlateauCoefficientRow]) -> dict[str, list[str]]:
    """Axes that are not observable at any plateau with estimates, by kind of coefficient."""
    estimated = {row.plateau for row in rows if not math.isnan(row.value)}
    observed = {(row.coefficient, row.axis) for row in rows if not math.isnan(row.value)}
    axes: dict[str, list[str]] = {}
    for row in _rows_of_plateau(rows, min(estimated, default=0)):
        if (row.coefficient, row.axis) not in observed:
            axes.setdefault(row.coefficient, []).append(row.axis)
    return axes


def _tables(rows: Sequence[PlateauCoefficientRow]) -> Iterator[SectionTable]:
    heads = plateau_heads(rows)
    for start in range(0, len(heads), _MAX_PLATEAUS_PER_TABLE):
        plateaus = list(heads)[start : start + _MAX_PLATEAUS_PER_TABLE]
        columns = [_rows_of_plateau(rows, plateau) for plateau in plateaus]
        between = "\n±" if len(plateaus) > _MAX_PLATEAUS_ON_ONE_LINE else " ±"
        header = ["coefficient", "axis", "unit", *(heads[plateau] for plateau in plateaus)]
        cells = [
            [COEFFICIENT_NAMES[first.coefficient], first.axis, first.unit]
            + [_value_cell(each).replace(" ±", between) for each in (first, *others)]
            for first, *others in zip(*columns, strict=True)
        ]
        yield SectionTable(_TABLE_CAPTION, header, cells, words=3)


def _rows_of_plateau(rows: Sequence[PlateauCoefficientRow], plateau: int) -> list[PlateauCoefficientRow]:
    """Rows of a plateau, sorted by kind of coefficient."""
    kinds = list(COEFFICIENT_NAMES)
    return sorted(
        (row for row in rows if row.plateau == plateau), key=lambda row: kinds.index(row.coefficient)
    )


def _value_cell(row: PlateauCoefficientRow) -> str:
    if math.isnan(row.value):
        return _NOT_OBSERVABLE_SIGN
    digits = max(0, 1 - math.floor(math.log10(row.sigma)))
    return f"{row.value:.{digits}f} ± {row.sigma:.{digits}f}"


def _specific_force_table(rows: Sequence[PlateauCoefficientRow]) -> SectionTable:
    first = next(row.plateau for row in rows if not math.isnan(row.sigma_with_force))
    cells = [
        [
            COEFFICIENT_NAMES[row.coefficient],
            row.axis,
            row.unit,
            _NOT_OBSERVABLE_SIGN if math.isnan(row.sigma) else f"{row.sigma:.2g}",
            f"{row.sigma_with_force:.2g}",
        ]
        for row in _rows_of_plateau(rows, first)
    ]
    return SectionTable(
        f"Standard uncertainties at plateau {first}",
        ["coefficient", "axis", "unit", "as measured", "with specific forces"],
        cells,
        words=3,
    )
