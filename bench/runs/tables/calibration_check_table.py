"""The table ``verification.csv``: one row for each bias that a calibration check measures."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from gyrobench.bench.foundations.csv_tables import CsvTable, format_rows, read_text, write_text
from gyrobench.bench.navigation.positions import AXES, POSITIONS

#: Ways to see a bias: in the heading after alignment, or in the velocity of a navigation after it.
METHODS = ("alignment", "velocity")


@dataclass(frozen=True)
class CalibrationCheckRow:
    """Bias of one gyro by a calibration check, beside the calibrated one."""

    #: unit, run: As in the dwell table.
    unit: str
    run: str
    #: dwell, turned_dwell: Number of the dwell; for two alignments that of the first, and of the one half a
    #: turn from it.
    dwell: int
    turned_dwell: int | None
    cycle: int  #: Which pass of the temperature profile.
    #: position, azimuth_deg: Key of :data:`gyrobench.bench.navigation.positions.POSITIONS`, and azimuth of
    #: the dwell.
    position: str
    azimuth_deg: float
    gyro: str  #: "x", "y" or "z".
    method: str  #: One of :data:`METHODS`.
    #: Mean of this gyro's optics over the alignments or the navigation; NaN where not measured.
    temperature_c: float = math.nan
    #: bias_dph, sigma_dph: Bias of the gyro and its standard uncertainty.
    bias_dph: float = math.nan
    sigma_dph: float = math.nan
    #: paper_bias_dph, paper_sigma_dph: The same by the second slope of the velocity East alone.
    paper_bias_dph: float = math.nan
    paper_sigma_dph: float = math.nan
    #: accelerometer_ug, accelerometer_sigma_ug: What was taken for the bias of the accelerometer along this
    #: gyro; both enter the biases.
    accelerometer_ug: float = math.nan
    accelerometer_sigma_ug: float = math.nan
    #: calibrated_dph, calibrated_sigma_dph: Calibrated bias of the gyro in this position at this temperature;
    #: NaN where there is none.
    calibrated_dph: float = math.nan
    calibrated_sigma_dph: float = math.nan
    #: difference_dph, difference_sigma_dph, p_value: The bias less the calibrated one, its standard
    #: uncertainty, and the probability of such a difference by chance; NaN without a calibrated one, and
    #: where there are flags.
    difference_dph: float = math.nan
    difference_sigma_dph: float = math.nan
    p_value: float = math.nan
    flags: str = ""  #: What was wrong; empty where nothing was. A row with flags may be without numbers.

    @property
    def is_compared(self) -> bool:
        """Whether there is a calibrated bias to hold against it, and nothing was wrong."""
        return not math.isnan(self.p_value)


#: Columns that a table is written with.
COLUMNS = tuple(field.name for field in fields(CalibrationCheckRow))

_MEASURED = ("bias_dph", "sigma_dph", "accelerometer_ug", "accelerometer_sigma_ug")
_SIGMAS = tuple(name for name in COLUMNS if "sigma" in name)
_CHOICES = {"position": tuple(POSITIONS), "gyro": AXES, "method": METHODS}
_TEXTS = ("unit", "run", "flags")
_INTEGERS = ("dwell", "cycle")


def write_calibration_check(path: Path, rows: Iterable[CalibrationCheckRow]) -> None:
    """Write the table of a calibration check. Raises RunFolderError if the file can't be written."""
    write_text(path, format_rows(COLUMNS, rows))


def read_calibration_check(path: Path) -> list[CalibrationCheckRow]:
    """Read the table of a calibration check.

    Raises DocumentError if the file can't be read or is wrong; the message lists all problems.
    """
    table = CsvTable(read_text(path), str(path), required=COLUMNS)
    return table.rows(
        lambda index: CalibrationCheckRow(**{name: _value(table, index, name) for name in COLUMNS})
    )


def _value(table: CsvTable, index: int, name: str) -> Any:
    text = table.text(index, name)
    if name in _TEXTS:
        return text
    if name in _CHOICES:
        return table.choice(index, name, _CHOICES[name])
    if name in _INTEGERS or (name == "turned_dwell" and text):
        return table.integer(index, name)
    if name == "turned_dwell":
        return None
    failed = bool(table.text(index, "flags"))
    may_be_empty = name != "azimuth_deg" and (name not in _MEASURED or failed)
    if name == "temperature_c":
        return table.temperature(index, name, may_be_empty)
    if name in _SIGMAS:
        return table.uncertainty(index, name, may_be_empty)
    return table.number(index, name, may_be_empty)
