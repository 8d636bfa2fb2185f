"""What an interlock finds wrong, in words: value and limit, and what to do."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

#: Where an instrument is silent.
CHECK_LINE = "Check its power, cable and port."


class Finding(NamedTuple):
    """Something wrong now; ``interlock`` is its key in the station file.

    ``problem`` is a sentence without its full stop, ``advice`` whole sentences; without any, ``problem``
    says all there is to say.
    """

    interlock: str
    problem: str
    advice: str


def told(findings: Iterable[Finding]) -> str:
    """All findings, each advice once."""
    problems: dict[str, list[str]] = {}
    for finding in findings:
        problems.setdefault(finding.advice, []).append(finding.problem)
    return " ".join(
        "; ".join(texts) + (f". {advice}" if advice else "") for advice, texts in problems.items()
    )


def outside(what: str, value: float, low: float, high: float, unit: str) -> str:
    """Say in which way a value is outside its range; empty where it is inside."""
    if low <= value <= high:
        return ""
    if math.isnan(value):
        return f"{what} is not known; allowed are {low:g} to {high:g} {unit}"
    side, limit = ("below", low) if value < low else ("above", high)
    return f"{what} is {value:.1f} {unit}, {side} the limit of {limit:g} {unit}"


def too_fast(what: str, rate_per_s: float | None, limit_per_min: float) -> str:
    """Say that a temperature changes faster than allowed; empty where it does not, or nobody knows yet."""
    if rate_per_s is None or abs(rate_per_s) * 60.0 <= limit_per_min:
        return ""
    return f"{what} changes by {rate_per_s * 60.0:.1f} degC/min; the limit is {limit_per_min:g} degC/min"


def silent(instrument: str, age_s: float, limit_s: float) -> str:
    """Say that an instrument's last answer is too old; empty where it is not."""
    if age_s <= limit_s:
        return ""
    since = f"for {age_s:.0f} s" if math.isfinite(age_s) else "yet"
    return (
        f"the {instrument} has said nothing {since} (limit {limit_s:g} s), too old to tell whether all is "
        "within its limits"
    )
