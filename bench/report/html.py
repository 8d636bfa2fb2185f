"""The report of a run: one HTML file that needs nothing beside it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.files import write_whole
from bench.navigation.positions import AXES
from bench.procedure.timeline import hours_minutes
from bench.report.content import Entry, RunContent, read_run
from bench.report.durations import clock_time, durations_by_kind, took_in_journal
from bench.report.dwell_lines import dwell_table
from bench.report.estimator_sections import estimators_note, estimators_section, fit_section
from bench.report.figures import save_figure, save_figures
from bench.report.findings import NOTHING_TO_COMPARE
from bench.report.joint_section import joint_section
from bench.report.noise_section import noise_section
from bench.report.pages import render_page
from bench.report.sections import Section
from bench.report.tables import gyro_part, measured_positions
from bench.report.verification_section import dwells_text, verification_section, verification_sentence
from bench.run_store.folder import RunFolder

_TEMPLATE = "report.html.j2"
_PROGRAMS = ("gyrobench", "python", "platform")
_CUT_OFF = "It was killed or cut off, or has not ended yet: the journal does not tell of its end."


def write_report(folder: RunFolder) -> Path:
    """Write ``report.html`` and the figures of a run, from what its folder holds.

    Parts that are missing, because the run failed or was cut off, are named in the report.

    Parameters
    ----------
    folder : RunFolder
        The run; its report and figures are written anew.

    Returns
    -------
    Path
        The report.

    Raises
    ------
    RunFolderError
        A file can't be written.
    """
    content = read_run(folder)
    sections = _sections(content)
    figures = save_figures(folder, content.telemetry, content.dwells, content.bins)
    for drawn in (figure for section in sections for figure in section.figures):
        figures.append(folder.figures / f"{drawn.name}.png")
        save_figure(drawn.figure, figures[-1])
    write_whole(folder.report, render(content, figures, sections).encode())
    return folder.report


def render(content: RunContent, figures: Iterable[Path], sections: Sequence[Section] = ()) -> str:
    """Give the report as HTML text.

    Parameters
    ----------
    content : RunContent
        What the run left.
    figures : iterable of Path
        PNG files, by the names of :func:`bench.report.figures.save_figures` and of the sections.
    sections : sequence of Section
        Parts that are not in every report.
    """
    return render_page(
        _TEMPLATE,
        figures,
        run=content,
        unit=_unit(content),
        facts=_facts(content),
        ending=_ending(content),
        instruments=_instruments(content),
        versions=_versions(content.provenance),
        positions=measured_positions(content.bins),
        gyros=[gyro_part(gyro, content.bins) for gyro in AXES],
        nothing_to_compare=NOTHING_TO_COMPARE,
        verification=verification_sentence(content.verification) if content.verification else "",
        note=estimators_note(content.dwells),
        sections=sections,
        dwells=dwell_table(content.dwells),
        durations=durations_by_kind(took_in_journal(content.journal)),
        clock_time=clock_time,
    )


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


def _unit(content: RunContent) -> str:
    units = {row.unit for row in content.dwells} | {row.unit for row in content.verification}
    identified = content.last("ins_identified").get("unit")
    return ", ".join(sorted(units - {""})) or str(identified or "")


def _dwells_text(content: RunContent) -> str:
    flagged = sum(bool(row.flags) for row in content.dwells)
    texts = [f"{len(content.dwells)} measured, {flagged} of them flagged"] if content.dwells else []
    texts += [dwells_text(content.verification)] if content.verification else []
    return "; ".join(texts) or "none"


def _facts(content: RunContent) -> dict[str, str]:
    started = content.last("run_started")
    end_s = max((entry.get("time_s", 0.0) for entry in content.journal), default=0.0)
    options = {**content.provenance.get("options", {}), **started.get("options", {})}
    facts = {
        "unit": _unit(content) or "serial number not known",
        "procedure": started.get("procedure") or content.procedure.get("procedure"),
        "purpose": content.procedure.get("description"),
        "station": started.get("station") or content.station.get("station"),
        "started (UTC)": _to_the_second(content.provenance.get("started_utc") or started.get("utc") or ""),
        "duration": f"{hours_minutes(end_s)} h" if end_s else None,
        "dwells": _dwells_text(content),
        "options": ", ".join(f"{name} {value}" for name, value in options.items()),
    }
    return {name: str(value) for name, value in facts.items() if value}


def _to_the_second(iso_time: str) -> str:
    return iso_time[: len("2000-01-01T00:00:00")].replace("T", " ")


def _ending(content: RunContent) -> Entry:
    """How the run ended: word, reason, the step that did not end, safe state."""
    end = content.last("run_ended")
    ended = str(end.get("ended", "not ended"))
    return {
        "word": ended,
        "reason": end.get("reason") or ("" if end else _CUT_OFF),
        "step": "" if ended == "finished" else _open_step(content),
        "safe_state": end.get("safe_state") or [],
    }


def _open_step(content: RunContent) -> str:
    """Say which step had begun and not ended; empty where none had."""
    steps = [entry for entry in content.journal if entry.get("event") in ("step_started", "step_finished")]
    if not steps or steps[-1]["event"] == "step_finished":
        return ""
    last = steps[-1]
    where = f" ({last['label']})" if last.get("label") else ""
    return f"step {last.get('step', '?')}, {last.get('what', 'of unknown kind')}{where}"


def _instruments(content: RunContent) -> dict[str, str]:
    known = dict(content.provenance.get("instruments", {}))
    identity = content.last("ins_identified").get("identity")
    if isinstance(identity, Mapping):
        identity = ", ".join(f"{name} {value}" for name, value in identity.items())
    return known | ({"INS": identity} if identity else {})


def _versions(provenance: Entry) -> dict[str, Any]:
    own = {name: provenance[name] for name in _PROGRAMS if name in provenance}
    return {**own, **provenance.get("packages", {})}
