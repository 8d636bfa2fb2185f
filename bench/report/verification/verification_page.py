"""The page of a verification (verification.html) with its figures, and its section of the report."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gyrobench.bench.foundations.files import file_sha256
from gyrobench.bench.foundations.text import counted, listed
from gyrobench.bench.report.closure.closure_text import verdict_sentence
from gyrobench.bench.report.figures.style import common_legend, house_style, new_figure, say_empty
from gyrobench.bench.report.page import Findings, Section, SectionFigure, SectionTable, write_findings
from gyrobench.bench.report.verification.coefficient_sections import coefficient_parts
from gyrobench.bench.report.verification.verification_text import (
    CONFIRMED,
    IMPROVED,
    INCONCLUSIVE,
    LABELS,
    NOT_CONFIRMED,
    SIZES,
    UNITS,
    chain,
    model_sentences,
    number_rows,
    outcome,
    outcome_sentence,
    plateau_rows,
    reading_sentences,
    total_rows,
)
from gyrobench.bench.runs.provenance import watermark_of
from gyrobench.bench.verification.compensation_verification import (
    DECLARED,
    EFFECT,
    NONE,
    VerificationResult,
    VerificationRow,
)

#: Colour and line of each compensation.
STYLES = {NONE: ("#AAAAAA", ":"), DECLARED: ("#E69F00", "--"), EFFECT: ("#0072B2", "-")}
_NOISE_COLOUR = "#222222"
_GROUP_WIDTH = 0.8
_PANELS = (
    ("bias without the gyros' means", "rms / (0.001 deg/h)", "varying_rms_dph", "bias_noise_dph", 1000.0),
    ("spread between positions", "maximum / (0.001 deg/h)", "spread_dph", "spread_noise_dph", 1000.0),
    ("velocity error East", "maximum / (mm/s)", "velocity_east_mps", "velocity_noise_mps", 1000.0),
    ("rotational INS in 24 h", "maximum error / nmi", "position_nmi", "position_noise_nmi", 1.0),
)


@house_style
def residual_bars_figure(result: VerificationResult) -> Figure:
    """Draw the sizes at all plateaus as bars, one for each compensation, with the noise as a line."""
    figure = new_figure(5.6, wspace=0.24, hspace=0.42)
    for axes, (title, unit, size, noise, factor) in zip(figure.subplots(2, 2).ravel(), _PANELS, strict=True):
        _bars(axes, result, size, noise, factor)
        axes.set_title(title, fontsize=9)
        axes.set_ylabel(unit)
    common_legend(figure, figure.axes[:1])
    return figure


@house_style
def day_figure(result: VerificationResult) -> Figure:
    """Draw the position error over a day for each plateau with all six positions."""
    plateaus = [
        (rows, days)
        for rows, days in zip(
            zip(*(each.rows for each in result.results), strict=False),
            zip(*((plateau.day for plateau in each.plateaus) for each in result.results), strict=False),
            strict=True,
        )
        if any(days)
    ]
    figure = new_figure(1.0 + 1.7 * max(len(plateaus), 1), hspace=0.2)
    panels = figure.subplots(max(len(plateaus), 1), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    if not plateaus:
        say_empty(panels[0], "no plateau with all six positions")
        return figure
    for axes, (rows, days) in zip(panels, plateaus, strict=True):
        for row, day in zip(rows, days, strict=True):
            if day is not None:
                colour, line = STYLES[row.compensation]
                axes.plot(
                    day.error.time_s / 3600.0,
                    day.error.distance_nmi,
                    color=colour,
                    linestyle=line,
                    label=LABELS[row.compensation],
                )
        axes.axhline(rows[-1].position_noise_nmi, color=_NOISE_COLOUR, linewidth=0.8, label="noise")
        axes.set_title(f"{rows[0].gyro_c:.0f} °C", fontsize=9)
        axes.set_ylabel("distance / nmi")
    panels[-1].set_xlabel("time / h")
    panels[-1].set_xlim(0.0, 24.0)
    panels[-1].set_xticks(np.arange(0, 25, 4))
    panels[-1].set_ylim(bottom=0.0)
    common_legend(figure, panels[:1])
    return figure


def _bars(axes: Axes, result: VerificationResult, size: str, noise: str, factor: float) -> None:
    rows = [row for row in result.results[0].rows if not math.isnan(getattr(row, size))]
    shown = [row.plateau for row in rows]
    if not rows:
        say_empty(axes, "not measured")
        return
    places = np.arange(len(rows))
    width = _GROUP_WIDTH / len(result.results)
    for number, each in enumerate(result.results):
        values = [factor * getattr(row, size) for row in each.rows if row.plateau in shown]
        offset = (number - 0.5 * (len(result.results) - 1)) * width
        axes.bar(
            places[: len(values)] + offset,
            values,
            0.92 * width,
            color=STYLES[each.compensation][0],
            label=LABELS[each.compensation],
        )
    noises = [factor * getattr(row, noise) for row in rows]
    axes.hlines(
        noises,
        places - 0.5 * _GROUP_WIDTH,
        places + 0.5 * _GROUP_WIDTH,
        color=_NOISE_COLOUR,
        linewidth=1.2,
        label="noise",
    )
    axes.set_xticks(places, _plateau_labels(rows))
    axes.set_ylim(bottom=0.0)
    axes.grid(visible=False, axis="x")


def _plateau_labels(rows: Sequence[VerificationRow]) -> list[str]:
    """Temperature, and the cycle if there are several."""
    several = len({row.cycle for row in rows}) > 1
    return [f"{row.gyro_c:.0f} °C" + (f"\ncycle {row.cycle}" if several else "") for row in rows]


_RESIDUALS = "Residual with each compensation at each plateau. The black lines are the noise."
_DAY = (
    "Position error over a day at rest of a rotational INS with the biases measured at each temperature. The "
    "black line is the largest error expected from the measurement noise alone."
)
_TOTAL = "All plateaus: rms of bias and varying bias, otherwise the maximum; {}"
_NUMBERS = (
    "Numbers of the compensation and their standard uncertainties, by gyro, as in compensation.yaml. Those "
    "of one gyro are correlated: the uncertainty of what is subtracted is stated under Residual."
)
_PLATEAUS = (
    "By mean gyro temperature in °C; fit: whether the model was fitted at the temperature, between fitted "
    "temperatures, or outside them; {}"
)


def verification_sections(result: VerificationResult) -> list[Section]:
    """Compensations, residual, a day of a rotational INS, definitions."""
    totals = SectionTable(_TOTAL.format(UNITS), ["compensation", *SIZES], total_rows(result))
    plateaus = SectionTable(
        _PLATEAUS.format(UNITS), ["°C", "cycle", "fit", "compensation", *SIZES], plateau_rows(result), words=4
    )
    numbers = SectionTable(_NUMBERS, ["number", "x", "y", "z"], number_rows(result.models))
    figures = [SectionFigure("residuals", _RESIDUALS, partial(residual_bars_figure, result))]
    return [
        Section("Compensations", model_sentences(result.closure, result.models), tables=[numbers]),
        Section("Residual", [sentence for _, sentence in chain(result)], figures, [totals, plateaus]),
        Section(
            "A day of a rotational INS", figures=[SectionFigure("day", _DAY, partial(day_figure, result))]
        ),
        *coefficient_parts(result),
        Section("Definitions", reading_sentences(result)),
    ]


#: Colours of the template's box, by judgement.
_COLOURS = {CONFIRMED: "finished", IMPROVED: "stopped", NOT_CONFIRMED: "failed", INCONCLUSIVE: "stopped"}


def write_verification_page(folder: Path, result: VerificationResult, dwells: Path | None = None) -> Path:
    """Write figures and page into an existing folder, with at least one compensation measured.

    ``dwells`` is the table that the model was fitted to: the report of its run includes only a page with its
    hash. Raises RunFolderError if a file can't be written.
    """
    judgement = outcome(result)
    findings = Findings(
        title="Verification of a compensation",
        source=result.source,
        judgement=judgement,
        colour=_COLOURS[judgement],
        sentence=outcome_sentence(result),
        facts=_facts(result),
        sections=verification_sections(result),
        dwells_sha256=file_sha256(dwells) if dwells else "",
        watermark=watermark_of(folder, *(Path(each.name) for each in result.closure.campaign.tables)),
    )
    return write_findings(folder / "verification.html", findings)


def _facts(result: VerificationResult) -> dict[str, str]:
    closure = result.closure
    measured = [LABELS[each.compensation] for each in result.results]
    return {
        "search": f"{closure.verdict}. {verdict_sentence(closure)}",
        "compensations": f"{counted(len(measured), 'run')}: {listed(measured)}",
        "dwells": f"{result.dwells} per run, at {counted(len(result.results[0].rows), 'plateau')}",
    }
