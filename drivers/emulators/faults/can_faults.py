"""Faults of the CAN bus.

A disturbance of frames touches the next ``frames`` that have one of the ``ids``, or with ``for_s`` the
``share`` of them that come in that time.
"""

from __future__ import annotations

import copy
from functools import partial
from typing import Annotated, ClassVar, Literal

import can
import numpy as np
from pydantic import Field
from typing_extensions import override

from gyrobench.drivers.emulators.can_formats.gyrobench_ins import HEADING, INS_STATUS
from gyrobench.drivers.emulators.faults.fault import BenchParts, End, Fault, Occurrence
from gyrobench.drivers.emulators.faults.faulty_can import FaultyCan, FrameFilter
from gyrobench.drivers.emulators.faults.timing import Count, Lasting

Identifier = Annotated[int, Field(ge=0, le=0x7FF)]
#: Bits of a data frame with eight bytes, stuff bits and the gap after it among them.
_FRAME_BITS = 130.0


def filter_while(bus: FaultyCan, frame_filter: FrameFilter) -> End:
    """Let the frames go through a filter until the fault ends."""
    bus.filters.append(frame_filter)
    return partial(bus.filters.remove, frame_filter)


class FrameFault(Fault):
    """A disturbance of some frames."""

    lasting: ClassVar[Lasting] = Lasting.UNTIL_USED

    frames: Count = Field(1, description="without for_s: how many frames it touches")
    share: Annotated[float, Field(gt=0.0, le=1.0)] = Field(1.0, description="with for_s: the share of frames")
    ids: Annotated[list[Identifier], Field(min_length=1)] | None = Field(None, description="these ids alone")

    def arrive(self, arrived: list[can.Message], message: can.Message, random: np.random.Generator) -> None:
        """Add to what has arrived in this stretch of time what arrives of this frame."""
        raise NotImplementedError

    @override
    def begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        left = self.frames

        def frame_filter(messages: list[can.Message]) -> list[can.Message]:
            nonlocal left
            arrived: list[can.Message] = []
            for message in messages:
                if (left > 0 or self.for_s is not None) and self._picks(message, occurrence.random):
                    left -= 1
                    occurrence.record()
                    self.arrive(arrived, message, occurrence.random)
                else:
                    arrived.append(message)
            if left == 0 and self.for_s is None:
                bench.bus.filters.remove(frame_filter)
            return arrived

        end = filter_while(bench.bus, frame_filter)
        return end if self.for_s is not None else None

    def _picks(self, message: can.Message, random: np.random.Generator) -> bool:
        if self.ids is not None and message.arbitration_id not in self.ids:
            return False
        return self.for_s is None or self.share == 1.0 or random.random() < self.share


class FramesLost(FrameFault):
    """Frames do not arrive."""

    fault: Literal["frames_lost"]

    @override
    def arrive(self, arrived: list[can.Message], message: can.Message, random: np.random.Generator) -> None:
        """Nothing arrives."""


class FramesRepeated(FrameFault):
    """Frames arrive twice."""

    fault: Literal["frames_repeated"]

    @override
    def arrive(self, arrived: list[can.Message], message: can.Message, random: np.random.Generator) -> None:
        arrived += (message, copy.copy(message))


class FramesOutOfOrder(FrameFault):
    """Frames arrive before the one that was sent before them in the same epoch."""

    fault: Literal["frames_out_of_order"]

    @override
    def arrive(self, arrived: list[can.Message], message: can.Message, random: np.random.Generator) -> None:
        arrived.insert(-1, message)


