"""What the report says of acceptance: limits, and each gyro against them, bin by bin."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from gyrobench.bench.bias.verdicts import Acceptance, AcceptanceLimits, Judgement, Verdict
from gyrobench.bench.foundations.text import bin_label, listed
from gyrobench.bench.navigation.positions import gyro_label, position_label
from gyrobench.bench.report.acceptance_wording import place_of
from gyrobench.bench.report.page.sections import Mark, Section, SectionTable
from gyrobench.bench.report.wording import BiasScale

_HOW = (
    "Positions are compared within one stop of the chamber, in one power-on, at the mean temperature of the "
    "stop, with the gyro's own curve over temperature; passes of a stop in several cycles are judged by "
    "their mean where they agree, else one by one. "
    "The largest of several noisy differences is larger than the largest true one, so the table tells "
    "between which limits the true one lies. Pass: every pair of positions stays below the limit with "
    "{0:g} % confidence. Fail: some pair is above it with {0:g} % confidence, allowing for the number of all "
    "pairs. Marginal: between the two. A unit at a limit is accepted, and one within all limits is "
    "rejected, with a probability of at most {1:g} %."
)
_LACKING = (
    "Planned dwells that were not compared with the others of their stop, because they are flagged or "
    "missing, or because of a power-on or other temperatures between them: {}."
)
_DISAGREEING = (
    "Passes of the same stop disagree by more than their noise does, and are judged one by one: {}. Bias "
    "may depend there on how the temperature came about."
)
_MOST_NAMED = 12
_CAPTIONS = (
    "Largest difference between two positions in {}, by temperature of the gyro",
    "Largest difference between two positions, and largest bias, in {}, by temperature of the gyro",
)
_MARKS: Mapping[Verdict, Mark] = MappingProxyType({"pass": "", "marginal": "doubtful", "fail": "bad"})


def acceptance_section(acceptance: Acceptance | None) -> Section | None:
    """Put the judgements of a run into a table; None where the procedure states no limits."""
    if acceptance is None or acceptance.limits is None:
        return None
    limits = acceptance.limits
    paragraphs = [
        _limits_sentence(limits),
        _how(limits),
        _disagreeing_sentence(acceptance),
        _lacking_sentence(acceptance),
    ]
    return Section(
        "Acceptance",
        [text for text in paragraphs if text],
        tables=[_table(acceptance)] if acceptance.judgements else [],
    )


def _limits_sentence(limits: AcceptanceLimits) -> str:
    told = [f"{limits.position_difference_dph:g} deg/h between two positions at one stop"]
    if limits.bias_dph is not None:
        told.append(f"a bias of {limits.bias_dph:g} deg/h of either sign")
    sentence = f"Limits of the procedure: {listed(told)}."
    if limits.bias_sigma_dph is not None:
        sentence += (
            f" A dwell whose bias is less certain than {limits.bias_sigma_dph:g} deg/h counts as "
            "not measured."
        )
    return sentence


def _how(limits: AcceptanceLimits) -> str:
    return _HOW.format(100.0 * limits.confidence, round(100.0 * (1.0 - limits.confidence), 6))


def _disagreeing_sentence(acceptance: Acceptance) -> str:
    places = [
        f"{gyro_label(each.gyro)} at {bin_label(each.bin_low_c, each.bin_high_c)} °C"
        for each in acceptance.judgements
        if not each.passes_agree
    ]
    return _DISAGREEING.format(listed(places)) if places else ""


def _lacking_sentence(acceptance: Acceptance) -> str:
    places = list(
        dict.fromkeys((each.cycle, each.chamber_set_c, each.position) for each in acceptance.not_measured)
    )
    if not places:
        return ""
    named = [
        position_label(position)
        + ("" if set_c is None else f" at {set_c:g} °C in the chamber")
        + f" in cycle {cycle}"
        for cycle, set_c, position in places[:_MOST_NAMED]
    ]
    more = len(places) - len(named)
    return _LACKING.format(listed([*named, f"{more} more"] if more else named))


def _table(acceptance: Acceptance) -> SectionTable:
    judged = acceptance.judgements
    scale = BiasScale.of([each.limit_dph for each in judged], [each.sigma_dph for each in judged])
    return SectionTable(
        _CAPTIONS[any(each.quantity == "bias" for each in judged)].format(scale.unit),
        ["gyro", "bin / °C", "position", "verdict", "measured ± 1 σ", "true, at least", "at most", "limit"],
        [_row(each, scale) for each in judged],
        words=4,
        marks=[_MARKS[each.verdict] for each in judged],
    )


def _row(judged: Judgement, scale: BiasScale) -> list[str]:
    return [
        gyro_label(judged.gyro),
        bin_label(judged.bin_low_c, judged.bin_high_c),
        place_of(judged),
        judged.verdict,
        scale.with_sigma(judged.value_dph, judged.sigma_dph),
        scale.text(judged.at_least_dph),
        scale.text(judged.at_most_dph),
        scale.text(judged.limit_dph),
    ]
