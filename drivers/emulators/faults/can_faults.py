"""Faults of the CAN bus.

A disturbance affects the next ``frames`` frames that have one of the ``ids``; with ``for_s``, instead, the
``share`` of these frames in that time.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import partial
from typing import Annotated, Literal

import can
import numpy as np
from pydantic import Field

from gyrobench.drivers.emulators.can_formats.gyrobench_ins import HEADING, INS_STATUS
from gyrobench.drivers.emulators.faults.fault import (
    BenchParts,
    Count,
    End,
    Fault,
    FaultyCan,
    FrameFilter,
    Occurrence,
    Persistence,
)
from gyrobench.drivers.frames import FrameBlock

Identifier = Annotated[int, Field(ge=0, le=0x7FF)]
#: Bits of a data frame with eight bytes, with stuff bits and interframe space.
_FRAME_BITS = 130.0


def filter_while(bus: FaultyCan, frame_filter: FrameFilter) -> End:
    """Add a filter to the bus; returns the function that removes it."""
    bus.filters.append(frame_filter)
    return partial(bus.filters.remove, frame_filter)


def _by_message(message_filter: Callable[[list[can.Message]], list[can.Message]]) -> FrameFilter:
    return lambda frames: FrameBlock.from_messages(message_filter(frames.messages()))


class FrameFault(Fault):
    """A disturbance of some frames."""

    immediate = False
    persistence = Persistence.UNTIL_USED

    frames: Count = Field(1, description="without for_s: number of affected frames")
    share: Annotated[float, Field(gt=0.0, le=1.0)] = Field(1.0, description="with for_s: share of frames")
    ids: Annotated[list[Identifier], Field(min_length=1)] | None = Field(None, description="only these ids")

    def _arrive(self, arrived: list[can.Message], message: can.Message, random: np.random.Generator) -> None:
        """Append the frames that arrive for ``message`` to those that have already arrived."""
        raise NotImplementedError

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        remaining = self.frames

        def disturb(messages: list[can.Message]) -> list[can.Message]:
            nonlocal remaining
            arrived: list[can.Message] = []
            for message in messages:
                if (remaining > 0 or self.for_s is not None) and self._affects(message, occurrence.random):
                    remaining -= 1
                    occurrence.record()
                    self._arrive(arrived, message, occurrence.random)
                else:
                    arrived.append(message)
            if remaining == 0 and self.for_s is None:
                bench.bus.filters.remove(frame_filter)
            return arrived

        frame_filter = _by_message(disturb)
        end = filter_while(bench.bus, frame_filter)
        return end if self.for_s is not None else None

    def _affects(self, message: can.Message, random: np.random.Generator) -> bool:
        if self.ids is not None and message.arbitration_id not in self.ids:
            return False
        return self.for_s is None or self.share == 1.0 or random.random() < self.share


class FramesLost(FrameFault):
    """Frames do not arrive."""

    fault: Literal["frames_lost"]

    def _arrive(self, arrived: list[can.Message], message: can.Message, random: np.random.Generator) -> None:
        """Nothing arrives."""


class FramesRepeated(FrameFault):
    """Frames arrive twice."""

    fault: Literal["frames_repeated"]

    def _arrive(self, arrived: list[can.Message], message: can.Message, random: np.random.Generator) -> None:
        arrived += (message, copy.copy(message))


class FramesOutOfOrder(FrameFault):
    """Frames arrive before the one that was sent before them in the same epoch."""

    fault: Literal["frames_out_of_order"]

    def _arrive(self, arrived: list[can.Message], message: can.Message, random: np.random.Generator) -> None:
        arrived.insert(-1, message)


class FramesCorrupted(FrameFault):
    """Bits of the data are wrong."""

    fault: Literal["frames_corrupted"]
    bits: int = Field(1, ge=1, le=8, description="number of wrong bits")

    def _arrive(self, arrived: list[can.Message], message: can.Message, random: np.random.Generator) -> None:
        wrong = copy.copy(message)
        wrong.data = bytearray(message.data)
        size = 8 * len(wrong.data)
        for bit in random.choice(size, min(self.bits, size), replace=False).tolist():
            wrong.data[bit // 8] ^= 1 << bit % 8
        arrived.append(wrong)


class CounterJump(Fault):
    """The INS's epoch counter jumps; no epoch is lost."""

    persistence = Persistence.MOMENTARY

    fault: Literal["counter_jump"]
    by: int = Field(ge=1, le=65535, description="size of the jump, epochs")

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        bench.ins.format.skip_epochs(self.by)
        return None


class TimeStampJump(Fault):
    """The receiver's time stamps of the frames are wrong."""

    fault: Literal["time_stamp_jump"]
    by_s: float = Field(description="error of the time stamps, s")

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        def shift(frames: FrameBlock) -> FrameBlock:
            return frames.with_fields(time_s=frames.timestamp_s + self.by_s)

        return filter_while(bench.bus, shift)


class BusOff(Fault):
    """The bench's CAN controller goes bus-off; after ``for_s`` it can be reopened."""

    fault: Literal["bus_off"]

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        bench.bus.connection.disconnect()
        return bench.bus.connection.reconnect


class SecondNode(Fault):
    """Another INS with the same ids is on the bus: it repeats old data with its own counters."""

    immediate = False
    fault: Literal["second_node"]

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        remembered: dict[int, bytes] = {}
        counters = {HEADING: (4, 0), INS_STATUS: (6, 0)}

        def add_other_node(messages: list[can.Message]) -> list[can.Message]:
            arriving: list[can.Message] = []
            for message in messages:
                identifier = message.arbitration_id
                other = copy.copy(message)
                other.data = bytearray(remembered.setdefault(identifier, bytes(message.data)))
                if identifier in counters:
                    first_byte, count = counters[identifier]
                    other.data[first_byte : first_byte + 2] = (count & 0xFFFF).to_bytes(2, "little")
                    counters[identifier] = first_byte, count + 1
                arriving += (message, other)
                occurrence.record()
            return arriving

        return filter_while(bench.bus, _by_message(add_other_node))


class ForeignFrames(Fault):
    """Frames of other nodes load the bus, as many as its bit rate allows beside the INS's frames."""

    immediate = False
    fault: Literal["foreign_frames"]
    load: Annotated[float, Field(gt=0.0, le=1.0)] = Field(1.0, description="bus load, 1 for a full bus")
    bitrate: int = Field(500_000, ge=10_000, le=1_000_000, description="bit rate of the bus, bit/s")
    first_id: int = Field(0x300, ge=0, le=0x700, description="lowest identifier of their frames")
    nodes: Annotated[int, Field(ge=1, le=256)] = Field(64, description="number of ids, from first_id on")

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        frame_s = _FRAME_BITS / self.bitrate / self.load
        free_from_s = 0.0
        sent = 0

        def add_foreign_frames(messages: list[can.Message]) -> list[can.Message]:
            nonlocal free_from_s, sent
            arriving: list[can.Message] = []
            for message in messages:
                # After a silence of the INS the foreign frames resume one second before its next frame.
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

        return filter_while(bench.bus, _by_message(add_foreign_frames))
