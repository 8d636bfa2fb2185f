"""One thing that was looked at on a bench before a run, and how it was found."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """How it was found; skipped where it could not be looked at."""

    PASS = "pass"  # noqa: S105 - no password
    FAIL = "FAIL"
    SKIPPED = "skipped"


@dataclass(frozen=True)
class Check:
    """What was looked at.

    Attributes
    ----------
    subject : str
        Instrument or part of the bench.
    what : str
        What was looked at, in a few words.
    verdict : Verdict
        How it was found.
    found : str
        What was found, or why it could not be looked at.
    advice : str
        What to do; empty where nothing is to be done.
    """

    subject: str
    what: str
    verdict: Verdict
    found: str
    advice: str = ""

    @classmethod
    def of(cls, subject: str, what: str, is_good: bool, found: str, advice: str) -> Check:
        """Make a check that passes or fails; the advice is kept where it fails."""
        if is_good:
            return cls(subject, what, Verdict.PASS, found)
        return cls(subject, what, Verdict.FAIL, found, advice)

    @classmethod
    def skipped(cls, subject: str, what: str, why: str, advice: str = "") -> Check:
        """Make a check that could not be looked at."""
        return cls(subject, what, Verdict.SKIPPED, why, advice)
