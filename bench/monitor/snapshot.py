"""One snapshot of a run: everything that a view of it shows, in plain numbers and text.

Times are on the run's clock unless a name says otherwise. An unknown number is NaN, null in JSON.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import BeforeValidator, ConfigDict, TypeAdapter, ValidationError

from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.reading import read_limited
from gyrobench.bench.navigation.positions import AXES

#: A number, or NaN where it is not known.
Number = Annotated[float, BeforeValidator(lambda value: math.nan if value is None else value)]
Series = tuple[Number, ...]
#: Values of the x, y and z gyro.
Triple = tuple[Number, Number, Number]


def mean_known(values: Triple) -> float:
    """Mean of the values that are known; NaN where none is."""
    known = [value for value in values if not math.isnan(value)]
    return sum(known) / len(known) if known else math.nan


class Strict:
    """Read back as it was written, or refused."""

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid", strict=True)


@dataclass(frozen=True)
class Question(Strict):
    """A question that is open, and the answers to choose from."""

    text: str
    answers: tuple[str, ...]


@dataclass(frozen=True)
class PositionSpan(Strict):
    """A stay in a position by the plan, on the plan's time."""

    start_s: float
    end_s: float
    position: str


@dataclass(frozen=True)
class PlannedProfile(Strict):
    """What the plan expects, on the plan's time, which begins with 0.

    Attributes
    ----------
    time_s, chamber_c, gyro_c : tuple of float, same length
        The chamber's ramped set point and the gyros' predicted temperature.
    positions : tuple of PositionSpan
        In order.
    """

    time_s: Series = ()
    chamber_c: Series = ()
    gyro_c: Series = ()
    positions: tuple[PositionSpan, ...] = ()


@dataclass(frozen=True)
class MeasuredProfile(Strict):
    """Temperatures so far; all series have the same length. A row of NaN breaks the lines."""

    time_s: Series = ()
    chamber_set_c: Series = ()
    chamber_c: Series = ()
    gyro_x_c: Series = ()
    gyro_y_c: Series = ()
    gyro_z_c: Series = ()


@dataclass(frozen=True)
class BenchNow(Strict):
    """What the instruments said last.

    Attributes
    ----------
    chamber_set_c, chamber_c : float
        What the chamber was told, NaN while nobody controls it, and its air.
    gyro_c, electronics_c, case_c
        Temperatures that the INS tells.
    outer_deg, inner_deg, outer_rate_dps, inner_rate_dps : float
        The table.
    ins_mode : str
        "unknown", "boot", "standby", "align", "navigate" or "fault".
    table_age_s, chamber_age_s, ins_age_s : float
        How old the last answer of each is; NaN for an INS that has never been heard.
    """

    chamber_set_c: Number
    chamber_c: Number
    gyro_c: Triple
    electronics_c: Triple
    case_c: Number
    outer_deg: Number
    inner_deg: Number
    outer_rate_dps: Number
    inner_rate_dps: Number
    ins_mode: str
    table_age_s: Number
    chamber_age_s: Number
    ins_age_s: Number


@dataclass(frozen=True)
class Attitude(Strict):
    """How the unit stands.

    Attributes
    ----------
    position : str
        Where the table was sent, as in the procedure; empty before that.
    azimuth_deg : float
        Turned about Up from the position's azimuth 0, by what was commanded.
    body_in_enu : tuple of 3 tuples
        Direction cosines from the table's angles: row East, North, Up; column body x, y, z.
    """

    position: str
    azimuth_deg: Number
    body_in_enu: tuple[Triple, Triple, Triple]


@dataclass(frozen=True)
class StepNow(Strict):
    """The step under way.

    Attributes
    ----------
    number, count : int
        Its number in the plan, from 1, and the number of steps.
    label, description : str
        Where the run is ("cycle 1, 60 degC, z_up") and what is done ("navigate 10 min").
    started_s, planned_s : float
        When it began, and how long it is expected to take.
    """

    number: int
    count: int
    label: str
    description: str
    started_s: float
    planned_s: float


@dataclass(frozen=True)
class WindowTrace(Strict):
    """One window of navigation at rest; the series have the same length.

    Attributes
    ----------
    planned_s : float
        How long it is to last.
    time_s : tuple of float
        Since the window began.
    velocity_east_mps, velocity_north_mps : tuple of float
        What the INS computes: errors, since it is at rest.
    heading_change_deg : tuple of float
        Since the window began, positive from North to West (about Up).
    """

    planned_s: float
    time_s: Series = ()
    velocity_east_mps: Series = ()
    velocity_north_mps: Series = ()
    heading_change_deg: Series = ()


@dataclass(frozen=True)
class LiveBias(Strict):
    """Estimate of the dwell under way at one moment; fields of three values are those of x, y and z."""

    time_s: float
    bias_dph: Triple
    sigma_dph: Triple


@dataclass(frozen=True)
class DwellNow(Strict):
    """The dwell under way.

    Attributes
    ----------
    number, count : int
        Its number, from 1, and how many the plan has.
    cycle, position
        Where it is.
    windows : tuple of WindowTrace
        The last is under way, or over while the table turns; empty while the INS aligns.
    estimates : tuple of LiveBias
        How the live estimate has become better; the last is the newest. Empty as long as nothing
        can be told.
    """

    number: int
    count: int
    cycle: int
    position: str
    windows: tuple[WindowTrace, ...] = ()
    estimates: tuple[LiveBias, ...] = ()


@dataclass(frozen=True)
class DwellDone(Strict):
    """A dwell that is measured; fields of three values are those of x, y and z."""

    number: int
    cycle: int
    position: str
    gyro_c: Triple
    bias_dph: Triple
    sigma_dph: Triple
    flags: str


@dataclass(frozen=True)
class FillingBin(Strict):
    """One gyro in one position and range of its temperature; bias and sigma are NaN while it is empty."""

    gyro: str
    position: str
    low_c: float
    high_c: float
    bias_dph: Number
    sigma_dph: Number
    count: int


@dataclass(frozen=True)
class Alarm(Strict):
    """Something wrong now.

    Attributes
    ----------
    name : str
        Interlock ("chamber_air") or instrument ("rate table") that it comes from.
    text : str
        What is wrong and what to do.
    """

    name: str
    text: str


@dataclass(frozen=True)
class Note(Strict):
    """Something that a person was told."""

    time_s: float
    text: str


_NAMES = (("East", "West"), ("North", "South"), ("Up", "Down"))
#: From there on an axis is said to point in a direction, and below the rest of it not to lean to it.
_ALONG = math.cos(math.radians(10.0))


def directions(attitude: Attitude) -> str:
    """Say where the body axes point: "x East, y South, z Down", or "x East-North" for one in between."""
    columns = zip(*attitude.body_in_enu, strict=True)
    return ", ".join(f"{name} {_direction(column)}" for name, column in zip(AXES, columns, strict=True))


def _direction(cosines: Sequence[float]) -> str:
    """Direction of an axis in a word, or two or three where it lies between."""
    nearest_first = sorted(range(3), key=lambda index: -abs(cosines[index]))
    if abs(cosines[nearest_first[0]]) >= _ALONG:
        nearest_first = nearest_first[:1]
    named = [index for index in nearest_first if abs(cosines[index]) > 1.0 - _ALONG]
    return "-".join(_NAMES[index][cosines[index] < 0.0] for index in named)


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
