"""The table ``verification.csv``: one row for each bias that a calibration check measures."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from gyrobench.bench.foundations.csv_tables import CsvTable, RecordTable, one_of
from gyrobench.bench.navigation.positions import AXES, POSITIONS

#: Methods of measuring a bias: by the heading after alignment, or by the velocity of a navigation after it.
METHODS = ("alignment", "velocity")


@dataclass(frozen=True)
class CalibrationCheckRow:
    """Bias of one gyro measured by a calibration check, with the calibrated bias."""

    #: unit, run: As in the dwell table.
    unit: str
    run: str
    #: dwell, turned_dwell: Number of the dwell; for two alignments that of the first, and of the second,
    #: which is half a turn from it.
    dwell: int
    turned_dwell: int | None
    cycle: int  #: Cycle of the temperature profile.
    #: position, azimuth_deg: Key of :data:`gyrobench.bench.navigation.positions.POSITIONS`, and azimuth of
    #: the dwell.
    position: str
    azimuth_deg: float
    gyro: str  #: "x", "y" or "z".
    method: str  #: One of :data:`METHODS`.
    #: Mean of this gyro's optics over the alignments or the navigation; NaN if not measured.
    temperature_c: float = math.nan
    #: bias_dph, sigma_dph: Bias of the gyro and its standard uncertainty.
    bias_dph: float = math.nan
    sigma_dph: float = math.nan
    #: paper_bias_dph, paper_sigma_dph: The same, only from the second slope of the velocity East.
    paper_bias_dph: float = math.nan
    paper_sigma_dph: float = math.nan
    #: accelerometer_ug, accelerometer_sigma_ug: Assumed bias of the accelerometer along this gyro, and its
    #: standard uncertainty; both enter the biases.
    accelerometer_ug: float = math.nan
    accelerometer_sigma_ug: float = math.nan
    #: calibrated_dph, calibrated_sigma_dph: Calibrated bias of the gyro in this position at this temperature;
    #: NaN if there is none.
    calibrated_dph: float = math.nan
    calibrated_sigma_dph: float = math.nan
    #: difference_dph, difference_sigma_dph, p_value: The bias minus the calibrated one, its standard
    #: uncertainty, and the probability of such a difference by chance; NaN without a calibrated bias, or
    #: with flags.
    difference_dph: float = math.nan
    difference_sigma_dph: float = math.nan
    p_value: float = math.nan
    #: Problems; empty if there are none. A row with flags may lack numbers.
    flags: tuple[str, ...] = ()

    @property
    def is_compared(self) -> bool:
        """Whether it is compared with a calibrated bias: there is one, and there are no flags."""
        return not math.isnan(self.p_value)


_MEASURED = ("bias_dph", "sigma_dph", "accelerometer_ug", "accelerometer_sigma_ug")


def _number(table: CsvTable, index: int, name: str) -> float:
    is_flagged = bool(table.text(index, "flags"))
    may_be_empty = name != "azimuth_deg" and (name not in _MEASURED or is_flagged)
    if name == "temperature_c":
        return table.temperature(index, name, may_be_empty)
    if "sigma" in name:
        return table.uncertainty(index, name, may_be_empty)
    return table.number(index, name, may_be_empty)


CALIBRATION_CHECK_TABLE = RecordTable(
    CalibrationCheckRow,
    {"position": one_of(POSITIONS), "gyro": one_of(AXES), "method": one_of(METHODS)}
    | {each.name: _number for each in fields(CalibrationCheckRow) if each.type == "float"},
)
