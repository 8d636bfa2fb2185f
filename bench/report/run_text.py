"""Sentences about the results of a run, the same in report and terminal."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from statistics import median
from types import MappingProxyType

from gyrobench.bench.bias.bins import BiasBin, PositionComparison, disconnected_bins
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.statistics import uniformity_p_value
from gyrobench.bench.bias.verdicts import Acceptance, JudgedQuantity, RunVerdict
from gyrobench.bench.foundations.text import counted, listed, plural
from gyrobench.bench.navigation.positions import AXES, gyro_label, position_label
from gyrobench.bench.report.number_format import dph_with_sigma, p_phrase, size_text, temperature_ranges

#: Sentence for a gyro without positions to compare.
NOTHING_TO_COMPARE = "Nothing to compare: no temperature bin has dwells in two positions of one power cycle."

#: Significance level of the differences between positions, for each gyro.
POSITION_SIGNIFICANCE = 0.01

_DATA_EXPLAINED = "Error model and noise explain the data."
_UNCERTAINTY_TOO_SMALL = (
    "The noise is larger than assumed, or the error model lacks an effect; the uncertainties are too small."
)
_UNCERTAINTY_TOO_LARGE = "The noise is smaller than assumed; the uncertainties are too large."


def significant_differences(comparisons: Iterable[PositionComparison]) -> list[PositionComparison]:
    """Comparisons with a significant difference, corrected for the bins of the gyro (Bonferroni)."""
    comparisons = list(comparisons)
    gyros = [each.gyro for each in comparisons]
    return [each for each in comparisons if each.p_value < POSITION_SIGNIFICANCE / gyros.count(each.gyro)]


def position_comparison_sentence(comparisons: Sequence[PositionComparison]) -> str:
    """Result of the comparisons of one gyro."""
    if not comparisons:
        return NOTHING_TO_COMPARE
    count = len(comparisons)
    corrected = f"corrected for {count} comparisons" if count > 1 else "one comparison"
    different = significant_differences(comparisons)
    if not different:
        ranges = temperature_ranges(comparisons)
        return (
            f"No significant difference between positions from {ranges} (no p < {POSITION_SIGNIFICANCE:g}, "
            f"{corrected})."
        )
    largest = max(different, key=lambda each: each.largest_difference_dph)
    high, low = map(position_label, largest.largest_pair)
    difference = dph_with_sigma(largest.largest_difference_dph, largest.largest_difference_sigma_dph)
    return (
        f"The bias differs between positions in {len(different)} of {count} bins: from "
        f"{temperature_ranges(different)} (p < {POSITION_SIGNIFICANCE:g}, {corrected}). Largest difference "
        f"from {temperature_ranges([largest])}: {high} above {low} by {difference} (k = 1)."
    )


def power_cycle_sentence(bins: Iterable[BiasBin]) -> str:
    """Temperatures at which positions of different power cycles are not compared; empty if none."""
    bins_not_compared = disconnected_bins(bins)
    if not bins_not_compared:
        return ""
    return (
        f"From {temperature_ranges(bins_not_compared)} several power cycles measured different positions. "
        "Only positions of the same power cycle are compared there."
    )


def scatter_sentence(bins: Iterable[BiasBin]) -> str:
    """Bins in which dwells of one position scatter more than their uncertainties; empty if none."""
    tested = [each for each in bins if each.count > 1]
    scattered = [each for each in tested if each.spread_p_value < POSITION_SIGNIFICANCE / len(tested)]
    if not scattered:
        return ""
    names = ", ".join(f"{position_label(each.position)} {temperature_ranges([each])}" for each in scattered)
    return (
        "Dwells of the same position and bin scatter more than their uncertainties explain; the "
        f"uncertainty of the mean and the p-value are too small at {names}."
    )


def paper_agreement_sentence(
    comparisons: Sequence[PositionComparison], by_paper: Sequence[PositionComparison]
) -> str:
    """Whether the paper's method finds differences in the same bins; empty without its results."""
    if not by_paper:
        return ""
    state_space = {each.bin_low_c: each for each in significant_differences(comparisons)}
    paper = {each.bin_low_c: each for each in significant_differences(by_paper)}
    only_paper = [each for low, each in paper.items() if low not in state_space]
    only_state_space = [each for low, each in state_space.items() if low not in paper]
    if not only_paper and not only_state_space:
        return "The paper's method agrees."
    parts = [f"it also finds a difference from {temperature_ranges(only_paper)}"] if only_paper else []
    parts += [f"it finds none from {temperature_ranges(only_state_space)}"] if only_state_space else []
    return f"The paper's method disagrees: {', and '.join(parts)}."


