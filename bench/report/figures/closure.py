"""Figures of effects: a search for them, their separability in a plan, an investigation."""

from __future__ import annotations

import math
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.patches import Rectangle

from gyrobench.bench.closure.outcome import Closure, FoundEffect
from gyrobench.bench.closure.search import EFFECT_SIGNIFICANCE
from gyrobench.bench.foundations.arrays import S_PER_H, BoolArray, FloatArray, nan_rms
from gyrobench.bench.navigation.positions import AXES, POSITIONS, position_label
from gyrobench.bench.report.closure_text import held_out_cycles, is_noise_only, models_of, scale_of_errors
from gyrobench.bench.report.figures.style import (
    GYRO_STYLES,
    common_legend,
    fitted_figure,
    house_style,
    label_empty,
    new_figure,
    text_width_in,
)
from gyrobench.bench.report.number_format import BiasScale, p_phrase, share_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from gyrobench.bench.closure.separability import Separability
    from gyrobench.bench.investigation.stages import Investigation

#: Colours of bars before and after, and of candidates that are found, tied, or neither.
_BEFORE_COLOUR, _AFTER_COLOUR = "#AAAAAA", "#0072B2"
_FOUND_COLOUR, _TIED_COLOUR, _OTHER_COLOUR = "#0072B2", "#E69F00", "#CCCCCC"
_KIND_COLOURS = {"found": _FOUND_COLOUR, "tied": _TIED_COLOUR, "others": _OTHER_COLOUR}
_NOTE_COLOUR, _NOISE_COLOUR, _BAND_COLOUR = "#666666", "#222222", "#E3E3E3"
_NOISE_LABEL = "± noise (k = 1)"
_HELD_OUT_COLOUR = "#D55E00"
_PERCENT = 100.0
_AXIS_MARGIN, _POINT_SIZE, _BAR_HEIGHT_IN, _MAX_POWER = 1.1, 2.2, 0.27, 12.0
#: Width over which the dwells of a position are spread in the order of time, relative to its spacing.
_DWELL_SPREAD = 0.7
#: Line length, in characters, of a label below one of three panels.
_LABEL_WIDTH = 32
#: Line length, in characters, of a note beside the bars of candidates.
_NOTE_WIDTH = 68
_BINS_C, _MAX_BINS = (5.0, 10.0, 20.0, 50.0), 12
#: Separability: correlation above which its text is white, and height of a row.
_MIN_WHITE_TEXT_VALUE, _ROW_INCHES = 0.6, 0.42
#: Investigation: colours of the curves of effects, smallest probability drawn, other hypotheses.
_CURVE_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_MIN_DRAWN_PROBABILITY = 0.02
_OTHER_HYPOTHESES = {
    "nothing": ("nothing beyond the declared model", "#888888"),
    "": ("not on the list", "#222222"),
}


def _draw_dwells(
    axes: Axes, abscissa: FloatArray, values: FloatArray, searched: BoolArray, gyro: str, size: float = 2.6
) -> None:
    """Draw a point for each dwell (n,) of a gyro; held-out dwells are hollow."""
    colour, _, marker = GYRO_STYLES[gyro]
    for label, selected, edge, face in (
        ("searched", searched, colour, colour),
        ("held out", ~searched, _HELD_OUT_COLOUR, "white"),
    ):
        axes.plot(
            abscissa[selected],
            values[selected],
            linestyle="none",
            marker=marker,
            markersize=size,
            markeredgewidth=0.2 * size,
            markeredgecolor=edge,
            markerfacecolor=face,
            label=label,
        )


