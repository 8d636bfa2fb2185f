"""Difference of the estimators, goodness of fit of the error model, and noise of the INS."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from gyrobench.bench.bias.dwell_table import DwellRow, paper_rows
from gyrobench.bench.bias.noise_estimate import ChannelNoise, NoiseEstimate, NoiseParameter
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.statistics import uniformity_band
from gyrobench.bench.foundations.arrays import (
    DEG_PER_SQRT_H_TO_SI,
    DPH_TO_RADPS,
    UG_PER_SQRT_HZ_TO_SI,
    FloatArray,
)
from gyrobench.bench.navigation.positions import AXES, POSITIONS, gyro_label, position_label
from gyrobench.bench.report.figures.style import (
    BARS,
    BARS_SHORT,
    GYRO_STYLES,
    POSITION_STYLES,
    WIDTH_IN,
    common_legend,
    draw_points,
    house_style,
    label_empty,
    mark_temperatures,
    new_figure,
    text_width_in,
)
from gyrobench.bench.report.number_format import PAPER, STATE_SPACE, BiasScale
from gyrobench.bench.report.run_text import POSITION_SIGNIFICANCE

_POSITION_OFFSET = (
    0.012  # horizontal offset between neighbouring positions, relative to the temperature range
)


@house_style
def estimators_figure(dwells: Iterable[DwellRow], marked_c: Sequence[float] = ()) -> Figure:
    """Draw the difference of the two estimates of every unflagged dwell against the gyro's temperature.

    Bars are combined uncertainties. Both use the same data, so noise alone separates them by less:
    points beyond their bars show systematic errors of the paper's method. Lines mark ``marked_c`` in degC.
    """
    points: dict[str, list[FloatArray]] = {position: [] for position in POSITION_STYLES}
    for row in dwells:
        if has_both_estimates(row):
            points[row.position].append(np.column_stack([row.gyro_c, differences_dph(row)]))
    by_position = {position: np.array(values) for position, values in points.items() if values}
    scale = BiasScale.of(
        *np.concatenate([values.reshape(-1, 3) for values in by_position.values()]).T[1:]
        if by_position
        else ((), ())
    )
    figure = new_figure(3.6, left_in=0.85)
    panels = figure.subplots(1, len(AXES), sharex=True, sharey=True)
    for axis, (gyro, axes) in enumerate(zip(AXES, panels, strict=True)):
        axes.set_title(gyro_label(gyro))
        axes.axhline(0.0, color="#444444", linewidth=0.9)
        _draw_estimator_differences(axes, axis, by_position, scale, marked_c)
    panels[0].set_ylabel(f"{PAPER} minus\n{STATE_SPACE} / ({scale.unit})")
    panels[1].set_xlabel("temperature of the gyro / °C")
    common_legend(figure, panels[:1], ncols=len(POSITIONS), title=BARS)
    if not by_position:
        label_empty(panels[1], "the paper's method gave no bias")
    return figure


def has_both_estimates(row: DwellRow) -> bool:
    """Whether a dwell is unflagged and has both estimates."""
    return bool(not row.flags and paper_rows([row]))


def differences_dph(row: DwellRow) -> list[tuple[float, float]]:
    """Bias by the paper's method minus state-space bias for each gyro, with combined uncertainties."""
    estimates = zip(row.bias_dph, row.sigma_dph, row.paper_bias_dph, row.paper_sigma_dph, strict=True)
    return [(paper - bias, math.hypot(sigma, paper_sigma)) for bias, sigma, paper, paper_sigma in estimates]


def _draw_estimator_differences(
    axes: Axes, axis: int, by_position: Mapping[str, FloatArray], scale: BiasScale, marked_c: Sequence[float]
) -> None:
    """``by_position``: temperature in degC, difference and uncertainty in deg/h of each dwell and gyro."""
    temperatures_c = np.concatenate([np.zeros(0), *(values[:, axis, 0] for values in by_position.values())])
    offset_c = (
        _POSITION_OFFSET * float(np.nanmax(temperatures_c) - np.nanmin(temperatures_c))
        if by_position
        else 0.0
    )
    for index, (position, style) in enumerate(POSITION_STYLES.items()):
        if position in by_position:
            temperature_c, difference_dph, sigma_dph = by_position[position][:, axis].T
            draw_points(
                axes,
                temperature_c + (index - 2.5) * offset_c,
                difference_dph * scale.factor,
                sigma_dph * scale.factor,
                alpha=1.0,
                bar_alpha=0.4,
                label=position_label(position),
                markersize=4.0,
                **style.points,
            )
    if by_position:
        mark_temperatures(axes, "x", marked_c)