def fit_sentence(rows: Iterable[DwellRow]) -> str:
    """Whether error model and noise explain the data of the dwells; empty if no dwell was tested."""
    tested = [row for row in rows if not math.isnan(row.fit_p_value)]
    if not tested:
        return ""
    p_values = [row.fit_p_value for row in tested]
    p_uniform = uniformity_p_value(p_values)
    if p_uniform < POSITION_SIGNIFICANCE:
        description, verdict = (
            ("too small", _UNCERTAINTY_TOO_SMALL)
            if median(p_values) < 0.5
            else ("too large", _UNCERTAINTY_TOO_LARGE)
        )
    else:
        description, verdict = "as expected", f"{_DATA_EXPLAINED}{_outlier_sentence(tested)}"
    ratios = [row.fit_ratio for row in tested]
    if len(tested) == 1:
        description = f"{ratios[0]:.2f} times as large as expected ({p_phrase(p_values[0])})"
        return f"Residuals of the only dwell tested are {description}. {verdict}"
    return (
        f"Residuals of {len(tested)} dwells are {min(ratios):.2f} to {max(ratios):.2f} times as large as "
        f"expected, median {median(ratios):.2f}; their p-values are {description} (Kolmogorov-Smirnov "
        f"{p_phrase(p_uniform)}). {verdict}"
    )


def _outlier_sentence(rows: Sequence[DwellRow]) -> str:
    outliers = [row for row in rows if row.fit_p_value < POSITION_SIGNIFICANCE / len(rows)]
    if not outliers:
        return ""
    dwells = f"dwell{'s' if len(outliers) > 1 else ''} {listed([str(row.dwell) for row in outliers])}"
    smallest = min(row.fit_p_value for row in outliers)
    return f" Outlying: {dwells} (smallest {p_phrase(smallest)})."


#: Colours of the template's box, by verdict.
VERDICT_COLOURS: Mapping[RunVerdict, str] = MappingProxyType(
    {"accepted": "finished", "marginal": "stopped", "rejected": "failed", "not judged": "open"}
)
_NO_LIMITS = "The procedure has no acceptance limits."
_NO_COMPARABLE_DWELLS = "No plateau has good dwells in two positions."
_NO_VERDICT = "The uncertainty is too large for a verdict. {}."
_CYCLES_ADVICE = "{:.0f} cycles in one run, instead of {}, give one if the differences stay as measured"
_COMMON_ERRORS_ADVICE = (
    "More cycles do not decide, because {} deg/h of it are the same in all of them: reduce its largest "
    "contributions in budget.csv"
)
_MAX_ADVISED_CYCLES = 20
_NOT_COMPARED = (
    "{} not compared with the others of the plateau, so the unit can't be accepted. Measure all positions of "
    "{} again in one power cycle."
)
_UNCONNECTED = (
    "No plateau compares {}, so the unit can't be accepted. Measure a position of each group on one plateau."
)
_MAX_NAMED_PLATEAUS = 3
#: A limit this many times what the data allow, or smaller than their uncertainty, has probably another unit.
#: One of the bias itself may be loose, as a rotational INS averages a constant bias out.
_MAX_LIMIT_RATIO, _MAX_BIAS_LIMIT_RATIO = 100.0, 1000.0
_LIMIT_NAMES: Mapping[JudgedQuantity, str] = MappingProxyType(
    {
        "position difference": "differences between positions",
        "vertical difference": "differences between a gyro's axis up and down",
        "bias": "biases",
    }
)


def acceptance_sentence(acceptance: Acceptance) -> str:
    """Reason for the verdict on the unit, and limits that seem to be in a wrong unit."""
    return " ".join([_verdict_sentence(acceptance), *_limits_in_doubt(acceptance)])


def _limits_in_doubt(acceptance: Acceptance) -> Iterator[str]:
    """Sentences on limits far beyond the values measured or far below their uncertainties."""
    for quantity, name in _LIMIT_NAMES.items():
        judged = [each for each in acceptance.judgements if each.quantity == quantity]
        if not judged:
            continue
        limit_dph = judged[0].limit_dph
        at_most_dph = max(each.at_most_dph for each in judged)
        sigma_dph = min(each.sigma_dph for each in judged)
        max_ratio = _MAX_BIAS_LIMIT_RATIO if quantity == "bias" else _MAX_LIMIT_RATIO
        if limit_dph > max_ratio * at_most_dph > 0.0:
            yield (
                f"The limit of {limit_dph:g} deg/h for {name} is {limit_dph / at_most_dph:.0f} times the "
                f"largest value that the data allow, {size_text(at_most_dph)} deg/h. Check its unit, deg/h."
            )
        elif sigma_dph > _MAX_LIMIT_RATIO * limit_dph:
            yield (
                f"The limit of {limit_dph:g} deg/h for {name} is {sigma_dph / limit_dph:.0f} times smaller "
                f"than the smallest uncertainty, {size_text(sigma_dph)} deg/h: no unit can pass. Check its "
                "unit, deg/h."
            )


