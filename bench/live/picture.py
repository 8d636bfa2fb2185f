"""The picture of a run at one moment: everything that a view of it shows.

Its parts, and how their numbers are to be read, are in :mod:`gyrobench.bench.live.picture_parts`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, TypeAdapter, ValidationError

from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.files import read_limited
from gyrobench.bench.live.picture_parts import (
    Alarm,
    Attitude,
    BenchNow,
    DwellDone,
    DwellNow,
    FillingBin,
    LiveBias,
    MeasuredProfile,
    Note,
    PlannedProfile,
    Question,
    Series,
    StepNow,
    Strict,
    WindowTrace,
)

#: Changes with the meaning of the fields.
FORMAT = 1
#: Thinned so that a picture stays small however long the run is.
MOST_PLANNED, MOST_MEASURED, MOST_IN_WINDOW, MOST_ESTIMATES, MOST_MESSAGES = 400, 600, 200, 200, 50
_MOST_BYTES = 20_000_000


class RunState(StrEnum):
    """What a run is doing."""

    STARTING = "starting"
    RUNNING = "running"
    HOLDING = "holding"
    PAUSED = "paused"
    WAITING = "waiting for a person"
    FINISHED = "finished"
    STOPPED = "stopped"
    FAILED = "failed"

    @property
    def is_over(self) -> bool:
        """Whether nothing comes any more, unless the run is resumed."""
        return self in (RunState.FINISHED, RunState.STOPPED, RunState.FAILED)


@dataclass(frozen=True)
class Picture(Strict):
    """A run at one moment.

    Attributes
    ----------
    name, folder : str
        Name and path of the run folder.
    procedure, station, unit : str
        What runs, where, and on which INS; the unit is empty before the INS has said it.
    started_utc, updated_utc : str
        ISO 8601: when the run's clock was zero, and the host's calendar when the picture was made. On
        virtual time a run starts in the year 2000.
    state, reason, question
        What it is doing; why it holds, waits, stopped or failed; the open question, if any.
    now_s, left_s, planned_s : float
        Time on the run's clock, what is left by the plan, and the duration planned for the whole.
    planned, measured
        Temperatures by plan and as they were.
    bench, attitude, step, dwell
        Present values; None before they are known, or where nothing is under way.
    dwells, bins, alarms, messages
        Dwells measured, the bins that they fill, what is wrong now, and the last messages, the newest last.
    """

    name: str
    folder: str
    procedure: str
    station: str
    unit: str
    started_utc: str
    updated_utc: str
    state: Annotated[RunState, BeforeValidator(lambda value: RunState(value))]
    now_s: float
    left_s: float
    planned_s: float
    dwell_count: int
    reason: str = ""
    question: Question | None = None
    planned: PlannedProfile = field(default_factory=PlannedProfile)
    measured: MeasuredProfile = field(default_factory=MeasuredProfile)
    bench: BenchNow | None = None
    attitude: Attitude | None = None
    step: StepNow | None = None
    dwell: DwellNow | None = None
    dwells: tuple[DwellDone, ...] = ()
    bins: tuple[FillingBin, ...] = ()
    alarms: tuple[Alarm, ...] = ()
    messages: tuple[Note, ...] = ()
    format: Literal[1] = FORMAT  # type: ignore[assignment]

    @property
    def plan_now_s(self) -> float:
        """The moment of the plan that the run has come to."""
        return self.planned_s - self.left_s

    @property
    def behind_s(self) -> float:
        """How far the run is behind its plan, as one that held; what is still to come is so much later."""
        return self.now_s - self.plan_now_s

    @property
    def live_bias(self) -> LiveBias | None:
        """Newest estimate of the dwell under way; None as long as nothing can be told."""
        return self.dwell.estimates[-1] if self.dwell and self.dwell.estimates else None

    def to_json(self) -> bytes:
        """JSON text; NaN becomes null."""
        return _adapter().dump_json(self)

    @classmethod
    def from_json(cls, data: bytes, name: str = "live.json") -> Picture:
        """Undo :meth:`to_json`; ``name`` is what to call the data in messages.

        Raises
        ------
        RunFolderError
            The data are damaged, or of another version of gyrobench.
        """
        damaged = f"{name}: damaged, or of another version of gyrobench"
        try:
            picture = _adapter().validate_json(data)
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, first["loc"])) or "the whole"
            raise RunFolderError(f"{damaged}: {where}: {first['msg']}") from error
        if any(len({len(series) for series in group}) > 1 for group in _series(picture)):
            raise RunFolderError(f"{damaged}: series that belong together differ in length")
        return picture


def read_picture(path: Path) -> Picture:
    """Read the picture that a run left.

    Raises
    ------
    RunFolderError
        It can't be read; see :meth:`Picture.from_json`.
    """
    return Picture.from_json(read_limited(path, _MOST_BYTES, RunFolderError), str(path))


@cache
def _adapter() -> TypeAdapter[Picture]:
    return TypeAdapter(Picture)


def _series(picture: Picture) -> Iterator[list[Series]]:
    """Series that have to be of one length, together."""
    windows = picture.dwell.windows if picture.dwell else ()
    parts: list[PlannedProfile | MeasuredProfile | WindowTrace] = [
        picture.planned,
        picture.measured,
        *windows,
    ]
    for part in parts:
        values = (getattr(part, each.name) for each in fields(part) if each.name != "positions")
        yield [value for value in values if isinstance(value, tuple)]
