"""Results of characteristic tests: measured values of each gyro, and the fit."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from gyrobench.bench.characteristics.results import Curve, TestName
from gyrobench.bench.navigation.positions import gyro_label
from gyrobench.bench.report.figures.style import (
    BARS_SHORT,
    GYRO_STYLES,
    common_legend,
    house_style,
    new_figure,
)

#: Lines of a fit's parts.
_LINES = (("-", "#000000"), ("--", "#0072b2"), ("-.", "#d55e00"), (":", "#009e73"))


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
