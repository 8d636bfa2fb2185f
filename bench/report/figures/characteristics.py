"""Results of characteristic tests: measured values of each gyro and the fit."""

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
