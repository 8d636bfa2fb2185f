"""Probabilities of effects over the hours of an investigation."""

from __future__ import annotations

from matplotlib.figure import Figure

from gyrobench.bench.investigation.stages import Investigation
from gyrobench.bench.report.figures.style import fitted_figure, house_style

_CURVES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_MIN_DRAWN = 0.02
_OTHERS = {"nothing": ("nothing beyond the declared model", "#888888"), "": ("not on the list", "#222222")}


@house_style
def probability_figure(found: Investigation) -> Figure:
    """Draw the probability of each effect, of nothing and of what is on no list over the hours."""
    hours = [stage.spent_h for stage in found.stages]
    posteriors = [stage.closure.posterior for stage in found.stages]
    values = [
        each.effect_probabilities | {"nothing": each.no_effect_probability, "": each.unlisted_probability}
        for each in posteriors
    ]
    curves = {name: [each.get(name, 0.0) for each in values] for every in values for name in every}
    figure = fitted_figure(3.4)
    axes = figure.subplots()
    shown = sorted(
        (each for each in curves if max(curves[each]) > _MIN_DRAWN), key=lambda each: -max(curves[each])
    )
    colours = iter(_CURVES)
    for name in shown:
        label, colour = _OTHERS.get(name, (found.closure.label(name), ""))
        axes.plot(
            hours,
            curves[name],
            marker="o",
            markersize=4,
            label=label,
            color=colour or next(colours, "#AAAAAA"),
        )
    axes.axhline(0.99, color="#888888", linewidth=0.8, linestyle=":")
    for number, (stage, after) in enumerate(zip(found.stages[:-1], found.stages[1:], strict=True), start=1):
        tint = "#EEEEEE" if number % 2 else "#FAFAFA"
        axes.axvspan(stage.spent_h, after.spent_h, color=tint, linewidth=0.0, zorder=0)
        middle = 0.5 * (stage.spent_h + after.spent_h)
        axes.annotate(str(number), (middle, 1.04), ha="center", fontsize=7, annotation_clip=False)
    if found.spent_h > 0.5 * found.repeated_campaign_h:
        axes.axvline(found.repeated_campaign_h, color="#888888", linewidth=0.8, label="campaign repeated")
    axes.set(xlabel="hours on the bench since the first table", ylabel="probability", ylim=(-0.02, 1.02))
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure
