"""The report of a run: one HTML file that needs nothing beside it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.files import make_folder, write_whole
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.report.acceptance_wording import VERDICT_COLOURS, verdict_sentence
from gyrobench.bench.report.calibration_check.section import verification_section, verification_sentence
from gyrobench.bench.report.content import RunContent, read_run
from gyrobench.bench.report.durations import clock_time, durations_by_kind, took_in_journal
from gyrobench.bench.report.figures import save_figures
from gyrobench.bench.report.findings import NOTHING_TO_COMPARE
from gyrobench.bench.report.page.figure_files import with_figure_files
from gyrobench.bench.report.page.rendering import render_page
from gyrobench.bench.report.page.sections import Section
from gyrobench.bench.report.run.acceptance_section import acceptance_section
from gyrobench.bench.report.run.before_after import before_after_section
from gyrobench.bench.report.run.dwell_lines import dwell_table
from gyrobench.bench.report.run.estimator_sections import estimators_note, estimators_section, fit_section
from gyrobench.bench.report.run.events import events_section
from gyrobench.bench.report.run.gyro_parts import gyro_part, measured_positions
from gyrobench.bench.report.run.head import (
    ending_of,
    head_lines,
    instruments_of,
    serial_number_of,
    versions_of,
)
from gyrobench.bench.report.run.joint_section import joint_section
from gyrobench.bench.report.run.noise_section import noise_section
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.provenance import DataHash, data_hashes, note_preparer

_TEMPLATE = "report.html.j2"


def write_report(
    folder: RunFolder, prepared_by: str = "", out: Path | None = None, before: RunFolder | None = None
) -> Path:
    """Write ``report.html`` and the figures of a run, from what its folder holds.

    Parts that are missing, because the run failed or was cut off, are named in the report.

    Parameters
    ----------
    folder : RunFolder
        The run; its report and figures are written anew.
    prepared_by : str
        Name for the sign-off, kept in the run for the next time; without one that of the last time, or a
        blank line.
    out : Path, optional
        Folder to write into; without one the run's.
    before : RunFolder, optional
        Run before a change, to be set beside this one.

    Returns
    -------
    Path
        The report.

    Raises
    ------
    RunFolderError
        A file can't be written.
    """
    into = RunFolder(out or folder.path)
    if prepared_by:
        note_preparer(folder, prepared_by)
    content, hashes = _with_hashes(folder)
    by = prepared_by or str(content.provenance.get("prepared_by", ""))
    make_folder(into.figures)
    figures = save_figures(into, content.telemetry, content.dwells, content.bins, content.acceptance)
    compared = [before_after_section(read_run(before), content)] if before else []
    sections = with_figure_files(into.figures, [*compared, *_sections(content)])
    write_whole(into.report, render(content, figures, sections, hashes, by).encode())
    return into.report


def render(
    content: RunContent,
    figures: Iterable[Path],
    sections: Sequence[Section] = (),
    hashes: Sequence[DataHash] = (),
    prepared_by: str = "",
) -> str:
    """Give the report as HTML text.

    Parameters
    ----------
    content : RunContent
        What the run left.
    figures : iterable of Path
        PNG files, by the names of :func:`gyrobench.bench.report.figures.save_figures`.
    sections : sequence of Section
        Parts that are not in every report, with figures that are drawn.
    hashes : sequence of DataHash
        What ties the report to its data.
    prepared_by : str
        Name for the sign-off.
    """
    return render_page(
        _TEMPLATE,
        figures={path.stem: path for path in figures},
        run=content,
        unit=serial_number_of(content),
        facts=head_lines(content),
        ending=ending_of(content),
        acceptance=content.acceptance,
        acceptance_colour=VERDICT_COLOURS[content.acceptance.verdict] if content.acceptance else "",
        acceptance_sentence=verdict_sentence(content.acceptance) if content.acceptance else "",
        acceptance_sections=[each for each in [acceptance_section(content.acceptance)] if each],
        prepared_by=prepared_by,
        instruments=instruments_of(content),
        versions=versions_of(content.provenance),
        positions=measured_positions(content.bins),
        gyros=[gyro_part(gyro, content.bins) for gyro in AXES],
        nothing_to_compare=NOTHING_TO_COMPARE,
        verification=verification_sentence(content.verification) if content.verification else "",
        note=estimators_note(content.dwells),
        sections=sections,
        hashes=hashes,
        chapters=content.chapters,
        events=[events_section(content.journal)],
        dwells=dwell_table(content.dwells),
        durations=durations_by_kind(took_in_journal(content.journal)),
        clock_time=clock_time,
    )


def _with_hashes(folder: RunFolder) -> tuple[RunContent, list[DataHash]]:
    """Read a run, and hash what the report is to be tied to."""
    content = read_run(folder)
    try:
        return content, data_hashes(folder)
    except RunFolderError as error:
        problem = f"The data can't be hashed: {error}"
        return replace(content, problems=[*content.problems, problem]), []


def _sections(content: RunContent) -> list[Section]:
    """Parts that this run has something for."""
    sections = [
        estimators_section(content.dwells),
        fit_section(content.dwells),
        joint_section(content.joint_biases, content.joint_stops),
        noise_section(content.noise, content.station),
        verification_section(content.verification),
    ]
    return [section for section in sections if section]
