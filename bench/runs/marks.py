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
from gyrobench.bench.procedure.plan import DwellPurpose

_CHECK = "is_verification"
#: Keys of the purposes in the journal, which always has the first; calibration is none of them.
_PURPOSES = {
    _CHECK: DwellPurpose.CALIBRATION_CHECK,
    "is_rotated": DwellPurpose.ROTATIONS,
    "is_noise_record": DwellPurpose.NOISE,
}
#: Attribute that the journal has only where it is known.
_NEIGHBOURS = "neighbours_on"
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
    purpose: DwellPurpose = DwellPurpose.CALIBRATION
    align_s: float = 0.0  #: How long the alignment took.
    neighbours_on: float | None = None  #: Mean number of other units that were on; None for a single unit.
    #: What went wrong while it lasted; a disturbed dwell is kept out of the bins.
    disturbances: tuple[str, ...] = ()

    @property
    def frame_count(self) -> int:
        """Number of frames of the log's part that belong to the dwell."""
        return self.windows[-1].end_frame if self.windows else 0

    @property
    def span(self) -> tuple[int, int]:
        """First frame of the first window, and the first one after the last."""
        return self.windows[0].first_frame, self.windows[-1].end_frame

    def to_json(self) -> dict[str, Any]:
        """Plain data for the journal."""
        data = asdict(self)
        del data["purpose"]
        if self.neighbours_on is None:
            del data[_NEIGHBOURS]
        is_for = {name: self.purpose is purpose for name, purpose in _PURPOSES.items()}
        return data | {name: is_so for name, is_so in is_for.items() if is_so or name == _CHECK}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> DwellMarks:
        """Undo :meth:`to_json`. Raises RunFolderError if the data are not those of a dwell."""
        given = _with_purpose(data)
        try:
            marks = _adapter().validate_json(json.dumps(given))
        except ValidationError as error:
            places = [".".join(map(str, each["loc"])) for each in error.errors()]
            names = [", ".join(_PURPOSES) if place == "purpose" else place for place in places]
            problems = "; ".join(
                f"{name}: {each['msg']}" for name, each in zip(names, error.errors(), strict=True)
            )
            raise RunFolderError(f"damaged marks of a dwell: {problems}") from error
        lacking = {each.name for each in fields(cls)} - {_NEIGHBOURS} - set(given)
        ends = [frame for window in marks.windows for frame in (window.first_frame, window.end_frame)]
        if lacking or marks.position not in POSITIONS or min(ends, default=0) < 0 or ends != sorted(ends):
            raise RunFolderError(
                "damaged marks of a dwell: keys, position or windows are not those of a dwell"
            )
        return marks


def purpose_of(marks: Any) -> DwellPurpose | None:
    """What a dwell is for by its marks in the journal, also damaged ones; None if it has none."""
    if not isinstance(marks, Mapping):
        return None
    return next((is_for for key, is_for in _PURPOSES.items() if marks.get(key)), DwellPurpose.CALIBRATION)


def _with_purpose(data: Any) -> Any:
    """Marks with their purpose, None where it is not stated; what is no mapping is left to the validation."""
    if not isinstance(data, Mapping):
        return data
    stated = {name: data[name] for name in _PURPOSES if name in data}
    is_stated = _CHECK in stated and all(isinstance(each, bool) for each in stated.values())
    others = {name: data[name] for name in data if name not in _PURPOSES}
    return others | {"purpose": purpose_of(stated) if is_stated else None}


@cache
def _adapter() -> TypeAdapter[DwellMarks]:
    return TypeAdapter(DwellMarks)
