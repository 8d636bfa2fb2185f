"""Allan deviation of gyros and accelerometers, as measured and as declared."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from gyrobench.bench.bias.noise_estimate import ChannelNoise, NoiseEstimate, NoiseParameter
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.foundations.arrays import DEG_PER_SQRT_H_TO_SI, DPH_TO_RADPS, UG_PER_SQRT_HZ_TO_SI
from gyrobench.bench.navigation.positions import AXES, gyro_label
from gyrobench.bench.report.figures.style import (
    BARS_SHORT,
    GYRO_STYLES,
    WIDTH_IN,
    house_style,
    new_figure,
    say_empty,
    text_width_in,
)

_ARW = ("deg/√h", DEG_PER_SQRT_H_TO_SI)
_VRW = ("µg/√Hz", UG_PER_SQRT_HZ_TO_SI)
_MICRO_G = UG_PER_SQRT_HZ_TO_SI  # m/s^2: the same number
_FITTED = "#000000"
_DECLARED = "#D55E00"
_FIT_WIDTH = 0.7
_FIT_LABEL = "complete fit"
_LEVEL = "#555555"
_WIDEST_BAR = 0.9  # of the value: an error bar down to zero would reach to the end of a log axis
_MARGIN = 1.3
_FEW_DECADES = 50.0
_KEY_IN = 0.55  # of a legend: its lines and edges


@house_style
def noise_figure(estimate: NoiseEstimate, declared: NoiseModel | None) -> Figure:
    """Draw the Allan deviations of the three gyros and of the horizontal accelerations.

    Lines of slope -1/2 are the random walks, fitted and declared; thin lines the complete fit.
    Channels whose noise is below the resolution are faint and have no error bars.
    """
    figure = new_figure(6.4)
    gyros, accelerometers = figure.subplots(2, 1)
    for axis, channel in zip(AXES, estimate.gyros, strict=True):
        colour, _, marker = GYRO_STYLES[axis]
        _draw_channel(gyros, channel, DPH_TO_RADPS, gyro_label(axis), colour, marker)
    _draw_channel(accelerometers, estimate.acceleration, _MICRO_G, "East and North", _LEVEL, "D")
    arw, vrw = (declared.angle_random_walk, declared.velocity_random_walk) if declared else (0.0, 0.0)
    has_fit = any(channel.fit for channel in estimate.gyros)
    _draw_walks(gyros, estimate.angle_random_walk, arw, _ARW, DPH_TO_RADPS, has_fit=has_fit)
    has_fit = estimate.acceleration.fit is not None
    _draw_walks(accelerometers, estimate.velocity_random_walk, vrw, _VRW, _MICRO_G, has_fit=has_fit)
    gyros.set(title="Noise of the gyros", ylabel="Allan deviation / (deg/h)")
    accelerometers.set(
        title="Noise of the accelerometers", ylabel="Allan deviation / µg", xlabel="averaging time / s"
    )
    texts = [text for panel in figure.axes for text in panel.get_legend_handles_labels()[1]]
    figure.subplots_adjust(right=1.0 - (_KEY_IN + text_width_in(texts, 8)) / WIDTH_IN)
    return figure


def _draw_channel(
    axes: Axes, channel: ChannelNoise, unit: float, label: str, colour: str, marker: str
) -> None:
    fit, is_seen = channel.fit, channel.is_seen
    if not is_seen.any():
        return
    tau, deviation = channel.allan.tau_s[is_seen], channel.allan.deviation[is_seen] / unit
    sigma = None
    if fit:
        sigma = deviation * np.minimum(1.0 / np.sqrt(2.0 * fit.edf[is_seen]), _WIDEST_BAR)
    axes.errorbar(
        tau,
        deviation,
        sigma,
        label=label if fit else f"{label} (below resolution)",
        linestyle="none",
        marker=marker,
        markersize=4.0,
        markerfacecolor="none",
        color=colour,
        elinewidth=0.8,
        capsize=1.5,
        alpha=1.0 if fit else 0.35,
    )
    if fit:
        axes.plot(tau, np.sqrt(fit.expected[is_seen]) / unit, color=colour, linewidth=_FIT_WIDTH)


def _draw_walks(
    axes: Axes,
    measured: NoiseParameter,
    declared: float,
    walk: tuple[str, float],
    unit: float,
    *,
    has_fit: bool,
) -> None:
    """Draw lines of slope -1/2 over the averaging times in the axes, and finish these."""
    name, size = walk
    if not axes.containers:
        axes.set(xticks=[], yticks=[])
        say_empty(axes, "constant output: noise below resolution")
        return
    tau = np.array([axes.dataLim.x0, axes.dataLim.x1])
    levels = [axes.dataLim.y0, axes.dataLim.y1]
    found = measured.value if measured.is_found and measured.value is not None else 0.0
    text = measured.text(name, size).replace(", ", "\n")
    for value, label, colour, line in (
        (found, f"random walk\n{text}", _FITTED, "-"),
        (declared, f"declared\n{declared / size:.3g} {name}", _DECLARED, (0, (5, 3))),
    ):
        if value > 0.0:
            walks = value / unit / np.sqrt(tau)
            levels.extend(walks)
            axes.plot(tau, walks, color=colour, linestyle=line, label=label)
    if not found:
        axes.plot([], [], linestyle="none", label=f"random walk\n{text}")
    if has_fit:
        axes.plot([], [], color=_LEVEL, linewidth=_FIT_WIDTH, label=_FIT_LABEL)
    low, high = min(levels), max(levels)
    axes.set(xscale="log", yscale="log", ylim=(low / _MARGIN, high * _MARGIN))
    for side in (axes.xaxis, axes.yaxis):
        side.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < _FEW_DECADES * low else (1.0,)))
        side.set_major_formatter("{x:g}")
        side.set_minor_formatter(NullFormatter())
    title = BARS_SHORT if has_fit else None
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), title=title, title_fontsize=8)
