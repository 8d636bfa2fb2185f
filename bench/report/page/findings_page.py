"""A page of findings, with its figures, which are files too."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from gyrobench.bench.foundations.files import make_folder, write_whole
from gyrobench.bench.report.page.figure_files import with_figure_files
from gyrobench.bench.report.page.findings import Findings
from gyrobench.bench.report.page.findings_file import write_findings_file
from gyrobench.bench.report.page.rendering import render_page

_TEMPLATE = "findings.html.j2"


def write_findings(path: Path, findings: Findings) -> Path:
    """Write the page, its figures into ``figures/`` and ``findings.json`` beside it; its folder is there.

    Raises
    ------
    RunFolderError
        A file can't be written.
    """
    folder = path.parent
    make_folder(folder / "figures")
    sections = with_figure_files(folder / "figures", findings.sections)
    write_whole(path, render_page(_TEMPLATE, findings=replace(findings, sections=sections)).encode())
    write_findings_file(folder, findings)
    return path
