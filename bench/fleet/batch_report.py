"""Report on a batch of units: ``batch.json``, page, tables and figures, and terminal text."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gyrobench.bench.fleet.batch import EffectSize, QuantityStatistics, UnitStatistics, outliers
from gyrobench.bench.foundations.files import make_folder, write_whole
from gyrobench.bench.foundations.text import bin_label, counted, listed
from gyrobench.bench.navigation.positions import AXES, gyro_label, position_label
from gyrobench.bench.report.figures.style import BARS, common_legend, fitted_figure, house_style, label_empty
from gyrobench.bench.report.number_format import BiasScale, dph_with_sigma, p_text
from gyrobench.bench.report.page import Box, Findings, Section, SectionFigure, SectionTable, write_findings
from gyrobench.bench.runs.index.run_biases import FALSE_ALARM, LEVEL, BiasQuantity


def _batch_sentence(batch: Sequence[QuantityStatistics]) -> str:
    """Sentence that names the outlying units."""
    comparisons = sum(len(stats.units) for stats in batch)
    corrected = f"p < {FALSE_ALARM:g}, corrected for {counted(comparisons, 'comparison')}"
    pairs = outliers(batch)
    if not pairs:
        return f"No outlying unit ({corrected})."
    texts = []
    for name in dict.fromkeys(unit.unit for _, unit in pairs):
        unit_pairs = [(stats, unit) for stats, unit in pairs if unit.unit == name]
        stats, unit = unit_pairs[0]
        difference = unit.bias_dph - unit.expected_dph
        others = len(unit_pairs) - 1
        more = f", and in {others} other {'quantity' if others == 1 else 'quantities'}" if others else ""
        deviation = dph_with_sigma(difference, unit.expected_sigma_dph)
        texts.append(
            f"unit {name} in {stats.quantity.label} ({deviation} from the prediction by the other units)"
            f"{more}"
        )
    sentence = listed(texts)
    return f"{counted(len(texts), 'outlying unit').capitalize()}: {sentence} ({corrected})."


def _outlier_table(batch: Sequence[QuantityStatistics]) -> SectionTable:
    scale = _batch_scale(batch)
    rows = [
        [
            unit.unit,
            str(unit.runs),
            stats.quantity.label,
            scale.with_sigma(unit.bias_dph, unit.sigma_dph),
            scale.with_sigma(unit.expected_dph, unit.expected_sigma_dph),
            p_text(unit.p_adjusted),
        ]
        for stats, unit in outliers(batch)
    ]
    caption = (
        f"Measured and predicted from the other units ± standard uncertainty, {scale.unit}. p corrected: "
        "p-value of the difference, corrected for all units and quantities"
    )
    header = ("unit", "runs", "quantity", "measured", "predicted", "p corrected")
    return SectionTable(caption, header, rows, words=3)


def _spread_table(batch: Sequence[QuantityStatistics]) -> SectionTable:
    scale = _batch_scale(batch)
    rows = [
        [
            stats.quantity.label,
            str(len(stats.units)),
            scale.with_sigma(stats.mean_dph, stats.mean_sigma_dph),
            scale.text(stats.between_units.value),
            f"{scale.text(stats.between_units.low)}..{scale.text(stats.between_units.high)}",
            "" if stats.between_runs_dph is None else scale.text(stats.between_runs_dph),
        ]
        for stats in batch
    ]
    caption = (
        "Mean ± standard uncertainty, and standard deviations between units (with its interval) and between "
        f"runs, both without noise, in {scale.unit}"
    )
    header = ("quantity", "units", "mean", "between units", "95 % interval", "between runs")
    return SectionTable(caption, header, rows)


def _unit_rows(stats: QuantityStatistics) -> list[list[str]]:
    """One row for each unit in one quantity: measured, shrunken, p."""
    scale = _batch_scale([stats])
    return [
        [
            unit.unit,
            str(unit.runs),
            scale.with_sigma(unit.bias_dph, unit.sigma_dph),
            scale.with_sigma(unit.shrunken_dph, unit.shrunken_sigma_dph),
            p_text(unit.p_value),
            p_text(unit.p_adjusted),
        ]
        for unit in stats.units
    ]


def _batch_scale(batch: Sequence[QuantityStatistics]) -> BiasScale:
    """Choose the unit and the number of decimals for a batch."""
    units: list[UnitStatistics] = [unit for stats in batch for unit in stats.units]
    return BiasScale.of(
        [unit.bias_dph for unit in units], [stats.mean_sigma_dph for stats in batch if stats.mean_sigma_dph]
    )


def _levels(batch: Sequence[QuantityStatistics]) -> list[QuantityStatistics]:
    """Quantities that are levels of gyros or sizes of effects."""
    return [
        stats for stats in batch if isinstance(stats.quantity, EffectSize) or stats.quantity.name == LEVEL
    ]


_COLOURS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_OTHER_COLOUR = "#444444"
_BAND_WIDTH = 0.62
#: Font size of the labels of positions, and space for them, points.
_POSITION_PT, _POSITION_SPACE_PT = 6.0, 32.0


@house_style
def batch_figure(batch: Sequence[QuantityStatistics], *, of_positions: bool) -> Figure:
    """Draw levels or position differences: a panel for each gyro, a band for each bin or position."""
    figure = fitted_figure(9.2 if of_positions else 7.6)
    panels = figure.subplots(len(AXES), 1, sharex=False)
    outlier_names = list(dict.fromkeys(unit.unit for _, unit in outliers(batch)))[: len(_COLOURS)]
    colours = dict(zip(outlier_names, _COLOURS, strict=False))
    scale = _batch_scale(batch)
    for gyro, panel in zip(AXES, panels, strict=True):
        panel_stats = [
            stats
            for stats in batch
            if not isinstance(stats.quantity, EffectSize)
            and stats.quantity.gyro == gyro
            and (stats.quantity.name != LEVEL) == of_positions
        ]
        for index, stats in enumerate(panel_stats):
            _draw_band(panel, index, stats, scale, colours)
        panel.set_title(gyro_label(gyro))
        panel.set_ylabel(f"{'difference' if of_positions else 'bias'} / ({scale.unit})")
        panel.grid(visible=False, axis="x")
        if panel_stats:
            _label(
                panel, [stats.quantity for stats in panel_stats if isinstance(stats.quantity, BiasQuantity)]
            )
        else:
            label_empty(panel, "measured on too few units")
    panels[-1].set_xlabel("temperature of the gyro, bin / °C")
    if outlier_names:
        panels[-1].plot([], [], "D", color=_OTHER_COLOUR, markersize=5.5, label="outlier")
    common_legend(figure, panels, "upper center", ncols=5, title=BARS)
    return figure


def _label(panel: Axes, quantities: Sequence[BiasQuantity]) -> None:
    """Label the bands with their bins, centred on those of a bin, and above with positions."""
    names = [each.name for each in quantities]
    bins = [(each.bin_low_c, each.bin_high_c) for each in quantities]
    middles = {
        limits: np.mean([index for index, bin_limits in enumerate(bins) if bin_limits == limits])
        for limits in bins
    }
    panel.set_xticks(list(middles.values()), [bin_label(*limits, "..") for limits in middles], fontsize=8)
    if LEVEL not in names:
        labels = list(map(position_label, names))
        panel.set_xticks(range(len(labels)), labels, minor=True, rotation=90, fontsize=_POSITION_PT)
        panel.tick_params("x", which="major", length=0, pad=_POSITION_SPACE_PT)


def _draw_band(
    panel: Axes, position: int, stats: QuantityStatistics, scale: BiasScale, colours: dict[str, str]
) -> None:
    centre, spread = scale.factor * stats.mean_dph, scale.factor * stats.between_units.value
    ends = [position - 0.5 * _BAND_WIDTH - 0.08, position + 0.5 * _BAND_WIDTH + 0.08]
    is_first = position == 0
    for factor, alpha in ((2.0, 0.16), (1.0, 0.3)):
        label = f"mean ± {factor:g} SD" if is_first else None
        panel.fill_between(
            ends,
            centre - factor * spread,
            centre + factor * spread,
            color="#5a656d",
            alpha=alpha,
            lw=0,
            label=label,
        )
    panel.plot(
        ends, [centre, centre], color="#1d2429", lw=1.2, label="mean of the batch" if is_first else None
    )
    x = position + np.linspace(-0.5, 0.5, len(stats.units)) * _BAND_WIDTH
    groups: dict[tuple[str, bool], list[int]] = {}
    for index, unit in enumerate(stats.units):
        groups.setdefault((unit.unit if unit.unit in colours else "", unit.is_outlier), []).append(index)
    for (name, is_outlier), indices in groups.items():
        panel.errorbar(
            x[indices],
            [scale.factor * stats.units[index].bias_dph for index in indices],
            [scale.factor * stats.units[index].sigma_dph for index in indices],
            fmt="D" if is_outlier else "o",
            markersize=5.5 if is_outlier else 2.8,
            color=colours.get(name, _OTHER_COLOUR),
            elinewidth=0.8,
            label=f"unit {name}" if name else None,
        )


_BAND_CAPTION = (
    "Line: mean of the batch; bands: one and two standard deviations between units, without noise. Points: "
    "units with standard uncertainties; diamonds: outliers."
)


def batch_document(name: str, batch: Sequence[QuantityStatistics], watermark: str) -> dict[str, Any]:
    """Content of ``batch.json``; ``watermark`` is the word across the page, if a run was emulated."""
    return {
        "batch": name,
        "simulated": bool(watermark),
        "standing_out": [
            {"unit": unit.unit, "in": stats.quantity.label, "p_adjusted": unit.p_adjusted}
            for stats, unit in outliers(batch)
        ],
        "quantities": [
            {
                "quantity": stats.quantity.label,
                **asdict(stats.quantity),
                "mean_dph": stats.mean_dph,
                "mean_sigma_dph": stats.mean_sigma_dph,
                "between_units_dph": stats.between_units.value,
                "between_units_95_dph": [
                    end if math.isfinite(end) else None
                    for end in (stats.between_units.low, stats.between_units.high)
                ],
                "between_runs_dph": stats.between_runs_dph,
                "units": [{**asdict(unit), "stands_out": unit.is_outlier} for unit in stats.units],
            }
            for stats in batch
        ],
    }


def write_batch(
    folder: Path, name: str, batch: Sequence[QuantityStatistics], source: str, watermark: str
) -> Path:
    """Write ``batch.json``, ``batch.html`` and figures to a folder, which is created if necessary.

    The name of the batch may be empty; the page, which is returned, shows the source. ``watermark`` is a
    word across page and figures.

    Raises RunFolderError if a file can't be written.
    """
    make_folder(folder)
    text = json.dumps(batch_document(name, batch, watermark), indent=1, allow_nan=False) + "\n"
    write_whole(folder / "batch.json", text.encode())
    units = {unit.unit for stats in batch for unit in stats.units}
    outlier_names = {unit.unit for _, unit in outliers(batch)}
    found = counted(len(outlier_names), "outlier") if outlier_names else "no outlier"
    findings = Findings(
        title=f"Batch {name}" if name else "Batch of units",
        source=source,
        judgement=f"{found} in {counted(len(units), 'unit')}",
        colour="stopped" if outlier_names else "finished",
        sentence=_batch_sentence(batch),
        facts={"units": ", ".join(sorted(units)), "quantities": str(len(batch))},
        sections=_sections(batch),
        watermark=watermark,
    )
    return write_findings(folder / "batch.html", findings)


def batch_summary(name: str, batch: Sequence[QuantityStatistics]) -> Section:
    """Section with outliers and the spread of the units, without figures."""
    box = Box("open", f"Batch {name}." if name else "", _batch_sentence(batch))
    return Section("", boxes=[box], sections=_spread_sections(batch))


def _spread_sections(batch: Sequence[QuantityStatistics]) -> list[Section]:
    sections = [Section("Outliers", tables=[_outlier_table(batch)])] if outliers(batch) else []
    return [*sections, Section("Spread between units", tables=[_spread_table(_levels(batch))])]


def _sections(batch: Sequence[QuantityStatistics]) -> list[Section]:
    sections = _spread_sections(batch)
    for of_positions, title, description in (
        (False, "Levels", "Mean bias of all positions by gyro temperature."),
        (True, "Differences between positions", "Bias of a position minus the mean of all positions."),
    ):
        figure = partial(batch_figure, batch, of_positions=of_positions)
        name = "batch_positions" if of_positions else "batch_levels"
        sections.append(
            Section(title, figures=[SectionFigure(name, f"{description} {_BAND_CAPTION}", figure)])
        )
    positions = [stats for stats in batch if stats not in _levels(batch)]
    sections.append(Section("Spread of the position differences", tables=[_spread_table(positions)]))
    header = ("unit", "runs", "mean of its runs", "shrunk to the batch", "p", "p corrected")
    tables = [
        SectionTable(f"{stats.quantity.label}, {_batch_scale([stats]).unit}", header, _unit_rows(stats))
        for stats in _levels(batch)
    ]
    sections.append(Section("Units", tables=tables))
    return sections
