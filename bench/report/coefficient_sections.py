"""Sensor coefficients over temperature in the report of a run."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial

from matplotlib.figure import Figure

from gyrobench.bench.bias.budget import NORMAL_K
from gyrobench.bench.calibration.coefficients import NOT_OBSERVABLE
from gyrobench.bench.foundations.text import counted, decimals_of, with_micro_sign
from gyrobench.bench.report.figures.style import GYRO_STYLES, house_style, new_figure
from gyrobench.bench.report.number_format import range_text
from gyrobench.bench.report.page import Section, SectionFigure, SectionTable
from gyrobench.bench.runs.tables.budget_table import BudgetSummary, coverage
from gyrobench.bench.runs.tables.coefficient_table import (
    FRAME_TEXT,
    TEMPERATURE_TEXT,
    PlateauCoefficientRow,
    plateau_findings,
    plateau_heads,
    plateau_notes,
)

_COEFFICIENT_NAMES = {
    "gyro_bias": "gyro bias",
    "gyro_scale_factor": "gyro scale factor",
    "gyro_misalignment": "gyro misalignment",
    "accelerometer_bias": "accel. bias",
    "accelerometer_scale_factor": "accel. scale factor",
    "accelerometer_misalignment": "accel. misalignment",
}
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
        f"{_COEFFICIENT_NAMES[name]} {', '.join(axes)}" for name, axes in unobservable_by_name
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
    is_known = gyros_c and not any(map(math.isnan, gyros_c))
    temperature_range = f" (gyros {range_text(gyros_c, 'z.0f')} °C)" if is_known else ""
    plateaus = counted(len({row.plateau for row in observed}), "plateau")
    unobservable = _unobservable_axes(rows)
    return SectionTable(
        _OVERVIEW_CAPTION.format(plateaus, temperature_range),
        ["coefficients", "unit", "values", "largest change", "largest standard uncertainty"],
        [
            _overview_cells(
                name, [row for row in observed if row.coefficient == kind], unobservable.get(kind)
            )
            for kind, name in _COEFFICIENT_NAMES.items()
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
    number_format = f"z.{decimals_of(sigma)}f"
    note = f"\n{', '.join(unobservable)} {NOT_OBSERVABLE}" if unobservable else ""
    has_change = any(len(values) > 1 for values in by_axis.values())
    return [
        f"{name}{note}",
        observed[0].unit,
        range_text((row.value for row in observed), number_format),
        f"{change:{number_format}} ({axis})" if has_change else "",
        f"{sigma:{number_format}}",
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
            [_COEFFICIENT_NAMES[first.coefficient], first.axis, first.unit]
            + [_value_cell(each).replace(" ±", between) for each in (first, *others)]
            for first, *others in zip(*columns, strict=True)
        ]
        yield SectionTable(_TABLE_CAPTION, header, cells, words=3)


def _rows_of_plateau(rows: Sequence[PlateauCoefficientRow], plateau: int) -> list[PlateauCoefficientRow]:
    """Rows of a plateau, sorted by kind of coefficient."""
    kinds = list(_COEFFICIENT_NAMES)
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
            _COEFFICIENT_NAMES[row.coefficient],
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


#: Height of a legend row relative to that of its panel.
_LEGEND_ROW = 0.13
#: Smallest range of a temperature axis, K.
_MIN_SPAN_C = 2.0


@house_style
def coefficients_figure(rows: Sequence[PlateauCoefficientRow], budget: BudgetSummary | None = None) -> Figure:
    """Draw each coefficient over temperature; 95 % bars by the budget, else for normal errors."""
    coverage_by_coefficient = coverage(budget) if budget else {}
    figure = new_figure(5.6, left_in=0.62, right_in=0.1, wspace=0.3, hspace=0.34)
    panels = figure.subplots(2, 3)
    coverage_factors = [
        k for (kind, *_), (k, _) in coverage_by_coefficient.items() if kind in _COEFFICIENT_NAMES
    ]
    bars_text = f"bars: 95 %, k = {range_text(coverage_factors or [NORMAL_K], '.2f')}"
    for (kind, title), axes in zip(_COEFFICIENT_NAMES.items(), panels.ravel(), strict=True):
        kind_rows = [row for row in rows if row.coefficient == kind and not math.isnan(row.value)]
        axes.set_title(f"{title} / {with_micro_sign(kind_rows[0].unit)}" if kind_rows else title, fontsize=8)
        for axis_name, cycle in dict.fromkeys((row.axis, row.cycle) for row in kind_rows):
            cycle_rows = [row for row in kind_rows if (row.axis, row.cycle) == (axis_name, cycle)]
            colour, line, marker = GYRO_STYLES[axis_name[0]]
            is_second = len(axis_name) > 1 and axis_name[1] == max(set("xyz") - {axis_name[0]})
            expanded_by_row = [
                coverage_by_coefficient.get(
                    (kind, axis_name, row.plateau, 0.0), (NORMAL_K, NORMAL_K * row.sigma)
                )
                for row in cycle_rows
            ]
            axes.errorbar(
                [row.temperature_c for row in cycle_rows],
                [row.value for row in cycle_rows],
                [expanded for _, expanded in expanded_by_row],
                label=axis_name if cycle == kind_rows[0].cycle else None,
                color=colour,
                linestyle=line,
                marker=marker,
                markersize=4,
                markerfacecolor="white" if is_second else colour,
                capsize=2,
            )
        if not kind_rows:
            axes.text(0.5, 0.5, "not observable", transform=axes.transAxes, ha="center")
            axes.set(xticks=[], yticks=[])
        else:
            low, high = axes.get_ylim()
            bars_title = bars_text if axes is panels[0, 0] else None
            style = {"title": bars_title, "title_fontsize": 7, "columnspacing": 0.8, "handlelength": 1.8}
            legend = axes.legend(ncols=3, loc="upper center", **style)
            legend_rows = math.ceil(len(legend.texts) / 3) + bool(bars_title)
            axes.set_ylim(low, high + _LEGEND_ROW * (high - low) * legend_rows)
            first_c, last_c = axes.get_xlim()
            margin_c = max(0.0, 0.5 * (_MIN_SPAN_C - (last_c - first_c)))
            axes.set_xlim(first_c - margin_c, last_c + margin_c)
    for sensor, row in zip(("gyro", "case"), panels, strict=True):
        for axes in row:
            axes.set_xlabel(f"{sensor} temperature / °C")
    return figure
