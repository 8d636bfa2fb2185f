"""Verdicts on a unit in words, the same in report and terminal."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from gyrobench.bench.bias.verdicts import Acceptance, Judgement, RunVerdict
from gyrobench.bench.foundations.text import counted, listed
from gyrobench.bench.navigation.positions import AXES, gyro_label, position_label

#: Colours of the template's box, by verdict.
VERDICT_COLOURS: Mapping[RunVerdict, str] = MappingProxyType(
    {"accepted": "finished", "marginal": "stopped", "rejected": "failed", "not judged": "open"}
)
_NO_LIMITS = "The procedure states no acceptance limits."
_NOTHING = "No stop of the chamber has good dwells in two positions."
_ADVICE = "The data do not tell on which side of it the unit is; more cycles would."
_LACKING = "{} not compared with all others of the stop, so the rest can't accept the unit."


def verdict_sentence(acceptance: Acceptance) -> str:
    """Say why the verdict on the run is what it is."""
    if acceptance.limits is None:
        return _NO_LIMITS
    limit = _limit(acceptance)
    with_confidence = f"with {100.0 * acceptance.limits.confidence:g} % confidence"
    match acceptance.verdict:
        case "accepted":
            return f"All gyros keep {limit} at all {_stops(acceptance)}, {with_confidence}."
        case "rejected":
            return f"{_gyros(acceptance, 'fail')} beyond {limit}, {with_confidence}."
        case "marginal":
            return f"{_gyros(acceptance, 'marginal')} near {limit}. {_ADVICE}"
    return _lacking_sentence(acceptance) if acceptance.judgements else _NOTHING


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
    dwells = {(each.cycle, each.chamber_set_c, each.position) for each in acceptance.not_measured}
    return _LACKING.format(f"{counted(len(dwells), 'planned dwell')} {'was' if len(dwells) == 1 else 'were'}")


def _stops(acceptance: Acceptance) -> str:
    bins = {(each.bin_low_c, each.bin_high_c) for each in acceptance.judgements}
    return f"{counted(acceptance.stops, 'stop')} compared, in {counted(len(bins), 'temperature bin')}"


def _gyros(acceptance: Acceptance, verdict: str) -> str:
    names = [gyro_label(gyro) for gyro in AXES if acceptance.gyros.get(gyro) == verdict]
    return f"{listed(names)} {'is' if len(names) == 1 else 'are'}"
