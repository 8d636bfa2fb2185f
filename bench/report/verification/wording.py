"""The proof of a compensation in sentences, the same in report and terminal."""

from __future__ import annotations

from collections.abc import Mapping

from gyrobench.bench.closure.loadable_model import LoadableModel
from gyrobench.bench.closure.loop import LEFT_OVER_P, Closure
from gyrobench.bench.foundations.text import listed, plain_name
from gyrobench.bench.report.closure.wording import found_names, p_phrase, size_text
from gyrobench.bench.verification.comparison import DECLARED, EFFECT, NONE, Comparison, Leftover

#: The compensations as people read them.
LABELS = {NONE: "none", DECLARED: "declared", EFFECT: "with effect"}
#: What is told of a comparison in one word, and the colour of its box on the page.
CONFIRMED, BETTER, NOT_CONFIRMED, NOTHING_TO_TELL = "confirmed", "better", "not confirmed", "nothing to tell"

_CONSTANT = (
    "Bias is the rms over all gyros with the constant of the power-on, which changes from one power-on to "
    "the next and which no model foretells; varying is the same without each gyro's mean over the run. The "
    "spread between positions and the 24 h of a rotational INS are free of the constant too, the velocity "
    "East is not."
)
_NOISE = (
    "Noise is what the uncertainty of the measurement alone would show in the place of each number: the rms, "
    "or the median where the number is the largest of several; over all stops it is that of the stop with "
    "the largest number. The uncertainty of the fit is not in it: what that does is part of what is left."
)
_DAY = (
    "24 h is the largest position error within a day at rest of a dual-axis rotational INS that has these "
    "biases: it turns through all six positions, each at two azimuths half a turn apart, with rests of 3 min."
)
_SAME_SEED = (
    "All runs had the same emulated world and the same seed, another one than the campaign: the constants of "
    "the power-on are the same, and so is the noise where two runs keep step in time, as those with a "
    "compensation mostly do; one without is some seconds ahead of them."
)
_OTHER_POWER_ONS = (
    "Each run had a power-on and noise of its own, so that two runs differ by those also: by the noise told "
    "here, and in bias and velocity by what the constant changes from power-on to power-on."
)


def model_sentences(closure: Closure, models: Mapping[str, LoadableModel]) -> list[str]:
    """Say what was made to be loaded, and what of the model an INS can't subtract."""
    declared = models[DECLARED].compensation
    lows, highs = declared.low_c.min(), declared.high_c.max()
    limits = f"Temperatures outside the fitted ones, {lows:.0f} to {highs:.0f} °C, are held at these."
    if EFFECT in models:
        effects = listed([plain_name(name) for name in models[EFFECT].effects])
        what = f"Two compensations: the declared model, a polynomial for each gyro, and one with {effects}."
    elif closure.effects:
        what = f"One compensation, the declared model: of {found_names(closure)} there is nothing to load."
    else:
        what = "One compensation, the declared model: there is no effect to add."
    notes = models[EFFECT].notes if EFFECT in models else models[DECLARED].notes
    return [f"{what} {limits}", *(f"{note[0].upper()}{note[1:]}." for note in notes)]


def outcome(comparison: Comparison) -> str:
    """Judge the fullest compensation measured by what it leaves beside the constant of the power-on."""
    if len(comparison.leftovers) < 2:
        return NOTHING_TO_TELL
    before, after = comparison.leftovers[-2:]
    is_noise = after.total.varying_p_value >= LEFT_OVER_P
    if is_noise and before.total.varying_p_value >= LEFT_OVER_P:
        return NOTHING_TO_TELL
    if not after.total.varying_rms_dph < before.total.varying_rms_dph:
        return NOT_CONFIRMED
    return CONFIRMED if is_noise else BETTER


def outcome_sentence(comparison: Comparison) -> str:
    """Say what the judgement rests on."""
    if len(comparison.leftovers) < 2:
        return (
            f"Only one run so far ({LABELS[comparison.leftovers[0].compensation]}): nothing to compare with."
        )
    before, after = comparison.leftovers[-2:]
    first, last = _named(before), _named(after)
    sizes = (
        f"{first[0].upper()}{first[1:]} leaves {size_text(before.total.varying_rms_dph)} deg/h rms of "
        f"varying bias, {last} {size_text(after.total.varying_rms_dph)}; noise alone shows "
        f"{size_text(after.total.bias_noise_dph)}."
    )
    p = p_phrase(after.total.varying_p_value)
    match outcome(comparison):
        case "confirmed":
            return f"{sizes} Noise accounts for what is left ({p})."
        case "better":
            return f"{sizes} More is left than noise ({p})."
        case "not confirmed":
            return f"{sizes} On new measurements that is no better."
        case _:
            return f"{sizes} Neither leaves more than noise."


def chain(comparison: Comparison) -> list[tuple[str, str]]:
    """Topic and sentence: what is new, and how bias, spread, velocity and position change."""
    totals = [each.total for each in comparison.leftovers]
    last = totals[-1]
    changes = [
        (
            "Bias",
            "Bias in deg/h, rms over all dwells, with the constant of the power-on",
            [size_text(each.bias_rms_dph) for each in totals if each.bias_rms_dph >= 0.0],
            size_text(last.bias_noise_dph),
        ),
        (
            "Positions",
            "Largest difference between positions in deg/h",
            [size_text(each.spread_dph) for each in totals if each.spread_dph >= 0.0],
            size_text(last.spread_noise_dph),
        ),
        (
            "Velocity",
            "Largest error of the velocity East in mm/s",
            [f"{1000.0 * each.velocity_east_mps:.1f}" for each in totals if each.velocity_east_mps >= 0.0],
            f"{1000.0 * last.velocity_noise_mps:.1f}",
        ),
        (
            "24 h",
            "Largest position error of a rotational INS in nmi",
            [f"{each.position_nmi:.2f}" for each in totals if each.position_nmi >= 0.0],
            f"{last.position_noise_nmi:.2f}",
        ),
    ]
    topics = [("New", newness_sentence(comparison))]
    for topic, what, values, noise in changes:
        if len(values) == len(totals):
            steps = listed(
                [f"{value} {_with(left)}" for value, left in zip(values, comparison.leftovers, strict=True)]
            )
            topics.append((topic, f"{what}: {steps}; noise alone shows {noise}."))
    return topics + [("Note", note) for note in comparison.notes]


def reading_sentences(comparison: Comparison) -> list[str]:
    """Say how the numbers are to be read."""
    seeds = _SAME_SEED if comparison.is_same_seed else _OTHER_POWER_ONS
    return [_CONSTANT, _NOISE, _DAY, seeds]


def newness_sentence(comparison: Comparison) -> str:
    """Say what of the new measurements the fit has not seen."""
    rows = comparison.leftovers[0].rows
    new = [row for row in rows if row.fit != "fitted"]
    temperatures = listed([f"{row.gyro_c:.0f} °C" for row in new])
    where = f"{len(new)} of {len(rows)} stops are at gyro temperatures that were not fitted"
    attitudes = (
        f"{comparison.new_attitudes} of {comparison.dwells} dwells begin in a position and azimuth that no "
        "dwell of the campaign began in"
    )
    return f"All measurements are new. {where}{f' ({temperatures})' if new else ''}, and {attitudes}."


def _named(left: Leftover) -> str:
    return {NONE: "no compensation", DECLARED: "the declared model", EFFECT: "the model with the effects"}[
        left.compensation
    ]


def _with(left: Leftover) -> str:
    return {NONE: "without", DECLARED: "with the declared model", EFFECT: "with the effects"}[
        left.compensation
    ]
