"""What the instruments should be doing by now."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Expected:
    """What the bench told the instruments last.

    Attributes
    ----------
    chamber_set_c : float or None
        Set point; None where none was commanded yet.
    chamber_on : bool or None
        Whether it was switched on or off; None where neither was commanded yet.
    chamber_reached : bool
        Whether the air had come to that set point, so that it should keep it.
    ins_on : bool
        Whether the INS is on and has spoken, so that its silence matters.
    table_prepared : bool
        Whether the table was made ready to move, so that open servos and faults matter.
    """

    chamber_set_c: float | None = None
    chamber_on: bool | None = None
    chamber_reached: bool = False
    ins_on: bool = False
    table_prepared: bool = False
