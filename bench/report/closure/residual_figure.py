"""What the bias model leaves of one gyro's bias, before and after effects were added."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gyrobench.bench.closure.loop import Closure
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.navigation.positions import AXES, POSITIONS, gyro_label, position_label
from gyrobench.bench.report.closure.residuals import noise_dph, residuals_dph, rms, scale_of_errors
from gyrobench.bench.report.closure.style import BAND_COLOUR, draw_dwells
from gyrobench.bench.report.figures.style import house_style, new_figure

_S_PER_H = 3600.0
_ROOM = 1.1
_POINT = 2.2
#: Part of a position's width over which its dwells are spread, in the order of time.
_SPREAD = 0.7


@house_style
def closure_residual_figure(closure: Closure, gyro: str) -> Figure:
    """Draw measured minus predicted bias against temperature, time, temperature rate and position.

    Above by the declared model, below with the effects found, on the same scale. Without any effect
    there is the declared model alone. The band is one standard deviation of the noise.

    Parameters
    ----------
    closure : Closure
        Outcome of a search.
    gyro : {"x", "y", "z"}
        Which gyro.
    """
    axis = AXES.index(gyro)
    models = {"declared model": closure.declared}
    if closure.effects:
        models["with the effects found"] = closure.model
    residuals = {name: residuals_dph(closure, model)[:, axis] for name, model in models.items()}
    noise = rms(noise_dph(closure)[:, axis])
    scale = scale_of_errors(closure)
    against = _against(closure, axis)
    largest = _ROOM * scale.factor * max(float(np.abs(each).max()) for each in residuals.values())
    figure = new_figure(0.8 + 1.75 * len(residuals))
    grid = figure.subplots(len(residuals), len(against), sharex="col", sharey=True, squeeze=False)
    for row, (name, values_dph) in zip(grid, residuals.items(), strict=True):
        row[0].set_title(f"{gyro_label(gyro)}, {name}")
        row[0].set_ylim(-largest, largest)
        for axes, along in zip(row, against.values(), strict=True):
            draw_dwells(axes, along, values_dph * scale.factor, closure.searched, gyro, size=_POINT)
            axes.axhspan(
                -noise * scale.factor, noise * scale.factor, color=BAND_COLOUR, zorder=0.5, label="± noise"
            )
    for axes, label in zip(grid[-1], against, strict=True):
        axes.set_xlabel(label, fontsize=8)
    _name_positions(grid[-1, -1], closure)
    figure.supylabel(f"residual / ({scale.unit})", fontsize=9)
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def _against(closure: Closure, axis: int) -> dict[str, FloatArray]:
    campaign = closure.campaign
    return {
        "temperature / °C": campaign.gyro_c[:, axis],
        "time / h": (campaign.middle_s - campaign.start_s[0]) / _S_PER_H,
        "its rate / (K/h)": campaign.rate_c_per_h[:, axis],
        "position": _places(closure),
    }


def _places(closure: Closure) -> FloatArray:
    """Number of each dwell's position, spread in the order of time."""
    names = _positions(closure)
    place = np.array([names.index(each) for each in closure.campaign.position], dtype=np.float64)
    part = np.arange(len(place)) / max(len(place) - 1, 1)
    return place + _SPREAD * (part - 0.5)


def _positions(closure: Closure) -> list[str]:
    return [name for name in POSITIONS if name in closure.campaign.position]


def _name_positions(axes: Axes, closure: Closure) -> None:
    names = _positions(closure)
    axes.set_xticks(range(len(names)), [position_label(name) for name in names], fontsize=7, rotation=90)
