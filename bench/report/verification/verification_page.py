"""The page of a verification (verification.html) with its figures, and its section of the report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gyrobench.bench.calibration.coefficients import COEFFICIENTS
from gyrobench.bench.calibration.mission import HOURS
from gyrobench.bench.closure.loadable_model import LoadableModel
from gyrobench.bench.closure.outcome import Closure
from gyrobench.bench.foundations.files import file_sha256
from gyrobench.bench.foundations.text import agreeing, counted, hours_minutes, listed, plain_name
from gyrobench.bench.report.closure.closure_text import searched_name, verdict_sentence
from gyrobench.bench.report.figures.style import common_legend, house_style, new_figure, say_empty
from gyrobench.bench.report.page import Box, Findings, Section, SectionFigure, SectionTable, write_findings
from gyrobench.bench.report.verification.verification_text import (
    CONFIRMED,
    IMPROVED,
    INCONCLUSIVE,
    LABELS,
    NOT_CONFIRMED,
    change_sentences,
    model_sentences,
    number_rows,
    outcome,
    outcome_sentence,
    plateau_rows,
    reading_sentences,
    size_heads,
    size_units,
    total_rows,
    with_text,
)
from gyrobench.bench.runs.provenance import watermark_of
from gyrobench.bench.verification.compensation_verification import (
    DECLARED,
    EFFECT,
    IN_WORDS,
    NONE,
    VerificationResult,
    VerificationRow,
)

#: Colour and line of each compensation.
_STYLES = {NONE: ("#AAAAAA", ":"), DECLARED: ("#E69F00", "--"), EFFECT: ("#0072B2", "-")}
_NOISE_COLOUR = "#222222"
_GROUP_WIDTH = 0.8
#: More labels of plateaus than these stand on end.
_MAX_UPRIGHT = 4
_Panel = tuple[str, str, str, str, float]
_PANELS: tuple[_Panel, ...] = (
    ("bias without the gyros' means", "rms / (0.001 deg/h)", "varying_rms_dph", "bias_noise_dph", 1000.0),
    ("spread between positions", "maximum / (0.001 deg/h)", "spread_dph", "spread_noise_dph", 1000.0),
    ("velocity error East", "maximum / (mm/s)", "velocity_east_mps", "velocity_noise_mps", 1000.0),
    ("rotational INS in 24 h", "maximum error / nmi", "position_nmi", "position_noise_nmi", 1.0),
)


@house_style
def residual_bars_figure(result: VerificationResult) -> Figure:
    """Draw the sizes at all plateaus as bars, one for each compensation, with the noise as a line."""
    panels = _measured_panels(result)
    rows, columns = -(-len(panels) // 2), min(len(panels), 2)
    figure = new_figure(0.2 + 2.7 * rows, wspace=0.24, hspace=0.42)
    every = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in every[len(panels) :]:
        axes.set_axis_off()
    for axes, (title, unit, size, noise, factor) in zip(every, panels, strict=False):
        _bars(axes, result, size, noise, factor)
        axes.set_title(title, fontsize=9)
        axes.set_ylabel(unit)
    common_legend(figure, figure.axes[:1])
    return figure


def _measured_panels(result: VerificationResult) -> list[_Panel]:
    """The sizes that were measured; the first one if none was."""
    rows = [row for each in result.results for row in each.rows]
    return [each for each in _PANELS if any(math.isfinite(getattr(row, each[2])) for row in rows)] or [
        _PANELS[0]
    ]


def _has_day(result: VerificationResult) -> bool:
    return any(plateau.day for each in result.results for plateau in each.plateaus)


@house_style
def day_figure(result: VerificationResult) -> Figure:
    """Draw the position error over a day for each plateau with all six positions, of which there is one."""
    plateaus = [each for each in result.plateaus if any(check and check.day for check in each.checks)]
    figure = new_figure(1.0 + 1.7 * len(plateaus), hspace=0.2)
    panels = figure.subplots(len(plateaus), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for axes, plateau in zip(panels, plateaus, strict=True):
        for each, check in zip(result.results, plateau.checks, strict=True):
            colour, line = _STYLES[each.compensation]
            error = check.day.error if check is not None and check.day is not None else None
            # A run that lacks the day has an empty line, which keeps the order of the legend.
            axes.plot(
                [] if error is None else error.time_s / 3600.0,
                [] if error is None else error.distance_nmi,
                color=colour,
                linestyle=line,
                label=LABELS[each.compensation],
            )
        noise_nmi = plateau.noise_row("position_nmi").position_noise_nmi
        axes.axhline(noise_nmi, color=_NOISE_COLOUR, linewidth=0.8, label="noise")
        axes.set_title(f"{plateau.known[0].gyro_c:.0f} °C", fontsize=9)
        axes.set_ylabel("distance / nmi")
    panels[-1].set_xlabel("time / h")
    panels[-1].set_xlim(0.0, 24.0)
    panels[-1].set_xticks(np.arange(0, 25, 4))
    panels[-1].set_ylim(bottom=0.0)
    common_legend(figure, panels)
    return figure


def _bars(axes: Axes, result: VerificationResult, size: str, noise: str, factor: float) -> None:
    plateaus = [
        each for each in result.plateaus if any(math.isfinite(getattr(row, size)) for row in each.known)
    ]
    if not plateaus:
        say_empty(axes, "not measured")
        return
    places = np.arange(len(plateaus))
    width = _GROUP_WIDTH / len(result.results)
    for number, each in enumerate(result.results):
        mine = [plateau.rows[number] for plateau in plateaus]
        # Without a value there is no bar: one of height NaN is not drawn.
        values = [math.nan if row is None else factor * getattr(row, size) for row in mine]
        offset = (number - 0.5 * (len(result.results) - 1)) * width
        axes.bar(
            places + offset,
            values,
            0.92 * width,
            color=_STYLES[each.compensation][0],
            label=LABELS[each.compensation],
        )
    noises = [factor * getattr(plateau.noise_row(size), noise) for plateau in plateaus]
    rows = [plateau.known[0] for plateau in plateaus]
    axes.hlines(
        noises,
        places - 0.5 * _GROUP_WIDTH,
        places + 0.5 * _GROUP_WIDTH,
        color=_NOISE_COLOUR,
        linewidth=1.2,
        label="noise",
    )
    if len(rows) > _MAX_UPRIGHT:
        axes.set_xticks(places, _plateau_labels(rows, ""), rotation=90, fontsize=6.5)
    else:
        axes.set_xticks(places, _plateau_labels(rows, " °C"), fontsize=8)
    axes.set_ylim(bottom=0.0)
    axes.grid(visible=False, axis="x")


def _plateau_labels(rows: Sequence[VerificationRow], unit: str) -> list[str]:
    """Temperature, and in brackets the cycle if there are several."""
    several = len({row.cycle for row in rows}) > 1
    return [f"{row.gyro_c:z.0f}{unit}" + (f" ({row.cycle})" if several else "") for row in rows]


_RESIDUALS = (
    "Residual with each compensation at each plateau: gyro temperature in °C, in brackets the cycle where "
    "there are several. The black lines are the noise."
)
_DAY = (
    "Position error over a day at rest of a rotational INS with the biases measured at each temperature. The "
    "black line is the largest error expected from the measurement noise alone."
)
_TOTAL = "All plateaus: rms of bias and varying bias, otherwise the maximum; {}"
_TOTAL_OF_SOME = (
    "All plateaus: rms of bias and varying bias over the dwells that are valid in all runs, otherwise the "
    "maximum over the plateaus with a value in all runs; {}"
)
_NUMBERS = (
    "Numbers of the compensation and their standard uncertainties, by gyro, as in compensation.yaml. Those "
    "of one gyro are correlated: the uncertainty of what is subtracted is stated under Residual."
)
_PLATEAUS = (
    "By mean gyro temperature in °C; fit: whether the model was fitted at the temperature, between fitted "
    "temperatures, or outside them; {}"
)


_MARKERS = {NONE: "o", DECLARED: "s", EFFECT: "D"}
_SHORT = {"gyro": "gyro", "accelerometer": "acc."}
_UNITS = tuple(dict.fromkeys(each.unit for each in COEFFICIENTS))
_COEFFICIENTS_CAPTION = (
    "Rms of each coefficient over the plateaus with each compensation, and of the standard uncertainty of "
    "the measurement (lines). The body frame is that of the accelerometers."
)
_MISSION_CAPTION = (
    "Distance from the true position with the coefficients left at the plateau where it is largest after a "
    "day. Dashed: by their uncertainty 95 % of all missions stay below, up to 1, 8 and 24 h."
)
_SCHEME = (
    "The mission is a mechanisation of the increments of a dual-axis rotational INS at rest: sixteen half "
    "turns at 10 deg/s between rests of 3 min, of which the last eight retrace the first eight; fixed "
    "altitude, a start without error, and coefficients constant at those of one plateau. What is not "
    "observable counts as zero. Position errors are the largest up to the time stated, at the plateau where "
    "that is largest."
)


def _mission_sentence(result: VerificationResult) -> str:
    """Position error after each time, with each compensation."""
    times = listed([f"{hours:g}" for hours in HOURS])
    errors = [
        f"{', '.join(map(_nmi, each.worst.error.stated_nmi))} nmi {with_text(each)}"
        for each in result.coefficients
    ]
    high = ", ".join(map(_nmi, result.coefficients[-1].worst.error.high_nmi))
    return (
        f"A mission with the coefficients left errs by up to ({times} h): {'; '.join(errors)}. By the "
        f"uncertainty of the last, 95 % of all are below {high} nmi."
    )


def _nmi(distance_nmi: float) -> str:
    return f"{distance_nmi:.2g}" if distance_nmi < 1.0 else f"{distance_nmi:.1f}"


def _coefficient_table(result: VerificationResult) -> SectionTable:
    results = result.coefficients
    head = ["coefficient", "unit", *(LABELS[each.compensation] for each in results), "noise"]
    rows = []
    for place, known in enumerate(COEFFICIENTS):
        sizes = [*(each.rms[place] for each in results), results[-1].noise[place]]
        texts = ["not observable" if np.isnan(size) else f"{size:.3g}" for size in sizes]
        rows.append([f"{plain_name(known.name)} {known.axis}", known.unit, *texts])
    return SectionTable("Rms over the plateaus", head, rows, words=2)


def _mission_table(result: VerificationResult) -> SectionTable:
    rows = [
        [
            LABELS[each.compensation],
            f"{each.worst.gyro_c:z.0f}",
            *(
                f"{_nmi(stated)} (< {_nmi(high)})"
                for stated, high in zip(each.worst.error.stated_nmi, each.worst.error.high_nmi, strict=True)
            ),
        ]
        for each in result.coefficients
    ]
    head = ["compensation", "°C", *(f"{hours:g} h" for hours in HOURS)]
    return SectionTable("Position error in nmi, in brackets the limit of 95 %", head, rows)


@house_style
def _coefficient_figure(result: VerificationResult) -> Figure:
    """Draw the rms of each coefficient with each compensation, by unit, on logarithmic scales."""
    figure = new_figure(5.2, bottom_in=0.6, top_in=0.1, wspace=0.22, hspace=0.45)
    panels = figure.subplots(2, 2).ravel()
    for axes, unit in zip(panels, _UNITS, strict=True):
        mine = [place for place, each in enumerate(COEFFICIENTS) if each.unit == unit]
        names = [f"{_SHORT[COEFFICIENTS[place].sensor]} {COEFFICIENTS[place].axis}" for place in mine]
        factor, label = (1000.0, f"0.001 {unit}") if unit == "deg/h" else (1.0, unit)
        for each in result.coefficients:
            axes.plot(
                names,
                factor * each.rms[mine],
                linestyle="none",
                marker=_MARKERS[each.compensation],
                markersize=4,
                color=_STYLES[each.compensation][0],
                label=LABELS[each.compensation],
            )
        places = np.arange(len(mine))
        noise = factor * result.coefficients[-1].noise[mine]
        axes.hlines(noise, places - 0.35, places + 0.35, color=_NOISE_COLOUR, linewidth=1.2, label="noise")
        axes.set_yscale("log")
        low, high = axes.get_ylim()
        axes.set_ylim(10.0 ** np.floor(np.log10(low)), 10.0 ** np.ceil(np.log10(high)))
        axes.set_xticks(places, names, rotation=90 if len(mine) > 3 else 0, fontsize=7)
        axes.set_ylabel(f"rms / ({label})")
    common_legend(figure, panels[:1])
    return figure


@house_style
def _mission_figure(result: VerificationResult) -> Figure:
    """Draw the position error over a day with each compensation, and the limit of 95 %."""
    figure = new_figure(3.2)
    axes = figure.subplots()
    for each in result.coefficients:
        error = each.worst.error
        colour, label = _STYLES[each.compensation][0], LABELS[each.compensation]
        axes.plot(error.time_s / 3600.0, error.distance_nmi, color=colour, linewidth=1.0, label=label)
        ends = [0.0, *HOURS]
        high = [error.high_nmi[0], *error.high_nmi]
        axes.step(
            ends, high, where="pre", color=colour, linewidth=0.8, linestyle="--", label=f"{label}, 95 %"
        )
    axes.set(xlabel="time / h", ylabel="distance / nmi", xlim=(0.0, HOURS[-1]), yscale="log")
    axes.set_xticks(np.arange(0, 25, 4))
    axes.set_ylim(
        bottom=max(1e-4, 0.03 * min(float(each.worst.error.high_nmi[0]) for each in result.coefficients))
    )
    common_legend(figure, [axes])
    return figure


def _coefficient_parts(result: VerificationResult) -> list[Section]:
    """Sections of the page; none where no coefficients were compensated."""
    if not result.coefficients:
        return []
    return [
        Section(
            "All coefficients",
            figures=[
                SectionFigure("coefficients", _COEFFICIENTS_CAPTION, partial(_coefficient_figure, result))
            ],
            tables=[_coefficient_table(result)],
        ),
        Section(
            "A mission of a rotational INS",
            [_mission_sentence(result), _SCHEME],
            [SectionFigure("mission", _MISSION_CAPTION, partial(_mission_figure, result))],
            [_mission_table(result)],
        ),
    ]


def verification_sections(result: VerificationResult) -> list[Section]:
    """Compensations, residual, a day of a rotational INS, definitions."""
    units, heads = size_units(result), size_heads(result)
    total = _TOTAL if result.is_complete or len(result.results) < 2 else _TOTAL_OF_SOME
    totals = SectionTable(total.format(units), ["compensation", *heads], total_rows(result))
    plateaus = SectionTable(
        _PLATEAUS.format(units), ["°C", "cycle", "fit", "compensation", *heads], plateau_rows(result), words=4
    )
    numbers = SectionTable(_NUMBERS, ["number", "x", "y", "z"], number_rows(result.models))
    figures = [SectionFigure("residuals", _RESIDUALS, partial(residual_bars_figure, result))]
    day = SectionFigure("day", _DAY, partial(day_figure, result))
    return [
        Section(
            "Compensations", model_sentences(result.closure, result.models, result.searches), tables=[numbers]
        ),
        Section("Residual", change_sentences(result), figures, [totals, plateaus]),
        *([Section("A day of a rotational INS", figures=[day])] if _has_day(result) else []),
        *_coefficient_parts(result),
        Section("Definitions", reading_sentences(result)),
    ]


#: Colours of the template's box, by judgement.
_COLOURS = {CONFIRMED: "finished", IMPROVED: "stopped", NOT_CONFIRMED: "failed", INCONCLUSIVE: "stopped"}


def verification_findings(result: VerificationResult) -> Findings:
    """Judgement, facts and all sections, with at least one compensation measured."""
    judgement = outcome(result)
    return Findings(
        title="Verification of a compensation",
        source=result.source,
        judgement=judgement,
        colour=_COLOURS[judgement],
        sentence=outcome_sentence(result),
        facts=_facts(result),
        sections=verification_sections(result),
    )


def write_verification_page(folder: Path, result: VerificationResult, dwells: Path | None = None) -> Path:
    """Write figures and page into an existing folder.

    ``dwells`` is the table that the model was fitted to: the report of its run includes only a page with its
    hash. Raises RunFolderError if a file can't be written.
    """
    findings = replace(
        verification_findings(result),
        dwells_sha256=file_sha256(dwells) if dwells else "",
        watermark=watermark_of(folder, *(Path(each.name) for each in result.closure.campaign.tables)),
    )
    return write_findings(folder / "verification.html", findings)


def _facts(result: VerificationResult) -> dict[str, str]:
    closure = result.closure
    measured = [with_text(each) for each in result.results]
    others = {f"search, {searched_name(each)}": _verdict(each) for each in result.searches}
    return {
        f"search, {searched_name(closure)}" if others else "search": _verdict(closure),
        **others,
        "compensations": f"{counted(len(measured), 'run')}: {listed(measured)}",
        "dwells": f"{result.dwells} per run, at {counted(len(result.plateaus), 'plateau')}",
    }


def _verdict(closure: Closure) -> str:
    return f"{closure.verdict}. {verdict_sentence(closure)}"


def verification_plan(
    closure: Closure,
    models: Mapping[str, LoadableModel],
    missing: Sequence[str],
    run_s: float,
    searches: Sequence[Closure] = (),
) -> Section:
    """Verdict of the search, compensations, and duration of the remaining runs.

    ``searches``: of other coefficients.
    """
    sentences = model_sentences(closure, models, searches)
    if missing:
        total = f", {hours_minutes(len(missing) * run_s)} h in total" if missing[1:] else ""
        verb, names = agreeing(len(missing), "remains", "remain"), [IN_WORDS[name] for name in missing]
        sentences.append(
            f"{counted(len(missing), 'run')} of {hours_minutes(run_s)} h {verb}{total}: {listed(names)}."
        )
    else:
        sentences.append("All runs are complete.")
    boxes = [
        Box(
            "open",
            f"{f'{searched_name(each)}: ' if searches else ''}{each.verdict}.".capitalize(),
            verdict_sentence(each),
        )
        for each in (closure, *searches)
    ]
    return Section("", boxes=boxes, paragraphs=sentences)