def _verdict_sentence(acceptance: Acceptance) -> str:
    if acceptance.limits is None:
        return _NO_LIMITS
    decisive = {"rejected": "fail", "marginal": "marginal"}.get(acceptance.verdict)
    limit = _limits_text(acceptance, decisive)
    with_confidence = f"with {100.0 * acceptance.limits.confidence:g} % confidence"
    match acceptance.verdict:
        case "accepted":
            bins = {(each.bin_low_c, each.bin_high_c) for each in acceptance.judgements}
            plateaus = f"{counted(acceptance.plateaus, 'plateau')} in {counted(len(bins), 'temperature bin')}"
            return f"All gyros are within {limit} at {plateaus}, {with_confidence}."
        case "rejected":
            return f"{_gyros_with_verdict(acceptance, 'fail')} beyond {limit}, {with_confidence}."
        case "marginal":
            advice = _NO_VERDICT.format(_measurement_advice(acceptance))
            return f"{_gyros_with_verdict(acceptance, 'marginal')} near {limit}. {advice}"
    if acceptance.judgements and acceptance.not_measured:
        return _not_measured_sentence(acceptance)
    if acceptance.judgements and acceptance.unconnected:
        groups = (" and ".join(map(position_label, group)) for group in acceptance.unconnected)
        return _UNCONNECTED.format(" with ".join(groups))
    return _NO_COMPARABLE_DWELLS


def _measurement_advice(acceptance: Acceptance) -> str:
    marginal = [each for each in acceptance.judgements if each.verdict == "marginal"]
    slowest = max(marginal, key=lambda each: each.cycles_to_decide)
    if slowest.is_limited_by_common_errors:
        return _COMMON_ERRORS_ADVICE.format(size_text(slowest.common_sigma_dph))
    if slowest.cycles_to_decide > _MAX_ADVISED_CYCLES:
        return "Measure more cycles"
    return _CYCLES_ADVICE.format(slowest.cycles_to_decide, slowest.passes)


def _limits_text(acceptance: Acceptance, verdict: str | None) -> str:
    """Limits of the procedure; with a verdict those for which a judgement has it."""
    limits = acceptance.limits
    if limits is None:
        return ""
    named = {each.quantity for each in acceptance.judgements if verdict in (None, each.verdict)}
    between, vertical = limits.position_difference_dph, limits.vertical_difference_dph
    texts = [f"{between:g} deg/h between positions"] if "position difference" in named else []
    if vertical is not None and "vertical difference" in named:
        vertical_text = "with the gyro up and down"
        texts = (
            [f"{texts[0]} ({vertical:g} {vertical_text})"]
            if texts
            else [f"{vertical:g} deg/h {vertical_text}"]
        )
    if limits.bias_dph is not None and "bias" in named:
        texts.append(f"{limits.bias_dph:g} deg/h for the bias")
    return f"the limit of {' or that of '.join(texts)}"


def _not_measured_sentence(acceptance: Acceptance) -> str:
    dwells = acceptance.dwells_not_measured
    plateaus = list(dict.fromkeys((cycle, set_c) for cycle, set_c, _ in dwells))
    plateau_names = [
        f"cycle {cycle}" + ("" if set_c is None else f" at {set_c:zg} °C in the chamber")
        for cycle, set_c in plateaus[:_MAX_NAMED_PLATEAUS]
    ]
    if unnamed := len(plateaus) - len(plateau_names):
        plateau_names.append(counted(unnamed, "other plateau"))
    verb = plural(len(dwells), "was", "were")
    return _NOT_COMPARED.format(f"{counted(len(dwells), 'planned dwell')} {verb}", listed(plateau_names))


def _gyros_with_verdict(acceptance: Acceptance, verdict: str) -> str:
    names = [gyro_label(gyro) for gyro in AXES if acceptance.gyros.get(gyro) == verdict]
    return f"{listed(names)} {'is' if len(names) == 1 else 'are'}"
