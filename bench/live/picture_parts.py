"""What a picture of a run is made of: temperatures, step, dwell, biases, alarms, in plain numbers and text.

Times are on the run's clock unless a name says otherwise. A number that is not known is NaN, null in JSON.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import BeforeValidator, ConfigDict

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
