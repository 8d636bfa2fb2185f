"""Parts of a report as data: what they say, their tables and figures. The template lays them out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from matplotlib.figure import Figure

#: What to make of a row.
Mark = Literal["", "bad", "doubtful"]


@dataclass(frozen=True)
class SectionTable:
    """A table of texts.

    Attributes
    ----------
    caption : str
        What it shows, with units.
    header, rows : sequence of str, sequence of sequences of str
        One cell for each column.
    words : int
        So many columns at the left hold words; those after them hold numbers.
    marks : sequence of str
        What to make of each row: "bad", "doubtful" or nothing; without any, nothing of all.
    """

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: int = 1
    marks: Sequence[Mark] = ()


@dataclass(frozen=True, eq=False)
class SectionFigure:
    """A figure, the name of its file without suffix, and what it shows.

    One that was drawn before is given by its PNG file.
    """

    name: str
    caption: str
    figure: Figure | Path


@dataclass(frozen=True, eq=False)
class Section:
    """One part of a report; paragraphs first, then figures, then tables."""

    title: str
    paragraphs: Sequence[str] = ()
    figures: Sequence[SectionFigure] = ()
    tables: Sequence[SectionTable] = ()