#: Probability of the band, matching the significance level of the test.
_BAND = 1.0 - POSITION_SIGNIFICANCE
#: Smallest number of p-values for a distribution.
_MIN_FOR_DISTRIBUTION = 5
#: Minimum range of the axis of residual ratios.
_MIN_RATIO_RANGE = (0.8, 1.2)
_AXIS_MARGIN = 0.05


@house_style
def fit_figure(dwells: Iterable[DwellRow]) -> Figure:
    """Draw the size of the residuals of each dwell tested, and the distribution of their p-values.

    Dwells with flags are crossed out. Few dwells have no distribution: see :func:`has_distribution`.
    """
    tested = _tested(dwells)
    figure = new_figure(3.4, wspace=0.22)
    ratios = [1.5, 1.0] if has_distribution(tested) else [1.0]
    panels = figure.subplots(1, len(ratios), width_ratios=ratios, squeeze=False)[0]
    panels[0].set(title="Size of residuals", xlabel="dwell", ylabel="residual / expected")
    if not tested:
        label_empty(panels[0], "no dwell tested")
        return figure
    _draw_ratios(panels[0], tested)
    for axes in panels[1:]:
        _draw_distribution(axes, [row.fit_p_value for row in tested])
    common_legend(figure, panels, ncols=len(POSITIONS) + 1)
    return figure


def has_distribution(dwells: Iterable[DwellRow]) -> bool:
    """Whether enough dwells were tested for a distribution of their p-values."""
    return len(_tested(dwells)) >= _MIN_FOR_DISTRIBUTION


def _tested(dwells: Iterable[DwellRow]) -> list[DwellRow]:
    return [row for row in dwells if not math.isnan(row.fit_p_value)]


def _draw_ratios(axes: Axes, rows: Sequence[DwellRow]) -> None:
    axes.axhline(1.0, color="#444444", linewidth=0.9)
    for position, style in POSITION_STYLES.items():
        points = [(row.dwell, row.fit_ratio) for row in rows if row.position == position]
        if points:
            label = position_label(position)
            axes.plot(
                *zip(*points, strict=True), label=label, linestyle="none", markersize=4.5, **style.points
            )
    flagged = [(row.dwell, row.fit_ratio) for row in rows if row.flags]
    if flagged:
        cross: dict[str, Any] = {"linestyle": "none", "marker": "x", "markersize": 8.0, "color": "#b3261e"}
        axes.plot(*zip(*flagged, strict=True), label="flagged", **cross)
    dwells, ratios = zip(*((row.dwell, row.fit_ratio) for row in rows), strict=True)
    low, high = min(*ratios, _MIN_RATIO_RANGE[0]), max(*ratios, _MIN_RATIO_RANGE[1])
    margin = _AXIS_MARGIN * (high - low)
    dwell_margin = max(_AXIS_MARGIN * (max(dwells) - min(dwells)), 0.5)
    axes.set(
        ylim=(low - margin, high + margin), xlim=(min(dwells) - dwell_margin, max(dwells) + dwell_margin)
    )
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))


def _draw_distribution(axes: Axes, p_values: Sequence[float]) -> None:
    """Draw the cumulative distribution of the p-values and its band if the model is correct."""
    axes.set(title="p-values", xlabel="p-value of the fit", ylabel="share of dwells below")
    axes.set(xlim=(0, 1), ylim=(0, 1))
    count = len(p_values)
    band = uniformity_band(count, _BAND)
    ends = np.array([0.0, 1.0])
    axes.fill_between(ends, ends - band, ends + band, color="#dddddd", label="_band", linewidth=0.0)
    axes.plot(ends, ends, color="#444444", linewidth=0.9)
    axes.annotate(
        f"grey: {_BAND:.0%} band",
        (1.0, 0.0),
        (-3, 3),
        xycoords="axes fraction",
        textcoords="offset points",
        ha="right",
        fontsize=7,
        color="#444444",
    )
    axes.step(
        [0.0, *np.sort(p_values), 1.0], [*np.arange(count + 1) / count, 1.0], where="post", color="#0072B2"
    )


