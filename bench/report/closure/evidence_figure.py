"""How much of what the declared model leaves each candidate effect explains, alone."""

from __future__ import annotations

import math

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from gyrobench.bench.closure.loop import Closure, Evidence
from gyrobench.bench.closure.search import SIGNIFICANCE
from gyrobench.bench.foundations.text import plain_name
from gyrobench.bench.report.closure.residuals import rests_on_noise
from gyrobench.bench.report.closure.style import FOUND_COLOUR, NOTE_COLOUR, OTHER_COLOUR, TIED_COLOUR
from gyrobench.bench.report.closure.wording import p_phrase, share_text
from gyrobench.bench.report.figures.style import house_style, new_figure

_HEIGHT_OF_BAR_IN = 0.27
_MOST_POWERS = 12.0
_PERCENT = 100.0


@house_style
def closure_evidence_figure(closure: Closure) -> Figure:
    """Draw a bar for each candidate: its share of the squares beyond the noise.

    Where the declared model leaves no more than noise there are no shares; the bars are then the
    probabilities of chance, the less the longer.
    """
    figure = new_figure(1.5 + _HEIGHT_OF_BAR_IN * len(closure.evidence))
    axes = figure.add_subplot()
    found = {each.candidate.effect.name for each in closure.effects}
    tied = {name for each in closure.effects for name in each.tied_with}
    by_chance = rests_on_noise(closure)
    for place, each in enumerate(closure.evidence):
        name = each.effect.name
        colour = FOUND_COLOUR if name in found else TIED_COLOUR if name in tied else OTHER_COLOUR
        if each.lacks is None:
            length = _powers(each) if by_chance else _PERCENT * min(max(each.share, 0.0), 1.0)
            axes.barh(place, length, color=colour, height=0.7)
            _note(axes, length, place, p_phrase(each.p_value) if by_chance else _told(each))
        else:
            _note(axes, 0.0, place, f"not tried: lacks {each.lacks}")
    axes.set_yticks(range(len(closure.evidence)), [plain_name(each.effect.name) for each in closure.evidence])
    for label, each in zip(axes.get_yticklabels(), closure.evidence, strict=True):
        label.set_color(NOTE_COLOUR if each.lacks else "black")
    axes.set_ylim(len(closure.evidence) - 0.4, -0.6)
    axes.grid(visible=False, axis="y")
    if by_chance:
        axes.axvline(-math.log10(SIGNIFICANCE), color="#444444", linestyle="--", linewidth=0.9)
        axes.set(
            title="Each effect alone, against chance", xlabel="-log10 of p; right of the line it is found"
        )
        axes.set_xlim(0.0, max(1.25 * axes.get_xlim()[1], 4.0))
    else:
        axes.set(
            title="Each effect alone", xlabel="share of the squares beyond the noise / %", xlim=(0.0, 132.0)
        )
        axes.set_xticks([0, 20, 40, 60, 80, 100])
    _legend(figure, found, tied)
    return figure


def _told(each: Evidence) -> str:
    return f"{share_text(each.share)}, {p_phrase(each.p_value)}"


def _powers(each: Evidence) -> float:
    return min(-math.log10(max(each.p_value, 1e-300)), _MOST_POWERS)


def _note(axes: Axes, length: float, place: int, text: str) -> None:
    axes.annotate(
        text, (length, place), (4, 0), textcoords="offset points", va="center", fontsize=7, color=NOTE_COLOUR
    )


def _legend(figure: Figure, found: set[str], tied: set[str]) -> None:
    parts = {"found": (found, FOUND_COLOUR), "would do as well": (tied, TIED_COLOUR)}
    handles = [Patch(color=colour, label=label) for label, (names, colour) in parts.items() if names]
    if handles:
        figure.legend(
            handles=[*handles, Patch(color=OTHER_COLOUR, label="others")], loc="outside lower center", ncols=3
        )
