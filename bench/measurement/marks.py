"""Marks: which frames make a dwell, and what table and chamber were doing.

Frames are counted from the part of the raw log that begins with the dwell's alignment, so that the
log gives the very frames that were there live, whatever the CAN interface's time stamps do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from bench.errors import RunFolderError


@dataclass(frozen=True)
class WindowMark:
    """One stretch of navigation at rest.

    Attributes
    ----------
    first_frame, end_frame : int
        Numbers of its first data frame, and of the first one after it.
    outer_deg, inner_deg : float
        Where the table stood, by its own reading.
    turn_first_frame, turn_end_frame : int or None
        Numbers of the frames with which the turn to this window began and was over; None where
        there was none.
    """

    first_frame: int
    end_frame: int
    outer_deg: float
    inner_deg: float
    turn_first_frame: int | None = None
    turn_end_frame: int | None = None


@dataclass(frozen=True)
class DwellMarks:
    """All that is known of a dwell beside its frames.

    Attributes
    ----------
    unit, run : str
        Serial number of the INS; one value per power-on.
    dwell, cycle : int
        As in the dwell table.
    position, azimuth_deg : str, float
        Where the dwell began.
    log_part : int
        Part of the raw CAN log that began with its alignment; frame 0 is that part's first.
    windows : tuple of WindowMark
        In the order of time; the paper's method has two.
    is_verification : bool
        Whether it verifies a calibration: one window straight from the alignment.
    align_s : float
        How long the alignment took.
    start_s, end_s, since_power_on_s : float
        Times of the first and last window's ends on the run's clock, and from power-on to the first.
    chamber_set_c, chamber_c : float or None
        Set point, and mean of the air; None where the chamber was not controlled or not read.
    disturbances : tuple of str
        What went wrong while it lasted; a disturbed dwell is kept out of the bins.
    """

    unit: str
    run: str
    dwell: int
    cycle: int
    position: str
    azimuth_deg: float
    log_part: int
    windows: tuple[WindowMark, ...]
    start_s: float
    end_s: float
    since_power_on_s: float
    chamber_set_c: float | None
    chamber_c: float | None
    is_verification: bool = False
    align_s: float = 0.0
    disturbances: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Plain data for the journal."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> DwellMarks:
        """Undo :meth:`to_json`.

        Raises
        ------
        RunFolderError
            The data are not those of a dwell.
        """
        try:
            windows = tuple(WindowMark(**window) for window in data["windows"])
            return cls(**{**data, "windows": windows, "disturbances": tuple(data["disturbances"])})
        except (KeyError, TypeError) as error:
            raise RunFolderError(f"journal: damaged marks of a dwell: {error}") from error
