"""Results of characteristic tests in the report of a run."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from gyrobench.bench.characteristics.results import Coefficient, TestName, TestResult
from gyrobench.bench.report.figures.characteristics import characteristics_figure
from gyrobench.bench.report.page import Section, SectionFigure, SectionTable

_TITLES: dict[TestName, str] = {
    "turn_on_repeatability": "Turn-on repeatability",
    "warm_up": "Warm-up",
    "thermal_sensitivity": "Thermal sensitivities",
    "allan_variance": "Allan variance",
    "scale_factor_stability": "Scale-factor stability",
}
_TEXTS: dict[TestName, str] = {
    "turn_on_repeatability": "Scatter of each gyro's bias from power cycle to power cycle, beyond the "
    "uncertainty of its measurement. The interval is exact for normally distributed biases.",
    "warm_up": "Bias after power-on: a constant and one or two exponentials, fitted to the dwells.",
    "thermal_sensitivity": "Bias against the gyro's temperature, its rate of change, and whether it came "
    "from below or above, fitted together. Hysteresis: bias after cooling less bias after heating. What lags "
    "behind the temperature in proportion to its rate, as a gradient does, is in the ramp sensitivity.",
    "allan_variance": "Noise of each gyro in a long navigation at rest, from the rates that attitude and "
    "velocity of the INS imply. The intervals are those of chi-squared with effective degrees of freedom.",
    "scale_factor_stability": "Scale factor of each gyro by whole turns, dwell after dwell: a drift within "
    "each power cycle, and the scatter beyond the uncertainty of the measurement. Asymmetry (positive less "
    "negative direction) and nonlinearity (one rate less all rates) are means over all dwells; "
    "the worst rate counts.",
}
_HEADER = ("coefficient", "gyro", "unit", "value", "95 % interval")
_DIGITS = 3
#: Numbers from here on are written with an exponent.
_MIN_WITH_EXPONENT = 1e6


def characteristics_sections(results: Sequence[TestResult]) -> list[Section]:
    """One section for each test."""
    return [_test_section(result) for result in results]


def _test_section(result: TestResult) -> Section:
    title = _TITLES[result.test]
    caption = f"{title}: measured values with standard uncertainties, and the fit."
    draw = partial(characteristics_figure, result.test, result.curves)
    return Section(
        title,
        [_TEXTS[result.test], *result.notes],
        [SectionFigure(result.test, caption, draw)] if result.curves else [],
        [SectionTable("Coefficients", _HEADER, _coefficient_rows(result), words=3)]
        if result.coefficients
        else [],
    )


def _coefficient_rows(result: TestResult) -> list[list[str]]:
    """One row for each gyro and coefficient, sorted by coefficient."""
    order = list(dict.fromkeys((each.name, each.unit) for each in result.coefficients))
    ordered = sorted(result.coefficients, key=lambda each: order.index((each.name, each.unit)))
    return [
        [each.name, each.gyro.upper(), each.unit, _number_text(each.value), _interval_text(each)]
        for each in ordered
    ]


def _number_text(value: float | None) -> str:
    if value is None:
        return "not determined"
    text = f"{value:.{_DIGITS}g}"
    return f"{float(text):.0f}" if "e+" in text and abs(value) < _MIN_WITH_EXPONENT else text


def _interval_text(coefficient: Coefficient) -> str:
    low, high = _number_text(coefficient.low), _number_text(coefficient.high)
    if coefficient.low is None or coefficient.low == 0.0:
        return "" if coefficient.high is None else f"below {high}"
    return f"above {low}" if coefficient.high is None else f"{low} to {high}"