class FramesCorrupted(FrameFault):
    """Bits of the data are wrong."""

    fault: Literal["frames_corrupted"]
    bits: int = Field(default=1, ge=1, le=8, description="how many bits of the data are wrong")

    @override
    def arrive(self, arrived: list[can.Message], message: can.Message, random: np.random.Generator) -> None:
        wrong = copy.copy(message)
        wrong.data = bytearray(message.data)
        size = 8 * len(wrong.data)
        for bit in random.choice(size, min(self.bits, size), replace=False).tolist():
            wrong.data[bit // 8] ^= 1 << bit % 8
        arrived.append(wrong)


class CounterJump(Fault):
    """The INS's epoch counter jumps; no epoch is lost."""

    lasting: ClassVar[Lasting] = Lasting.MOMENT

    fault: Literal["counter_jump"]
    by: int = Field(ge=1, le=65535, description="how far the epoch counter jumps")

    @override
    def begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        bench.ins.skip_epochs(self.by)
        occurrence.record()
        return None


class TimeStampJump(Fault):
    """The time stamps that the receiver gives to frames are wrong."""

    fault: Literal["time_stamp_jump"]
    by_s: float = Field(description="how wrong the time stamps are, s")

    @override
    def begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        def shifted(messages: list[can.Message]) -> list[can.Message]:
            for message in messages:
                message.timestamp += self.by_s
            return messages

        occurrence.record()
        return filter_while(bench.bus, shifted)


class BusOff(Fault):
    """The bench's CAN controller leaves the bus; after ``for_s`` it can be opened anew."""

    fault: Literal["bus_off"]

    @override
    def begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        bench.bus.connection.cut()
        occurrence.record()
        return bench.bus.connection.mend


class SecondNode(Fault):
    """Another INS with the same ids is on the bus: it repeats what it once sent, with counters of its own."""

    fault: Literal["second_node"]

    @override
    def begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        remembered: dict[int, bytes] = {}
        counters = {HEADING: (4, 0), INS_STATUS: (6, 0)}

        def others_too(messages: list[can.Message]) -> list[can.Message]:
            arriving: list[can.Message] = []
            for message in messages:
                identifier = message.arbitration_id
                other = copy.copy(message)
                other.data = bytearray(remembered.setdefault(identifier, bytes(message.data)))
                if identifier in counters:
                    place, count = counters[identifier]
                    other.data[place : place + 2] = (count & 0xFFFF).to_bytes(2, "little")
                    counters[identifier] = place, count + 1
                arriving += (message, other)
                occurrence.record()
            return arriving

        return filter_while(bench.bus, others_too)


class ForeignFrames(Fault):
    """Frames of other nodes fill the bus, as many as its bit rate carries beside the INS's own."""

    fault: Literal["foreign_frames"]
    load: Annotated[float, Field(gt=0.0, le=1.0)] = Field(1.0, description="share of the bus that is in use")
    bitrate: int = Field(default=500_000, ge=10_000, le=1_000_000, description="of the bus, bit/s")
    first_id: int = Field(default=0x300, ge=0, le=0x700, description="lowest identifier of their frames")
    nodes: Annotated[int, Field(ge=1, le=256)] = Field(64, description="how many ids, from first_id on")

    @override
    def begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        frame_s = _FRAME_BITS / self.bitrate / self.load
        free_from_s = 0.0
        sent = 0

        def crowded(messages: list[can.Message]) -> list[can.Message]:
            nonlocal free_from_s, sent
            arriving: list[can.Message] = []
            for message in messages:
                # After a silence of the INS the others are taken up from its next frame on.
                free_from_s = max(free_from_s, message.timestamp - 1.0)
                while free_from_s + frame_s < message.timestamp:
                    identifier = self.first_id + sent % self.nodes
                    data = sent.to_bytes(8, "little")
                    arriving.append(
                        can.Message(
                            timestamp=free_from_s, arbitration_id=identifier, data=data,
                            is_extended_id=False,
                        )
                    )  # fmt: skip
                    sent += 1
                    free_from_s += frame_s
                    occurrence.record()
                arriving.append(message)
                free_from_s += frame_s
            return arriving

        return filter_while(bench.bus, crowded)


CanFault = (
    FramesLost
    | FramesRepeated
    | FramesOutOfOrder
    | FramesCorrupted
    | CounterJump
    | TimeStampJump
    | BusOff
    | SecondNode
    | ForeignFrames
)
