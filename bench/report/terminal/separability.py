"""Separability of effects in a planned campaign, for a terminal of 80 columns."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Sequence

import numpy as np
from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from gyrobench.bench.closure.planned_campaign import PlannedUnit
from gyrobench.bench.closure.procedure_changes import Advice
from gyrobench.bench.closure.separability import POWER, Detection, Separability
from gyrobench.bench.foundations.text import counted, listed

_MAX_INFLATION = 1000.0
_COLUMNS = (
    f"found from: smallest size found with {POWER:.0%} probability at the median of the effect's "
    "parameters; at worst: at the worst value. variance: inflation of the variance of its size by fitting "
    "the other effects. distinct: smallest size at which it is distinguished from the hardest rival."
)


def separability_summary(
    separability: Separability, dwells: int, unit: PlannedUnit, target_dph: float, advice: Sequence[Advice]
) -> RenderableType:
    """Sizes at which effects are found and separable, failures at the target size, and advice.

    Parameters
    ----------
    separability : Separability
        Of the dwells searched.
    dwells : int
        Number of dwells including those held out.
    unit : PlannedUnit
        The unit under test.
    target_dph : float
        Size of interest, deg/h rms.
    advice : sequence of Advice
        What :func:`gyrobench.bench.closure.procedure_changes.advise` says for the target.
    """
    seen = [each for each in separability.detections if each.lacks is None]
    parts: list[RenderableType] = [
        Text("Separability of effects; sizes rms in 0.001 deg/h", style="bold"),
        Text(_basis(separability, dwells, unit)),
        Text(),
    ]
    if seen:
        parts += [_table(separability, seen), Text(_COLUMNS), Text()]
    for lack, each in itertools.groupby(sorted(separability.detections, key=_lack), key=_lack):
        if lack:
            names = listed([detection.effect.name for detection in each])
            parts.append(Text(f"Not observable without {lack}: {names}."))
    parts += [Text(line) for line in _not_separable(separability, seen, target_dph)]
    parts += [Text(_advice_sentence(each)) for each in advice]
    return Group(*parts)


def _lack(detection: Detection) -> str:
    return detection.lacks or ""


def pairs_text(pairs: Collection[tuple[str, str]]) -> str:
    """Pairs, each once, gathered by the effect that is in most of them: "a from b and c; d from e"."""
    left = set(pairs)
    groups = []
    while left:
        names = sorted({name for pair in left for name in pair})
        first = max(names, key=lambda name: sum(name in pair for pair in left))
        mine = {pair for pair in left if first in pair}
        others = sorted(name for pair in mine for name in pair if name != first)
        groups.append(f"{first} from {listed(others)}")
        left -= mine
    return "; ".join(groups)


def _basis(separability: Separability, dwells: int, unit: PlannedUnit) -> str:
    campaign = separability.campaign
    walk = f"an angle random walk of {unit.angle_random_walk_deg_per_sqrt_h:g} deg/sqrt(h)"
    whose = "declared by the station" if unit.is_noise_declared else "a typical value, none is declared"
    sigma = f"±{1e3 * float(np.sqrt(np.mean(campaign.sigma_dph**2))):.2f}"
    if dwells > len(campaign):
        searched = f"{len(campaign)} of {dwells} dwells are searched; the last cycle is held out."
    else:
        searched = (
            f"One cycle of {counted(dwells, 'dwell')}; a search needs two to hold one out. These results are "
            "for all dwells."
        )
    return f"{searched} Standard uncertainty of each bias {sigma}, from {walk}, {whose}."


def _table(separability: Separability, seen: Sequence[Detection]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=0)
    table.add_column("effect", no_wrap=True)
    for header in ("found from", "at worst", "variance"):
        table.add_column(header, justify="right", no_wrap=True)
    table.add_column("hardest rival", no_wrap=True)
    table.add_column("distinct", justify="right", no_wrap=True)
    for each in seen:
        name = each.effect.name
        rival, separable_dph = separability.hardest_rival(name) or ("none", each.typical_dph)
        inflation = f"x{each.inflation:.1f}" if each.inflation < _MAX_INFLATION else "x>1000"
        sizes = _size(each.typical_dph), _size(each.largest_dph)
        table.add_row(name, *sizes, inflation, rival, _size(separable_dph))
    return table


def _not_separable(separability: Separability, seen: Sequence[Detection], target_dph: float) -> list[str]:
    hidden = [each.effect.name for each in seen if each.effect.name in separability.not_found(target_dph)]
    pairs = separability.not_told(target_dph)
    if not seen:
        return []
    if not (hidden or pairs):
        return [f"At {_size(target_dph)} all of them are found and separable."]
    lines = []
    if hidden:
        lines.append(f"Not found at {_size(target_dph)}: {listed(hidden)}.")
    if pairs:
        lines.append(f"Not separable at {_size(target_dph)}: {pairs_text(pairs)}.")
    return [*lines, ""]


def _advice_sentence(advice: Advice) -> str:
    helps = []
    if advice.found:
        them = "it" if len(advice.found) == 1 else "them"
        helps.append(f"finds {listed(advice.found)} and separates {them} from all others")
    if advice.pairs:
        helps.append(f"separates {pairs_text(advice.pairs)}")
    if not advice.what:
        return f"No change known here {', or '.join(helps)}."
    hours = f"{abs(advice.added_h):.1f} h {'less' if advice.added_h < 0.0 else 'more'}"
    lost = f"; but no longer {pairs_text(advice.lost)}" if advice.lost else ""
    return f"With {hours}, {listed(advice.what)}: {', and '.join(helps)}{lost}."


def _size(size_dph: float) -> str:
    return f"{1e3 * size_dph:.2f}" if np.isfinite(size_dph) else "never"
