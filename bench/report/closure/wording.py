"""The chain from residual to cause in sentences, the same in report and terminal."""

from __future__ import annotations

import math

from gyrobench.bench.closure.loop import (
    LEFT_OVER_P,
    Closure,
    Evidence,
    FoundEffect,
    separating_measurement,
    statement,
    whereabouts,
)
from gyrobench.bench.foundations.text import counted, listed, plain_name
from gyrobench.bench.report.closure.residuals import (
    held_out_cycles,
    noise_dph,
    residuals_dph,
    rests_on_noise,
    rms,
    smallest_visible_dph,
)
from gyrobench.bench.report.number_format import p_text

_NOTICEABLE_SCALE = 1.005
#: Odds of two to one.
_EVEN = 2.0 * math.log(2.0)
_NEARLY_ALL, _ALL = 98.5, 100.0
_PLAIN_POWER, _LARGEST_POWER = 3.0, 12.0


def size_text(size_dph: float) -> str:
    """Write a size in deg/h with two digits, never with an exponent: "0.0092"."""
    if not size_dph > 0.0:
        return "0"
    return f"{size_dph:.{max(1 - math.floor(math.log10(size_dph)), 1)}f}"


def share_text(share: float) -> str:
    """Write a share in percent, at most all; what is less than all is never rounded to all."""
    percent = 100.0 * min(share, 1.0)
    is_nearly_all = _NEARLY_ALL <= percent < _ALL
    return f"{math.floor(percent * 10.0) / 10.0:.1f} %" if is_nearly_all else f"{percent:z.0f} %"


def p_phrase(p_value: float) -> str:
    """Write a p-value in a sentence: "p = 0.02", "p < 1e-09"."""
    text = p_text(p_value)
    return f"p < {text[1:]}" if text.startswith("<") else f"p = {text}"


def found_names(closure: Closure) -> str:
    """Labels of the effects found, as one."""
    return listed([plain_name(each.candidate.effect.name) for each in closure.effects])


def verdict_sentence(closure: Closure) -> str:
    """Say what came out, in one sentence."""
    found = found_names(closure)
    match closure.verdict:
        case "clean":
            return "The declared model explains the biases: what it leaves is noise."
        case "explained":
            causes = "one cause" if len(closure.effects) == 1 else f"{len(closure.effects)} causes"
            return f"What is left has {causes}, which the data tell from all else tried: {found}."
        case "ambiguous":
            either = "; ".join(map(_either, closure.effects))
            return f"There is an effect, but the data can't tell which: {either}."
        case _:
            part = f" {found.capitalize()} accounts for a part alone." if found else ""
            return f"Something is left that is more than noise, and no effect tried accounts for it.{part}"


def before_sentence(closure: Closure) -> str:
    """Say what the declared model leaves in the dwells searched, against the noise."""
    size = rms(residuals_dph(closure, closure.declared)[closure.searched])
    before = closure.before
    left = (
        f"The declared model, a cubic in each gyro's temperature and one constant for each run, leaves "
        f"{size_text(size)} deg/h rms in the {closure.searched.sum()} dwells searched; the noise of a "
        f"measured bias is {size_text(closure.noise_dph)} deg/h."
    )
    if before.p_value < LEFT_OVER_P:
        return (
            f"{left} Chance does not explain that ({p_phrase(before.p_value)}); it follows {before.follows}."
        )
    if closure.effects:
        chance = f"As a whole that could be chance ({p_phrase(before.p_value)})"
        return f"{left} {chance}; asking for each effect sees more."
    return f"{left} Chance explains that ({p_phrase(before.p_value)})."


def scale_sentence(closure: Closure) -> str:
    """Say where the noise is larger than stated; empty where it is not."""
    if closure.noise_scale < _NOTICEABLE_SCALE:
        return ""
    return (
        f"The biases scatter {closure.noise_scale:.2f} times as much as their stated uncertainties say, and "
        "that scatter follows nothing: it is taken for noise, and the noise told here holds it."
    )


def cause_sentences(closure: Closure) -> list[str]:
    """Name each effect, with its evidence: chance, and the cycles left out."""
    return [f"{statement(each)} {_evidence_of(each)}" for each in closure.effects]


def runner_up_sentence(closure: Closure) -> str:
    """Say how far behind the best other effect is; or what it explains, where nothing was found."""
    names = {each.candidate.effect.name for each in closure.effects}
    others = [each for each in closure.evidence if each.lacks is None and each.effect.name not in names]
    if not others or closure.verdict == "clean":
        return ""
    best = min(others, key=lambda each: each.score_behind)
    if not names and rests_on_noise(closure):
        best = min(others, key=lambda each: each.p_value)
        return (
            f"The best of the effects tried is {plain_name(best.effect.name)}; chance gives as much as it "
            f"explains, alone, with {p_phrase(best.p_value)}."
        )
    if not names:
        return (
            f"The best of the effects tried, {plain_name(best.effect.name)}, takes away "
            f"{share_text(best.share)} of what is beyond the noise, alone."
        )
    nearest = f"Of the effects not chosen {plain_name(best.effect.name)} alone comes nearest"
    odds = odds_text(best.score_behind).replace(">", "more than ")
    if best.score_behind < _EVEN:
        return f"{nearest}{_share_of(best, closure)}; the data do not prefer {found_names(closure)} to it."
    return f"{nearest}{_share_of(best, closure)}; the data prefer {found_names(closure)} to it by {odds}."


