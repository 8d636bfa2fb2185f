"""The figures of sections as files."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from gyrobench.bench.report.page.sections import Section, SectionFigure
from gyrobench.bench.report.style import save_figure


def with_figure_files(folder: Path, sections: Iterable[Section]) -> list[Section]:
    """Draw the figures of some sections into a folder that is there; those drawn before stay where they are.

    Returns
    -------
    list of Section
        The sections with PNG files as figures.

    Raises
    ------
    RunFolderError
        A file can't be written.
    """
    return [
        replace(section, figures=[_as_file(folder, each) for each in section.figures]) for section in sections
    ]


def _as_file(folder: Path, drawn: SectionFigure) -> SectionFigure:
    if isinstance(drawn.figure, Path):
        return drawn
    path = folder / f"{drawn.name}.png"
    save_figure(drawn.figure, path)
    return replace(drawn, figure=path)
