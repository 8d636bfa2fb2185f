"""Correlation of effects in a planned campaign."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from gyrobench.bench.closure.separability import Separability
from gyrobench.bench.report.figures.style import fitted_figure, house_style, label_empty

_MIN_WHITE_TEXT_VALUE = 0.6
_ROW_INCHES = 0.42


@house_style
def separability_figure(separability: Separability, target_dph: float, name: str) -> Figure:
    """Draw the correlations of effects; pairs not distinguished at the target size (rms) are framed."""
    names = [each.effect.name for each in separability.detections if each.missing_input is None]
    figure = fitted_figure(2.0 + _ROW_INCHES * max(len(names), 3))
    axes = figure.subplots()
    axes.grid(False)
    axes.set_title(f"Correlation of effects in {name}")
    if len(names) < 2:
        axes.set_axis_off()
        label_empty(axes, "fewer than two observable effects")
        return figure
    values = np.array(
        [[separability.correlation.get((row, column), 1.0) for column in names] for row in names]
    )
    image = axes.imshow(values, vmin=0.0, vmax=1.0, cmap="Blues", aspect="auto")
    labels = [*map(separability.label, names)]
    axes.set_xticks(range(len(names)), labels, rotation=35, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(len(names)), labels)
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)
    framed = {
        pair
        for row_name, column_name in separability.not_distinguished(target_dph)
        for pair in ((row_name, column_name), (column_name, row_name))
    }
    for row, row_name in enumerate(names):
        for column, column_name in enumerate(names):
            if row == column:
                continue
            colour = "white" if values[row, column] > _MIN_WHITE_TEXT_VALUE else "black"
            axes.text(
                column, row, f"{values[row, column]:.2f}", ha="center", va="center", color=colour, fontsize=7
            )
            if (row_name, column_name) in framed:
                frame = Rectangle((column - 0.46, row - 0.44), 0.92, 0.88, fill=False)
                frame.set(edgecolor="#D55E00", linewidth=1.6)
                axes.add_patch(frame)
    figure.colorbar(image, ax=axes, label="largest canonical correlation of any gyro", fraction=0.04)
    found_count = len(set(names) - set(separability.not_found(target_dph)))
    axes.set_xlabel(
        f"{found_count} of {len(names)} effects are found at {target_dph:g} deg/h rms\n"
        "framed: not distinguished from one of these"
    )
    return figure
