"""Snapshot of a run: everything that its views show, as plain numbers and texts.

Its last functions make the parts that follow from the plan and the tables of a run. Times are on the run's
clock unless a name says otherwise. An unknown number is NaN, null in JSON.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BeforeValidator, ConfigDict, TypeAdapter, ValidationError
from pydantic_core import to_json

from gyrobench.bench.bias.bins import bin_biases
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.files import read_limited
from gyrobench.bench.foundations.text import flag_text
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.procedure.timeline import position_spans, temperature_profile

#: A number; NaN if unknown.
Number = Annotated[float, BeforeValidator(lambda value: math.nan if value is None else value)]
Series = tuple[Number, ...]
#: Values of the x, y and z gyro.
NumberTriple = tuple[Number, Number, Number]
UNKNOWN: NumberTriple = (math.nan, math.nan, math.nan)


def mean_known(values: NumberTriple) -> float:
    """Mean of the known values; NaN if there is none."""
    finite = [value for value in values if not math.isnan(value)]
    return sum(finite) / len(finite) if finite else math.nan


class StrictRecord:
    """Base of records that are read back exactly as written, or rejected."""

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid", strict=True)


@dataclass(frozen=True)
class Question(StrictRecord):
    """An open question and the possible answers."""

    text: str
    answers: tuple[str, ...]


@dataclass(frozen=True)
class PositionSpan(StrictRecord):
    """Planned time in one position, on the plan's time."""

    start_s: float
    end_s: float
    position: str
    dwells: tuple[int, ...] = ()  #: Numbers of the dwells in it.


@dataclass(frozen=True)
class PlannedProfile(StrictRecord):
    """Planned temperatures and positions, on the plan's time, which begins with 0."""

    #: time_s, chamber_c, gyro_c: Set point of the chamber, with ramps, and predicted temperature of the
    #: gyros.
    time_s: Series = ()
    chamber_c: Series = ()
    gyro_c: Series = ()
    positions: tuple[PositionSpan, ...] = ()  #: In order.


@dataclass(frozen=True)
class MeasuredProfile(StrictRecord):
    """Temperatures so far; all series have the same length. Values of NaN at one time mark a gap."""

    time_s: Series = ()
    chamber_set_c: Series = ()
    chamber_c: Series = ()
    gyro_x_c: Series = ()
    gyro_y_c: Series = ()
    gyro_z_c: Series = ()


@dataclass(frozen=True)
class BenchReadings(StrictRecord):
    """Last readings of the instruments."""

    #: chamber_set_c, chamber_c: Commanded set point, NaN while the chamber is not controlled, and chamber
    #: air.
    chamber_set_c: Number
    chamber_c: Number
    #: gyro_c, electronics_c, case_c: Temperatures reported by the INS.
    gyro_c: NumberTriple
    electronics_c: NumberTriple
    case_c: Number
    #: outer_deg, inner_deg, outer_rate_dps, inner_rate_dps: Table axes.
    outer_deg: Number
    inner_deg: Number
    outer_rate_dps: Number
    inner_rate_dps: Number
    ins_mode: str  #: "unknown", "boot", "standby", "align", "navigate" or "fault".
    #: table_age_s, chamber_age_s, ins_age_s: Age of each instrument's last reply; NaN for an INS that has
    #: sent nothing.
    table_age_s: Number
    chamber_age_s: Number
    ins_age_s: Number


_DIRECTIONS = (("East", "West"), ("North", "South"), ("Up", "Down"))
#: An axis within 10 deg of a direction is named by it alone; components below 1 minus this are not named.
_MIN_COSINE = math.cos(math.radians(10.0))


@dataclass(frozen=True)
class Attitude(StrictRecord):
    """Attitude of the unit."""

    position: str  #: Commanded position, as in the procedure; empty before the first and after rotations.
    azimuth_deg: Number  #: Commanded turn about Up from the position's azimuth 0.
    #: Direction cosines from the table's angles: row East, North, Up; column body x, y, z.
    body_in_enu: tuple[NumberTriple, NumberTriple, NumberTriple]

    @classmethod
    def of(cls, C_nb: FloatArray, position: str, azimuth_deg: float) -> Attitude:
        """Attitude from the direction cosines (3, 3) of the body axes in ENU."""
        east, north, up = C_nb.tolist()
        return cls(position, azimuth_deg, (tuple(east), tuple(north), tuple(up)))

    def directions(self) -> str:
        """Directions of the body axes: "x East, y South, z Down", or "x East-North" in between."""
        columns = zip(*self.body_in_enu, strict=True)
        return ", ".join(f"{name} {_direction(column)}" for name, column in zip(AXES, columns, strict=True))


