"""Marks of a dwell: its frames in the raw log, and the state of table and chamber.

Frames are numbered from the start of the part of the raw log that begins with the dwell's alignment. So the
log yields the same frames as the run, independent of the CAN interface's time stamps.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import cache
from typing import Any, ClassVar

from pydantic import ConfigDict, TypeAdapter, ValidationError

from gyrobench.bench.bias.dwell import DwellPurpose
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.navigation.positions import POSITIONS

_CHECK_KEY = "is_verification"
#: Purpose by its key in the journal. The first key is always present; for a calibration all are false.
_PURPOSE_BY_KEY = {
    _CHECK_KEY: DwellPurpose.CALIBRATION_CHECK,
    "is_rotated": DwellPurpose.ROTATIONS,
    "is_noise_record": DwellPurpose.NOISE,
}
#: Attribute that is in the journal only if it is known.
_NEIGHBOURS_KEY = "neighbours_on"
_STRICT = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


@dataclass(frozen=True)
class WindowMark:
    """One segment of navigation at rest."""

    __pydantic_config__: ClassVar[ConfigDict] = _STRICT

    #: first_frame, end_frame: Numbers of its first data frame, and of the first data frame after it.
    first_frame: int
    end_frame: int
    #: outer_deg, inner_deg: Angles that the table reported.
    outer_deg: float
    inner_deg: float
    #: turn_first_frame, turn_end_frame: Numbers of the first frame of the turn to this window, and of the
    #: first one after the turn; None if there was no turn.
    turn_first_frame: int | None = None
    turn_end_frame: int | None = None


@dataclass(frozen=True)
class DwellMarks:
    """Everything that is known of a dwell except its frames."""

    __pydantic_config__: ClassVar[ConfigDict] = _STRICT

    #: unit, run: Serial number of the INS; one value per power-on.
    unit: str
    run: str
    #: dwell, cycle: As in the dwell table.
    dwell: int
    cycle: int
    #: position, azimuth_deg: At the start of the dwell.
    position: str
    azimuth_deg: float
    log_part: int  #: Part of the raw CAN log that began with its alignment; its first frame has number 0.
    windows: tuple[WindowMark, ...]  #: In the order of time; two for the paper's method.
    #: start_s, end_s, since_power_on_s: Times of the first and last window's ends on the run's clock, and
    #: from power-on to the first.
    start_s: float
    end_s: float
    since_power_on_s: float
    #: chamber_set_c, chamber_c: Set point, and mean air temperature; None if the chamber was not controlled
    #: or not read.
    chamber_set_c: float | None
    chamber_c: float | None
    purpose: DwellPurpose = DwellPurpose.CALIBRATION
    align_s: float = 0.0  #: Duration of the alignment.
    neighbours_on: float | None = None  #: Mean number of other units that were on; None for a single unit.
    #: Disturbances during the dwell; a disturbed dwell is excluded from the bins.
    disturbances: tuple[str, ...] = ()

    @property
    def frame_count(self) -> int:
        """Number of frames of the log's part that belong to the dwell."""
        return self.windows[-1].end_frame if self.windows else 0

    @property
    def span(self) -> tuple[int, int]:
        """Number of the first frame of the first window, and of the first frame after the last window."""
        return self.windows[0].first_frame, self.windows[-1].end_frame

    def to_json(self) -> dict[str, Any]:
        """Marks as plain data for the journal."""
        data = asdict(self)
        del data["purpose"]
        if self.neighbours_on is None:
            del data[_NEIGHBOURS_KEY]
        flags = {key: self.purpose is purpose for key, purpose in _PURPOSE_BY_KEY.items()}
        return data | {key: is_set for key, is_set in flags.items() if is_set or key == _CHECK_KEY}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> DwellMarks:
        """Undo :meth:`to_json`. Raises RunFolderError if the data are not those of a dwell."""
        values = _with_purpose(data)
        try:
            marks = _adapter().validate_json(json.dumps(values))
        except ValidationError as error:
            locations = [".".join(map(str, each["loc"])) for each in error.errors()]
            names = [
                ", ".join(_PURPOSE_BY_KEY) if location == "purpose" else location for location in locations
            ]
            problems = "; ".join(
                f"{name}: {each['msg']}" for name, each in zip(names, error.errors(), strict=True)
            )
            raise RunFolderError(f"damaged marks of a dwell: {problems}") from error
        missing = {each.name for each in fields(cls)} - {_NEIGHBOURS_KEY} - set(values)
        frames = [frame for window in marks.windows for frame in (window.first_frame, window.end_frame)]
        if (
            missing
            or marks.position not in POSITIONS
            or min(frames, default=0) < 0
            or frames != sorted(frames)
        ):
            raise RunFolderError(
                "damaged marks of a dwell: keys, position or windows are not those of a dwell"
            )
        return marks


def purpose_of(marks: Any) -> DwellPurpose | None:
    """Purpose of a dwell by its marks in the journal, which may be damaged; None if there are no marks."""
    if not isinstance(marks, Mapping):
        return None
    return next(
        (purpose for key, purpose in _PURPOSE_BY_KEY.items() if marks.get(key)), DwellPurpose.CALIBRATION
    )


def _with_purpose(data: Any) -> Any:
    """Marks with the key ``purpose``, None if it is not stated; data that are no mapping are unchanged."""
    if not isinstance(data, Mapping):
        return data
    stated = {name: data[name] for name in _PURPOSE_BY_KEY if name in data}
    is_stated = _CHECK_KEY in stated and all(isinstance(each, bool) for each in stated.values())
    others = {name: data[name] for name in data if name not in _PURPOSE_BY_KEY}
    return others | {"purpose": purpose_of(stated) if is_stated else None}


@cache
def _adapter() -> TypeAdapter[DwellMarks]:
    return TypeAdapter(DwellMarks)
