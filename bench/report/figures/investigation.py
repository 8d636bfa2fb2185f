"""Probabilities of effects over the time of an investigation."""

from __future__ import annotations

from matplotlib.figure import Figure

from gyrobench.bench.investigation.stages import Investigation
from gyrobench.bench.report.figures.style import fitted_figure, house_style

_CURVE_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_MIN_DRAWN_PROBABILITY = 0.02
_OTHER_HYPOTHESES = {
    "nothing": ("nothing beyond the declared model", "#888888"),
    "": ("not on the list", "#222222"),
}


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
