"""The report of a run, of one unit or several: one self-contained HTML file."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import matplotlib
import numpy as np

from gyrobench.bench import __version__
from gyrobench.bench.bias.bins import BiasBin, compare_positions
from gyrobench.bench.bias.dwell import DwellPurpose
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.verdicts import Acceptance
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.files import file_sha256, make_folder, write_whole
from gyrobench.bench.foundations.text import counted, hours_minutes, listed
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.report.bias_sections import (
    acceptance_section,
    before_after_section,
    comparison_section,
    dwells_section,
    gyro_section,
    verdict_box,
)
from gyrobench.bench.report.budget_section import budget_box, budget_figures, budget_section, variance_shares
from gyrobench.bench.report.calibration_check_section import (
    calibration_check_section,
    calibration_check_sentence,
    dwells_text,
)
from gyrobench.bench.report.characteristic_sections import characteristics_sections
from gyrobench.bench.report.coefficient_sections import (
    coefficients_overview,
    coefficients_section,
    has_rotations,
)
from gyrobench.bench.report.estimator_sections import (
    estimators_note,
    estimators_section,
    fit_section,
    joint_section,
    noise_section,
)
from gyrobench.bench.report.figures.bias import (
    bias_figure,
    bias_span_dph,
    position_difference_figure,
    position_pair_figure,
)
from gyrobench.bench.report.figures.temperatures import DRAWN_COLUMNS, TelemetryValues, temperature_figure
from gyrobench.bench.report.journal_sections import Entry, durations_section, events_section
from gyrobench.bench.report.page import Box, Section, SectionFigure, render_page, with_figure_files
from gyrobench.bench.report.run_content import RunContent, read_run, with_joint_solution
from gyrobench.bench.report.run_findings import signs_sentence
from gyrobench.bench.report.run_text import VERDICT_COLOURS
from gyrobench.bench.report.temperature_findings import SENSOR_COLUMNS, sensors_sentence
from gyrobench.bench.runs.folder import JOURNAL, RunFolder
from gyrobench.bench.runs.provenance import DataHash, data_hashes, record_preparer
from gyrobench.bench.runs.seal import update_seal
from gyrobench.bench.runs.tables.coefficient_table import plateau_findings
from gyrobench.bench.runs.telemetry import read_telemetry

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_VERSION_KEYS = ("gyrobench", "python", "platform")
_TIME_FORMAT = "%Y-%m-%d %H:%M:%S"
_MAX_UTC_OFFSET_S = 86_000.0
_INTERRUPTED = "It was killed or is still running: the journal has no end."
_NO_BIAS = "No dwell gave a bias."
_NOT_JUDGED = "A run with a damaged file is not judged."
_DWELL_BANDS = " Bands and bars are dwells by position; a hollow bar is a flagged dwell."
_HASHES_TEXT = (
    "SHA-256 of the files in the run folder. The hash of a log in parts is that of the list of its parts' "
    "hashes, as printed by: sha256sum can/*.blf | sha256sum"
)


class WrittenReport(NamedTuple):
    """The page of a report, the content that it shows, and the comparison with an earlier run, if any."""

    path: Path
    content: RunContent
    comparison: Section | None = None


def write_report(
    folder: RunFolder,
    prepared_by: str = "",
    out: Path | None = None,
    before: RunFolder | None = None,
    mark_temperatures_c: Sequence[float] = (),
    vectors: Sequence[str] = (),
    are_tables_new: bool = False,
) -> WrittenReport:
    """Write ``report.html`` and the figures of a run from the files in its folder.

    An existing report is replaced. The report lists the files that are missing because the run failed or was
    interrupted. A run that has ended is sealed with its report.

    ``prepared_by``: name for the sign-off, stored in the run; default: the stored name, or a blank line.
    ``out``: output folder; default: the run folder. ``before``: run before a change, compared with this one.
    ``mark_temperatures_c``: temperatures that figures mark in addition to those of the procedure.
    ``vectors``: further formats of the figures, besides PNG: ``svg``, ``pdf``. ``are_tables_new``: whether
    the tables were recomputed since the last seal. Raises RunFolderError if a file can't be written.
    """
    target = RunFolder(out or folder.path)
    if prepared_by:
        record_preparer(folder, prepared_by)
    content = read_run(folder, are_tables_new, tuple(dict.fromkeys((*DRAWN_COLUMNS, *SENSOR_COLUMNS))))
    preparer = prepared_by or str(content.provenance.get("prepared_by", ""))
    make_folder(target.figures)
    marked_c = [*content.marked_temperatures_c, *mark_temperatures_c]
    earlier = read_run(before, telemetry_columns=()) if before else None
    comparison = before_after_section(earlier, content, marked_c) if earlier else None
    key = _figures_key(content, earlier, marked_c)
    readings = partial(read_telemetry, folder.telemetry, DRAWN_COLUMNS) if content.has_readings else None
    content = _without_unused_data(content)
    figures_of_run = run_figures(readings, content.dwells, content.bins, content.acceptance, marked_c)
    figures = [SectionFigure(name, "", figure) for name, figure in figures_of_run]
    if not has_rotations(content.coefficients):
        figures += budget_figures(content.budget)
    [drawn_figures, *sections] = with_figure_files(
        target.figures,
        [
            Section("", figures=figures),
            *([comparison] if comparison else []),
            *_analysis_sections(content, marked_c),
        ],
        content.watermark,
        key,
        vectors,
    )
    content = with_joint_solution(content, folder)
    hashes = _data_hashes(folder, content.problems)
    paths = [each.figure for each in drawn_figures.figures if isinstance(each.figure, Path)]
    write_whole(target.report, map(str.encode, render(content, paths, sections, hashes, preparer)))
    if out is None:
        sha256_by_path = {path: digest for each in hashes for path, digest in each.parts.items()}
        update_seal(folder, sha256_by_path, are_tables_new)
    return WrittenReport(target.report, content, comparison)


def _without_unused_data(content: RunContent) -> RunContent:
    """Content without telemetry and without tables that the report does not show, to free memory."""
    content = replace(content, telemetry={}, sensors=sensors_sentence(content.telemetry))
    if has_rotations(content.coefficients) or plateau_findings(content.coefficients):
        return content
    stated = [row for row in content.budget.stated if row.result == "bin"]
    return replace(content, coefficients=[], budget=replace(content.budget, stated=stated))


def _figures_key(content: RunContent, before: RunContent | None, marked_c: Sequence[float]) -> str:
    """Hash of the data that the figures show and of the code that draws them."""
    code = sorted(file_sha256(each) for each in Path(__file__).parent.rglob("*.py"))
    inputs = (
        *(content.dwells, content.bins, content.acceptance, content.noise, variance_shares(content.budget)),
        *(content.coefficients, content.characteristics, before.bins if before else None),
        [content.station, content.watermark, marked_c, code, __version__, matplotlib.__version__],
    )
    digest = hashlib.sha256()
    with np.printoptions(threshold=sys.maxsize, floatmode="unique"):
        for each in inputs:
            # Row by row: the text of all rows would take megabytes.
            for item in each if isinstance(each, Sequence) else [each]:
                digest.update(repr(item).encode())
            digest.update(b";")
    for name in DRAWN_COLUMNS if content.telemetry else ():
        digest.update(content.telemetry[name].tobytes())
    return digest.hexdigest()


def render(
    content: RunContent,
    figures: Iterable[Path],
    sections: Sequence[Section] = (),
    hashes: Sequence[DataHash] = (),
    prepared_by: str = "",
) -> Iterator[str]:
    """Yield the report as HTML text, part by part.

    ``figures``: PNG files, named as by :func:`run_figures`. ``sections``: further sections with PNG files,
    placed before the dwells.
    """
    paths_by_name = {path.stem: path for path in figures}
    unit, facts = serial_number_of(content), head_facts(content)
    check = calibration_check_sentence(content.calibration_check) if content.calibration_check else ""
    no_bias = "" if content.bins or check else _NO_BIAS
    no_dwell = f"{facts['dwells']}, without a turn." if check else "No dwell was measured."
    if content.dwell_purposes and not (content.dwell_purposes[DwellPurpose.CALIBRATION] or check):
        no_bias = no_dwell = f"{facts['dwells']}, which give no biases by themselves."
    temperatures = f"Temperatures over the run.{_DWELL_BANDS if content.dwells else ''}"
    hash_by_name = {
        f"{each.name} ({each.count} files)" if each.count > 1 else each.name: each.sha256 for each in hashes
    }
    parts = [
        acceptance_section(content.acceptance),
        comparison_section(
            content.bins, content.acceptance, paths_by_name, no_bias, check, estimators_note(content.dwells)
        ),
        Section(
            "Temperatures", figures=[SectionFigure("temperature", temperatures, paths_by_name["temperature"])]
        )
        if "temperature" in paths_by_name
        else None,
        *(gyro_section(gyro, content.bins, paths_by_name) for gyro in AXES),
        *sections,
        joint_section(content.joint_sigmas, content.joint_plateaus),
        *(findings.chapter for findings in content.chapters),
        dwells_section(content.dwells, no_dwell),
        events_section(content.journal),
        _list_section("Approvals of the investigation", content.approvals),
        durations_section(content.step_durations),
        _list_section("Assumptions of the procedure", content.procedure.get("assumptions")),
        _instruments_section(content),
        Section("Data of this report", [_HASHES_TEXT], facts=hash_by_name) if hashes else None,
        safe_state_section(content),
        _list_section("Missing in the run folder", content.problems),
    ]
    subject = _subject(content)
    title = f"{subject} of unit {unit}" if unit else subject
    started = f", started {facts['started']}" if "started" in facts else ""
    page = Section(
        title,
        boxes=verdict_boxes(content),
        facts=facts,
        figures=[
            replace(each, figure=paths_by_name[each.name])
            for each in budget_figures(content.budget)
            if each.name in paths_by_name
        ],
        tables=[coefficients_overview(content.coefficients)] if has_rotations(content.coefficients) else [],
        sections=[part for part in parts if part],
    )
    source = f"Run {content.run_name}{started}"
    return render_page(page, source, content.watermark, f"{title}: {content.run_name}", prepared_by)


def _subject(content: RunContent) -> str:
    if has_rotations(content.coefficients):
        return "Gyro and accelerometer coefficients"
    return "Gyro bias" if content.dwells or not content.characteristics else "Gyro characteristics"


def _data_hashes(folder: RunFolder, problems: list[str]) -> list[DataHash]:
    try:
        return data_hashes(folder)
    except RunFolderError as error:
        problems.append(f"The data can't be hashed: {error}")
        return []


def _analysis_sections(content: RunContent, marked_c: Sequence[float]) -> list[Section]:
    """Sections of the analyses for which the run has data."""
    sections = [
        coefficients_section(content.coefficients, content.budget),
        *characteristics_sections(content.characteristics),
        budget_section(content.budget, is_drawn=has_rotations(content.coefficients)),
        estimators_section(content.dwells, marked_c),
        fit_section(content.dwells),
        noise_section(content.noise, content.station),
        calibration_check_section(content.calibration_check),
    ]
    return [section for section in sections if section]


def verdict_boxes(content: RunContent) -> list[Box]:
    """Boxes at the top: damaged files, how the run ended, the verdict on the unit, and doubts about it."""
    acceptance = content.acceptance
    boxes = [*damage_boxes(content.damage), ending_box(content)]
    if JOURNAL in content.damage:
        return [*boxes, *_not_judged_boxes(content)]
    boxes += [verdict_box(acceptance)] if acceptance else _not_judged_boxes(content)
    if findings_by_plateau := plateau_findings(content.coefficients):
        plateaus = listed(sorted({each.partition(":")[0] for each in findings_by_plateau}))
        text = f"{plateaus}: see the section on coefficients."
        boxes.append(Box(VERDICT_COLOURS["marginal"], "Coefficients in doubt.", text))
    if box := budget_box(content.budget):
        boxes.append(box)
    return [*boxes, *doubt_boxes(content)]


def ending_box(content: RunContent) -> Box:
    """How the run ended, and whether the bench is safe."""
    facts = content.facts
    if JOURNAL in content.damage:  # the entries before the damage do not state how the run ended
        return Box("failed", content.ending, "")
    is_safe = not any(action.get("problem") for action in facts.safe_state)
    notes = [f"Unfinished step: {_unfinished_step(content)}."] if _unfinished_step(content) else []
    notes += [
        f"Past due: {each.get('found')}; acknowledged by {each.get('operator')}."
        for each in content.entries("past_due")
    ]
    notes += [] if is_safe else ["The safe state was not fully reached; see the section Safe state."]
    colour = facts.ended if is_safe and facts.ended in ("finished", "stopped") else "failed"
    return Box(colour, content.ending, content.reason or ("" if facts.ended else _INTERRUPTED), notes)


def doubt_boxes(content: RunContent) -> list[Box]:
    """One box for each doubt about results; none if the journal is damaged."""
    if JOURNAL in content.damage:
        return []
    boxes = [Box("failed", title, text) for title, text in content.doubts.items()]
    if text := signs_sentence(content.facts, content.station, Path("RUN", RunFolder.station)):
        boxes.append(Box(VERDICT_COLOURS["marginal"], "Signal map not tested.", text))
    return boxes


def damage_boxes(damage: Mapping[str, str]) -> list[Box]:
    """One box for each damaged file, see :func:`gyrobench.bench.report.run_content.damage_of`."""
    return [Box("failed", f"{name} can't be used.", text) for name, text in damage.items()]


def _not_judged_boxes(content: RunContent) -> list[Box]:
    return [Box(VERDICT_COLOURS["not judged"], "Unit not judged.", _NOT_JUDGED)] if content.damage else []


def _list_section(title: str, items: object) -> Section | None:
    return Section(title, items=[str(each) for each in items]) if isinstance(items, list) and items else None


def _instruments_section(content: RunContent) -> Section:
    instruments, provenance = instruments_of(content), content.provenance
    versions = {name: provenance[name] for name in _VERSION_KEYS if name in provenance}
    versions |= provenance.get("packages", {})
    version_text = ", ".join(f"{name} {version}" for name, version in versions.items())
    hashes = _as_texts(provenance.get("files_sha256") or {})
    parts = [
        _list_section("Resolution of the INS output", content.last("resolution").get("lines")),
        Section("Versions", [version_text]) if versions else None,
        Section("SHA-256 of the input files", facts=hashes) if hashes else None,
    ]
    return Section(
        "Instruments and software",
        paragraphs=[] if instruments else ["The instruments are unknown."],
        facts=_as_texts(instruments),
        sections=[part for part in parts if part],
    )


def safe_state_section(content: RunContent) -> Section:
    """What was done at the end to make the bench safe, and what failed."""
    actions = content.facts.safe_state
    if JOURNAL in content.damage:
        return Section("Safe state", [f"{JOURNAL} can't be used."])
    if not actions:
        return Section("Safe state", ["The journal has no safe state."])
    items = [
        f"{action.get('what', 'unnamed action')}{': failed: ' if problem else ''}{problem}"
        for action in actions
        for problem in [str(action.get("problem") or "")]
    ]
    return Section("Safe state", items=items)


def _as_texts(facts: Mapping[str, object]) -> dict[str, str]:
    return {str(name): str(value) for name, value in facts.items()}


def serial_number_of(content: RunContent) -> str:
    """Serial number of the unit, or of several units; empty if unknown."""
    units = {row.unit for row in content.dwells} | {row.unit for row in content.calibration_check}
    return ", ".join(sorted(units - {""})) or content.facts.unit


def _dwell_counts(content: RunContent) -> str:
    flagged = sum(bool(row.flags) for row in content.dwells)
    texts = [f"{len(content.dwells)} measured, {flagged} of them flagged"] if content.dwells else []
    texts += [dwells_text(content.calibration_check)] if content.calibration_check else []
    for purpose, text in ((DwellPurpose.ROTATIONS, "with rotations"), (DwellPurpose.NOISE, "for noise")):
        if count := content.dwell_purposes[purpose]:
            texts.append(f"{counted(count, 'dwell')} {text}")
    texts += [f"{len(content.skipped)} skipped"] if content.skipped else []
    if content.replaced:
        texts.append(f"measured again in place of earlier ones: {listed([*map(str, content.replaced)])}")
    return "; ".join(texts) or "none"


def head_facts(content: RunContent) -> dict[str, str]:
    """Unit, procedure, bench, operator and times of a run by label; unknown values are omitted."""
    facts, provenance = content.facts, content.provenance
    options = {**provenance.get("options", {}), **facts.options}
    own_clock = " by the run's own clock" if "speed" in options or options.get("clock") == "virtual" else ""
    if "speed" in options:
        options["speed"] = f"{options['speed']:g} (the run's clock, relative to real time)"
    resumed = f", resumed {counted(facts.resumes, 'time')}" if facts.resumes else ""
    is_end_known = JOURNAL not in content.damage
    lines = {
        "unit": serial_number_of(content) or "serial number unknown",
        "procedure": facts.procedure or content.procedure.get("procedure"),
        "purpose": content.procedure.get("description"),
        "bench": facts.station or content.station.get("station"),
        "started by": " on ".join(
            str(provenance[name]) for name in ("operator", "host") if provenance.get(name)
        ),
        "started": _utc_and_local(content.started, 0.0, provenance),
        "ended": _utc_and_local(content.started, facts.last_s, provenance) + own_clock
        if facts.ended and is_end_known and content.started
        else "",
        "duration": f"{hours_minutes(facts.last_s)} h{resumed}" if facts.last_s and is_end_known else "",
        "dwells": _dwell_counts(content),
        "options": ", ".join(f"{name} {value}" for name, value in options.items()),
    }
    return {name: str(value) for name, value in lines.items() if value}


def _utc_and_local(started: datetime | None, after_s: float, provenance: Entry) -> str:
    """Time in UTC, and in local time of the bench if its offset from UTC is known."""
    if started is None:
        return ""
    try:
        time = started.astimezone(UTC) + timedelta(seconds=after_s)
        text = f"{time.strftime(_TIME_FORMAT)} UTC"
        offset_s = provenance.get("utc_offset_s")
        if not isinstance(offset_s, int | float) or not abs(offset_s) < _MAX_UTC_OFFSET_S:
            return text
        if not offset_s:
            return f"{text} (local time is UTC)"
        local = time.astimezone(timezone(timedelta(seconds=offset_s)))
    except OverflowError:
        return ""
    return f"{text}, {local.strftime(_TIME_FORMAT)} local time ({local.tzname()})"


def _unfinished_step(content: RunContent) -> str:
    """Step that was in progress when the run ended; empty if none."""
    if content.facts.ended == "finished":
        return ""
    last = content.last_step
    if last.get("event") != "step_started":
        return ""
    label = f" ({last['label']})" if last.get("label") else ""
    return f"{last.get('step', '?')}, {last.get('what', 'unknown kind')}{label}"


def instruments_of(content: RunContent) -> dict[str, str]:
    """Identification of each instrument, by instrument."""
    instruments = dict(content.provenance.get("instruments", {}))
    identity = content.last("ins_identified").get("identity")
    if isinstance(identity, Mapping):
        identity = ", ".join(f"{name} {value}" for name, value in identity.items())
    return instruments | ({"INS": identity} if identity else {})


def figures_of(content: RunContent) -> Iterator[tuple[str, Callable[[], Figure]]]:
    """Figures of a run for which there are data, see :func:`run_figures`."""
    readings = (lambda: content.telemetry) if content.has_readings else None
    return run_figures(
        readings, content.dwells, content.bins, content.acceptance, content.marked_temperatures_c
    )


def run_figures(
    readings: Callable[[], TelemetryValues] | None,
    dwells: Sequence[DwellRow],
    bins: Sequence[BiasBin],
    acceptance: Acceptance | None = None,
    marked_c: Sequence[float] = (),
) -> Iterator[tuple[str, Callable[[], Figure]]]:
    """Figures for which there are data: yields the name of each and a function that draws it.

    The names are temperature, bias_x, bias_y, bias_z, position_pair and position_differences. ``readings``
    returns the telemetry; None without telemetry.
    """
    if readings or dwells:
        yield "temperature", lambda: temperature_figure(readings() if readings else {}, dwells, marked_c)
    if bins or any(not row.flags for row in dwells):
        span_dph = bias_span_dph(dwells, bins)
        for gyro in AXES:
            yield f"bias_{gyro}", partial(bias_figure, gyro, dwells, bins, span_dph, marked_c)
    if {"z_up", "y_up"} <= {each.position for each in bins if not each.is_empty}:
        yield "position_pair", partial(position_pair_figure, bins, marked_c)
    comparisons = compare_positions(bins)
    limits = acceptance.limits if acceptance else None
    if comparisons:
        yield "position_differences", partial(position_difference_figure, comparisons, limits, marked_c)
