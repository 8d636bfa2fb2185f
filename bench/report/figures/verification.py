"""Residual biases and coefficients with each compensation, and position errors over a day."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gyrobench.bench.calibration.coefficients import COEFFICIENTS
from gyrobench.bench.calibration.mission import HOURS
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.report.figures.style import common_legend, house_style, label_empty, new_figure
from gyrobench.bench.report.verification_text import LABELS
from gyrobench.bench.verification.compensation_verification import DECLARED, EFFECT, NONE, VerificationResult

#: Colour and label of each compensation, and its line.
_STYLES: dict[str, dict[str, Any]] = {
    name: {"color": colour, "label": LABELS[name]}
    for name, colour in ((NONE, "#AAAAAA"), (DECLARED, "#E69F00"), (EFFECT, "#0072B2"))
}
_LINES = {NONE: ":", DECLARED: "--", EFFECT: "-"}
_NOISE_COLOUR = "#222222"
_GROUP_WIDTH = 0.8
#: Labels of plateaus, with the cycle in brackets if there are several, are vertical if there are more.
_MAX_HORIZONTAL_LABELS = 4
_Panel = tuple[str, str, str, str, float]
_PANELS: tuple[_Panel, ...] = (
    ("bias without the gyros' means", "rms / (0.001 deg/h)", "varying_rms_dph", "bias_noise_dph", 1000.0),
    ("spread between positions", "maximum / (0.001 deg/h)", "spread_dph", "spread_noise_dph", 1000.0),
    ("velocity error East", "maximum / (mm/s)", "velocity_east_mps", "velocity_noise_mps", 1000.0),
    ("rotational INS in 24 h", "maximum error / nmi", "position_nmi", "position_noise_nmi", 1.0),
)


@house_style
def residual_bars_figure(result: VerificationResult) -> Figure:
    """Draw the residuals at all plateaus as bars, one for each compensation, with the noise as a line."""
    measured = [row for each in result.results for row in each.rows]
    panels = [each for each in _PANELS if any(math.isfinite(getattr(row, each[2])) for row in measured)]
    panels = panels or [_PANELS[0]]
    rows, columns = -(-len(panels) // 2), min(len(panels), 2)
    figure = new_figure(0.2 + 2.7 * rows, wspace=0.24, hspace=0.42)
    all_axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in all_axes[len(panels) :]:
        axes.set_axis_off()
    for axes, (title, unit, size, noise, factor) in zip(all_axes, panels, strict=False):
        _draw_bars(axes, result, size, noise, factor)
        axes.set_title(title, fontsize=9)
        axes.set_ylabel(unit)
    common_legend(figure, figure.axes[:1])
    return figure


@house_style
def day_figure(result: VerificationResult) -> Figure:
    """Draw the position error over a day for each plateau with all six positions, of which at least one."""
    plateaus = [each for each in result.plateaus if any(row.day for row in each.measured_rows)]
    figure = new_figure(1.0 + 1.7 * len(plateaus), hspace=0.2)
    panels = figure.subplots(len(plateaus), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for axes, plateau in zip(panels, plateaus, strict=True):
        for each, row in zip(result.results, plateau.rows, strict=True):
            error = row.day.error if row is not None and row.day is not None else None
            # A run without this plateau has an empty line, which keeps the order of the legend.
            axes.plot(
                [] if error is None else error.time_s / 3600.0,
                [] if error is None else error.distance_nmi,
                linestyle=_LINES[each.compensation],
                **_STYLES[each.compensation],
            )
        noise_nmi = plateau.noise_row("position_nmi").position_noise_nmi
        axes.axhline(noise_nmi, color=_NOISE_COLOUR, linewidth=0.8, label="noise")
        axes.set_title(f"{plateau.measured_rows[0].gyro_c:.0f} °C", fontsize=9)
        axes.set_ylabel("distance / nmi")
    panels[-1].set_xlabel("time / h")
    panels[-1].set_xlim(0.0, 24.0)
    panels[-1].set_xticks(np.arange(0, 25, 4))
    panels[-1].set_ylim(bottom=0.0)
    common_legend(figure, panels)
    return figure


def _draw_bars(axes: Axes, result: VerificationResult, size: str, noise: str, factor: float) -> None:
    plateaus = [
        each
        for each in result.plateaus
        if any(math.isfinite(getattr(row, size)) for row in each.measured_rows)
    ]
    if not plateaus:
        label_empty(axes, "not measured")
        return
    positions = np.arange(len(plateaus))
    width = _GROUP_WIDTH / len(result.results)
    for index, each in enumerate(result.results):
        run_rows = [plateau.rows[index] for plateau in plateaus]
        # Without a value there is no bar: one of height NaN is not drawn.
        values = [math.nan if row is None else factor * getattr(row, size) for row in run_rows]
        offset = (index - 0.5 * (len(result.results) - 1)) * width
        axes.bar(positions + offset, values, 0.92 * width, **_STYLES[each.compensation])
    noises = [factor * getattr(plateau.noise_row(size), noise) for plateau in plateaus]
    rows = [plateau.measured_rows[0] for plateau in plateaus]
    _draw_noise(axes, noises, 0.5 * _GROUP_WIDTH)
    is_upright = len(rows) > _MAX_HORIZONTAL_LABELS
    unit, several = "" if is_upright else " °C", len({row.cycle for row in rows}) > 1
    labels = [f"{row.gyro_c:z.0f}{unit}" + (f" ({row.cycle})" if several else "") for row in rows]
    axes.set_xticks(positions, labels, rotation=90 if is_upright else 0, fontsize=6.5 if is_upright else 8)
    axes.set_ylim(bottom=0.0)
    axes.grid(visible=False, axis="x")


def _draw_noise(axes: Axes, values: Sequence[float] | FloatArray, half_width: float) -> None:
    """Draw the noise of each group of bars or points as a line across the group."""
    positions = np.arange(len(values))
    ends = positions - half_width, positions + half_width
    axes.hlines(values, *ends, color=_NOISE_COLOUR, linewidth=1.2, label="noise")


_MARKERS = {NONE: "o", DECLARED: "s", EFFECT: "D"}
_SENSOR_LABELS = {"gyro": "gyro", "accelerometer": "acc."}
_UNITS = tuple(dict.fromkeys(each.unit for each in COEFFICIENTS))


@house_style
def coefficient_residuals_figure(result: VerificationResult) -> Figure:
    """Draw the rms of each coefficient with each compensation, by unit, on logarithmic scales."""
    figure = new_figure(5.2, bottom_in=0.6, top_in=0.1, wspace=0.22, hspace=0.45)
    panels = figure.subplots(2, 2).ravel()
    for axes, unit in zip(panels, _UNITS, strict=True):
        indices = [index for index, each in enumerate(COEFFICIENTS) if each.unit == unit]
        names = [
            f"{_SENSOR_LABELS[COEFFICIENTS[index].sensor]} {COEFFICIENTS[index].axis}" for index in indices
        ]
        factor, label = (1000.0, f"0.001 {unit}") if unit == "deg/h" else (1.0, unit)
        for each in result.coefficients:
            axes.plot(
                names,
                factor * each.rms[indices],
                linestyle="none",
                marker=_MARKERS[each.compensation],
                markersize=4,
                **_STYLES[each.compensation],
            )
        positions = np.arange(len(indices))
        _draw_noise(axes, factor * result.coefficients[-1].noise[indices], 0.35)
        axes.set_yscale("log")
        low, high = axes.get_ylim()
        axes.set_ylim(10.0 ** np.floor(np.log10(low)), 10.0 ** np.ceil(np.log10(high)))
        axes.set_xticks(positions, names, rotation=90 if len(indices) > 3 else 0, fontsize=7)
        axes.set_ylabel(f"rms / ({label})")
    common_legend(figure, panels[:1])
    return figure


@house_style
def mission_figure(result: VerificationResult) -> Figure:
    """Draw the position error over a day with each compensation, and the limit of 95 %."""
    figure = new_figure(3.2)
    axes = figure.subplots()
    for each in result.coefficients:
        error = each.worst.error
        style = _STYLES[each.compensation]
        axes.plot(error.time_s / 3600.0, error.distance_nmi, linewidth=1.0, **style)
        limit_style = style | {"label": f"{style['label']}, 95 %", "linestyle": "--"}
        limits_nmi = [error.high_nmi[0], *error.high_nmi]
        axes.step([0.0, *HOURS], limits_nmi, where="pre", linewidth=0.8, **limit_style)
    axes.set(xlabel="time / h", ylabel="distance / nmi", xlim=(0.0, HOURS[-1]), yscale="log")
    axes.set_xticks(np.arange(0, 25, 4))
    axes.set_ylim(
        bottom=max(1e-4, 0.03 * min(float(each.worst.error.high_nmi[0]) for each in result.coefficients))
    )
    common_legend(figure, [axes])
    return figure
