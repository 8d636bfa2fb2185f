"""Common base of all faults: timing keys, the parts of the bench that faults act on, and faulty lines.

Wrappers of the serial line and the CAN bus disturb the exchange between an emulated instrument and its
clients.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Annotated, ClassVar, Literal, NamedTuple, TypeVar

import can
import numpy as np
from pydantic import Field, model_validator

from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.drivers.emulators.can_ins import CanInsEmulator
from gyrobench.drivers.emulators.dialect import Connection, SerialInstrument
from gyrobench.drivers.emulators.world.undeclared_effects import NotNegative, Positive
from gyrobench.drivers.emulators.world.world import World
from gyrobench.drivers.frames import FrameBlock


class Reply(NamedTuple):
    """Bytes that arrive from the instrument, and their delay beyond the usual latency."""

    data: bytes
    delay_s: float = 0.0


@dataclass
class Exchange:
    """A request to an instrument, for a fault that may disturb it."""

    request: bytes
    earlier_reply: bytes  #: Reply to the previous request.
    execute: Callable[[], bytes]  #: Makes the instrument execute the request; returns its reply.

    @cached_property
    def answer(self) -> bytes:
        """The correct reply; the instrument executes the request when this is first read."""
        return self.execute()


#: Returns the reply in place of the correct one; None leaves the exchange unchanged.
Disturbance = Callable[[Exchange], Reply | None]
#: Returns the frames that arrive for the frames that were sent, without changing the latter.
FrameFilter = Callable[[FrameBlock], FrameBlock]


class FaultySerial:
    """An emulated instrument whose exchanges may be disturbed."""

    def __init__(self, instrument: SerialInstrument) -> None:
        self._instrument = instrument
        self.latency_s = instrument.latency_s  #: Latency of the reply that :meth:`feed` last returned.
        self.connection = Connection()  #: The plug.
        self.powered = True  #: Whether the instrument has power; without, it is silent.
        self.disturbances: list[Disturbance] = []  #: Only the first that returns a reply is applied.
        self._earlier_reply = b""

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Receive bytes; see :meth:`gyrobench.drivers.emulators.dialect.SerialInstrument.feed`."""
        self.latency_s = self._instrument.latency_s
        if not self.powered:
            return b""
        exchange = Exchange(data, self._earlier_reply, lambda: self._instrument.feed(data, now_s))
        for disturbance in tuple(self.disturbances):
            reply = disturbance(exchange)
            if reply is not None:
                break
        else:
            reply = Reply(exchange.answer)
        if "answer" in vars(exchange):
            self._earlier_reply = exchange.answer or self._earlier_reply
        self.latency_s += reply.delay_s
        return reply.data


class FaultyCan:
    """The emulated INS with filters that disturb its frames; a CanNode."""

    def __init__(self, ins: CanInsEmulator) -> None:
        self._ins = ins
        self.listeners: list[Callable[[FrameBlock], None]] = []
        self.connection = Connection()  #: Broken while the controller is bus-off.
        self.filters: list[FrameFilter] = []  #: Filters of the frames, applied in this order.
        ins.listeners.append(self._forward)

    def receive(self, message: can.Message) -> None:
        """Pass a frame to the INS."""
        if not self.connection.broken:
            self._ins.receive(message)

    def _forward(self, frames: FrameBlock) -> None:
        if self.connection.broken:
            return
        for frame_filter in tuple(self.filters):
            frames = frame_filter(frames)
        if len(frames):
            for listener in self.listeners:
                listener(frames)


Count = Annotated[int, Field(ge=1)]
#: Mean spacing, s; the minimum limits the computing time of a run.
_Spacing = Annotated[float, Field(ge=1.0)]
#: Phase of the emulated bench, determined from the state of the world.
BenchPhase = Literal["power_on", "align", "navigate", "turn", "ramp"]
#: Function that ends a fault; None if it ends by itself.
End = Callable[[], None] | None

_CapabilityT = TypeVar("_CapabilityT")


class Persistence(Enum):
    """Duration of a kind of fault without ``for_s``."""

    MOMENTARY = "happens at one moment; for_s is not allowed"
    UNTIL_USED = "affects as many of the next replies or frames as its own key gives"
    PERMANENT = "lasts until the end of the run"


