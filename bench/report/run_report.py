"""The report of a run: one HTML file that needs nothing beside it, and the same as PDF on A4."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from gyrobench.bench.bias.bins import BiasBin, compare_positions
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.verdicts import Acceptance
from gyrobench.bench.foundations.clock import parsed_utc
from gyrobench.bench.foundations.errors import GyrobenchError, RunFolderError
from gyrobench.bench.foundations.extras import require
from gyrobench.bench.foundations.files import make_folder, write_whole
from gyrobench.bench.foundations.text import counted
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.procedure.timeline import hours_minutes
from gyrobench.bench.report.bias_sections import (
    acceptance_section,
    before_after_section,
    dwell_table,
    gyro_part,
    measured_positions,
)
from gyrobench.bench.report.calibration_check import (
    dwells_text,
    verification_section,
    verification_sentence,
)
from gyrobench.bench.report.content import Entry, RunContent, read_run
from gyrobench.bench.report.estimator_sections import (
    estimators_note,
    estimators_section,
    fit_section,
    joint_section,
    noise_section,
)
from gyrobench.bench.report.figures.bias import bias_figure, bias_span_dph, position_difference_figure
from gyrobench.bench.report.figures.style import save_figure
from gyrobench.bench.report.figures.temperatures import Readings, temperature_figure
from gyrobench.bench.report.journal_sections import (
    clock_time,
    durations_by_kind,
    events_section,
    took_in_journal,
)
from gyrobench.bench.report.page import Section, render_page, with_figure_files
from gyrobench.bench.report.statements import NOTHING_TO_COMPARE, VERDICT_COLOURS, verdict_sentence
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import RunFacts
from gyrobench.bench.runs.provenance import DataHash, data_hashes, note_preparer

_TEMPLATE = "report.html.j2"


def write_report(
    folder: RunFolder,
    prepared_by: str = "",
    out: Path | None = None,
    before: RunFolder | None = None,
    mark_temperatures_c: Sequence[float] = (),
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
        Run before a change, to compare with this one.
    mark_temperatures_c : sequence of float
        Temperatures in degC that figures mark beside those of the procedure.

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
    marked_c = [*content.marked_temperatures_c, *mark_temperatures_c]
    figures = save_figures(
        into, content.telemetry, content.dwells, content.bins, content.acceptance, marked_c
    )
    compared = [before_after_section(read_run(before), content, marked_c)] if before else []
    sections = with_figure_files(into.figures, [*compared, *_sections(content, marked_c)])
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
        PNG files, by the names of :func:`gyrobench.bench.report.run_report.save_figures`.
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


def _sections(content: RunContent, marked_c: Sequence[float]) -> list[Section]:
    """Parts that this run has something for."""
    sections = [
        estimators_section(content.dwells, marked_c),
        fit_section(content.dwells),
        joint_section(content.joint_biases, content.joint_plateaus),
        noise_section(content.noise, content.station),
        verification_section(content.verification),
    ]
    return [section for section in sections if section]


_PROGRAMS = ("gyrobench", "python", "platform")
_CUT_OFF = "It was killed or cut off, or has not ended yet: the journal does not tell of its end."
_TIME = "%Y-%m-%d %H:%M:%S"
_MOST_OFFSET_S = 86_000.0


def serial_number_of(content: RunContent) -> str:
    """Serial number of the unit, or of several; empty where none is known."""
    units = {row.unit for row in content.dwells} | {row.unit for row in content.verification}
    return ", ".join(sorted(units - {""})) or content.facts.unit


def _dwells_text(content: RunContent) -> str:
    flagged = sum(bool(row.flags) for row in content.dwells)
    texts = [f"{len(content.dwells)} measured, {flagged} of them flagged"] if content.dwells else []
    texts += [dwells_text(content.verification)] if content.verification else []
    return "; ".join(texts) or "none"


def head_lines(content: RunContent) -> dict[str, str]:
    """What was run, on what, by whom and when; what is not known is left out."""
    told, own = content.facts, content.provenance
    options = {**own.get("options", {}), **told.options}
    begun = parsed_utc(own.get("started_utc") or told.started_utc)
    lines = {
        "unit": serial_number_of(content) or "serial number not known",
        "procedure": told.procedure or content.procedure.get("procedure"),
        "purpose": content.procedure.get("description"),
        "bench": told.station or content.station.get("station"),
        "started by": " on ".join(str(own[name]) for name in ("operator", "host") if own.get(name)),
        "started": _both_times(begun, 0.0, own),
        "ended": _both_times(begun, told.last_s, own) if told.ended else "",
        "duration": _duration(told),
        "dwells": _dwells_text(content),
        "options": ", ".join(f"{name} {value}" for name, value in options.items()),
    }
    return {name: str(value) for name, value in lines.items() if value}


def _duration(told: RunFacts) -> str:
    more = f", gone on with {counted(told.resumes, 'time')}" if told.resumes else ""
    return f"{hours_minutes(told.last_s)} h{more}" if told.last_s else ""


def _both_times(begun: datetime | None, after_s: float, provenance: Entry) -> str:
    """Write a time in UTC, and as clocks on the bench showed it, where that is known."""
    if begun is None:
        return ""
    try:
        moment = begun.astimezone(UTC) + timedelta(seconds=after_s)
        text = f"{moment.strftime(_TIME)} UTC"
        offset_s = provenance.get("utc_offset_s")
        if not isinstance(offset_s, int | float) or not abs(offset_s) < _MOST_OFFSET_S:
            return text
        if not offset_s:
            return f"{text}, which is local time too"
        local = moment.astimezone(timezone(timedelta(seconds=offset_s)))
    except OverflowError:
        return ""
    return f"{text}, {local.strftime(_TIME)} local time ({local.tzname()})"


def ending_of(content: RunContent) -> Entry:
    """Tell how the run ended: word, reason, the step that did not end, safe state."""
    told = content.facts
    return {
        "word": told.ended or "not ended",
        "reason": told.reason or ("" if told.ended else _CUT_OFF),
        "step": "" if told.ended == "finished" else _open_step(content),
        "safe_state": told.safe_state,
    }


def _open_step(content: RunContent) -> str:
    """Say which step had begun and not ended; empty where none had."""
    steps = [entry for entry in content.journal if entry.get("event") in ("step_started", "step_finished")]
    if not steps or steps[-1]["event"] == "step_finished":
        return ""
    last = steps[-1]
    where = f" ({last['label']})" if last.get("label") else ""
    return f"step {last.get('step', '?')}, {last.get('what', 'of unknown kind')}{where}"


def instruments_of(content: RunContent) -> dict[str, str]:
    """What each instrument said it is."""
    known = dict(content.provenance.get("instruments", {}))
    identity = content.last("ins_identified").get("identity")
    if isinstance(identity, Mapping):
        identity = ", ".join(f"{name} {value}" for name, value in identity.items())
    return known | ({"INS": identity} if identity else {})


def versions_of(provenance: Entry) -> dict[str, Any]:
    """Versions of the programs that made the run."""
    own = {name: provenance[name] for name in _PROGRAMS if name in provenance}
    return {**own, **provenance.get("packages", {})}


_LACKING = (
    "can't load the library Pango, needed for PDF: {}. Install it (Debian, Ubuntu: "
    "`apt-get install libpango-1.0-0 libpangoft2-1.0-0 libharfbuzz-subset0`; macOS: `brew install pango`), "
    "or print report.html in a browser."
)


def write_pdf(page: Path, pdf: Path) -> Path:
    """Lay a self-contained HTML page out as PDF.

    Parameters
    ----------
    page : Path
        What :func:`gyrobench.bench.report.run_report.write_report` wrote.
    pdf : Path
        Where to write.

    Raises
    ------
    GyrobenchError
        A system library is missing.
    MissingPackageError
        Weasyprint is not installed.
    RunFolderError
        The file can't be written.
    """
    try:
        html, urls = require("weasyprint"), require("weasyprint.urls")
    except OSError as error:
        raise GyrobenchError(_LACKING.format(str(error).splitlines()[0])) from error
    for name in ("weasyprint", "fontTools"):
        logging.getLogger(name).setLevel(logging.ERROR)
    # Pictures are embedded: no other address is fetched.
    document = html.HTML(
        string=page.read_text(encoding="utf-8"), url_fetcher=urls.URLFetcher(allowed_protocols=["data"])
    )
    write_whole(pdf, document.write_pdf())
    return pdf


def save_figures(
    folder: RunFolder,
    telemetry: Readings,
    dwells: Sequence[DwellRow],
    bins: Sequence[BiasBin],
    acceptance: Acceptance | None = None,
    marked_c: Sequence[float] = (),
) -> list[Path]:
    """Draw everything that a run gives into its folder of figures.

    Returns
    -------
    list of Path
        Of temperature.png, bias_x.png, bias_y.png, bias_z.png and position_differences.png those
        that there are data for.

    Raises
    ------
    RunFolderError
        A file can't be written.
    """
    make_folder(folder.figures)
    paths = []
    for name, figure in run_figures(telemetry, dwells, bins, acceptance, marked_c):
        paths.append(folder.figures / f"{name}.png")
        save_figure(figure, paths[-1])
    return paths


def run_figures(
    telemetry: Readings,
    dwells: Sequence[DwellRow],
    bins: Sequence[BiasBin],
    acceptance: Acceptance | None,
    marked_c: Sequence[float],
) -> Iterator[tuple[str, Figure]]:
    """Draw what a run gives: name and figure, one after the other."""
    if len(telemetry.get("time_s", ())) or dwells:
        yield "temperature", temperature_figure(telemetry, dwells, marked_c)
    if bins or any(not row.flags for row in dwells):
        span_dph = bias_span_dph(dwells, bins)
        for gyro in AXES:
            yield f"bias_{gyro}", bias_figure(gyro, dwells, bins, span_dph, marked_c)
    comparisons = compare_positions(bins)
    limits = acceptance.limits if acceptance else None
    limit_dph = limits.position_difference_dph if limits else None
    if comparisons:
        yield "position_differences", position_difference_figure(comparisons, limit_dph, marked_c)
