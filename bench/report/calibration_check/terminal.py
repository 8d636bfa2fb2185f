"""The verification of a calibration for a terminal of 80 columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple

from rich import box
from rich.console import Group, JustifyMethod, RenderableType
from rich.table import Table
from rich.text import Text

from gyrobench.bench.report.calibration_check.section import (
    accelerometer_sentence,
    flag_lines,
    verification_lines,
    verification_scale,
    verification_sentence,
)
from gyrobench.bench.runs.tables.verification_table import VerificationRow

_HEADERS = ("position", "gyro", "seen in", "°C", "bias", "slope", "calibrated", "diff")
_WORDS = 3
_LEGEND = (
    "slope: by the second slope of the velocity East alone. diff: bias less calibrated one in standard "
    "uncertainties of both; * chance does not explain it. Changes from power-on to power-on are in no "
    "uncertainty."
)


def verification_table(rows: Sequence[VerificationRow]) -> RenderableType:
    """Biases that a verification shows beside the calibrated ones, and what that says."""
    if not rows:
        return Text("Nothing was verified.")
    # Not the table's title: rich would fold that to the width of the table.
    unit = verification_scale(rows).unit
    heading = Text(f"Verification: bias ± 1 sigma in {unit} by gyro temperature, °C", style="bold")
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=0)
    for number, header in enumerate(_HEADERS):
        is_word = number < _WORDS
        justify: JustifyMethod = "left" if is_word else "right"
        table.add_column(header, justify=justify, no_wrap=is_word, min_width=len(header))
    for line in verification_lines(rows):
        table.add_row(*(Text(cell.replace(" ± ", " ±")) for cell in astuple(line)))
    flags = [f"{where}: {what}" for where, what in flag_lines(rows)]
    sentences = [verification_sentence(rows), accelerometer_sentence(rows), *flags, _LEGEND]
    return Group(heading, table, *(Text(one) for one in sentences if one))