class Timing(StrictModel):
    """Keys of every entry: exactly one of ``at_s``, ``every_s`` and ``during``, and the duration."""

    persistence: ClassVar[Persistence] = Persistence.PERMANENT

    at_s: NotNegative | None = Field(None, description="time on the bench's clock, s")
    every_s: _Spacing | None = Field(None, description="mean spacing of random times, from the seed, s")
    from_s: NotNegative = Field(0.0, description="with every_s: not before this time, s")
    during: BenchPhase | None = Field(None, description="phase of the bench")
    after_s: NotNegative = Field(0.0, description="with during: delay from the start of the phase, s")
    nth: Count = Field(1, description="with during: the first such phase that counts")
    times: Count | None = Field(
        None, description="maximum number of times; by default, at_s and during once, every_s unlimited"
    )
    for_s: Positive | None = Field(None, description="duration, s")
    unit: Count = Field(1, description="number of the unit that it affects, and whose phase during means")

    @property
    def duration_s(self) -> float:
        """Time from start to end; zero for a fault that ends by itself, infinite for a permanent one."""
        if self.for_s is not None:
            return self.for_s
        return math.inf if self.persistence is Persistence.PERMANENT else 0.0

    @property
    def max_times(self) -> float:
        """Maximum number of times."""
        if self.times is not None:
            return self.times
        return math.inf if self.every_s is not None else 1

    @model_validator(mode="after")
    def _check_timing(self) -> Timing:
        timing_keys = [key for key in ("at_s", "every_s", "during") if getattr(self, key) is not None]
        if len(timing_keys) != 1:
            raise ValueError("an entry has exactly one of the keys at_s, every_s and during")
        for key, needs in {"from_s": "every_s", "after_s": "during", "nth": "during"}.items():
            if key in self.model_fields_set and needs not in timing_keys:
                raise ValueError(f"{key} is allowed only with {needs}")
        if self.at_s is not None and self.max_times > 1:
            raise ValueError("at_s is one moment; for more times use every_s or another entry")
        if self.persistence is Persistence.MOMENTARY and self.for_s is not None:
            raise ValueError("for_s is not allowed here: this fault happens at one moment")
        if self.max_times > 1 and math.isinf(self.duration_s):
            raise ValueError("a fault that repeats must end: add for_s")
        return self


class UnsupportedFaultError(Exception):
    """The emulators of this bench do not support a fault; caught where a list of faults is checked."""


@dataclass(frozen=True)
class BenchParts:
    """The parts of an emulated bench that faults act on, with one of its units."""

    world: World
    table: SerialInstrument
    chamber: SerialInstrument
    ins: CanInsEmulator
    lines: Mapping[str, FaultySerial]  #: ``table`` and ``chamber`` at their ports.
    bus: FaultyCan
    dialects: Mapping[str, str]  #: Dialects of ``table`` and ``chamber``.

    def require_capability(self, name: str, capability: type[_CapabilityT]) -> _CapabilityT:
        """Return the table or the chamber, with the type of the capability that a fault needs.

        Raises UnsupportedFaultError if the emulator of this dialect lacks it.
        """
        instrument = self.table if name == "table" else self.chamber
        if not isinstance(instrument, capability):
            raise UnsupportedFaultError(
                f"the emulated {name} of the dialect {self.dialects.get(name)} does not support it"
            )
        return instrument


@dataclass(frozen=True)
class Occurrence:
    """One occurrence of a fault."""

    now_s: Callable[[], float]  #: Returns the time on the bench's clock.
    random: np.random.Generator  #: Random numbers of the entry in the list.
    #: Called when the fault takes effect; only the first call of an occurrence counts.
    record: Callable[[], None]


class Fault(Timing):
    """Base class of the kinds of faults; a subclass has its name as the value of the key ``fault``."""

    #: ``table`` or ``chamber``, and the capability that its emulator needs for this fault; None for none.
    requires: ClassVar[tuple[str, type] | None] = None
    #: Whether it takes effect when it starts; otherwise the subclass calls ``occurrence.record``.
    immediate: ClassVar[bool] = True

    @property
    def kind(self) -> str:
        """Name of the kind of fault."""
        return str(getattr(self, "fault"))  # noqa: B009

    def check(self, bench: BenchParts) -> None:
        """Raise UnsupportedFaultError if this bench does not support the fault."""
        if self.requires is not None:
            bench.require_capability(*self.requires)

    def begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        """Start the fault; returns the function that ends it. The world is at the present time."""
        if self.immediate:
            occurrence.record()
        return self._begin(bench, occurrence)

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        raise NotImplementedError
