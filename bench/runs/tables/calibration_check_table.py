"""The table ``verification.csv``: one row for each bias that a calibration check measures."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path

from gyrobench.bench.foundations.csv_tables import CsvTable, format_rows, one_of, read_rows, write_text
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
    #: What was wrong; empty where nothing was. A row with flags may be without numbers.
    flags: tuple[str, ...] = ()

    @property
    def is_compared(self) -> bool:
        """Whether there is a calibrated bias to hold against it, and nothing was wrong."""
        return not math.isnan(self.p_value)


#: Columns that a table is written with.
CHECK_COLUMNS = tuple(field.name for field in fields(CalibrationCheckRow))

_MEASURED = ("bias_dph", "sigma_dph", "accelerometer_ug", "accelerometer_sigma_ug")


def write_calibration_check(path: Path, rows: Iterable[CalibrationCheckRow]) -> None:
    """Write the table of a calibration check. Raises RunFolderError if the file can't be written."""
    write_text(path, format_rows(CHECK_COLUMNS, rows))


def read_calibration_check(path: Path) -> list[CalibrationCheckRow]:
    """Read the table of a calibration check.

    Errors as for :func:`gyrobench.bench.foundations.csv_tables.read_rows`.
    """
    words = {"position": one_of(POSITIONS), "gyro": one_of(AXES), "method": one_of(METHODS)}
    numbers = {field.name: _number for field in fields(CalibrationCheckRow) if field.type == "float"}
    return read_rows(path, CalibrationCheckRow, words | numbers)


def _number(table: CsvTable, index: int, name: str) -> float:
    failed = bool(table.text(index, "flags"))
    may_be_empty = name != "azimuth_deg" and (name not in _MEASURED or failed)
    if name == "temperature_c":
        return table.temperature(index, name, may_be_empty)
    if "sigma" in name:
        return table.uncertainty(index, name, may_be_empty)
    return table.number(index, name, may_be_empty)