def _direction(cosines: Sequence[float]) -> str:
    """Name of the direction of an axis; two or three names for directions in between."""
    nearest_first = sorted(range(3), key=lambda index: -abs(cosines[index]))
    if abs(cosines[nearest_first[0]]) >= _MIN_COSINE:
        nearest_first = nearest_first[:1]
    significant = [index for index in nearest_first if abs(cosines[index]) > 1.0 - _MIN_COSINE]
    return "-".join(_DIRECTIONS[index][cosines[index] < 0.0] for index in significant)


@dataclass(frozen=True)
class CurrentStep(StrictRecord):
    """The step in progress."""

    #: number, count: Its number in the plan, from 1, and the number of steps; while the run returns to a step
    #: after an interruption, the number of that step.
    number: int
    count: int
    #: label, description: Place in the plan ("cycle 1, 60 degC, z_up") and action ("navigate 10 min").
    label: str
    description: str
    #: started_s, planned_s: Start, and planned duration.
    started_s: float
    planned_s: float
    is_return: bool = False  #: Whether the run returns to the step ``number``.


@dataclass(frozen=True)
class WindowTrace(StrictRecord):
    """One window of navigation at rest; the series have the same length."""

    planned_s: float  #: Planned duration.
    time_s: Series = ()  #: Since the window began.
    #: velocity_east_mps, velocity_north_mps: Velocity errors of the INS, which is at rest.
    velocity_east_mps: Series = ()
    velocity_north_mps: Series = ()
    heading_change_deg: Series = ()  #: Since the window began, positive from North to West (about Up).


@dataclass(frozen=True)
class LiveBias(StrictRecord):
    """Estimate of the bias of the current dwell at one time; triples are x, y, z."""

    time_s: float
    bias_dph: NumberTriple
    sigma_dph: NumberTriple


@dataclass(frozen=True)
class CurrentDwell(StrictRecord):
    """The dwell in progress."""

    #: number, count: Its number, from 1, and the number of dwells in the plan.
    number: int
    count: int
    #: cycle, position: As in the dwell table.
    cycle: int
    position: str
    #: The last one is in progress, or complete while the table turns; empty while the INS aligns.
    windows: tuple[WindowTrace, ...] = ()
    #: Successive live estimates, the newest last; empty until the bias is observable.
    estimates: tuple[LiveBias, ...] = ()


@dataclass(frozen=True)
class SnapshotDwell(StrictRecord):
    """A completed dwell; triples are x, y, z."""

    number: int
    cycle: int
    position: str
    gyro_c: NumberTriple
    bias_dph: NumberTriple
    sigma_dph: NumberTriple
    flags: str


@dataclass(frozen=True)
class LiveBin(StrictRecord):
    """One gyro in one position and temperature bin; bias and sigma are NaN while it is empty."""

    gyro: str
    position: str
    low_c: float
    high_c: float
    bias_dph: Number
    sigma_dph: Number
    count: int


@dataclass(frozen=True)
class Alarm(StrictRecord):
    """An active alarm: interlock ("chamber_air") or instrument ("rate table"), and text for the operator."""

    name: str
    text: str


@dataclass(frozen=True)
class Note(StrictRecord):
    """A message of the run."""

    time_s: float
    text: str


@dataclass(frozen=True)
class UnitStatus(StrictRecord):
    """One of several units of a run."""

    number: str  #: serial number
    ins_mode: str  #: as in :class:`BenchReadings`; empty for a unit that is not measured
    gyro_c: NumberTriple  #: optics temperatures of the gyros
    dwells: int  #: completed dwells
    #: bias_dph, sigma_dph, flags: of the newest dwell; NaN and empty before the first.
    bias_dph: NumberTriple
    sigma_dph: NumberTriple
    flags: str
    dropped: str = ""  #: why it is left out of the rest of the run; empty if it is not
    position: str = ""  #: of the newest dwell
    flagged: int = 0  #: completed dwells with flags
    ins_age_s: Number = math.nan  #: as in :class:`BenchReadings`
    bins: tuple[LiveBin, ...] = ()  #: bins with its dwells


