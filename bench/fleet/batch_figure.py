"""Units of a batch around what they share: one figure of levels, one of differences between positions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gyrobench.bench.fleet.batch_model import EffectSize, TraitInBatch, standing_out
from gyrobench.bench.fleet.batch_wording import batch_scale
from gyrobench.bench.foundations.text import bin_label
from gyrobench.bench.navigation.positions import AXES, gyro_label, position_label
from gyrobench.bench.report.figures.style import house_style, new_figure, say_empty
from gyrobench.bench.report.number_format import BiasScale
from gyrobench.bench.runs.index_run_biases import LEVEL, Quantity

_COLOURS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_WIDTH = 0.62


@house_style
def batch_figure(batch: Sequence[TraitInBatch], *, of_positions: bool) -> Figure:
    """Draw the units, one panel a gyro, one band a temperature bin or a position in one.

    Parameters
    ----------
    batch : sequence of TraitInBatch
        The batch.
    of_positions : bool
        Whether to draw the differences of positions in place of the levels.
    """
    figure = new_figure(9.2 if of_positions else 7.6)
    panels = figure.subplots(len(AXES), 1, sharex=False)
    out = list(dict.fromkeys(unit.unit for _, unit in standing_out(batch)))[: len(_COLOURS)]
    colours = dict(zip(out, _COLOURS, strict=False))
    scale = batch_scale(batch)
    for gyro, panel in zip(AXES, panels, strict=True):
        mine = [
            trait
            for trait in batch
            if not isinstance(trait.trait, EffectSize)
            and trait.trait.gyro == gyro
            and (trait.trait.name != LEVEL) == of_positions
        ]
        for place, trait in enumerate(mine):
            _draw(panel, place, trait, scale, colours)
        panel.set_title(gyro_label(gyro))
        panel.set_ylabel(f"{'difference' if of_positions else 'bias'} / ({scale.unit})")
        panel.grid(visible=False, axis="x")
        if mine:
            labels = [_label(trait.trait) for trait in mine if isinstance(trait.trait, Quantity)]
            panel.set_xticks(range(len(mine)), labels, rotation=90 if of_positions else 0, fontsize=8)
        else:
            say_empty(panel, "nothing that enough units have")
    handles, labels = panels[0].get_legend_handles_labels()
    for panel in panels[1:]:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            if label not in labels:
                handles.append(handle)
                labels.append(label)
    figure.legend(handles, labels, loc="outside upper center", ncols=5)
    return figure


def _draw(panel: Axes, place: int, trait: TraitInBatch, scale: BiasScale, colours: dict[str, str]) -> None:
    centre, spread = scale.factor * trait.mean_dph, scale.factor * trait.between_units.value
    ends = [place - 0.5 * _WIDTH - 0.08, place + 0.5 * _WIDTH + 0.08]
    first = place == 0
    for times, alpha in ((2.0, 0.16), (1.0, 0.3)):
        label = f"batch ± {times:g} spread" if first else None
        panel.fill_between(
            ends,
            centre - times * spread,
            centre + times * spread,
            color="#5a656d",
            alpha=alpha,
            lw=0,
            label=label,
        )
    panel.plot(ends, [centre, centre], color="#1d2429", lw=1.2, label="batch's mean" if first else None)
    places = place + np.linspace(-0.5, 0.5, len(trait.units)) * _WIDTH
    for x, unit in zip(places, trait.units, strict=True):
        colour = colours.get(unit.unit, "#444444")
        panel.errorbar(
            x,
            scale.factor * unit.bias_dph,
            scale.factor * unit.sigma_dph,
            fmt="D" if unit.stands_out else "o",
            markersize=5.5 if unit.stands_out else 2.8,
            color=colour,
            elinewidth=0.8,
            label=_unit_label(unit.unit, unit.stands_out, unit.unit in colours, first=first),
        )


def _unit_label(unit: str, stands_out: bool, is_coloured: bool, *, first: bool) -> str | None:
    if stands_out:
        return f"unit {unit}, stands out"
    if is_coloured:
        return f"unit {unit}, elsewhere" if first else None
    return None


def _label(quantity: Quantity) -> str:
    if quantity.name == LEVEL:
        return f"{bin_label(quantity.bin_low_c, quantity.bin_high_c)} °C"
    return f"{position_label(quantity.name)}, {bin_label(quantity.bin_low_c, quantity.bin_high_c, '..')} °C"
