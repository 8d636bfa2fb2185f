"""Results of characteristic tests in the report of a run: coefficients, measured values and their fit."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from gyrobench.bench.characteristics.results import Coefficient, Curve, TestName, TestResult
from gyrobench.bench.navigation.positions import gyro_label
from gyrobench.bench.report.figures.style import (
    BARS_SHORT,
    GYRO_STYLES,
    common_legend,
    house_style,
    new_figure,
)
from gyrobench.bench.report.page import Section, SectionFigure, SectionTable

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
_HEADER = ("coefficient", "gyro", "unit", "value", "95 % interval")
_DIGITS = 3
#: Numbers from here on are written with an exponent.
_MIN_WITH_EXPONENT = 1e6


def characteristics_sections(results: Sequence[TestResult]) -> list[Section]:
    """One section for each test, with a row for each coefficient and gyro."""
    sections = []
    for result in results:
        title = _TITLES[result.test]
        caption = f"{title}: measured values with standard uncertainties, and the fit."
        draw = partial(characteristics_figure, result.test, result.curves)
        figures = [SectionFigure(result.test, caption, draw)] if result.curves else []
        order = list(dict.fromkeys((each.name, each.unit) for each in result.coefficients))
        rows = [
            [each.name, each.gyro.upper(), each.unit, _number_text(each.value), _interval_text(each)]
            for each in sorted(result.coefficients, key=lambda each: order.index((each.name, each.unit)))
        ]
        tables = [SectionTable("Coefficients", _HEADER, rows, words=3)] if rows else []
        sections.append(Section(title, [_TEXTS[result.test], *result.notes], figures, tables))
    return sections


def _number_text(value: float | None) -> str:
    if value is None:
        return "not determined"
    text = f"{value:.{_DIGITS}g}"
    return f"{float(text):.0f}" if "e+" in text and abs(value) < _MIN_WITH_EXPONENT else text


def _interval_text(coefficient: Coefficient) -> str:
    low, high = _number_text(coefficient.low), _number_text(coefficient.high)
    if coefficient.low is None or coefficient.low == 0.0:
        return "" if coefficient.high is None else f"below {high}"
    return f"above {low}" if coefficient.high is None else f"{low} to {high}"


#: Line style and colour of the parts of a fit.
_PART_LINES = (("-", "#000000"), ("--", "#0072b2"), ("-.", "#d55e00"), (":", "#009e73"))


class _PanelStyle(NamedTuple):
    x: str
    y: str
    fit: str  #: Label of the fitted line, with a placeholder for the name of its part.
    is_log: bool = False
    factor: float = 1000.0


_PANELS: dict[TestName, _PanelStyle] = {
    "turn_on_repeatability": _PanelStyle("power cycle", "bias less mean / (0.001 deg/h)", "mean"),
    "warm_up": _PanelStyle("time since power-on / h", "bias less final bias / (0.001 deg/h)", "fit"),
    "thermal_sensitivity": _PanelStyle(
        "temperature of the gyro / °C", "bias less constant / (0.001 deg/h)", "fit, {}"
    ),
    "allan_variance": _PanelStyle(
        "averaging time / s", "Allan deviation / (deg/h)", "fit", is_log=True, factor=1.0
    ),
    "scale_factor_stability": _PanelStyle(
        "time since the first dwell / h", "scale factor less mean / ppm", "drift", factor=1.0
    ),
}


@house_style
def characteristics_figure(test: TestName, curves: Sequence[Curve]) -> Figure:
    """Draw the measured points with bars and the fit of a test for each gyro, one line for each part."""
    panel_style = _PANELS[test]
    figure = new_figure(3.5)
    panels = figure.subplots(1, len(curves), sharex=True, sharey=True, squeeze=False)[0]
    for axes, curve in zip(panels, curves, strict=True):
        colour, _, marker = GYRO_STYLES[curve.gyro]
        values, low, high, fit = (
            panel_style.factor * np.array(each) for each in (curve.value, curve.low, curve.high, curve.fit)
        )
        axes.errorbar(
            curve.x,
            values,
            np.maximum([values - low, high - values], 0.0),
            linestyle="none",
            marker=marker,
            markersize=3.0,
            color=colour,
            elinewidth=0.6,
            alpha=0.7,
        )
        labels = [panel_style.fit.format(part).rstrip(", ") for part in curve.parts or [""] * len(fit)]
        part_names = list(dict.fromkeys(labels))
        start = 0
        for _, points in itertools.groupby(curve.parts or labels):
            end = start + len(list(points))
            line, colour = _PART_LINES[part_names.index(labels[start]) % len(_PART_LINES)]
            axes.plot(
                curve.x[start:end], fit[start:end], line, color=colour, linewidth=1.1, label=labels[start]
            )
            start = end
        axes.set_title(gyro_label(curve.gyro))
        if panel_style.is_log:
            axes.set(xscale="log", yscale="log")
    panels[0].set_ylabel(panel_style.y)
    panels[len(panels) // 2].set_xlabel(panel_style.x)
    common_legend(figure, panels, ncols=2, title=BARS_SHORT)
    return figure
