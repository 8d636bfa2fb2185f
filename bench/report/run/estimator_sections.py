"""What the report says of the estimators: how they differ, and whether the data fit the model."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gyrobench.bench.bias.dwell_table import DwellRow, paper_rows
from gyrobench.bench.foundations.text import counted
from gyrobench.bench.navigation.positions import AXES, gyro_label, position_label
from gyrobench.bench.report.figures.estimators import differences_dph, estimators_figure, with_both
from gyrobench.bench.report.figures.fit import fit_figure, has_distribution
from gyrobench.bench.report.findings import SIGNIFICANCE, fit_sentence
from gyrobench.bench.report.page.sections import Section, SectionFigure, SectionTable
from gyrobench.bench.report.wording import NO_PAPER, BiasScale

_STATE_SPACE = (
    "Biases are those of the state-space estimator: it fits the full error model of an INS at rest, "
    "with Schuler loop, Earth rate, accelerometer biases and initial errors, to velocity and heading of"
    " a whole dwell. Its uncertainty holds the noise and what is not known of unit and bench."
)
_PAPER = (
    "What the paper's method makes of the same data stands beside them in grey: quadratic fits of the "
    "velocities and slopes of the heading, before and after a turn of 180 deg. Its uncertainty is that "
    "of the noise alone."
)
_UNKNOWN = "The dwell table does not tell by which estimator these biases were measured."
_LEAKS = (
    "The paper's method leaves out that the errors of an INS are coupled. Over windows of ten minutes "
    "it reads a level bias 8 to 17 % wrong, because the Schuler loop feeds velocity back into tilt; up "
    "to 20 % of one axis leaks into another, because the Earth's rotation couples them; and 10 µg of "
    "accelerometer bias pass for up to 0.001 deg/h. In each position the same bias leaks differently, "
    "so a difference between positions that only the paper's method finds may be its own. The "
    "state-space estimator has all this in its model."
)
_DIFFERENCES = (
    "The paper's bias less the state-space one, dwell by dwell. Bars are the uncertainties of both "
    "combined; as both come from the same data, noise alone keeps them closer together than that. "
    "Points beyond their bars are what the paper's method leaves out."
)
_FIT = (
    "In each dwell the residuals of velocity and heading, summed minute by minute, are compared with "
    "the noise: a wrong model leaves residuals that are slow, and these add up."
)
_FIT_SIZES = "Size of the residuals of each dwell, 1 where model and noise are true."
_FIT_P_VALUES = (
    f"Left: {_FIT_SIZES[0].lower()}{_FIT_SIZES[1:]} Right: share of the dwells whose p-value is below a "
    "value; the straight line where model and noise are true, the grey band what chance makes of it in "
    f"{100 * (1 - SIGNIFICANCE):.0f} of 100 runs."
)


def estimators_note(rows: Sequence[DwellRow]) -> str:
    """Say by which estimator the biases of the report are."""
    if paper_rows(rows):
        return f"{_STATE_SPACE} {_PAPER}"
    if any(not math.isnan(row.fit_p_value) for row in rows):
        return f"{_STATE_SPACE} {NO_PAPER}"
    return _UNKNOWN if rows else ""


def estimators_section(rows: Sequence[DwellRow]) -> Section | None:
    """Compare the estimators; None where no good dwell has both."""
    both = with_both(rows)
    if not both:
        return None
    # A single dwell has no course to draw: the table says it all.
    drawn = [SectionFigure("estimators", _DIFFERENCES, estimators_figure(both))] if len(both) > 1 else []
    return Section("The two estimators", [_LEAKS], drawn, [_difference_table(both)])


def fit_section(rows: Sequence[DwellRow]) -> Section | None:
    """Tell whether model and noise explain the data; None where no dwell was tested."""
    sentence = fit_sentence(rows)
    if not sentence:
        return None
    caption = _FIT_P_VALUES if has_distribution(rows) else _FIT_SIZES
    return Section(
        "Does the model explain the data?",
        [_FIT, sentence],
        [SectionFigure("fit", caption, fit_figure(rows))],
    )


def _difference_table(rows: Sequence[DwellRow]) -> SectionTable:
    pairs = [differences_dph(row) for row in rows]
    scale = BiasScale.of(*zip(*(pair for three in pairs for pair in three), strict=True))
    cells = []
    for axis, gyro in enumerate(AXES):
        own = [three[axis] for three in pairs]
        rms_dph = math.sqrt(sum(difference**2 for difference, _ in own) / len(own))
        largest, row = max(zip(own, rows, strict=True), key=lambda each: abs(each[0][0]))
        where = f"{position_label(row.position)}, {row.gyro_c[axis]:.0f} °C, dwell {row.dwell}"
        cells.append([gyro_label(gyro), where, scale.text(rms_dph), scale.with_sigma(*largest)])
    return SectionTable(
        f"The paper's bias less the state-space one in {scale.unit}, over {counted(len(rows), 'dwell')}",
        ["gyro", "largest in", "rms", "largest ± combined uncertainty"],
        cells,
        words=2,
    )
