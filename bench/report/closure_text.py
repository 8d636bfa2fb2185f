"""Sentences and numbers of a search for effects, the same on the page and in the terminal."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from statistics import NormalDist

import numpy as np

from gyrobench.bench.closure.candidates import start_count
from gyrobench.bench.closure.evidence import REMAINDER_POWER
from gyrobench.bench.closure.noise import OUTLIER_SIGMA, outliers_text
from gyrobench.bench.closure.outcome import CandidateResult, Closure, FoundEffect
from gyrobench.bench.closure.posterior import CLEAN, EXPLAINED, RIVAL
from gyrobench.bench.closure.problem import Solution
from gyrobench.bench.closure.search import EFFECT_SIGNIFICANCE
from gyrobench.bench.closure.validation import LACK_OF_FIT_P
from gyrobench.bench.foundations.arrays import S_PER_H, nan_rms
from gyrobench.bench.foundations.text import (
    capitalised,
    counted,
    decimals_of,
    listed,
    probability_number,
    with_sigma,
)
from gyrobench.bench.report.number_format import BiasScale, odds_text, p_phrase, share_text, size_text

_VISIBLE_NOISE_DIFFERENCE = 0.005
#: Odds of two to one, as twice their logarithm.
_EVEN_LOG_ODDS = 2.0 * math.log(2.0)
#: Smallest probability of an effect that a sentence states.
_MIN_STATED = 0.005
#: Smallest probability with which an effect is said to explain a part.
_MIN_LIKELY = 0.5


def models_of(closure: Closure) -> dict[str, Solution]:
    """The declared model and, if effects were found, the model with them, by label."""
    effects = {"with the effects found": closure.model} if closure.effects else {}
    return {"declared model": closure.declared, **effects}


def is_noise_only(closure: Closure) -> bool:
    """Whether the residual of the declared model is consistent with noise: there is no excess variance."""
    return bool(closure.before.p_noise >= LACK_OF_FIT_P)


def smallest_visible_dph(closure: Closure) -> float:
    """Smallest rms size of a detectable effect on one gyro, deg/h.

    It holds for an effect of one term that is uncorrelated with the declared model: the reduction of chi2 is
    the number of dwells searched times the square of the size over the noise.
    """
    counts = [start_count(each.effect, closure.campaign) for each in closure.evidence]
    reduction = NormalDist().inv_cdf(0.5 * EFFECT_SIGNIFICANCE / (min(counts) * len(counts))) ** 2
    return closure.noise_dph * float(np.sqrt(reduction / closure.searched.sum()))


def scale_of_errors(closure: Closure) -> BiasScale:
    """Unit and decimals for the errors of a closure; the resolution is a tenth of the noise."""
    if not closure.quantity.is_gyro_bias:
        return BiasScale(1.0, closure.quantity.unit, decimals_of(0.1 * closure.noise_dph, 4))
    return BiasScale.of([closure.error_before_dph], [0.1 * closure.noise_dph])


def held_out_cycles(closure: Closure) -> str:
    """Held-out cycles as text: "cycle 3", "cycles 2 and 3"; of several tables "cycle 3 of A"."""
    if closure.searched.all():
        return "no cycle"
    return cycles_text(closure, np.unique(closure.campaign.cycle[~closure.searched]).tolist())


def cycles_text(closure: Closure, cycles: Collection[int]) -> str:
    """Cycles as text; of several tables with the table of each."""

    def joined(numbers: Collection[int]) -> str:
        return f"cycle{'s' if len(numbers) > 1 else ''} {listed(list(map(str, numbers)))}"

    tables = closure.campaign.tables
    if len(tables) < 2:
        return joined(cycles)
    cycles_by_table = [(table.name, [cycle for cycle in cycles if cycle in table.cycles]) for table in tables]
    return listed([f"{joined(numbers)} of {name}" for name, numbers in cycles_by_table if numbers])


def table_texts(closure: Closure) -> list[str]:
    """One text for each table: its cycles, its start, how that was determined, and doubts about the unit."""
    campaign = closure.campaign
    first_s = campaign.tables[0].start_s
    texts = []
    for table in campaign.tables:
        notes = "; ".join(filter(None, (table.placed, table.doubt)))
        start_h = (table.start_s - first_s) / S_PER_H
        texts.append(
            f"{cycles_text(closure, table.cycles)}, from {start_h:.1f} h{f' ({notes})' if notes else ''}"
        )
    return texts


def labels(closure: Closure, names: Iterable[str]) -> str:
    """Labels of candidate effects, listed."""
    return listed([closure.label(name) for name in names])


def found_labels(closure: Closure) -> str:
    """Labels of the effects found, listed."""
    return listed([each.effect.display_name for each in closure.effects])


def verdict_sentence(closure: Closure) -> str:
    """The verdict in one sentence."""
    effects = found_labels(closure)
    match closure.verdict:
        case "clean":
            probability = _probability_text(closure.posterior.no_effect_probability)
            return (
                f"No undeclared effect was found: the residual of the declared model is noise ({probability})"
                f"{_detection_limit_text(closure)}."
            )
        case "explained":
            count = "One effect" if len(closure.effects) == 1 else f"A set of {len(closure.effects)} effects"
            return (
                f"{count} explains the residual within the noise and is the best of those tried: {effects} "
                f"({_probability_text(closure.probability)})."
            )
        case "ambiguous":
            p_effect = 1.0 - closure.posterior.no_effect_probability
            likely = f"An effect is likely ({_probability_text(p_effect)})"
            present = "An effect is present" if p_effect >= EXPLAINED else likely
            return f"{present}, but {_ambiguity_text(closure)}" if effects else _undecided_sentence(closure)
        case "not searched":
            return (
                "A search needs a second cycle to test what it finds, so polynomials over temperature "
                "alone are compensated."
            )
        case _ if closure.differs_held_out:
            return f"The residual in the dwells searched is noise, but {closure.held_out_difference}"
        case _:
            explained_part = _partial_explanations(closure)
            p_unlisted = closure.posterior.unlisted_probability
            noise_note = "; more noise than stated is likelier" if p_unlisted < 0.5 else ""
            return (
                "The residual exceeds the noise, and no candidate effect explains it (an unlisted effect: "
                f"{_probability_text(p_unlisted)}{noise_note}).{explained_part}"
            )


def _partial_explanations(closure: Closure) -> str:
    """Which of the effects found explain a part of an otherwise unexplained residual."""
    likely, ambiguous, improbable = [], [], []
    for each in closure.effects:
        rivals = [
            name for name in each.tied_with if closure.posterior.effect_probabilities.get(name, 0.0) >= RIVAL
        ]
        fit = f"{each.effect.display_name} ({_probability_text(each.probability)})"
        if rivals and closure.posterior.any_probability([each.effect.name, *rivals]) >= _MIN_LIKELY:
            ambiguous.append(" or ".join([fit, *(_with_probability(closure, name) for name in rivals)]))
        elif each.probability >= _MIN_LIKELY:
            likely.append(each.effect.display_name)
        else:
            improbable.append(fit)
    sentences = []
    if likely:
        names, verb = listed(likely), "explains" if len(likely) == 1 else "explain"
        sentences.append(f"{capitalised(names)} {verb} only a part.")
    sentences += [
        f"A part is explained by {fits}, which the data do not distinguish; a residual remains."
        for fits in ambiguous
    ]
    if improbable:
        sentences.append(f"Fitted, but improbable given the remaining residual: {listed(improbable)}.")
    return "".join(f" {each}" for each in sentences)


def _detection_limit_text(closure: Closure) -> str:
    """Size below which a clean verdict does not exclude an effect."""
    sizes = [size for size in closure.detectable_dph.values() if math.isfinite(size)]
    if not sizes:
        return ""
    return f"; an effect below {size_text(max(sizes))} {closure.quantity.unit} rms is not excluded"


def _ambiguity_text(closure: Closure) -> str:
    """Why the verdict is ambiguous."""
    tied = [each for each in closure.effects if each.tied_with]
    if tied:
        fits = "; ".join(
            f"{each.effect.display_name} ({_probability_text(each.probability)}) or "
            f"{' or '.join(_with_probability(closure, name) for name in each.tied_with)}"
            for each in tied
        )
        return f"the data do not distinguish the candidates: {fits}."
    effects = f"{found_labels(closure)} ({_probability_text(closure.probability)}"
    if closure.probability < EXPLAINED:
        return f"{effects}, required {EXPLAINED:g}) is not probable enough."
    rivals = closure.posterior.rivals(closure.names)
    if rivals:
        with_them = " or ".join(_with_probability(closure, name) for name in rivals)
        instead = " or ".join(closure.label(name) for name in rivals)
        names = found_labels(closure)
        one_effect = "one of them" if closure.effects[1:] else names
        return (
            f"{effects}) alone, {names} with {with_them}, and {instead} instead of {one_effect} can't "
            "be distinguished."
        )
    if closure.circular:
        verb = "was" if len(closure.circular) == 1 else "were"
        return (
            f"{labels(closure, closure.circular)} {verb} composed from the held-out dwells: measure others."
        )
    if closure.searched.all():
        return f"no cycle is held out to confirm {effects}). Measure the profile a second time."
    if closure.held_out_difference:
        return f"{effects}) is not sufficient: {closure.held_out_difference}"
    verb = "do" if closure.effects[1:] else "does"
    return f"{effects}) {verb} not predict the held-out cycle significantly better and to within the noise."


def _undecided_sentence(closure: Closure) -> str:
    """Why neither the presence nor the absence of an effect is stated."""
    p_noise = _probability_text(closure.posterior.no_effect_probability)
    sentence = f"It is not settled whether the residual is noise ({p_noise}, required {CLEAN:g})"
    candidate = closure.not_accepted
    if candidate is None:
        return f"{sentence}: it may hold an unlisted effect."
    names = f"{labels(closure, candidate.names)} ({_probability_text(candidate.probability)})"
    kind = "set of effects" if candidate.names[1:] else "effect"
    return f"{sentence}. The most probable {kind}, {names}, is not accepted: {candidate.reason}."


def _with_probability(closure: Closure, name: str) -> str:
    probability = closure.posterior.effect_probabilities.get(name, 0.0)
    return f"{closure.label(name)} ({_probability_text(probability)})"


def _probability_text(probability: float) -> str:
    """Write a probability with its symbol: "P = 0.62", "P > 0.999"."""
    number = probability_number(probability)
    return f"P {number}" if number[0] in "<>" else f"P = {number}"


def searched_name(closure: Closure) -> str:
    """Quantity searched: "gyro biases", "gyro misalignments xy, yz and zx"."""
    quantity = closure.quantity
    name = f"{quantity.sensor} {quantity.label}s" + (
        f" {listed(quantity.axes)}" if quantity.axes[0][1:] else ""
    )
    return name.replace("biass", "biases")


def search_title(closure: Closure) -> str:
    """Heading of a search: "Search for effects", followed by the quantity if it is not the gyro biases."""
    is_gyro_bias = closure.quantity.is_gyro_bias
    return "Search for effects" + ("" if is_gyro_bias else f": {searched_name(closure)}")


def probability_sentence(closure: Closure) -> str:
    """Probabilities of the effects, of an unlisted effect, and of no undeclared effect."""
    posterior = closure.posterior
    likely = {name: p for name, p in posterior.effect_probabilities.items() if p >= _MIN_STATED}
    parts = []
    for each in closure.effects:
        likely.pop(each.effect.name, None)
        more_general = [
            name for name in posterior.more_general.get(each.effect.name, ()) if likely.pop(name, None)
        ]
        law_note = f" (as such or as {labels(closure, more_general)})" if more_general else ""
        parts.append(f"{each.effect.display_name} {_probability_text(each.probability)}{law_note}")
    parts += [f"{closure.label(name)} {_probability_text(p)}" for name, p in likely.items()]
    followed = max(posterior.process_probabilities, key=lambda name: posterior.process_probabilities[name])
    unknown = f"an unlisted effect {_probability_text(posterior.unlisted_probability)}"
    parts.append(f"{unknown} (it follows {followed})" if posterior.unlisted_probability >= 0.5 else unknown)
    parts.append(f"no undeclared effect {_probability_text(posterior.no_effect_probability)}")
    return f"Probabilities: {'; '.join(parts)}."


def detectable_effect_sentence(closure: Closure) -> str:
    """The smallest further effect that would have been detected; empty if a residual remains."""
    sizes = {name: size for name, size in closure.detectable_dph.items() if math.isfinite(size)}
    if not sizes or (closure.verdict == "unexplained" and not closure.differs_held_out):
        return ""
    lowest, highest = min(sizes, key=lambda name: sizes[name]), max(sizes, key=lambda name: sizes[name])
    unit = closure.quantity.unit
    smallest, largest = size_text(sizes[lowest]), size_text(sizes[highest])
    other_structure = f", and one of {largest} {unit} or more if it follows {highest}"
    structure_note = "" if smallest == largest else f" if it follows {lowest}{other_structure}"
    effect = "A further effect" if closure.effects else "An effect"
    return (
        f"{effect} of {smallest} {unit} rms or more would have been detected with "
        f"{100.0 * REMAINDER_POWER:.0f} % probability{structure_note}; smaller ones are not excluded."
    )


def declared_residual_sentence(closure: Closure) -> str:
    """Residual of the declared model in the dwells searched, compared with the noise."""
    rms = nan_rms(closure.residuals_dph(closure.declared)[closure.searched])
    p, quantity, unit = p_phrase(closure.before.p_value), closure.quantity, closure.quantity.unit
    residual = (
        f"The residual of the declared model (a cubic in each {quantity.sensor}'s temperature and one "
        f"constant per power cycle) is {size_text(rms)} {unit} rms in the {closure.searched.sum()} dwells "
        f"searched; the noise of a measured {quantity.label} is {size_text(closure.noise_dph)} {unit}."
    )
    if closure.before.p_value < LACK_OF_FIT_P:
        return (
            f"{residual} The lack of fit is significant ({p}): the residual follows {closure.before.follows}."
        )
    if closure.effects:
        return (
            f"{residual} The overall lack of fit is not significant ({p}); the test for a single "
            "effect is more sensitive."
        )
    return f"{residual} The residual is consistent with noise ({p})."


def rejection_sentences(closure: Closure) -> list[str]:
    """Candidates that are significant alone but rejected, grouped by reason."""
    tied = closure.tied
    by_reason: dict[str, list[str]] = {}
    for each in closure.evidence:
        if each.rejected and each.effect.name not in tied:
            reason, _, detail = each.rejected.partition(" (")
            detail = f" ({detail.partition(',')[0].removesuffix(')')})" if detail else ""
            by_reason.setdefault(reason, []).append(f"{each.effect.display_name}{detail}")
    return [
        f"Rejected although significant alone: {listed(names)}. Reason: {reason}."
        for reason, names in by_reason.items()
    ]


def effect_sentences(closure: Closure) -> list[str]:
    """One sentence for each effect, with its significance and cross-validation."""
    is_one_cycle = len(np.unique(closure.campaign.cycle[closure.searched])) == 1
    return [f"{each.statement} {_evidence_text(each, is_one_cycle)}" for each in closure.effects]


def _evidence_text(effect: FoundEffect, is_one_cycle: bool) -> str:
    significance = (
        f"{p_phrase(effect.p_value)}, corrected for {counted(effect.candidate_fits, 'candidate fit')}."
    )
    if not effect.gains:
        reason = (
            "only one cycle was searched" if is_one_cycle else "no cycle determines its size in another one"
        )
        return f"{significance} Not confirmed by cross-validation: {reason}."
    cycles = "cycle" if len(effect.gains) == 1 else "cycles"
    parts = [f"{share_text(gain)} of chi2 in cycle {cycle}" for cycle, gain in effect.gains.items()]
    opposed = [str(cycle) for cycle, gain in effect.gains.items() if gain <= 0.0]
    clause = f"cycles {listed(opposed)} contradict" if opposed[1:] else f"cycle {listed(opposed)} contradicts"
    note = f" It depends on which cycle is held out: {clause} it." if opposed else ""
    return f"{significance} With its size fitted to the other {cycles}, it explains {listed(parts)}.{note}"


def alternative_sentence(closure: Closure) -> str:
    """The best alternative and the odds against it; its share if no effect was found."""
    names = set(closure.names)
    same = names.union(*(closure.posterior.more_general.get(name, ()) for name in names))
    others = [each for each in closure.evidence if not each.missing_input and each.effect.name not in same]
    if not others or closure.verdict == "clean":
        return ""
    best = min(others, key=lambda each: each.log_odds_against)
    if not names and is_noise_only(closure):
        best = min(others, key=lambda each: each.p_value)
        return (
            f"The most significant candidate alone is {best.effect.display_name} ({p_phrase(best.p_value)})."
        )
    if not names:
        best = max(others, key=lambda each: each.share)
        return f"The best candidate alone, {best.effect.display_name}, explains {_share_of_excess(best)}."
    share = "" if is_noise_only(closure) else f" (explains {_share_of_excess(best)})"
    alternative = f"The most probable alternative is {best.effect.display_name} alone{share}; the data"
    if best.log_odds_against < _EVEN_LOG_ODDS:
        return f"{alternative} do not prefer {found_labels(closure)}."
    odds = odds_text(best.log_odds_against).replace(">", "more than ")
    return f"{alternative} prefer {found_labels(closure)} by odds of {odds}."


def _share_of_excess(candidate: CandidateResult) -> str:
    return f"{share_text(candidate.share)} of the excess variance"


def tie_sentences(closure: Closure) -> list[str]:
    """Candidates that fit equally well and the measurement that distinguishes them, or that none does."""
    not_fitted = {each.effect.name for each in closure.evidence if each.missing_input}
    sentences = []
    for each in closure.effects:
        fitted = [name for name in each.tied_with if name not in not_fitted]
        others = [name for name in each.tied_with if name in not_fitted]
        if fitted:
            sentences.append(
                f"Tied with {each.effect.display_name}: {labels(closure, fitted)}. The odds are below 100 "
                "to 1."
            )
        if others:
            sentences.append(
                f"Not excluded in place of {each.effect.display_name}: {labels(closure, others)}, not fitted."
            )
    if sentences:
        return [*sentences, closure.separating_measurement or ""]
    is_alone = closure.effects and not closure.posterior.rivals(closure.names)
    return ["No other candidate of those tried fits equally well."] if is_alone else []


def missing_input_sentences(closure: Closure) -> list[str]:
    """Candidates that were not fitted, grouped by missing input."""
    by_input: dict[str, list[str]] = {}
    for each in closure.evidence:
        if each.missing_input is not None:
            by_input.setdefault(each.missing_input, []).append(each.effect.display_name)
    return [f"Not fitted: {listed(each)}. Missing input: {missing}." for missing, each in by_input.items()]


def held_out_error_sentence(closure: Closure) -> str:
    """Held-out error with the declared model and with the effects, compared with the noise."""
    held_out = ~closure.searched
    if not held_out.any():
        return "No cycle is held out to test the model. Measure the profile a second time."
    before = with_sigma(closure.error_before_dph, closure.error_before_sigma_dph)
    unit, label = closure.quantity.unit, closure.quantity.label
    models = f"{before} {unit} rms with the declared model"
    if closure.effects:
        after = with_sigma(closure.error_after_dph, closure.error_after_sigma_dph)
        models += f" and {after} {unit} with {found_labels(closure)}"
    dwells = counted(int(held_out.sum()), "dwell")
    dwell_sigmas = (closure.dwell_noise_dph, closure.prediction_sigma_dph)
    noise, sigma = (nan_rms(each[held_out]) for each in dwell_sigmas)
    outliers = outliers_text(closure.held_out.outliers)
    conclusion = f"explain the {'others' if outliers else 'errors'}"
    if closure.held_out_axes:
        conclusion = f"do not explain the errors of the {closure.quantity.place(closure.held_out_axes)}"
    outlier_note = (
        f" Included in these errors, further than {OUTLIER_SIGMA:.0f} sigma from the prediction: {outliers}."
        if outliers
        else ""
    )
    return (
        f"In {held_out_cycles(closure)} (held out, {dwells}), measured minus predicted {label} is {models}; "
        f"the noise is {size_text(noise)} {unit}. A predicted {label} has a standard uncertainty of "
        f"{size_text(sigma)} {unit}"
        f"{', as far as the model holds' if closure.verdict == 'unexplained' else ''}.{outlier_note} "
        f"Noise and this uncertainty {conclusion} ({p_phrase(closure.held_out.p_value)})."
    )


def held_out_in_turn_sentence(closure: Closure) -> str:
    """Whether the outcome depends on which cycle is held out; empty if only one choice was searched."""
    trials = [trial for trial in closure.held_out_in_turn if trial.verdict]
    outcomes: dict[tuple[str, tuple[str, ...]], list[int]] = {}
    for trial in trials:
        outcomes.setdefault((trial.verdict, tuple(sorted(trial.effects))), []).append(trial.cycle)
    if not outcomes:
        return "No cycle can be held out alone." if closure.held_out_in_turn else ""
    texts = [
        f"{verdict}{f' ({labels(closure, names)})' if names else ''} with {cycles_text(closure, cycles)}"
        for (verdict, names), cycles in outcomes.items()
    ]
    if len(texts) == 1:
        return f"The outcome does not depend on which cycle is held out: {texts[0]}."
    return f"The outcome depends on which cycle is held out: {'; '.join(texts)}."


def removed_means_sentence(closure: Closure) -> str:
    """Power cycles whose mean error is removed; empty if there are none."""
    campaign, searched = closure.campaign, closure.searched
    power_cycles = set(campaign.run[~searched].tolist()) - set(campaign.run[searched].tolist())
    if not power_cycles:
        return ""
    return (
        f"The mean error of {counted(len(power_cycles), 'power cycle')} that the search did not use is "
        "removed before and after: the constant of a power cycle is known only from its own dwells."
    )


def remaining_residual_sentence(closure: Closure) -> str:
    """The remaining residual: its size and structure, or that it is noise."""
    if closure.unexplained_part and not closure.differs_held_out:
        return closure.unexplained_part
    after = closure.after
    if math.isnan(after.noise_ratio):
        return "The remaining residual is not tested: the fit leaves no degrees of freedom."
    is_as_stated = np.all(np.abs(closure.noise.scales - 1.0) < _VISIBLE_NOISE_DIFFERENCE)
    scale_note = "" if is_as_stated else " (with the noise as estimated)"
    return (
        f"The remaining residual in the dwells searched is {after.noise_ratio:.2f} times the stated "
        f"uncertainties{scale_note} and follows neither time, temperature, position nor temperature rate "
        f"({p_phrase(after.p_value)})."
    )


def sensitivity_sentence(closure: Closure) -> str:
    """Size of the smallest effect that the search would have found."""
    return (
        f"An effect on one {closure.quantity.sensor} is detectable from about "
        f"{size_text(smallest_visible_dph(closure))} {closure.quantity.unit} rms, unless it is correlated "
        "with temperature or with the constants of the power cycles. An effect of several terms must be "
        "larger."
    )
