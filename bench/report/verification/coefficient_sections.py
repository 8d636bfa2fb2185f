"""All coefficients in a verification: what is left of each, and the position error of a mission."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.figure import Figure

from gyrobench.bench.calibration.coefficients import COEFFICIENTS
from gyrobench.bench.calibration.mission import HOURS
from gyrobench.bench.foundations.text import listed, plain_name
from gyrobench.bench.report.figures.style import common_legend, house_style, new_figure
from gyrobench.bench.report.page import Section, SectionFigure, SectionTable
from gyrobench.bench.report.verification.verification_text import LABELS, with_text
from gyrobench.bench.verification.compensation_verification import DECLARED, EFFECT, NONE, VerificationResult

_COLOURS = {NONE: "#888888", DECLARED: "#E69F00", EFFECT: "#0072B2"}
_MARKERS = {NONE: "o", DECLARED: "s", EFFECT: "D"}
_SHORT = {"gyro": "gyro", "accelerometer": "acc."}
_NOISE_COLOUR = "#222222"
_UNITS = tuple(dict.fromkeys(each.unit for each in COEFFICIENTS))
_COEFFICIENTS = (
    "Rms of each coefficient over the plateaus with each compensation, and of the standard uncertainty of "
    "the measurement (lines). The body frame is that of the accelerometers."
)
_MISSION = (
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


def mission_sentence(result: VerificationResult) -> str:
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


def coefficient_table(result: VerificationResult) -> tuple[list[str], list[list[str]]]:
    """Head and rows of all coefficients; two columns of words."""
    results = result.coefficients
    head = ["coefficient", "unit", *(LABELS[each.compensation] for each in results), "noise"]
    rows = []
    for place, known in enumerate(COEFFICIENTS):
        sizes = [*(each.rms[place] for each in results), results[-1].noise[place]]
        texts = ["not observable" if np.isnan(size) else f"{size:.3g}" for size in sizes]
        rows.append([f"{plain_name(known.name)} {known.axis}", known.unit, *texts])
    return head, rows


def mission_table(result: VerificationResult) -> tuple[list[str], list[list[str]]]:
    """Head and rows of the missions, each with the limit of 95 %; one column of words."""
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
    return ["compensation", "°C", *(f"{hours:g} h" for hours in HOURS)], rows


@house_style
def coefficient_figure(result: VerificationResult) -> Figure:
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
                color=_COLOURS[each.compensation],
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
def mission_figure(result: VerificationResult) -> Figure:
    """Draw the position error over a day with each compensation, and the limit of 95 %."""
    figure = new_figure(3.2)
    axes = figure.subplots()
    for each in result.coefficients:
        error = each.worst.error
        colour, label = _COLOURS[each.compensation], LABELS[each.compensation]
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


def coefficient_parts(result: VerificationResult) -> list[Section]:
    """Sections of the page; none where no coefficients were compensated."""
    if not result.coefficients:
        return []
    return [
        Section(
            "All coefficients",
            figures=[SectionFigure("coefficients", _COEFFICIENTS, partial(coefficient_figure, result))],
            tables=[SectionTable("Rms over the plateaus", *coefficient_table(result), words=2)],
        ),
        Section(
            "A mission of a rotational INS",
            [mission_sentence(result), _SCHEME],
            [SectionFigure("mission", _MISSION, partial(mission_figure, result))],
            [
                SectionTable(
                    "Position error in nmi, in brackets the limit of 95 %", *mission_table(result), words=1
                )
            ],
        ),
    ]
