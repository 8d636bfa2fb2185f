"""Formats numbers and words for messages and tables in the same way in every part of the bench."""

from __future__ import annotations

import difflib
import json
import math
import re
from collections.abc import Iterable, Sequence
from typing import Any

WRITE_POINT = "A number has a decimal point, not a comma"
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")
#: The unit ug as files and messages write it, and not as part of a name or path.
_ASCII_MICRO_G = re.compile(r"(?<![\w./-])ug(?![\w-])")
#: Smallest uncertainty that is written without a power of ten.
_MIN_SIGMA_WITHOUT_EXPONENT = 1e-5
_MAX_QUOTED_CHARACTERS = 60
#: Significant digits of a floating-point number.
_MAX_DIGITS = 15


def listed(texts: Sequence[str]) -> str:
    """Join texts to a list in a sentence: "a, b and c"."""
    return " and ".join([", ".join(texts[:-1]), texts[-1]] if len(texts) > 1 else texts)


def plain_name(name: str) -> str:
    """Write a key of a file as words: "thermal lag" for "thermal_lag"."""
    return name.replace("_", " ")


def capitalised(text: str) -> str:
    """Text as the start of a sentence; other capitals stay."""
    return f"{text[:1].upper()}{text[1:]}"


def counted(number: int, noun: str) -> str:
    """Write a number with its noun: "1 dwell", "2 dwells"."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def plural(number: int, singular: str, plural_form: str) -> str:
    """Return the form of a verb or noun for a number: ``singular`` for 1, else ``plural_form``."""
    return singular if number == 1 else plural_form


def hours_minutes(time_s: float) -> str:
    """Write a duration as h:mm, to the nearest minute."""
    minutes = round(time_s / 60.0)
    return f"{minutes // 60}:{minutes % 60:02d}"


def run_ending(ended: str, reason: str, *, with_reason: bool = True) -> str:
    """Write how a run ended: "was stopped by the operator (Ctrl-C)", "failed: the INS is silent".

    Without the reason: "was stopped by the operator (Ctrl-C)", "failed".
    """
    if reason.startswith("stopped by "):
        return f"was {reason}"
    return f"{ended}: {reason}" if reason and with_reason else ended


def of_units(numbers: Sequence[str], text: str) -> str:
    """Text with the numbers of the units that it is about; that of a single unit is empty, and not named."""
    return f"{plural(len(numbers), 'Unit', 'Units')} {listed(numbers)}: {text}" if numbers[0] else text


def with_micro_sign(text: str) -> str:
    """Text as people read it: the unit ug of files is written µg."""
    return _ASCII_MICRO_G.sub("µg", text) if "ug" in text else text


def bin_label(low_c: float, high_c: float, between: str = " to ") -> str:
    """Write the range of a bin, without its unit."""
    return f"{low_c:g}{between}{high_c:g}"


def format_number(value: float) -> str:
    """Write a number with nine significant digits, which reading and writing do not change; empty for NaN."""
    return "" if math.isnan(value) else f"{value:.9g}"


def decimals_of(sigma: float, max_decimals: int = 7) -> int:
    """Number of decimals for one digit of a standard uncertainty, or two if it begins with 1 or 2."""
    return min(max(-math.floor(math.log10(sigma / 3.0)), 0), max_decimals)


def with_sigma(value: float, sigma: float) -> str:
    """Write a value with its standard uncertainty: "1.52 ± 0.08"; the value alone if that is unknown.

    If the uncertainty is small, both have a common power of ten: "(-2.6 ± 3.0)e-8".
    """
    if not 0.0 < sigma < math.inf:
        return f"{value:.3g}"
    decimals = decimals_of(sigma)
    if sigma < _MIN_SIGMA_WITHOUT_EXPONENT:
        exponent = math.floor(math.log10(max(abs(value), sigma)))
        value, sigma = value / 10.0**exponent, sigma / 10.0**exponent
        decimals = decimals_of(sigma, _MAX_DIGITS)
        power = f"e{exponent}" if exponent else ""
        text = f"{value:z.{decimals}f} ± {sigma:.{decimals}f}"
        return f"({text}){power}" if power else text
    return f"{value:z.{decimals}f} ± {sigma:.{decimals}f}"


def with_expanded(value: float, expanded: float, more_digits: int = 0) -> str:
    """Write a value with its expanded uncertainty: "7.6 ± 3.4".

    The uncertainty has two digits (JCGM 100, 7.2.6): rounded to one, it may be stated 14 % too small.
    ``more_digits``: number of digits of the value beyond those of the uncertainty.
    """
    decimals = 1 - int(f"{expanded:.1e}".partition("e")[2])
    value_decimals = decimals + more_digits
    value_text = f"{round(value, value_decimals):z.{max(value_decimals, 0)}f}"
    return f"{value_text} ± {round(expanded, decimals):.{max(decimals, 0)}f}"


def probability_number(probability: float) -> str:
    """Write a probability, never rounded to 0 or 1: "0.62", "0.004", "> 0.999"."""
    if not 0.001 <= probability <= 0.999:
        return "> 0.999" if probability > 0.5 else "< 0.001"
    return f"{probability:.{2 if 0.1 <= probability <= 0.9 else 3}f}"


def flag_text(flags: Sequence[str]) -> str:
    """Join flags to one text, as in a table: "door opened; the INS left navigation".

    A semicolon within a flag becomes a comma, as semicolons separate the flags.
    """
    return "; ".join(flag.replace("; ", ", ") for flag in flags)


def format_cell(value: str | float | tuple[str, ...] | None) -> str:
    """Format a cell: numbers by :func:`format_number`, flags by :func:`flag_text`, None as an empty text."""
    if value is None:
        return ""
    if isinstance(value, tuple):
        return flag_text(value)
    return format_number(value) if isinstance(value, float) else str(value)


def did_you_mean(name: str, allowed: Iterable[str]) -> str:
    """Write " (did you mean 'x'?)" if one of the allowed names is similar; otherwise empty.

    Upper and lower case, hyphens and blanks make no difference: "Z-Up" is similar to "z_up".
    """
    names = {_comparable(each): each for each in allowed}
    close = difflib.get_close_matches(_comparable(name), list(names), n=1)
    return f" (did you mean '{names[close[0]]}'?)" if close else ""


def _comparable(name: str) -> str:
    return re.sub(r"[-\s]", "_", name.lower())


def quoted(key: str) -> str:
    """Write a key in single quotes; in double quotes, with escapes, if it has control characters."""
    return f"'{key}'" if key.isprintable() else json.dumps(key)


def excerpt(value: Any) -> str:
    """Write the beginning of a value as JSON, on one line."""
    text = json.dumps(value, default=str, ensure_ascii=False)
    text = text if text.isprintable() else json.dumps(value, default=str)
    return text if len(text) <= _MAX_QUOTED_CHARACTERS else f"{text[:_MAX_QUOTED_CHARACTERS]}..."


def has_decimal_comma(text: str) -> bool:
    """Whether a text is a number with a decimal comma."""
    return _DECIMAL_COMMA.fullmatch(text) is not None