#: Version of the format, which changes with the meaning of the fields.
FORMAT = 1
#: Series are thinned so that a snapshot stays small in a run of any length.
MAX_PLANNED, MAX_MEASURED, MAX_WINDOW_SAMPLES, MAX_ESTIMATES, MAX_MESSAGES = 400, 600, 200, 200, 50
_MAX_BYTES = 20_000_000
#: State by its text in live.json if they differ; other programs rely on the texts.
_STATES_IN_FILE = {"waiting for a person": "waiting for the operator"}
_TEXTS_IN_FILE = {state: text for text, state in _STATES_IN_FILE.items()}


class RunState(StrEnum):
    """State of a run."""

    STARTING = "starting"
    RUNNING = "running"
    HOLDING = "holding"
    PAUSED = "paused"
    WAITING = "waiting for the operator"
    FINISHED = "finished"
    STOPPED = "stopped"
    FAILED = "failed"

    @property
    def is_over(self) -> bool:
        """Whether the run has ended, unless it is resumed."""
        return self in (RunState.FINISHED, RunState.STOPPED, RunState.FAILED)


@dataclass(frozen=True)
class RunSnapshot(StrictRecord):
    """Snapshot of a run at one time."""

    #: name, folder: Name and path of the run folder.
    name: str
    folder: str
    #: procedure, station, unit: Serial number of the INS, empty before the INS has reported it.
    procedure: str
    station: str
    unit: str
    #: started_utc, updated_utc: ISO 8601: start of the run's clock, in the year 2000 on virtual time,
    #: and the host's calendar at this snapshot.
    started_utc: str
    updated_utc: str
    state: Annotated[RunState, BeforeValidator(lambda value: RunState(_STATES_IN_FILE.get(value, value)))]
    #: now_s, left_s, planned_s: Time on the run's clock, planned time remaining, planned duration of the run.
    now_s: float
    left_s: float
    planned_s: float
    dwell_count: int
    finished_dwells: int = 0  #: Number of completed dwells, with those for rotations and noise.
    skipped: tuple[int, ...] = ()  #: Numbers of the dwells that the operator skipped.
    reason: str = ""  #: Why the run holds, waits, stopped or failed.
    question: Question | None = None
    planned: PlannedProfile = field(default_factory=PlannedProfile)
    measured: MeasuredProfile = field(default_factory=MeasuredProfile)
    #: bench, attitude, step, dwell: Present values; None if unknown or none is in progress.
    bench: BenchReadings | None = None
    attitude: Attitude | None = None
    step: CurrentStep | None = None
    dwell: CurrentDwell | None = None
    dwells: tuple[SnapshotDwell, ...] = ()  #: Completed dwells that measure a bias.
    bins: tuple[LiveBin, ...] = ()  #: Of these dwells.
    alarms: tuple[Alarm, ...] = ()  #: Active ones.
    messages: tuple[Note, ...] = ()  #: The last messages, the newest last.
    #: Each unit of a run with several; ``unit``, ``dwells`` and ``bins`` are then of the first that is
    #: measured.
    units: tuple[UnitStatus, ...] = ()
    format: Literal[1] = FORMAT  # type: ignore[assignment]

    @property
    def plan_now_s(self) -> float:
        """Present time on the plan's time scale."""
        return self.planned_s - self.left_s

    @property
    def behind_s(self) -> float:
        """Delay behind the plan, for example after a hold."""
        return self.now_s - self.plan_now_s

    @property
    def share_done(self) -> float:
        """Completed share of the planned duration; visits of which all dwells were skipped do not count."""
        skipped_s = sum(span.end_s - span.start_s for span in self.planned.positions if self.is_skipped(span))
        share = (self.plan_now_s - skipped_s) / self.planned_s if self.planned_s > 0.0 else 0.0
        return min(max(share, 0.0), 1.0)

    def is_skipped(self, span: PositionSpan) -> bool:
        """Whether the operator skipped all dwells of a visit to a position."""
        return bool(span.dwells) and set(span.dwells) <= set(self.skipped)

    @property
    def live_bias(self) -> LiveBias | None:
        """Newest estimate of the current dwell; None until the bias is observable."""
        return self.dwell.estimates[-1] if self.dwell and self.dwell.estimates else None

    def to_json(self) -> bytes:
        """JSON text; NaN becomes null."""
        # A TypeAdapter would build a schema of all records first, which takes 0.06 s in each run.
        state: Any = _TEXTS_IN_FILE.get(self.state, str(self.state))
        return to_json(replace(self, state=state), inf_nan_mode="null")

    @classmethod
    def from_json(cls, data: bytes, name: str = "live.json") -> RunSnapshot:
        """Undo :meth:`to_json`; ``name`` identifies the data in messages.

        Raises RunFolderError if the data are damaged, or of another version of gyrobench.
        """
        damaged = f"{name}: damaged, or of another version of gyrobench"
        try:
            snapshot = _adapter().validate_json(data)
        except ValidationError as error:
            first = error.errors()[0]
            location = ".".join(map(str, first["loc"])) or "the file"
            raise RunFolderError(f"{damaged}: {location}: {first['msg']}") from error
        if any(len({len(series) for series in group}) > 1 for group in _series(snapshot)):
            raise RunFolderError(f"{damaged}: series of one table differ in length")
        # Versions before 0.2.0 write no number.
        return replace(snapshot, finished_dwells=max(snapshot.finished_dwells, len(snapshot.dwells)))


