"""What the instruments said when they were last asked."""

from __future__ import annotations

from dataclasses import dataclass

from gyrobench.drivers.chamber import ChamberReading
from gyrobench.drivers.ins.ins_status import InsStatus
from gyrobench.drivers.rate_table import TableReading


@dataclass(frozen=True)
class Readings:
    """Newest answer of each instrument, and when it came.

    Attributes
    ----------
    table, chamber, ins
        What they said.
    table_s, chamber_s : float
        When, on the run's clock; the INS tells its own age.
    table_faults, chamber_alarms : tuple of str
        What each reports to be wrong, in words.
    asked_s : float
        When the instruments were last asked, whether they answered or not.
    """

    table: TableReading
    table_s: float
    table_faults: tuple[str, ...]
    chamber: ChamberReading
    chamber_s: float
    chamber_alarms: tuple[str, ...]
    ins: InsStatus
    asked_s: float = 0.0
