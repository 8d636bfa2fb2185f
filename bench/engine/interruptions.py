"""What takes the engine out of a step."""

from __future__ import annotations

from collections.abc import Sequence

from gyrobench.bench.engine.interlocks import Finding, Trip, text_of
from gyrobench.bench.engine.orders import GivenOrder
from gyrobench.bench.foundations.errors import (
    FaultError,
    GyrobenchError,
    InstrumentError,
    InterlockError,
    RefusedError,
)
from gyrobench.bench.procedure.steps import PowerOn, Step
from gyrobench.bench.station.interlocks import InterlockRule
from gyrobench.bench.station.station import Station

_SILENT = {"rate table": "table_silence", "chamber": "chamber_silence", "INS": "ins_silence"}
_FAULTY = {"rate table": "table_fault", "chamber": "chamber_alarm", "INS": "ins_fault"}


class TrippedError(InterlockError):
    """Interlocks are tripped."""

    def __init__(self, trips: Sequence[Trip]) -> None:
        super().__init__(text_of(trips))
        self.trips = trips


class OrderedError(GyrobenchError):
    """Somebody ordered a pause, or to skip the dwell under way."""

    def __init__(self, given: GivenOrder) -> None:
        super().__init__(f"{given.order} by {given.by}")
        self.given = given


def trip_of(error: GyrobenchError, station: Station, step: Step | None = None) -> Trip:
    """The interlock by whose rule a failed step is treated: the instrument is silent, or at fault.

    A step that did not reach its end needs a person, but for an INS that did not come up.
    """
    rules = station.file.interlocks
    name = "step"
    if isinstance(error, InstrumentError):
        at_fault = isinstance(error, FaultError | RefusedError)
        name = (_FAULTY if at_fault else _SILENT)[error.instrument]
    elif isinstance(step, PowerOn):
        name = "ins_silence"
    rule = InterlockRule() if name == "step" else getattr(rules, name)
    return Trip(name, (Finding(name, str(error), ""),), rule)
