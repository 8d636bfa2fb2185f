"""Figures of a report's sections as files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bench.errors import RunFolderError
from bench.report.sections import Section
from bench.report.style import save_figure


def save_section_figures(folder: Path, sections: Sequence[Section]) -> list[Path]:
    """Write the figures of sections as PNG files by their names, into a folder that is made for them.

    Raises
    ------
    RunFolderError
        The folder or a file can't be written.
    """
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise RunFolderError(f"{folder}: can't be made: {error.strerror}") from error
    paths = []
    for drawn in (figure for section in sections for figure in section.figures):
        paths.append(folder / f"{drawn.name}.png")
        save_figure(drawn.figure, paths[-1])
    return paths
