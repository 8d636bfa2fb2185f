"""What the paper's method leaves out: its bias less that of the state-space estimator."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gyrobench.bench.bias.dwell_table import DwellRow, paper_rows
from gyrobench.bench.navigation.positions import AXES, POSITIONS, gyro_label, position_label
from gyrobench.bench.report.style import POSITION_STYLES, house_style, mark_paper_limit, new_figure, say_empty
from gyrobench.bench.report.wording import PAPER, STATE_SPACE, BiasScale

_DODGE = 0.012  # of the range of temperatures, between neighbouring positions


@house_style
def estimators_figure(dwells: Iterable[DwellRow]) -> Figure:
    """Draw the difference of the two estimates of every dwell against the gyro's temperature.

    Bars are the uncertainties of both combined. Both come from the same data, so noise alone
    drives them less far apart: points beyond their bars are what the paper's method leaves out.

    Parameters
    ----------
    dwells : iterable of DwellRow
        Dwells with flags, or without the paper's estimate, are left out.
    """
    both = with_both(dwells)
    pairs = [pair for row in both for pair in differences_dph(row)]
    scale = BiasScale.of(*(zip(*pairs, strict=True) if pairs else ((), ())))
    figure = new_figure(3.6)
    panels = figure.subplots(1, len(AXES), sharex=True, sharey=True)
    for axis, (gyro, axes) in enumerate(zip(AXES, panels, strict=True)):
        axes.set_title(gyro_label(gyro))
        axes.axhline(0.0, color="#444444", linewidth=0.9)
        _draw(axes, axis, both, scale)
    panels[0].set_ylabel(f"{PAPER} less\n{STATE_SPACE} / ({scale.unit})")
    panels[1].set_xlabel("temperature of the gyro / °C")
    if both:
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(POSITIONS))
    else:
        say_empty(panels[1], "the paper's method gave no bias")
    return figure


def with_both(dwells: Iterable[DwellRow]) -> list[DwellRow]:
    """Dwells without flags that have both estimates."""
    return [row for row in dwells if not row.flags and paper_rows([row])]


def differences_dph(row: DwellRow) -> list[tuple[float, float]]:
    """The paper's bias less the state-space one for each gyro, and their uncertainties combined."""
    both = zip(row.bias_dph, row.sigma_dph, row.paper_bias_dph, row.paper_sigma_dph, strict=True)
    return [(paper - bias, math.hypot(sigma, paper_sigma)) for bias, sigma, paper, paper_sigma in both]


def _draw(axes: Axes, axis: int, rows: Sequence[DwellRow], scale: BiasScale) -> None:
    temperatures = [row.gyro_c[axis] for row in rows]
    dodge_c = _DODGE * (max(temperatures, default=0.0) - min(temperatures, default=0.0))
    for place, (position, style) in enumerate(POSITION_STYLES.items()):
        own = [row for row in rows if row.position == position]
        if own:
            pairs = [differences_dph(row)[axis] for row in own]
            _, _, bars = axes.errorbar(
                [row.gyro_c[axis] + (place - 2.5) * dodge_c for row in own],
                [difference * scale.factor for difference, _ in pairs],
                [sigma * scale.factor for _, sigma in pairs],
                label=position_label(position),
                linestyle="none",
                marker=style.marker,
                markersize=4.0,
                markerfacecolor=style.face,
                color=style.colour,
                elinewidth=0.7,
            )
            bars[0].set_alpha(0.4)
    if rows:
        mark_paper_limit(axes, along="x")
