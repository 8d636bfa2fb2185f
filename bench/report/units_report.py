"""Report of a run with several units: a comparison of the units, and links to the report of each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import PurePosixPath
from typing import NamedTuple

import numpy as np

from gyrobench.bench.bias.dwell_table import noise_and_common
from gyrobench.bench.foundations.files import write_whole
from gyrobench.bench.foundations.text import counted, of_units
from gyrobench.bench.navigation.positions import AXES, gyro_label
from gyrobench.bench.report.journal_sections import durations_section, events_section
from gyrobench.bench.report.number_format import BiasScale
from gyrobench.bench.report.page import Box, Mark, Section, SectionTable, render_page
from gyrobench.bench.report.run_content import RunContent, read_run
from gyrobench.bench.report.run_report import (
    damage_boxes,
    doubt_boxes,
    ending_box,
    head_facts,
    safe_state_section,
    write_report,
)
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.seal import update_seal


class WrittenUnitsReport(NamedTuple):
    """The comparison of the units, and the content of each."""

    comparison: Section
    units: list[RunContent]


def write_units_report(
    folder: RunFolder, prepared_by: str = "", vectors: Sequence[str] = ()
) -> WrittenUnitsReport:
    """Write the report of each unit and the ``report.html`` of the run.

    A run that has ended is sealed with it. Raises RunFolderError if a file can't be written.
    """
    units = [write_report(unit, prepared_by, vectors=vectors).content for unit in folder.unit_folders]
    content = read_run(folder, telemetry_columns=())
    comparison = _section_of_units(content, units)
    facts = head_facts(content)
    facts["unit"] = ", ".join(unit.name for unit in units)
    facts.pop("dwells", None)
    procedure = str(content.procedure.get("procedure", ""))
    page = Section(
        f"Gyro bias of {counted(len(units), 'unit')}",
        boxes=[
            *(box for each in (content, *units) for box in damage_boxes(each.damage)),
            ending_box(content),
            *_doubts_of_units(units),
        ],
        facts=facts,
        sections=[
            comparison,
            Section("Reports", items=[PurePosixPath("units", unit.name, "report.html") for unit in units]),
            events_section(content.journal),
            durations_section(content.step_durations),
            safe_state_section(content),
        ],
    )
    text = render_page(page, f"Run {content.name}, {procedure}", content.watermark, sign_off=prepared_by)
    write_whole(folder.report, map(str.encode, text))
    update_seal(folder)
    return WrittenUnitsReport(comparison, units)


def _doubts_of_units(units: Sequence[RunContent]) -> list[Box]:
    """Doubts about the results of the units; one that several units have alike is stated once."""
    names: dict[tuple[str, str, str], list[str]] = {}
    for unit in units:
        for box in doubt_boxes(unit):
            names.setdefault((box.colour, box.headline, box.text), []).append(unit.name)
    return [
        Box(colour, of_units(numbers, headline), text) for (colour, headline, text), numbers in names.items()
    ]


def _section_of_units(run: RunContent, units: Sequence[RunContent]) -> Section:
    """Comparison of the units of a run: verdict, mean bias of each gyro, dwells, and why one was dropped."""
    drop_reasons = {str(entry.get("unit")): str(entry.get("why")) for entry in run.entries("unit_dropped")}
    means = {unit.name: _mean_biases(unit) for unit in units}
    pairs = [pair for each in means.values() for pair in each]
    scale = BiasScale.of([mean for mean, _ in pairs], [sigma for _, sigma in pairs])
    rows = []
    for unit in units:
        cells = [scale.with_sigma(*pair) for pair in means[unit.name]] or ["–"] * len(AXES)
        flagged = sum(bool(row.flags) for row in unit.dwells)
        dwells = f"{len(unit.dwells)}" + (f", {flagged} flagged" if flagged else "")
        verdict = unit.acceptance.verdict if unit.acceptance else "not judged"
        rows.append([unit.name, "dropped" if unit.name in drop_reasons else verdict, dwells, *cells])
    header = ["unit", "verdict", "dwells", *map(gyro_label, AXES)]
    caption = (
        f"Mean bias over the dwells without flags with its standard uncertainty, {scale.unit}; it includes "
        "the change with temperature. The bins are in the report of each unit."
    )
    marks: list[Mark] = ["bad" if unit.name in drop_reasons else "" for unit in units]
    reasons = [f"Unit {unit_name} was dropped: {reason}" for unit_name, reason in drop_reasons.items()]
    table = SectionTable(caption, header, rows, words=2, marks=marks)
    return Section("Units", paragraphs=reasons, tables=[table])


def _mean_biases(unit: RunContent) -> list[tuple[float, float]]:
    """Mean bias of each gyro over the unflagged dwells, its standard uncertainty, deg/h; empty without any.

    Errors that are the same in all dwells of an attitude average out over the positions alone.
    """
    rows = [row for row in unit.dwells if not row.flags]
    if not rows:
        return []
    biases_dph = np.array([row.bias_dph for row in rows])
    noise_dph, common_dph = noise_and_common(rows)
    scatter_dph = biases_dph.std(axis=0, ddof=1) if len(rows) > 1 else noise_dph[0]
    variances = np.maximum(scatter_dph**2, (noise_dph**2).mean(axis=0)) / len(rows)
    variances += (common_dph**2).mean(axis=0) / len({row.position for row in rows})
    return list(zip(biases_dph.mean(axis=0).tolist(), np.sqrt(variances).tolist(), strict=True))
