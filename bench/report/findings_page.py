"""A page that says what was found: a judgement, facts, and sections with figures, which are files too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.errors import RunFolderError
from bench.files import write_whole
from bench.report.pages import render_page
from bench.report.sections import Section
from bench.report.style import save_figure

_TEMPLATE = "findings.html.j2"


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
    """

    title: str
    source: str
    judgement: str
    colour: str
    sentence: str
    facts: Mapping[str, str]
    sections: Sequence[Section]


def write_findings(path: Path, findings: Findings) -> Path:
    """Write the page, and its figures into ``figures/`` beside it; its folder is there already.

    Raises
    ------
    RunFolderError
        A file can't be written.
    """
    figures = _save_figures(path.parent / "figures", findings.sections)
    write_whole(path, render_page(_TEMPLATE, figures, **vars(findings)).encode())
    return path


def _save_figures(folder: Path, sections: Sequence[Section]) -> list[Path]:
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise RunFolderError(f"{folder}: can't be made: {error.strerror}") from error
    paths = []
    for drawn in (figure for section in sections for figure in section.figures):
        paths.append(folder / f"{drawn.name}.png")
        save_figure(drawn.figure, paths[-1])
    return paths
