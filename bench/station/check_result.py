"""Result of one preflight check of the bench."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class CheckVerdict(StrEnum):
    """Verdict of a check; skipped if the check was not possible."""

    PASS = "pass"  # noqa: S105 - no password
    FAIL = "FAIL"
    SKIPPED = "skipped"


@dataclass(frozen=True)
class Check:
    """Result of one check."""

    #: subject, what: Instrument or part of the bench, and the property that was checked.
    subject: str
    what: str
    verdict: CheckVerdict
    #: found, advice: Finding, or why the check was not possible; what to do, empty if nothing.
    found: str
    advice: str = ""

    @classmethod
    def of(cls, subject: str, what: str, is_good: bool, found: str, advice: str) -> Check:
        """A check that passes or fails; only a failed one keeps the advice."""
        if is_good:
            return cls(subject, what, CheckVerdict.PASS, found)
        return cls(subject, what, CheckVerdict.FAIL, found, advice)

    @classmethod
    def skipped(cls, subject: str, what: str, reason: str, advice: str = "") -> Check:
        """A check that was not possible."""
        return cls(subject, what, CheckVerdict.SKIPPED, reason, advice)