def read_snapshot(path: Path) -> RunSnapshot:
    """Read the snapshot in a run folder.

    Raises RunFolderError if it can't be read; see :meth:`RunSnapshot.from_json`.
    """
    return RunSnapshot.from_json(read_limited(path, _MAX_BYTES, RunFolderError), str(path))


@cache
def _adapter() -> TypeAdapter[RunSnapshot]:
    return TypeAdapter(RunSnapshot)


def _series(snapshot: RunSnapshot) -> Iterator[list[Series]]:
    """Groups of series that must have equal length."""
    windows = snapshot.dwell.windows if snapshot.dwell else ()
    parts: list[PlannedProfile | MeasuredProfile | WindowTrace] = [
        snapshot.planned,
        snapshot.measured,
        *windows,
    ]
    for part in parts:
        values = (getattr(part, each.name) for each in fields(part) if each.name != "positions")
        yield [value for value in values if isinstance(value, tuple)]


def planned_profile(plan: Plan) -> PlannedProfile:
    """Planned temperatures and positions."""
    time_s, chamber_c, gyro_c = (_evenly_chosen(each, MAX_PLANNED) for each in temperature_profile(plan))
    spans = []
    for start_s, end_s, name in position_spans(plan):
        dwells = (each.dwell for each in plan.steps if start_s <= each.start_s < end_s and each.dwell)
        spans.append(PositionSpan(float(start_s), float(end_s), name, tuple(dict.fromkeys(dwells))))
    return PlannedProfile(time_s, chamber_c, gyro_c, tuple(spans))


def profile_of_telemetry(telemetry: Mapping[str, FloatArray]) -> MeasuredProfile:
    """Profile of a run from its telemetry, whose columns have the names of its series."""
    return MeasuredProfile(
        *(_evenly_chosen(telemetry[each.name], MAX_MEASURED) for each in fields(MeasuredProfile))
    )


def _evenly_chosen(values: FloatArray, max_count: int) -> tuple[float, ...]:
    """At most ``max_count`` values, evenly chosen, with the first and the last."""
    if len(values) > max_count:
        values = values[np.linspace(0, len(values) - 1, max_count).round().astype(int)]
    return tuple(map(float, values))


def snapshot_dwells(rows: Sequence[DwellRow]) -> tuple[SnapshotDwell, ...]:
    """Summary of each dwell."""
    return tuple(
        SnapshotDwell(
            row.dwell, row.cycle, row.position, row.gyro_c, row.bias_dph, row.sigma_dph, flag_text(row.flags)
        )
        for row in rows
    )


def live_bins(rows: Sequence[DwellRow], width_c: float) -> tuple[LiveBin, ...]:
    """Bins of the dwells without flags, including empty bins between them."""
    return tuple(
        LiveBin(row.gyro, row.position, row.bin_low_c, row.bin_high_c, row.bias_dph, row.sigma_dph, row.count)
        for row in bin_biases([each for each in rows if not each.flags], width_c)
    )