@house_style
def closure_residual_figure(closure: Closure, gyro: str) -> Figure:
    """Draw measured minus predicted bias against temperature, time, temperature rate and position.

    Top: declared model, bottom: with the effects found, on the same scale; without effects the declared
    model alone. The band is one standard deviation of the noise.
    """
    axis = AXES.index(gyro)
    residuals = {name: closure.residuals_dph(model)[:, axis] for name, model in models_of(closure).items()}
    noise = nan_rms(closure.dwell_noise_dph[:, axis])
    scale = scale_of_errors(closure)
    abscissae = _abscissae(closure, axis)
    largest = _AXIS_MARGIN * scale.factor * max(float(np.nanmax(np.abs(each))) for each in residuals.values())
    figure = new_figure(0.8 + 1.75 * len(residuals), right_in=0.07, bottom_in=0.65, hspace=0.22)
    grid = figure.subplots(len(residuals), len(abscissae), sharex="col", sharey=True, squeeze=False)
    for row, (name, values_dph) in zip(grid, residuals.items(), strict=True):
        row[0].set_title(f"{closure.quantity.headings[axis]}, {name}")
        row[0].set_ylim(-largest, largest)
        for axes, abscissa in zip(row, abscissae.values(), strict=True):
            _draw_dwells(axes, abscissa, values_dph * scale.factor, closure.searched, gyro, size=_POINT_SIZE)
            axes.axhspan(
                -noise * scale.factor,
                noise * scale.factor,
                color=_BAND_COLOUR,
                zorder=0.5,
                label=_NOISE_LABEL,
            )
    for axes, label in zip(grid[-1], abscissae, strict=True):
        axes.set_xlabel(label, fontsize=8)
    names = _positions(closure)
    grid[-1, -1].set_xticks(range(len(names)), list(map(position_label, names)), fontsize=7, rotation=90)
    figure.supylabel(f"residual / ({scale.unit})", x=0.005, fontsize=9)
    common_legend(figure, grid[0, :1])
    return figure


def _abscissae(closure: Closure, axis: int) -> dict[str, FloatArray]:
    """Values of the dwells by label; the dwells of a position are spread in the order of time."""
    campaign, names = closure.campaign, _positions(closure)
    position = np.array([names.index(each) for each in campaign.position], dtype=np.float64)
    time_share = np.arange(len(position)) / max(len(position) - 1, 1)
    return {
        "temperature / °C": campaign.gyro_c[:, axis],
        "time / h": (campaign.middle_s - campaign.start_s[0]) / S_PER_H,
        "temperature rate / (K/h)": campaign.rate_c_per_h[:, axis],
        "position": position + _DWELL_SPREAD * (time_share - 0.5),
    }


def _positions(closure: Closure) -> list[str]:
    return [name for name in POSITIONS if name in closure.campaign.position]


@house_style
def closure_evidence_figure(closure: Closure) -> Figure:
    """Draw the share of excess variance explained by each candidate alone.

    If there is no excess variance, the bars show the p-values on a logarithmic scale.
    """
    names = [each.effect.display_name for each in closure.evidence]
    figure = new_figure(1.5 + _BAR_HEIGHT_IN * len(names), left_in=0.15 + text_width_in(names, 9))
    axes = figure.add_subplot()
    found, tied = set(closure.names), closure.tied
    by_p_value = is_noise_only(closure)
    for row, each in enumerate(closure.evidence):
        name = each.effect.name
        kind = "found" if name in found else "tied" if name in tied else "others"
        if each.missing_input is None:
            power = min(-math.log10(max(each.p_value, 1e-300)), _MAX_POWER)
            length = power if by_p_value else _PERCENT * min(max(each.share, 0.0), 1.0)
            share = "" if by_p_value else f"{share_text(each.share)}, "
            axes.barh(row, length, color=_KIND_COLOURS[kind], height=0.7, label=kind)
            _annotate_bar(axes, length, row, share + p_phrase(each.p_value))
        else:
            _annotate_bar(axes, 0.0, row, fill(f"not fitted; missing: {each.missing_input}", _NOTE_WIDTH))
    axes.set_yticks(range(len(names)), names)
    for label, each in zip(axes.get_yticklabels(), closure.evidence, strict=True):
        label.set_color(_NOTE_COLOUR if each.missing_input else "black")
    axes.set_ylim(len(closure.evidence) - 0.4, -0.6)
    axes.grid(visible=False, axis="y")
    if by_p_value:
        axes.axvline(-math.log10(EFFECT_SIGNIFICANCE), color="#444444", linestyle="--", linewidth=0.9)
        axes.set(
            title="Significance of each effect alone", xlabel="-log10(p); found to the right of the line"
        )
        axes.set_xlim(0.0, max(1.25 * axes.get_xlim()[1], 4.0))
    else:
        axes.set(
            title="Each effect alone", xlabel="share of excess variance explained / %", xlim=(0.0, 132.0)
        )
        axes.set_xticks([0, 20, 40, 60, 80, 100])
    if found or tied:
        common_legend(figure, [axes])
    return figure


def _annotate_bar(axes: Axes, length: float, row: int, text: str) -> None:
    axes.annotate(
        text, (length, row), (4, 0), textcoords="offset points", va="center", fontsize=7, color=_NOTE_COLOUR
    )


