"""Marks: which frames make a dwell, and what table and chamber were doing.

Frames are counted from the part of the raw log that begins with the dwell's alignment, so that the
log gives the same frames as live, independent of the CAN interface's time stamps.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import cache
from typing import Any, ClassVar

from pydantic import ConfigDict, TypeAdapter, ValidationError

from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.navigation.positions import POSITIONS

#: What the journal calls :attr:`DwellMarks.is_calibration_check`.
_CHECK_IN_JOURNAL = "is_verification"
#: Attributes that the journal has only where they are true, or known.
_LATER = ("is_rotated", "is_noise_record", "neighbours_on")
_AS_WRITTEN = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


@dataclass(frozen=True)
class WindowMark:
    """One segment of navigation at rest."""

    __pydantic_config__: ClassVar[ConfigDict] = _AS_WRITTEN

    #: first_frame, end_frame: Numbers of its first data frame, and of the first one after it.
    first_frame: int
    end_frame: int
    #: outer_deg, inner_deg: Where the table stood, by its own reading.
    outer_deg: float
    inner_deg: float
    #: turn_first_frame, turn_end_frame: Numbers of the frames with which the turn to this window began and
    #: was over; None where there was none.
    turn_first_frame: int | None = None
    turn_end_frame: int | None = None


@dataclass(frozen=True)
class DwellMarks:
    """All that is known of a dwell beside its frames."""

    __pydantic_config__: ClassVar[ConfigDict] = _AS_WRITTEN

    #: unit, run: Serial number of the INS; one value per power-on.
    unit: str
    run: str
    #: dwell, cycle: As in the dwell table.
    dwell: int
    cycle: int
    #: position, azimuth_deg: Where the dwell began.
    position: str
    azimuth_deg: float
    log_part: int  #: Part of the raw CAN log that began with its alignment; frame 0 is that part's first.
    windows: tuple[WindowMark, ...]  #: In the order of time; the paper's method has two.
    #: start_s, end_s, since_power_on_s: Times of the first and last window's ends on the run's clock, and
    #: from power-on to the first.
    start_s: float
    end_s: float
    since_power_on_s: float
    #: chamber_set_c, chamber_c: Set point, and mean of the air; None where the chamber was not controlled or
    #: not read.
    chamber_set_c: float | None
    chamber_c: float | None
    #: Whether it checks a calibration: one window straight from the alignment.
    is_calibration_check: bool = False
    align_s: float = 0.0  #: How long the alignment took.
    #: Whether the unit was rotated about the table's axes between the windows: it gives no bias by itself.
    is_rotated: bool = False
    is_noise_record: bool = False  #: Whether it is one long navigation for the gyros' noise.
    neighbours_on: float | None = None  #: Mean number of other units that were on; None for a single unit.
    #: What went wrong while it lasted; a disturbed dwell is kept out of the bins.
    disturbances: tuple[str, ...] = ()

    @property
    def gives_bias(self) -> bool:
        """Whether the dwell measures gyro biases."""
        return not (self.is_rotated or self.is_noise_record)

    @property
    def frame_count(self) -> int:
        """Number of frames of the log's part that belong to the dwell."""
        return self.windows[-1].end_frame if self.windows else 0

    def to_json(self) -> dict[str, Any]:
        """Plain data for the journal."""
        data = asdict(self)
        data[_CHECK_IN_JOURNAL] = data.pop("is_calibration_check")
        for name in _LATER:
            if data[name] is False or data[name] is None:
                del data[name]
        return data

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> DwellMarks:
        """Undo :meth:`to_json`. Raises RunFolderError if the data are not those of a dwell."""
        try:
            marks = _adapter().validate_json(json.dumps(_named(data)))
        except ValidationError as error:
            problems = "; ".join(
                f"{'.'.join(map(str, each['loc']))}: {each['msg']}" for each in error.errors()
            )
            raise RunFolderError(f"damaged marks of a dwell: {problems}") from error
        lacking = {each.name for each in fields(cls)} - {*_LATER} - set(_named(data))
        ends = [frame for window in marks.windows for frame in (window.first_frame, window.end_frame)]
        if lacking or marks.position not in POSITIONS or min(ends, default=0) < 0 or ends != sorted(ends):
            raise RunFolderError(
                "damaged marks of a dwell: keys, position or windows are not those of a dwell"
            )
        return marks


def _named(data: Any) -> Any:
    """Marks by the names of their attributes; what is no mapping is left to the validation."""
    if not isinstance(data, Mapping):
        return data
    return {"is_calibration_check" if name == _CHECK_IN_JOURNAL else name: data[name] for name in data}


@cache
def _adapter() -> TypeAdapter[DwellMarks]:
    return TypeAdapter(DwellMarks)
