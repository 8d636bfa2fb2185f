"""What a batch's model says, as ``batch.json``, as a page with figures, and in a terminal of 80 columns."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Group, RenderableType
from rich.text import Text

from gyrobench.bench.fleet.batch_figure import batch_figure
from gyrobench.bench.fleet.batch_model import TraitInBatch, standing_out
from gyrobench.bench.fleet.batch_wording import (
    OUT_HEADER,
    SPREAD_HEADER,
    batch_scale,
    batch_sentence,
    levels,
    out_rows,
    spread_rows,
    unit_rows,
)
from gyrobench.bench.foundations.files import make_folder, write_whole
from gyrobench.bench.foundations.text import counted
from gyrobench.bench.report.page import Findings, Section, SectionFigure, SectionTable, write_findings
from gyrobench.bench.report.terminal.tables import plain_table

_BAND = (
    "The line is the batch's mean, the bands are one and two standard deviations of the units about it, with "
    "the noise taken off. Points are the units with their standard uncertainties; diamonds stand out."
)


def batch_document(name: str, batch: Sequence[TraitInBatch]) -> dict[str, Any]:
    """Content of ``batch.json``."""
    return {
        "batch": name,
        "standing_out": [
            {"unit": unit.unit, "in": trait.trait.label, "p_adjusted": unit.p_adjusted}
            for trait, unit in standing_out(batch)
        ],
        "quantities": [
            {
                "quantity": trait.trait.label,
                **asdict(trait.trait),
                "mean_dph": trait.mean_dph,
                "mean_sigma_dph": trait.mean_sigma_dph,
                "between_units_dph": trait.between_units.value,
                "between_units_95_dph": [
                    end if math.isfinite(end) else None
                    for end in (trait.between_units.low, trait.between_units.high)
                ],
                "between_runs_dph": trait.between_runs_dph,
                "units": [{**asdict(unit), "stands_out": unit.stands_out} for unit in trait.units],
            }
            for trait in batch
        ],
    }


def write_batch(folder: Path, name: str, batch: Sequence[TraitInBatch], source: str) -> Path:
    """Write ``batch.json``, ``batch.html`` and figures into a folder, made if it isn't there.

    Parameters
    ----------
    folder : Path
        Where to write.
    name : str
        Of the batch; may be empty.
    batch : sequence of TraitInBatch
        The model.
    source : str
        Which runs it is of, for people.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    RunFolderError
        A file can't be written.
    """
    make_folder(folder)
    text = json.dumps(batch_document(name, batch), indent=1, allow_nan=False) + "\n"
    write_whole(folder / "batch.json", text.encode())
    units = {unit.unit for trait in batch for unit in trait.units}
    out = {unit.unit for _, unit in standing_out(batch)}
    findings = Findings(
        title=f"Batch {name}" if name else "Batch of units",
        source=source,
        judgement=f"{counted(len(out), 'unit')} of {len(units)} {'stands' if len(out) == 1 else 'stand'} out"
        if out
        else f"{counted(len(units), 'unit')} alike",
        colour="stopped" if out else "finished",
        sentence=batch_sentence(batch),
        facts={"units": ", ".join(sorted(units)), "quantities": str(len(batch))},
        sections=_sections(batch),
    )
    return write_findings(folder / "batch.html", findings)


def batch_summary(name: str, batch: Sequence[TraitInBatch]) -> RenderableType:
    """Who stands out and in what, and how far the units spread."""
    scale = batch_scale(batch)
    title = f"Batch {name}. " if name else ""
    parts: list[RenderableType] = [Text(f"{title}{batch_sentence(batch)}", style="bold"), Text()]
    if standing_out(batch):
        parts += [_table(OUT_HEADER, out_rows(batch), 3), Text()]
    parts += [_table(SPREAD_HEADER, spread_rows(levels(batch)), 1), Text()]
    parts.append(
        Text(f"In {scale.unit}. Spread between units and between runs: standard deviations, noise off.")
    )
    return Group(*parts)


def _sections(batch: Sequence[TraitInBatch]) -> list[Section]:
    scale = batch_scale(batch)
    spread = SectionTable(
        f"What the units share and how far they spread, {scale.unit}; noise is taken off both "
        "spreads, and the interval is that of the spread between units",
        SPREAD_HEADER,
        spread_rows(levels(batch)),
    )
    sections = [Section("Spread of the units", tables=[spread])]
    if standing_out(batch):
        caption = (
            f"In what units stand out, {scale.unit}; beside their values what all other units lead to "
            "expect, with how far one may be from it. p all: probability of that distance by chance, "
            "allowing for all units and quantities"
        )
        out = SectionTable(caption, OUT_HEADER, out_rows(batch), words=3)
        sections.insert(0, Section("Standing out", tables=[out]))
    for of_positions, title, what in (
        (False, "Levels", "Mean bias over the positions, by temperature of the gyro."),
        (True, "Differences between positions", "Bias of a position less the mean of the positions."),
    ):
        figure = batch_figure(batch, of_positions=of_positions)
        name = "batch_positions" if of_positions else "batch_levels"
        sections.append(Section(title, figures=[SectionFigure(name, f"{what} {_BAND}", figure)]))
    positions = [trait for trait in batch if trait not in levels(batch)]
    sections.append(
        Section(
            "Spread of the differences",
            tables=[SectionTable(scale.unit, SPREAD_HEADER, spread_rows(positions))],
        )
    )
    header = ("unit", "runs", "mean of its runs", "as all units tell it", "p", "p all")
    tables = [
        SectionTable(f"{trait.trait.label}, {batch_scale([trait]).unit}", header, unit_rows(trait))
        for trait in levels(batch)
    ]
    sections.append(Section("Units", tables=tables))
    return sections


def _table(header: Sequence[str], rows: Sequence[Sequence[str]], words: int) -> RenderableType:
    table = plain_table(header, words)
    for row in rows:
        table.add_row(*map(Text, row))
    return table