_ARW = ("deg/√h", DEG_PER_SQRT_H_TO_SI)
_VRW = ("µg/√Hz", UG_PER_SQRT_HZ_TO_SI)
_MICRO_G = UG_PER_SQRT_HZ_TO_SI  # m/s^2, numerically equal
_FITTED_COLOUR = "#000000"
_DECLARED_COLOUR = "#D55E00"
_FIT_WIDTH = 0.7
_FIT_LABEL = "complete fit"
_ACCELERATION_COLOUR = "#555555"
#: Largest error bar relative to the value: a bar down to zero would reach the end of a log axis.
_MAX_BAR_SHARE = 0.9
_LOG_MARGIN = 1.3
_MAX_FINE_TICKS_RATIO = 50.0
_LEGEND_KEY_IN = 0.55  # width of a legend without its text: its lines and edges


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
    _draw_channel(
        accelerometers, estimate.acceleration, _MICRO_G, "East and North", _ACCELERATION_COLOUR, "D"
    )
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
    figure.subplots_adjust(right=1.0 - (_LEGEND_KEY_IN + text_width_in(texts, 8)) / WIDTH_IN)
    return figure


def _draw_channel(
    axes: Axes, channel: ChannelNoise, unit: float, label: str, colour: str, marker: str
) -> None:
    fit, has_motion = channel.fit, channel.has_motion
    if not has_motion.any():
        return
    tau, deviation = channel.allan.tau_s[has_motion], channel.allan.deviation[has_motion] / unit
    sigma = None
    if fit:
        sigma = deviation * np.minimum(1.0 / np.sqrt(2.0 * fit.edf[has_motion]), _MAX_BAR_SHARE)
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
        axes.plot(tau, np.sqrt(fit.expected[has_motion]) / unit, color=colour, linewidth=_FIT_WIDTH)


def _draw_walks(
    axes: Axes,
    measured: NoiseParameter,
    declared: float,
    walk_unit: tuple[str, float],
    unit: float,
    *,
    has_fit: bool,
) -> None:
    """Draw the random walks as lines of slope -1/2, and format axes and legend."""
    unit_name, unit_si = walk_unit
    if not axes.containers:
        axes.set(xticks=[], yticks=[])
        label_empty(axes, "constant output: noise below resolution")
        return
    tau = np.array([axes.dataLim.x0, axes.dataLim.x1])
    levels = [axes.dataLim.y0, axes.dataLim.y1]
    fitted = measured.value if measured.is_significant and measured.value is not None else 0.0
    text = measured.text(unit_name, unit_si).replace(", ", "\n")
    for value, label, colour, line in (
        (fitted, f"random walk\n{text}", _FITTED_COLOUR, "-"),
        (declared, f"declared\n{declared / unit_si:.3g} {unit_name}", _DECLARED_COLOUR, (0, (5, 3))),
    ):
        if value > 0.0:
            deviations = value / unit / np.sqrt(tau)
            levels.extend(deviations)
            axes.plot(tau, deviations, color=colour, linestyle=line, label=label)
    if not fitted:
        axes.plot([], [], linestyle="none", label=f"random walk\n{text}")
    if has_fit:
        axes.plot([], [], color=_ACCELERATION_COLOUR, linewidth=_FIT_WIDTH, label=_FIT_LABEL)
    low, high = min(levels), max(levels)
    axes.set(xscale="log", yscale="log", ylim=(low / _LOG_MARGIN, high * _LOG_MARGIN))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(
            LogLocator(subs=(1.0, 2.0, 5.0) if high < _MAX_FINE_TICKS_RATIO * low else (1.0,))
        )
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
    title = BARS_SHORT if has_fit else None
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), title=title, title_fontsize=8)
