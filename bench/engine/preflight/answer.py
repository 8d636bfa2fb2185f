"""The check that comes first for each instrument: it answers, and it is the one named."""

from __future__ import annotations

from collections.abc import Iterable

from gyrobench.bench.foundations.errors import InstrumentError
from gyrobench.bench.station.check import Check, Verdict

_ANSWERS = "answers"


def answered(subject: str, identification: str, named: str) -> Check:
    """Tell whether an instrument that answered is the one that the station file names."""
    return Check.of(
        subject,
        _ANSWERS,
        named in identification,
        identification if named in identification else f"{identification}, which lacks {named!r}",
        "Connect the right one, or correct `identity` in the station file.",
    )


def unanswered(subject: str, error: InstrumentError) -> Check:
    """Tell why an instrument does not answer."""
    return Check.of(
        subject,
        _ANSWERS,
        False,
        str(error).removeprefix(f"{subject}: "),
        "Nothing else can be looked at before it answers.",
    )


def failed(subject: str, what: str, error: InstrumentError) -> Check:
    """Tell that a question after the first was not answered as it should be."""
    return Check.of(
        subject, what, False, str(error).removeprefix(f"{subject}: "), "Check its line, and look again."
    )


def nobody_answers(checks: Iterable[Check]) -> bool:
    """Tell whether no instrument at all answered."""
    return all(check.verdict is not Verdict.PASS for check in checks if check.what == _ANSWERS)
