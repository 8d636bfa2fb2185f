"""Separability of effects in a planned campaign for a terminal of 80 columns, readable without colour."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from gyrobench.bench.closure.loop import reason_too_few_dwells
from gyrobench.bench.closure.outcome import Closure
from gyrobench.bench.closure.planned_campaign import UnitProperties
from gyrobench.bench.closure.posterior import TIE_ODDS
from gyrobench.bench.closure.procedure_changes import Advice
from gyrobench.bench.closure.separability import EFFECT_POWER, Detection, Separability
from gyrobench.bench.closure.tie_forecast import TieForecast
from gyrobench.bench.foundations.arrays import rms
from gyrobench.bench.foundations.text import counted, listed
from gyrobench.bench.report.number_format import odds_text
from gyrobench.bench.report.terminal.tables import titled_table

_MAX_INFLATION = 1000.0
#: Larger sizes are not stated: such an effect is visible without a search.
_MAX_SIZE_DPH = 1.0
_COLUMNS_TEXT = (
    f"found: smallest size found with {EFFECT_POWER:.0%} probability, for the middle values of the effect's "
    "parameters; worst: for the worst values. VIF: variance inflation by the other effects, fitted beside "
    "it. distinct: smallest size at which it is distinguished from its nearest alternative."
)


def separability_summary(
    separability: Separability, dwells: int, unit: UnitProperties, target_dph: float, advice: Sequence[Advice]
) -> RenderableType:
    """Sizes at which effects are found and distinguished, effects that are not, and procedure changes.

    ``separability``: of the dwells searched. ``dwells``: number of dwells, including held-out ones.
    ``target_dph``: rms size that should be found and distinguished. ``advice``: changes for that size.
    """
    observable = [each for each in separability.detections if each.missing_input is None]
    parts: list[RenderableType] = [
        Text("Separability of effects; sizes rms in 0.001 deg/h", style="bold"),
        Text(_assumptions_text(separability, dwells, unit)),
        Text(),
    ]
    if observable:
        parts += [_detection_table(separability, observable), Text(_COLUMNS_TEXT), Text()]
    names_by_input: dict[str, list[str]] = {}
    for each in separability.detections:
        if each.missing_input:
            names_by_input.setdefault(each.missing_input, []).append(each.effect.display_name)
    parts += [
        Text(f"Not observable: {listed(names)}. Missing input: {missing}.")
        for missing, names in sorted(names_by_input.items())
    ]
    parts += [Text(line) for line in _not_distinguished_lines(separability, observable, target_dph)]
    parts += [Text(_advice_sentence(each, separability.label)) for each in advice]
    return Group(*parts)


def closure_forecast(
    closure: Closure,
    unit: UnitProperties,
    expected_dph: Mapping[str, float],
    ties: Sequence[TieForecast],
    advice: Sequence[Advice],
) -> RenderableType:
    """Ties of a closure, the odds expected after the plan, and procedure changes that settle them.

    ``expected_dph``: expected sizes, in the dwells of the plan, of the effects found.
    """
    rms_k = unit.thermal.rms_k if unit.thermal else None
    fit_text = "are those of a typical unit" if rms_k is None else f"fit its dwells within {rms_k:.2g} K rms"
    sizes = (
        listed([f"{closure.label(name)} {_size_text(size_dph)}" for name, size_dph in expected_dph.items()])
        or "none"
    )
    parts: list[RenderableType] = [
        Text("What the plan decides of the search", style="bold"),
        Text(
            f"The search: {closure.verdict}. Effects found, with their sizes in the plan's dwells: {sizes}. "
            f"The temperatures of the unit {fit_text}."
        ),
    ]
    if not ties:
        return Group(*parts, Text("The search leaves no tie."))
    text_columns = ("found", "tied with")
    table = titled_table(
        headers=(*text_columns, "now", "plan alone", "if found", "if tied"), wrapped=text_columns
    )
    for each in ties:
        odds = [_plan_odds_text(value) for value in (each.now, each.plan_only, each.if_found, each.if_other)]
        table.add_row(closure.label(each.found), closure.label(each.other), *odds)
    columns_text = (
        "now: odds by which the dwells searched prefer the effect found. plan alone: expected from the plan "
        "without them, if the effect found is present. if found, if tied: expected with both, for the effect "
        f"that is present; settled from {TIE_ODDS:.0f} to 1 for both."
    )
    missing = [
        f"{closure.label(each.other)} is not fitted. Missing input: {each.missing_input}."
        for each in ties
        if each.missing_input
    ]
    open_ties = [(each.found, each.other) for each in ties if not each.is_settled]
    outcome = (
        f"Still tied after the plan: {pairs_text(open_ties, closure.label)}."
        if open_ties
        else "The plan settles all ties."
    )
    return Group(
        *parts,
        table,
        Text(columns_text),
        *map(Text, missing),
        Text(outcome),
        *(Text(_advice_sentence(each, closure.label)) for each in advice),
    )


def _plan_odds_text(odds: float) -> str:
    if not np.isfinite(odds):
        return "not fitted"
    text = odds_text(2.0 * abs(math.log(odds)))
    return text if odds >= 1.0 else f"1 to {text.removesuffix(' to 1')}"


def pairs_text(pairs: Collection[tuple[str, str]], label: Callable[[str], str]) -> str:
    """Pairs, each once, grouped by the effect that occurs in most of them: "a from b and c; d from e"."""
    remaining = {(label(first), label(second)) for first, second in pairs}
    groups = []
    while remaining:
        names = sorted({name for pair in remaining for name in pair})
        most_frequent = max(names, key=lambda name: sum(name in pair for pair in remaining))
        group = {pair for pair in remaining if most_frequent in pair}
        others = sorted(name for pair in group for name in pair if name != most_frequent)
        groups.append(f"{most_frequent} from {listed(others)}")
        remaining -= group
    return "; ".join(groups)


def _assumptions_text(separability: Separability, dwells: int, unit: UnitProperties) -> str:
    campaign = separability.campaign
    noise_text = f"an angle random walk of {np.mean(unit.angle_random_walk_deg_per_sqrt_h):.2g} deg/sqrt(h)"
    sigma_text = f"±{1e3 * rms(campaign.sigma_dph):.2f}"
    if dwells > len(campaign):
        searched_text = f"The search uses {len(campaign)} of {dwells} dwells; the last cycle is held out."
    else:
        searched_text = (
            f"There is one cycle of {counted(dwells, 'dwell')}. A search needs two, one of them held out; "
            "this table is for all dwells."
        )
    if text := reason_too_few_dwells(campaign, campaign.all_dwells):
        searched_text += f" Too few for gyrobench close: {text}."
    return (
        f"{searched_text} Standard uncertainty of a bias: {sigma_text}, from {noise_text}, "
        f"{unit.noise_source}."
    )


def _detection_table(separability: Separability, observable: Sequence[Detection]) -> Table:
    headers = ("effect", "found", "worst", "VIF", "alternative", "distinct")
    table = titled_table(headers=headers, wrapped=("effect", "alternative"))
    for each in observable:
        nearest, size_dph = separability.nearest_alternative(each.effect.name) or ("none", each.typical_dph)
        inflation = f"x{each.inflation:.1f}" if each.inflation < _MAX_INFLATION else "x>1000"
        sizes = _size_text(each.typical_dph), _size_text(each.largest_dph)
        table.add_row(
            each.effect.display_name, *sizes, inflation, separability.label(nearest), _size_text(size_dph)
        )
    return table


def _not_distinguished_lines(
    separability: Separability, observable: Sequence[Detection], target_dph: float
) -> list[str]:
    not_found = separability.not_found(target_dph)
    undetected = [each.effect.display_name for each in observable if each.effect.name in not_found]
    pairs = separability.not_distinguished(target_dph)
    if not observable:
        return []
    if not (undetected or pairs):
        return [f"At {_size_text(target_dph)} all effects are found and distinguished."]
    lines = []
    if undetected:
        lines.append(f"Not found at {_size_text(target_dph)}: {listed(undetected)}.")
    if pairs:
        text = pairs_text(pairs, separability.label)
        lines.append(f"Not distinguished at {_size_text(target_dph)}: {text}.")
    return [*lines, ""]


def _advice_sentence(advice: Advice, label: Callable[[str], str]) -> str:
    benefits = []
    if advice.found:
        pronoun = "it" if len(advice.found) == 1 else "them"
        benefits.append(
            f"finds {listed([*map(label, advice.found)])} and distinguishes {pronoun} from all others"
        )
    if advice.pairs:
        benefits.append(f"distinguishes {pairs_text(advice.pairs, label)}")
    if not advice.instructions:
        return f"No known change {', or '.join(benefits)}."
    hours = f"{abs(advice.added_h):.1f} h {'less' if advice.added_h < 0.0 else 'more'}"
    loss = f", but does not distinguish {pairs_text(advice.lost, label)}" if advice.lost else ""
    return f"With {hours}: {listed(advice.instructions)}. This {', and '.join(benefits)}{loss}."


def _size_text(size_dph: float) -> str:
    if not np.isfinite(size_dph):
        return "never"
    return f"{1e3 * size_dph:.2f}" if size_dph < _MAX_SIZE_DPH else f">{1e3 * _MAX_SIZE_DPH:.0f}"