@house_style
def closure_effect_figure(closure: Closure, effect: FoundEffect) -> Figure:
    """Draw partial residuals for each gyro: measured bias minus the model without the main term.

    The main term is the one that changes the gyro's bias most in the dwells searched. A monotonic
    function of time is drawn over time. The line is the fitted term.
    """
    columns = effect.candidate.columns(closure.campaign)
    residual_dph = closure.residuals_dph(closure.model)
    found_axes = [axis for axis, name in enumerate(closure.quantity.axes) if name in effect.axes]
    scale = scale_of_errors(closure)
    figure = new_figure(3.1, right_in=0.07, bottom_in=0.6, top_in=0.5, wspace=0.2)
    all_axes = figure.subplots(1, len(AXES), sharey=True)
    for axis, (axes, gyro) in enumerate(zip(all_axes, AXES, strict=True)):
        axes.set_title(closure.quantity.headings[axis])
        if axis not in found_axes:
            label_empty(axes, "not significant")
            axes.set_xticks([])
            continue
        abscissa, label, bias_dph = _main_term(closure, effect, columns, axis)
        order = np.argsort(abscissa, kind="stable")
        line, band = bias_dph[order] * scale.factor, nan_rms(closure.dwell_noise_dph[:, axis]) * scale.factor
        area = axes.fill_between(abscissa[order], line - band, line + band, zorder=0.5, label=_NOISE_LABEL)
        area.set(color=_BAND_COLOUR, linewidth=0)
        values = (residual_dph[:, axis] + bias_dph) * scale.factor
        _draw_dwells(axes, abscissa, values, closure.searched, gyro)
        axes.plot(abscissa[order], line, color="black", linewidth=1.0, label="fit")
        axes.set_xlabel(fill(label, _LABEL_WIDTH), fontsize=8)
    figure.supylabel(f"partial residual / ({scale.unit})", x=0.005, fontsize=9)
    figure.suptitle(effect.effect.display_name.capitalize(), fontsize=9)
    common_legend(figure, [all_axes[found_axes[0]]])
    return figure


def _main_term(
    closure: Closure, effect: FoundEffect, columns: FloatArray, axis: int
) -> tuple[FloatArray, str, FloatArray]:
    """The term that changes one gyro's bias most: abscissa and its label, bias (n,) without its mean."""
    campaign, searched = closure.campaign, closure.searched
    terms_dph = columns[:, axis] * effect.sizes_dph[axis]
    term = int(np.argmax(np.std(terms_dph[searched], axis=0)))
    abscissa, label = (columns / effect.weights)[:, axis, term], effect.candidate.form.terms[term]
    if np.all(np.diff(abscissa) >= 0.0):
        abscissa, label = (campaign.middle_s - campaign.start_s[0]) / S_PER_H, "time / h"
    return abscissa, label, terms_dph[:, term] - terms_dph[searched, term].mean()


@house_style
def closure_error_figure(closure: Closure) -> Figure:
    """Draw the held-out rms error by gyro, position and temperature, with the noise.

    Paired bars: declared model, and with the effects found.
    """
    held_out = ~closure.searched
    scale = scale_of_errors(closure)
    figure = new_figure(4.6)
    upper, lower = figure.subplots(2, 1, sharey=True)
    groups = {
        heading: np.asarray(held_out[:, np.newaxis] & (np.arange(len(AXES)) == axis))
        for axis, heading in enumerate(closure.quantity.headings)
    }
    for name in POSITIONS:
        selected = held_out & (np.array(closure.campaign.position) == name)
        if selected.any():
            groups[position_label(name)] = np.repeat(selected[:, np.newaxis], len(AXES), axis=1)
    _draw_bars(upper, closure, groups, scale)
    _draw_bars(lower, closure, temperature_groups(closure), scale)
    upper.axvline(len(AXES) - 0.5, color="#bbbbbb", linewidth=0.8)
    upper.set_title(f"Error in {held_out_cycles(closure)} (held out)")
    lower.set_xlabel("gyro temperature / °C")
    for axes in (upper, lower):
        axes.set_ylabel(f"rms / ({scale.unit})")
    common_legend(figure, [upper])
    return figure


