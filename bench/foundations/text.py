"""Small pieces of sentences that every part of the bench writes alike."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Sequence

WRITE_POINT = "A number has a decimal point, not a comma"
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")
#: Smallest uncertainty that is written without a power of ten: with one or two digits in five decimals.
_PLAIN_SIGMA = 1e-5
#: Digits of a floating-point number.
_MAX_DIGITS = 15


def listed(texts: Sequence[str]) -> str:
    """Write some things as one: "a, b and c"."""
    return " and ".join([", ".join(texts[:-1]), texts[-1]] if len(texts) > 1 else texts)


def plain_name(name: str) -> str:
    """A key of a file in words: "thermal lag" for "thermal_lag"."""
    return name.replace("_", " ")


def capitalised(text: str) -> str:
    """Text as the start of a sentence; other capitals stay."""
    return f"{text[:1].upper()}{text[1:]}"


def counted(number: int, noun: str) -> str:
    """Write how many: "1 dwell", "2 dwells"."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def agreeing(number: int, one: str, several: str) -> str:
    """Write the form of a verb or noun that agrees with a number: "is" of one, "are" of several."""
    return one if number == 1 else several


def hours_minutes(time_s: float) -> str:
    """Write a time as h:mm, to the nearest minute."""
    minutes = round(time_s / 60.0)
    return f"{minutes // 60}:{minutes % 60:02d}"


def run_ending(ended: str, reason: str, *, with_reason: bool = True) -> str:
    """Write how a run ended: "was stopped by the operator (Ctrl-C)", "failed: the INS is silent".

    Without the reason: "was stopped by the operator (Ctrl-C)", "failed".
    """
    if reason.startswith("stopped by "):
        return f"was {reason}"
    return f"{ended}: {reason}" if reason and with_reason else ended


def bin_label(low_c: float, high_c: float, between: str = " to ") -> str:
    """Write the range of a bin, without its unit."""
    return f"{low_c:g}{between}{high_c:g}"


def format_number(value: float) -> str:
    """Nine significant digits, which survive reading and writing again; empty for NaN."""
    return "" if math.isnan(value) else f"{value:.9g}"


def decimals_of(sigma: float, most: int = 7) -> int:
    """Decimals that show one digit of a standard uncertainty, or two if it begins with 1 or 2."""
    return min(max(-math.floor(math.log10(sigma / 3.0)), 0), most)


def with_sigma(value: float, sigma: float) -> str:
    """Write a value with its standard uncertainty: "1.52 ± 0.08"; the value alone if that is not known.

    Of small ones with a power of ten for both: "(-2.6 ± 3.0)e-8".
    """
    if not 0.0 < sigma < math.inf:
        return f"{value:.3g}"
    decimals = decimals_of(sigma)
    if sigma < _PLAIN_SIGMA:
        exponent = math.floor(math.log10(max(abs(value), sigma)))
        value, sigma = value / 10.0**exponent, sigma / 10.0**exponent
        decimals = decimals_of(sigma, _MAX_DIGITS)
        power = f"e{exponent}" if exponent else ""
        text = f"{value:z.{decimals}f} ± {sigma:.{decimals}f}"
        return f"({text}){power}" if power else text
    return f"{value:z.{decimals}f} ± {sigma:.{decimals}f}"


def probability_number(probability: float) -> str:
    """Write a probability, never rounded to 0 or 1: "0.62", "0.004", "> 0.999"."""
    if not 0.001 <= probability <= 0.999:
        return "> 0.999" if probability > 0.5 else "< 0.001"
    return f"{probability:.{2 if 0.1 <= probability <= 0.9 else 3}f}"


def flag_text(flags: Sequence[str]) -> str:
    """Flags as one text, as a table has them: "door opened; the INS left navigation".

    A semicolon within a flag becomes a comma, since semicolons separate them.
    """
    return "; ".join(flag.replace("; ", ", ") for flag in flags)


def format_cell(value: str | float | tuple[str, ...] | None) -> str:
    """A number by :func:`format_number`, flags by :func:`flag_text`, empty for None, else as it is."""
    if value is None:
        return ""
    if isinstance(value, tuple):
        return flag_text(value)
    return format_number(value) if isinstance(value, float) else str(value)


def did_you_mean(name: str, allowed: Iterable[str]) -> str:
    """Write " (did you mean 'x'?)" if one of the allowed names is near, else nothing."""
    close = difflib.get_close_matches(name, list(allowed), n=1)
    return f" (did you mean '{close[0]}'?)" if close else ""


def has_decimal_comma(text: str) -> bool:
    """Whether a text is a number but for the comma in it."""
    return _DECIMAL_COMMA.fullmatch(text) is not None
