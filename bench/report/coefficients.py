"""Coefficients of the sensors over temperature, and the results of characteristic tests."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from gyrobench.bench.bias.budget import NORMAL_K
from gyrobench.bench.calibration.results import NOT_OBSERVABLE
from gyrobench.bench.characteristics.results import Coefficient, Curve, TestName, TestResult
from gyrobench.bench.foundations.text import counted, decimals_of
from gyrobench.bench.navigation.positions import gyro_label
from gyrobench.bench.report.figures.style import (
    BARS_SHORT,
    GYRO_STYLES,
    common_legend,
    house_style,
    new_figure,
)
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
_NAMES = {
    "gyro_bias": "gyro bias",
    "gyro_scale_factor": "gyro scale factor",
    "gyro_misalignment": "gyro misalignment",
    "accelerometer_bias": "accel. bias",
    "accelerometer_scale_factor": "accel. scale factor",
    "accelerometer_misalignment": "accel. misalignment",
}
_UNITS = {"ug": "µg"}
_NOT_OBSERVED = "–"
#: Height of a row of a legend as a part of its panel's.
_LEGEND_ROW = 0.13
#: Least range of a temperature axis, K.
_MIN_SPAN_C = 2.0
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
    open_axes = "; ".join(f"{_NAMES[name]} {', '.join(of)}" for name, of in _not_observable(rows).items())
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
            for kind, name in _NAMES.items()
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
        _unit(observed[0].unit),
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


@house_style
def coefficients_figure(rows: Sequence[PlateauCoefficientRow], budget: BudgetSummary | None = None) -> Figure:
    """Each coefficient over temperature with bars of 95 %, by the budget, or for a normal distribution."""
    covered = coverage(budget) if budget else {}
    figure = new_figure(5.6, left_in=0.62, right_in=0.1, wspace=0.3, hspace=0.34)
    panels = figure.subplots(2, 3)
    factors = {f"{k:.2f}" for (kind, *_), (k, _) in covered.items() if kind in _NAMES} or {f"{NORMAL_K:.2f}"}
    bars_text = f"bars: 95 %, k = {' to '.join(sorted({min(factors), max(factors)}))}"
    for (kind, title), axes in zip(_NAMES.items(), panels.ravel(), strict=True):
        own = [row for row in rows if row.coefficient == kind and not math.isnan(row.value)]
        axes.set_title(f"{title} / {_unit(own[0].unit)}" if own else title, fontsize=8)
        for name, cycle in dict.fromkeys((row.axis, row.cycle) for row in own):
            chosen = [row for row in own if (row.axis, row.cycle) == (name, cycle)]
            colour, line, marker = GYRO_STYLES[name[0]]
            is_second = len(name) > 1 and name[1] == max(set("xyz") - {name[0]})
            bars = [
                covered.get((kind, name, row.plateau, 0.0), (NORMAL_K, NORMAL_K * row.sigma))
                for row in chosen
            ]
            axes.errorbar(
                [row.temperature_c for row in chosen],
                [row.value for row in chosen],
                [expanded for _, expanded in bars],
                label=name if cycle == own[0].cycle else None,
                color=colour,
                linestyle=line,
                marker=marker,
                markersize=4,
                markerfacecolor="white" if is_second else colour,
                capsize=2,
            )
        if not own:
            axes.text(0.5, 0.5, "not observable", transform=axes.transAxes, ha="center")
            axes.set(xticks=[], yticks=[])
        else:
            low, high = axes.get_ylim()
            of_bars = bars_text if axes is panels[0, 0] else None
            style = {"title": of_bars, "title_fontsize": 7, "columnspacing": 0.8, "handlelength": 1.8}
            legend = axes.legend(ncols=3, loc="upper center", **style)
            rows_in_it = math.ceil(len(legend.texts) / 3) + bool(of_bars)
            axes.set_ylim(low, high + _LEGEND_ROW * (high - low) * rows_in_it)
            first_c, last_c = axes.get_xlim()
            beside_c = max(0.0, 0.5 * (_MIN_SPAN_C - (last_c - first_c)))
            axes.set_xlim(first_c - beside_c, last_c + beside_c)
    for sensor, row in zip(("gyro", "case"), panels, strict=True):
        for axes in row:
            axes.set_xlabel(f"{sensor} temperature / °C")
    return figure


def _tables(rows: Sequence[PlateauCoefficientRow]) -> Iterator[SectionTable]:
    heads = plateau_heads(rows)
    for begin in range(0, len(heads), _PER_TABLE):
        plateaus = list(heads)[begin : begin + _PER_TABLE]
        columns = [_at_plateau(rows, plateau) for plateau in plateaus]
        between = "\n±" if len(plateaus) > _PER_WIDE_TABLE else " ±"
        header = ["coefficient", "axis", "unit", *(heads[plateau] for plateau in plateaus)]
        cells = [
            [_NAMES[first.coefficient], first.axis, _unit(first.unit)]
            + [_cell(each).replace(" ±", between) for each in (first, *others)]
            for first, *others in zip(*columns, strict=True)
        ]
        yield SectionTable(_TABLE, header, cells, words=3)


def _at_plateau(rows: Sequence[PlateauCoefficientRow], plateau: int) -> list[PlateauCoefficientRow]:
    """Its rows, those of one kind of coefficient together."""
    kinds = list(_NAMES)
    return sorted(
        (row for row in rows if row.plateau == plateau), key=lambda row: kinds.index(row.coefficient)
    )


def _unit(unit: str) -> str:
    return _UNITS.get(unit, unit)


def _cell(row: PlateauCoefficientRow) -> str:
    if math.isnan(row.value):
        return _NOT_OBSERVED
    digits = max(0, 1 - math.floor(math.log10(row.sigma)))
    return f"{row.value:.{digits}f} ± {row.sigma:.{digits}f}"


def _cost_table(rows: Sequence[PlateauCoefficientRow]) -> SectionTable:
    first = next(row.plateau for row in rows if not math.isnan(row.sigma_with_force))
    cells = [
        [
            _NAMES[row.coefficient],
            row.axis,
            _unit(row.unit),
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


_TITLES: dict[TestName, str] = {
    "turn_on_repeatability": "Turn-on repeatability",
    "warm_up": "Warm-up",
    "thermal_sensitivity": "Thermal sensitivities",
    "allan_variance": "Allan variance",
    "scale_factor_stability": "Scale-factor stability",
}
_TEXTS: dict[TestName, str] = {
    "turn_on_repeatability": "Scatter of each gyro's bias from power cycle to power cycle, beyond the "
    "uncertainty of its measurement. The interval is exact for normally distributed biases.",
    "warm_up": "Bias after power-on: a constant and one or two exponentials, fitted to the dwells.",
    "thermal_sensitivity": "Bias against the gyro's temperature, its rate of change, and whether it came "
    "from below or above, fitted together. Hysteresis: bias after cooling less bias after heating. What lags "
    "behind the temperature in proportion to its rate, as a gradient does, is in the ramp sensitivity.",
    "allan_variance": "Noise of each gyro in a long navigation at rest, from the rates that attitude and "
    "velocity of the INS imply. The intervals are those of chi-squared with effective degrees of freedom.",
    "scale_factor_stability": "Scale factor of each gyro by whole turns, dwell after dwell: a drift within "
    "each power cycle, and the scatter beyond the uncertainty of the measurement. Asymmetry (positive less "
    "negative direction) and nonlinearity (one rate less all rates) are means over all dwells; "
    "the worst rate counts.",
}
#: Lines of a fit's parts.
_LINES = (("-", "#000000"), ("--", "#0072b2"), ("-.", "#d55e00"), (":", "#009e73"))
_HEADER = ("coefficient", "gyro", "unit", "value", "95 % interval")
_DIGITS = 3


def characteristics_sections(results: Sequence[TestResult]) -> list[Section]:
    """One section for each test."""
    return [_section(result) for result in results]


def _section(result: TestResult) -> Section:
    title = _TITLES[result.test]
    caption = f"{title}: measured values with standard uncertainties, and the fit."
    draw = partial(characteristics_figure, result.test, result.curves)
    return Section(
        title,
        [_TEXTS[result.test], *result.notes],
        [SectionFigure(result.test, caption, draw)] if result.curves else [],
        [SectionTable("Coefficients", _HEADER, _rows(result), words=3)] if result.coefficients else [],
    )


def _rows(result: TestResult) -> list[list[str]]:
    """One row for each coefficient, the gyros of one coefficient together."""
    names = list(dict.fromkeys((each.name, each.unit) for each in result.coefficients))
    ordered = sorted(result.coefficients, key=lambda each: names.index((each.name, each.unit)))
    return [
        [each.name, each.gyro.upper(), each.unit, _number(each.value), _interval(each)] for each in ordered
    ]


def _number(value: float | None) -> str:
    return "not determined" if value is None else f"{value:.{_DIGITS}g}"


def _interval(each: Coefficient) -> str:
    low, high = _number(each.low), _number(each.high)
    if each.low is None or each.low == 0.0:
        return "" if each.high is None else f"below {high}"
    return f"above {low}" if each.high is None else f"{low} to {high}"


class _Axes(NamedTuple):
    x: str
    y: str
    fit: str  #: Label of its line, with a place for the name of its part.
    is_log: bool = False
    factor: float = 1000.0


_PANELS: dict[TestName, _Axes] = {
    "turn_on_repeatability": _Axes("power cycle", "bias less mean / (0.001 deg/h)", "mean"),
    "warm_up": _Axes("time since power-on / h", "bias less final bias / (0.001 deg/h)", "fit"),
    "thermal_sensitivity": _Axes(
        "temperature of the gyro / °C", "bias less constant / (0.001 deg/h)", "fit, {}"
    ),
    "allan_variance": _Axes(
        "averaging time / s", "Allan deviation / (deg/h)", "fit", is_log=True, factor=1.0
    ),
    "scale_factor_stability": _Axes(
        "time since the first dwell / h", "scale factor less mean / ppm", "drift", factor=1.0
    ),
}


@house_style
def characteristics_figure(test: TestName, curves: Sequence[Curve]) -> Figure:
    """Draw a test's points with bars and its fit, for each gyro; the lines of the fit end with their part."""
    names = _PANELS[test]
    figure = new_figure(3.5)
    panels = figure.subplots(1, len(curves), sharex=True, sharey=True, squeeze=False)[0]
    for axes, curve in zip(panels, curves, strict=True):
        colour, _, marker = GYRO_STYLES[curve.gyro]
        value, low, high, fit = (
            names.factor * np.array(each) for each in (curve.value, curve.low, curve.high, curve.fit)
        )
        axes.errorbar(
            curve.x,
            value,
            np.maximum([value - low, high - value], 0.0),
            linestyle="none",
            marker=marker,
            markersize=3.0,
            color=colour,
            elinewidth=0.6,
            alpha=0.7,
        )
        parts = [names.fit.format(part).rstrip(", ") for part in curve.parts or [""] * len(fit)]
        known = list(dict.fromkeys(parts))
        begin = 0
        for _, points in itertools.groupby(curve.parts or parts):
            end = begin + len(list(points))
            line, colour = _LINES[known.index(parts[begin]) % len(_LINES)]
            axes.plot(
                curve.x[begin:end], fit[begin:end], line, color=colour, linewidth=1.1, label=parts[begin]
            )
            begin = end
        axes.set_title(gyro_label(curve.gyro))
        if names.is_log:
            axes.set(xscale="log", yscale="log")
    panels[0].set_ylabel(names.y)
    panels[len(panels) // 2].set_xlabel(names.x)
    common_legend(figure, panels, ncols=2, title=BARS_SHORT)
    return figure
