"""The proof of a compensation as parts of a report."""

from __future__ import annotations

from gyrobench.bench.report.page import Section, SectionFigure, SectionTable
from gyrobench.bench.report.verification import wording
from gyrobench.bench.report.verification.figures import day_figure, leftovers_figure
from gyrobench.bench.report.verification.rows import SIZES, UNITS, stop_rows, total_rows
from gyrobench.bench.verification.comparison import Comparison

_LEFTOVERS = (
    "What each compensation leaves at each stop of the chamber. The black lines are what the noise alone "
    "would show."
)
_DAY = (
    "Distance from the true position over a day at rest, of a rotational INS with the biases measured at "
    "each temperature. The black line is the largest distance that the noise of the measurement alone would "
    "show."
)
_TOTAL = "Over all stops: rms of bias and varying bias, and the largest of the rest; {}"
_STOPS = (
    "By mean temperature of the gyros in °C; fit: whether the model was fitted there, between fitted "
    "temperatures, or outside them; {}"
)


def verify_sections(comparison: Comparison) -> list[Section]:
    """What was loaded, what is left with each compensation, and how to read it."""
    totals = SectionTable(_TOTAL.format(UNITS), ["compensation", *SIZES], total_rows(comparison))
    stops = SectionTable(
        _STOPS.format(UNITS), ["°C", "cycle", "fit", "compensation", *SIZES], stop_rows(comparison), words=4
    )
    left = [sentence for _, sentence in wording.chain(comparison)]
    return [
        Section("What was loaded", wording.model_sentences(comparison.closure, comparison.models)),
        Section(
            "What is left",
            left,
            [SectionFigure("leftovers", _LEFTOVERS, leftovers_figure(comparison))],
            [totals, stops],
        ),
        Section("A day of a rotational INS", figures=[SectionFigure("day", _DAY, day_figure(comparison))]),
        Section("How to read the numbers", wording.reading_sentences(comparison)),
    ]