def lacks_sentences(closure: Closure) -> list[str]:
    """Say which effects were not tried, for want of which input."""
    reasons: dict[str, list[str]] = {}
    for each in closure.evidence:
        if each.lacks is not None:
            reasons.setdefault(each.lacks, []).append(plain_name(each.effect.name))
    return [f"Not tried: {listed(names)}, for want of {reason}." for reason, names in reasons.items()]


def tie_sentences(closure: Closure) -> list[str]:
    """Say what else it could be and how to find out; or that the data tell."""
    separating = separating_measurement(closure)
    ties = [
        f"In the place of {plain_name(each.candidate.effect.name)}, "
        f"{listed([plain_name(name) for name in each.tied_with])} would do nearly as well: the data prefer "
        "it by less than 100 to 1."
        for each in closure.effects
        if each.tied_with
    ]
    if ties:
        return [*ties, separating] if separating else ties
    place = "its place" if len(closure.effects) == 1 else "the place of one of them"
    return [f"Nothing else that was tried would do in {place}."] if closure.effects else []


def error_sentence(closure: Closure) -> str:
    """Say how large the error is in the cycle held out, before and after, beside its noise."""
    held_out = ~closure.searched
    noise = rms(noise_dph(closure)[held_out])
    dwells = counted(int(held_out.sum()), "dwell")
    cycle = f"In {held_out_cycles(closure)}, which the search did not see ({dwells})"
    start = f"{cycle}, measured minus predicted bias is"
    before, after = size_text(closure.error_before_dph), size_text(closure.error_after_dph)
    if not closure.effects:
        return f"{start} {before} deg/h rms; its noise is {size_text(noise)} deg/h."
    return (
        f"{start} {before} deg/h rms by the declared model and {after} with "
        f"{found_names(closure)}; its noise is {size_text(noise)} deg/h."
    )


def constants_sentence(closure: Closure) -> str:
    """Say which runs have their own mean removed; empty where none has."""
    campaign, searched = closure.campaign, closure.searched
    unseen = set(campaign.run[~searched].tolist()) - set(campaign.run[searched].tolist())
    if not unseen:
        return ""
    return (
        f"A run's constant is known from its own dwells alone, so {counted(len(unseen), 'run')} that the "
        "search did not see had the mean of its errors taken out first, before and after alike."
    )


def after_sentence(closure: Closure) -> str:
    """Say whether anything is left, and where."""
    place = whereabouts(closure)
    if place:
        return f"{place[0].upper()}{place[1:]}"
    after = closure.after
    left = f"What is left in the dwells searched is {after.noise_ratio:.2f} times the stated uncertainties"
    tests = (
        f"and follows neither time, temperature, position nor temperature rate ({p_phrase(after.p_value)})"
    )
    return (
        f"{left} {tests}."
        if closure.noise_scale < _NOTICEABLE_SCALE
        else f"{left}, with the noise as found, {tests}."
    )


def limit_sentence(closure: Closure) -> str:
    """Say what a search that found nothing would have found."""
    return (
        f"An effect on one gyro from about {size_text(smallest_visible_dph(closure))} deg/h rms would have "
        "been found, unless temperature and the constants of the runs imitate it; one of many terms from "
        "somewhat more."
    )


def chain(closure: Closure) -> list[tuple[str, str]]:
    """Everything of the above that applies, in order, each with a word that says what it is about."""
    pairs = [("Residual", before_sentence(closure)), ("", scale_sentence(closure))]
    pairs += [("Cause", text) for text in cause_sentences(closure)]
    pairs += [("Rivals", runner_up_sentence(closure))]
    pairs += [("", text) for text in (*tie_sentences(closure), *lacks_sentences(closure))]
    pairs += [("Held out", error_sentence(closure)), ("", constants_sentence(closure))]
    pairs += [("Left", after_sentence(closure))]
    pairs += [("Limit", limit_sentence(closure))] if closure.verdict == "clean" else []
    return [(topic, text) for topic, text in pairs if text]


def odds_text(score: float) -> str:
    """Twice a logarithm of odds as people read them: "20 to 1", "10^7 to 1", ">10^12 to 1"."""
    power = score / (2.0 * math.log(10.0))
    if power < _PLAIN_POWER:
        return f"{10.0**power:.0f} to 1"
    return f"10^{power:.0f} to 1" if power <= _LARGEST_POWER else f">10^{_LARGEST_POWER:.0f} to 1"


def gains_text(gains: dict[int, float]) -> str:
    """Share of the squares that an effect takes away in each cycle left out: "1: 97 %, 2: 96 %"."""
    return ", ".join(f"{cycle}: {share_text(gain)}" for cycle, gain in gains.items())


def _either(found: FoundEffect) -> str:
    name = plain_name(found.candidate.effect.name)
    if not found.tied_with:
        return f"{name} for certain"
    return f"{name} fits best, {listed([plain_name(each) for each in found.tied_with])} nearly as well"


def _evidence_of(found: FoundEffect) -> str:
    chance = f"Chance gives as much with {p_phrase(found.p_value)}, over all that was tried."
    if not found.gains:
        return f"{chance} The search saw too few cycles to leave one out and confirm it."
    cycles = "cycle" if len(found.gains) == 1 else "cycles"
    parts = [f"{share_text(gain)} in cycle {cycle}" for cycle, gain in found.gains.items()]
    left_out = "each left out in its turn" if len(parts) > 1 else "left out"
    return (
        f"{chance} With its size taken from the other {cycles} it takes away {listed(parts)}, {left_out}, "
        "of the squares that are left without it."
    )


def _share_of(each: Evidence, closure: Closure) -> str:
    if rests_on_noise(closure):
        return ""
    return f", with {share_text(each.share)} of what is beyond the noise"