def temperature_groups(closure: Closure) -> dict[str, BoolArray]:
    """Held-out biases (n, 3) by gyro temperature, in at most twelve bins of equal width."""
    gyro_c = closure.campaign.gyro_c
    held_out = np.repeat(~closure.searched[:, np.newaxis], len(AXES), axis=1)
    low_c, high_c = gyro_c[held_out].min(), gyro_c[held_out].max()
    width_c = next((each for each in _BINS_C if (high_c - low_c) / each < _MAX_BINS - 1), _BINS_C[-1])
    edges = np.arange(np.floor(low_c / width_c), np.floor(high_c / width_c) + 1.0) * width_c
    groups = {
        f"{edge:g}..{edge + width_c:g}": held_out & (gyro_c >= edge) & (gyro_c < edge + width_c)
        for edge in edges
    }
    return {name: chosen for name, chosen in groups.items() if chosen.any()}


def _draw_bars(axes: Axes, closure: Closure, groups: dict[str, BoolArray], scale: BiasScale) -> None:
    models = models_of(closure)
    positions = np.arange(len(groups))
    width = 0.8 / len(models)
    colours = (_BEFORE_COLOUR, _AFTER_COLOUR)
    for index, ((label, model), colour) in enumerate(zip(models.items(), colours, strict=False)):
        errors_dph = closure.residuals_dph(model)
        heights = [nan_rms(errors_dph[chosen]) * scale.factor for chosen in groups.values()]
        axes.bar(positions - 0.4 + (index + 0.5) * width, heights, width, color=colour, label=label)
    noise = [nan_rms(closure.dwell_noise_dph[chosen]) * scale.factor for chosen in groups.values()]
    axes.hlines(noise, positions - 0.45, positions + 0.45, color=_NOISE_COLOUR, linewidth=1.4, label="noise")
    axes.set_xticks(positions, list(groups), fontsize=7)
    axes.grid(visible=False, axis="x")


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
    framed = {frozenset(pair) for pair in separability.not_distinguished(target_dph)}
    for row, row_name in enumerate(names):
        for column, column_name in enumerate(names):
            if row == column:
                continue
            colour = "white" if values[row, column] > _MIN_WHITE_TEXT_VALUE else "black"
            axes.text(
                column, row, f"{values[row, column]:.2f}", ha="center", va="center", color=colour, fontsize=7
            )
            if {row_name, column_name} in framed:
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


@house_style
def probability_figure(investigation: Investigation) -> Figure:
    """Draw the probabilities of each effect, of no effect and of an unlisted effect over bench hours."""
    hours = [stage.spent_h for stage in investigation.stages]
    posteriors = [stage.closure.posterior for stage in investigation.stages]
    probabilities = [
        each.effect_probabilities | {"nothing": each.no_effect_probability, "": each.unlisted_probability}
        for each in posteriors
    ]
    curves = {
        name: [each.get(name, 0.0) for each in probabilities]
        for stage_probabilities in probabilities
        for name in stage_probabilities
    }
    figure = fitted_figure(3.4)
    axes = figure.subplots()
    names = sorted(
        (each for each in curves if max(curves[each]) > _MIN_DRAWN_PROBABILITY),
        key=lambda each: -max(curves[each]),
    )
    colours = iter(_CURVE_COLOURS)
    for name in names:
        label, colour = _OTHER_HYPOTHESES.get(name, (investigation.closure.label(name), ""))
        axes.plot(
            hours,
            curves[name],
            marker="o",
            markersize=4,
            label=label,
            color=colour or next(colours, "#AAAAAA"),
        )
    axes.axhline(0.99, color="#888888", linewidth=0.8, linestyle=":")
    for block_number, (stage, after) in enumerate(
        zip(investigation.stages[:-1], investigation.stages[1:], strict=True), start=1
    ):
        tint = "#EEEEEE" if block_number % 2 else "#FAFAFA"
        axes.axvspan(stage.spent_h, after.spent_h, color=tint, linewidth=0.0, zorder=0)
        middle = 0.5 * (stage.spent_h + after.spent_h)
        axes.annotate(str(block_number), (middle, 1.04), ha="center", fontsize=7, annotation_clip=False)
    if investigation.spent_h > 0.5 * investigation.repeated_campaign_h:
        axes.axvline(
            investigation.repeated_campaign_h, color="#888888", linewidth=0.8, label="campaign repeated"
        )
    axes.set(xlabel="hours on the bench since the first table", ylabel="probability", ylim=(-0.02, 1.02))
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure
