"""Result of one preflight check of the bench."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class CheckVerdict(StrEnum):
    """Result; skipped where the check was not possible."""

    PASS = "pass"  # noqa: S105 - no password
    FAIL = "FAIL"
    SKIPPED = "skipped"


@dataclass(frozen=True)
class Check:
    """One check."""

    #: subject, what: Instrument or part of the bench, and what was checked, in a few words.
    subject: str
    what: str
    verdict: CheckVerdict
    #: found, advice: What was found, or why the check was not possible; what to do, empty if nothing.
    found: str
    advice: str = ""

    @classmethod
    def of(cls, subject: str, what: str, is_good: bool, found: str, advice: str) -> Check:
        """A check that passes or fails; only a failed one keeps the advice."""
        if is_good:
            return cls(subject, what, CheckVerdict.PASS, found)
        return cls(subject, what, CheckVerdict.FAIL, found, advice)

    @classmethod
    def skipped(cls, subject: str, what: str, why: str, advice: str = "") -> Check:
        """A check that was not possible."""
        return cls(subject, what, CheckVerdict.SKIPPED, why, advice)
