"""Results of characteristic tests."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from gyrobench.bench.characteristics.results import Coefficient, Curve, TestName, TestResult
from gyrobench.bench.navigation.positions import gyro_label
from gyrobench.bench.report.figures.style import BARS_SHORT, GYRO_STYLES, house_style, new_figure
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
    fit: str
    is_log: bool = False
    factor: float = 1000.0


_PANELS: dict[TestName, _Axes] = {
    "turn_on_repeatability": _Axes("power cycle", "bias less mean / (0.001 deg/h)", "mean"),
    "warm_up": _Axes("time since power-on / h", "bias less final bias / (0.001 deg/h)", "fit"),
    "thermal_sensitivity": _Axes(
        "temperature of the gyro / °C", "bias less constant / (0.001 deg/h)", "fit, in the order of time"
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
    """Draw a test's points with bars and its fit, for each gyro."""
    names = _PANELS[test]
    figure = new_figure(3.2)
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
        axes.plot(curve.x, fit, color="#000000", linewidth=0.9, label=names.fit)
        axes.set_title(gyro_label(curve.gyro))
        if names.is_log:
            axes.set(xscale="log", yscale="log")
    panels[0].set_ylabel(names.y)
    panels[0].legend(loc="best", title=BARS_SHORT, title_fontsize=7)
    panels[len(panels) // 2].set_xlabel(names.x)
    return figure
