"""Error of the predicted bias in the dwells that the search did not see, before and after."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gyrobench.bench.closure.loop import Closure
from gyrobench.bench.foundations.arrays import BoolArray
from gyrobench.bench.navigation.positions import AXES, POSITIONS, gyro_label, position_label
from gyrobench.bench.report.closure.residuals import (
    held_out_cycles,
    noise_dph,
    residuals_dph,
    rms,
    scale_of_errors,
)
from gyrobench.bench.report.closure.style import AFTER_COLOUR, BEFORE_COLOUR, NOISE_COLOUR
from gyrobench.bench.report.figures.style import house_style, new_figure
from gyrobench.bench.report.number_format import BiasScale

_BINS_C = (5.0, 10.0, 20.0, 50.0)
_MOST_BINS = 12


@house_style
def closure_error_figure(closure: Closure) -> Figure:
    """Draw the rms error of the held-out dwells by gyro, position and temperature, with their noise.

    Paired bars, declared model and with the effects; without any effect single bars.
    """
    held_out = ~closure.searched
    scale = scale_of_errors(closure)
    figure = new_figure(4.6)
    upper, lower = figure.subplots(2, 1, sharey=True)
    groups = {gyro_label(gyro): _of_gyro(held_out, axis) for axis, gyro in enumerate(AXES)}
    for name in POSITIONS:
        chosen = held_out & (np.array(closure.campaign.position) == name)
        if chosen.any():
            groups[position_label(name)] = np.repeat(chosen[:, np.newaxis], len(AXES), axis=1)
    _bars(upper, closure, groups, scale)
    _bars(lower, closure, temperature_groups(closure), scale)
    upper.axvline(len(AXES) - 0.5, color="#bbbbbb", linewidth=0.8)
    upper.set_title(f"Error in {held_out_cycles(closure)}, which the search did not see")
    lower.set_xlabel("temperature of the gyro / °C")
    for axes in (upper, lower):
        axes.set_ylabel(f"rms / ({scale.unit})")
    figure.legend(*upper.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def temperature_groups(closure: Closure) -> dict[str, BoolArray]:
    """Held-out biases (n, 3) by temperature of their gyro, in at most a dozen bins of equal width."""
    gyro_c = closure.campaign.gyro_c
    held_out = np.repeat(~closure.searched[:, np.newaxis], len(AXES), axis=1)
    low_c, high_c = gyro_c[held_out].min(), gyro_c[held_out].max()
    width_c = next((each for each in _BINS_C if (high_c - low_c) / each < _MOST_BINS - 1), _BINS_C[-1])
    edges = np.arange(np.floor(low_c / width_c), np.floor(high_c / width_c) + 1.0) * width_c
    groups = {
        f"{edge:g}..{edge + width_c:g}": held_out & (gyro_c >= edge) & (gyro_c < edge + width_c)
        for edge in edges
    }
    return {name: chosen for name, chosen in groups.items() if chosen.any()}


def _of_gyro(held_out: BoolArray, axis: int) -> BoolArray:
    return np.asarray(held_out[:, np.newaxis] & (np.arange(len(AXES)) == axis))


def _bars(axes: Axes, closure: Closure, groups: dict[str, BoolArray], scale: BiasScale) -> None:
    models = {"declared model": (closure.declared, BEFORE_COLOUR)}
    if closure.effects:
        models["with the effects found"] = (closure.model, AFTER_COLOUR)
    places = np.arange(len(groups))
    width = 0.8 / len(models)
    for number, (label, (model, colour)) in enumerate(models.items()):
        errors_dph = residuals_dph(closure, model)
        heights = [rms(errors_dph[chosen]) * scale.factor for chosen in groups.values()]
        axes.bar(places - 0.4 + (number + 0.5) * width, heights, width, color=colour, label=label)
    noise = [rms(noise_dph(closure)[chosen]) * scale.factor for chosen in groups.values()]
    axes.hlines(noise, places - 0.45, places + 0.45, color=NOISE_COLOUR, linewidth=1.4, label="noise")
    axes.set_xticks(places, list(groups), fontsize=7)
    axes.grid(visible=False, axis="x")
