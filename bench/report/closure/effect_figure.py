"""An effect as the dwells show it: what is left without its main term, against what that term follows."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gyrobench.bench.closure.loop import Closure, FoundEffect
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray
from gyrobench.bench.foundations.text import plain_name
from gyrobench.bench.navigation.positions import AXES, gyro_label
from gyrobench.bench.report.closure.residuals import noise_dph, residuals_dph, rms, scale_of_errors
from gyrobench.bench.report.closure.style import BAND_COLOUR, draw_dwells
from gyrobench.bench.report.figures.style import house_style, new_figure, say_empty
from gyrobench.bench.report.number_format import BiasScale

_S_PER_H = 3600.0


@house_style
def closure_effect_figure(closure: Closure, found: FoundEffect) -> Figure:
    """Draw partial residuals for each gyro: measured bias less all of the model but the main term.

    The main term is the one that moves the gyro's bias most in the dwells searched. A term that only
    ever rises with time is drawn over time. The line is the term as fitted.

    Parameters
    ----------
    closure : Closure
        Outcome of a search.
    found : FoundEffect
        One of its effects.
    """
    columns = found.candidate.columns(closure.campaign)
    left_dph = residuals_dph(closure, closure.model)
    parts = {
        axis: _MainTerm(closure, found, columns, axis) for axis, gyro in enumerate(AXES) if gyro in found.axes
    }
    scale = scale_of_errors(closure)
    figure = new_figure(3.1)
    all_axes = figure.subplots(1, len(AXES), sharey=True)
    for axis, (axes, gyro) in enumerate(zip(all_axes, AXES, strict=True)):
        axes.set_title(gyro_label(gyro))
        if axis not in parts:
            say_empty(axes, "does not show it")
            axes.set_xticks([])
            continue
        noise = rms(noise_dph(closure)[:, axis])
        _draw(axes, parts[axis], left_dph[:, axis], noise, scale, closure.searched, gyro)
    all_axes[0].set_ylabel(f"bias less all else / ({scale.unit})")
    first = all_axes[min(parts)]
    figure.suptitle(plain_name(found.candidate.effect.name).capitalize(), fontsize=9)
    figure.legend(*first.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


class _MainTerm:
    """The term of an effect that moves one gyro's bias most.

    Attributes
    ----------
    label : str
        What the horizontal axis is.
    along, bias_dph : ndarray, shape (n,)
        What the term is drawn against, and the bias that it makes, less its mean.
    """

    def __init__(self, closure: Closure, found: FoundEffect, columns: FloatArray, axis: int) -> None:
        campaign, searched = closure.campaign, closure.searched
        parts_dph = columns[:, axis] * found.sizes_dph[axis]
        term = int(np.argmax(np.std(parts_dph[searched], axis=0)))
        self.along: FloatArray = columns[:, axis, term]
        self.label = found.candidate.form.terms[term]
        self.bias_dph: FloatArray = parts_dph[:, term] - parts_dph[searched, term].mean()
        if np.all(np.diff(self.along) >= 0.0):
            self.along = (campaign.middle_s - campaign.start_s[0]) / _S_PER_H
            self.label = "time / h"


def _draw(
    axes: Axes,
    main: _MainTerm,
    left_dph: FloatArray,
    noise_dph: float,
    scale: BiasScale,
    searched: BoolArray,
    gyro: str,
) -> None:
    values = (left_dph + main.bias_dph) * scale.factor
    order = np.argsort(main.along, kind="stable")
    along, line = main.along[order], main.bias_dph[order] * scale.factor
    band = noise_dph * scale.factor
    axes.fill_between(
        along, line - band, line + band, color=BAND_COLOUR, zorder=0.5, linewidth=0, label="± noise"
    )
    draw_dwells(axes, main.along, values, searched, gyro)
    axes.plot(along, line, color="black", linewidth=1.0, label="as fitted")
    axes.set_xlabel(main.label, fontsize=8)
