"""Format of numbers with units and of p-values, the same in figures, report and terminal."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeVar

from gyrobench.bench.bias.bins import BiasBin, PositionComparison
from gyrobench.bench.foundations.text import bin_label, decimals_of, listed, with_sigma

_BinT = TypeVar("_BinT")

#: Names of the estimators.
STATE_SPACE, PAPER = "state-space estimator", "paper's method"
#: Reason for missing results of the paper's method.
NO_PAPER = "The paper's method needs two windows half a turn apart, so it does not apply to these dwells."

_MIN_STATED_P = 1e-9
_MIN_DECIMAL_P = 0.001
_LARGE_BIAS_DPH = 1.0
_MAX_DECIMALS = 4
_ROUNDS_TO_ALL_PERCENT, _ALL_PERCENT = 98.5, 100.0


@dataclass(frozen=True)
class BiasScale:
    """Unit and number of decimals for a set of biases."""

    factor: float  #: Factor from deg/h to the unit.
    unit: str
    #: Number of decimals: one digit of the smallest uncertainty, two if it begins with 1 or 2.
    decimals: int

    @classmethod
    def of(cls, bias_dph: Iterable[float], sigma_dph: Iterable[float]) -> BiasScale:
        """Choose unit and decimals for these biases and uncertainties; NaN are ignored."""
        largest = max((abs(value) for value in bias_dph if math.isfinite(value)), default=0.0)
        factor, unit = (1.0, "deg/h") if largest >= _LARGE_BIAS_DPH else (1000.0, "0.001 deg/h")
        smallest = min((value for value in sigma_dph if value > 0.0), default=1.0)
        return cls(factor, unit, decimals_of(smallest * factor, _MAX_DECIMALS))

    def text(self, value_dph: float) -> str:
        """Write a bias, without its unit."""
        return f"{value_dph * self.factor:z.{self.decimals}f}"

    def limit_text(self, value_dph: float) -> str:
        """Write a limit, without its unit, with at least as many decimals as its value has."""
        text, value = self.text(value_dph), round(value_dph * self.factor, 6)
        return text if float(text) == value else f"{value:g}"

    def with_sigma(self, value_dph: float, sigma_dph: float, between: str = " ± ") -> str:
        """Write a bias with its uncertainty, without their unit; empty for NaN."""
        return "" if math.isnan(value_dph) else f"{self.text(value_dph)}{between}{self.text(sigma_dph)}"


def scale_of_bins(bins: Iterable[BiasBin]) -> BiasScale:
    """Choose unit and decimals for the biases of some bins."""
    filled = [each for each in bins if not each.is_empty]
    return BiasScale.of([each.bias_dph for each in filled], [each.sigma_dph for each in filled])


def dph_with_sigma(value_dph: float, sigma_dph: float) -> str:
    """Write a bias with its uncertainty and unit, in deg/h."""
    return f"{with_sigma(value_dph, sigma_dph)} deg/h"


def p_text(p_value: float) -> str:
    """Write a p-value in at most seven characters; empty for NaN."""
    if math.isnan(p_value):
        return ""
    if p_value < _MIN_STATED_P:
        return f"<{_exponent_text(_MIN_STATED_P)}"
    return f"{p_value:.3f}" if p_value >= _MIN_DECIMAL_P else _exponent_text(p_value)


def p_in_brackets(p_value: float) -> str:
    """Write a p-value in brackets: " (p = 0.012)", " (p < 1e-9)"; empty for NaN."""
    return "" if math.isnan(p_value) else f" ({p_phrase(p_value)})"


def corrected_p(p_value: float, plateaus: int) -> str:
    """Write a p-value that is corrected for the number of plateaus, in brackets as :func:`p_in_brackets`."""
    return f" ({p_phrase(p_value)}{f', corrected for {plateaus} plateaus' if plateaus > 1 else ''})"


def p_phrase(p_value: float) -> str:
    """Write a p-value for a sentence: "p = 0.02", "p < 1e-9"."""
    text = p_text(p_value)
    return f"p < {text[1:]}" if text.startswith("<") else f"p = {text}"


def _exponent_text(value: float) -> str:
    """One digit and an exponent without leading zeros: "1e-9"."""
    return f"{value:.0e}".replace("e-0", "e-")


def size_text(size_dph: float) -> str:
    """Write a size with two significant digits, without an exponent: "0.0092"."""
    if not size_dph > 0.0:
        return "0"
    return f"{size_dph:.{max(1 - math.floor(math.log10(size_dph)), 1)}f}"


def share_text(share: float) -> str:
    """Write a share in percent, at most 100 %; a share below 1 is never rounded to 100 %."""
    percent = 100.0 * min(share, 1.0)
    is_nearly_all = _ROUNDS_TO_ALL_PERCENT <= percent < _ALL_PERCENT
    return f"{math.floor(percent * 10.0) / 10.0:.1f} %" if is_nearly_all else f"{percent:z.0f} %"


def bins_by_temperature(bins: Iterable[BiasBin]) -> list[tuple[float, float, list[BiasBin]]]:
    """Bins of one gyro grouped by temperature; see :func:`group_by_temperature`."""
    return group_by_temperature(
        bins, lambda each: (each.bin_low_c, each.bin_high_c), lambda each: not each.is_empty
    )


def group_by_temperature(
    bins: Iterable[_BinT], ends_c: Callable[[_BinT], tuple[float, float]], is_filled: Callable[[_BinT], bool]
) -> list[tuple[float, float, list[_BinT]]]:
    """Lower end, upper end and bins (one for each position) of each temperature range, the coldest first.

    ``bins``: those of one gyro. Adjacent ranges that are empty in all positions are merged into one without
    bins. ``ends_c`` returns the ends of a bin, ``is_filled`` whether it contains a measurement.
    """
    groups: dict[tuple[float, float], list[_BinT]] = {}
    for each in sorted(bins, key=ends_c):
        groups.setdefault(ends_c(each), []).append(each)
    result: list[tuple[float, float, list[_BinT]]] = []
    for (low, high), members in groups.items():
        if any(map(is_filled, members)):
            result.append((low, high, members))
        elif result and not result[-1][2]:
            result[-1] = (result[-1][0], high, [])
        else:
            result.append((low, high, []))
    return result


def temperature_ranges(bins: Iterable[BiasBin | PositionComparison]) -> str:
    """Write the temperature ranges of bins, adjacent ones merged: "-20 to 5 °C and 10 to 15 °C"."""
    ranges: list[tuple[float, float]] = []
    for low, high in sorted({(each.bin_low_c, each.bin_high_c) for each in bins}):
        if ranges and math.isclose(ranges[-1][1], low, abs_tol=1e-6):
            ranges[-1] = (ranges[-1][0], high)
        else:
            ranges.append((low, high))
    return listed([f"{bin_label(low, high)} °C" for low, high in ranges])


def range_text(values: Iterable[float], number_format: str) -> str:
    """Smallest and largest value, or one value if both have the same text."""
    ordered = sorted(values)
    return " to ".join(dict.fromkeys(format(each, number_format) for each in (ordered[0], ordered[-1])))


def true_minus(text: str) -> str:
    """Replace hyphens by minus signs."""
    return text.replace("-", "−")


_MAX_DECIMAL_POWER, _MAX_STATED_POWER = 3.0, 12.0


def odds_text(log_odds: float) -> str:
    """Write odds, given twice their logarithm: "20 to 1", "10^7 to 1", ">10^12 to 1"."""
    power = log_odds / (2.0 * math.log(10.0))
    if power < _MAX_DECIMAL_POWER:
        return f"{10.0**power:.0f} to 1"
    return f"10^{power:.0f} to 1" if power <= _MAX_STATED_POWER else f">10^{_MAX_STATED_POWER:.0f} to 1"
