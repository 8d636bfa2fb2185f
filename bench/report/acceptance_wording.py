"""Verdicts on a unit in words, the same in report and terminal."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from bench.bias.verdicts import Acceptance, Judgement, RunVerdict
from bench.navigation.positions import AXES
from bench.phrases import listed
from bench.report.wording import counted, gyro_label, position_label

#: Colours of the template's box, by verdict.
VERDICT_COLOURS: Mapping[RunVerdict, str] = MappingProxyType(
    {"accepted": "finished", "marginal": "stopped", "rejected": "failed", "not judged": "open"}
)
_NO_LIMITS = "The procedure states no acceptance limits."
_NOTHING = "No temperature bin holds dwells of two positions."
_ADVICE = "The data do not tell on which side of it the unit is; more cycles would."
_LACKING = "{} no good dwell to compare, so the rest can't accept the unit."


def verdict_sentence(acceptance: Acceptance) -> str:
    """Say why the verdict on the run is what it is."""
    if acceptance.limits is None:
        return _NO_LIMITS
    limit = _limit(acceptance)
    with_confidence = f"with {100.0 * acceptance.limits.confidence:g} % confidence"
    match acceptance.verdict:
        case "accepted":
            return f"All gyros keep {limit} in every bin, {with_confidence}."
        case "rejected":
            return f"{_gyros(acceptance, 'fail')} beyond {limit}, {with_confidence}."
        case "marginal":
            return f"{_gyros(acceptance, 'marginal')} near {limit}. {_ADVICE}"
    return _lacking_sentence(acceptance) if acceptance.judgements else _NOTHING


def deciding_judgement(acceptance: Acceptance, gyro: str) -> Judgement | None:
    """Return what decides on one gyro: the worst of its differences, or of its biases; None without any."""
    order = ("pass", "marginal", "fail")
    judged = [acceptance.worst(gyro), acceptance.worst(gyro, "bias")]
    known = [each for each in judged if each is not None]
    return max(known, key=lambda each: order.index(each.verdict), default=None)


def place_of(judged: Judgement) -> str:
    """Name the positions that differ most, "Y-Down above Y-Up", or the one with the largest bias."""
    return " above ".join(map(position_label, judged.worst))


def _limit(acceptance: Acceptance) -> str:
    limits = acceptance.limits
    if limits is None:
        return ""
    told = f"the limit of {limits.position_difference_dph:g} deg/h between positions"
    return told if limits.bias_dph is None else f"{told} or that of {limits.bias_dph:g} deg/h for the bias"


def _lacking_sentence(acceptance: Acceptance) -> str:
    places = {(each.chamber_set_c, each.position) for each in acceptance.not_measured}
    return _LACKING.format(
        f"{counted(len(places), 'planned position')} {'has' if len(places) == 1 else 'have'}"
    )


def _gyros(acceptance: Acceptance, verdict: str) -> str:
    names = [gyro_label(gyro) for gyro in AXES if acceptance.gyros.get(gyro) == verdict]
    return f"{listed(names)} {'is' if len(names) == 1 else 'are'}"
