"""What was found, as a page or a chapter of a report says it: a judgement, facts, and sections."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from gyrobench.bench.report.page.sections import Section


@dataclass(frozen=True, eq=False)
class Findings:
    """What such a page says.

    Attributes
    ----------
    title : str
        Of the page.
    source : str
        What was looked at, for people.
    judgement : str
        In a word or two.
    colour : str
        Of the box around it: a class of the template, "finished", "stopped" or "failed".
    sentence : str
        The judgement in a sentence.
    facts : mapping of str to str
        Names and values.
    sections : sequence of Section
        The rest.
    dwells_sha256 : str
        Hash of the dwell table that was looked at; empty where there is none.
    """

    title: str
    source: str
    judgement: str
    colour: str
    sentence: str
    facts: Mapping[str, str]
    sections: Sequence[Section]
    dwells_sha256: str = ""
