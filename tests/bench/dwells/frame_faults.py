"""Faults put into the frames of a recorded dwell, as CAN, INS and table would make them.

The frames are those of the shipped DBC file.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gyrobench.bench.runs.marks import DwellMarks
from gyrobench.drivers.frames import FrameBlock

TIME, VELOCITY, ROLL_PITCH, HEADING, STATUS, OPTICS, ELECTRONICS = 0x01, 0x04, 0x06, 0x07, 0x10, 0x20, 0x21
#: Messages of an epoch.
EPOCH = (VELOCITY, ROLL_PITCH, HEADING)


@dataclass(frozen=True)
class Recording:
    """Marks and frames of a dwell; what is done to the frames carries the marks along."""

    marks: DwellMarks
    frames: FrameBlock

    def rows(self, *identifiers, window=None):
        """Numbers of the frames with some identifiers, of one window (0, 1) or of both with the turn."""
        windows = self.marks.windows
        first, last = (windows[0], windows[-1]) if window is None else (windows[window],) * 2
        numbers = np.arange(first.first_frame, last.end_frame)
        return numbers[np.isin(self.frames.arbitration_id[numbers], identifiers)]

    def row_at(self, share, window=0):
        """The first frame at a share of a window's length."""
        mark = self.marks.windows[window]
        return round(mark.first_frame + share * (mark.end_frame - mark.first_frame))

    def seconds(self, begin, duration_s):
        """Numbers of all frames of some seconds from a frame on."""
        stamps_s = self.frames.timestamp_s
        return np.flatnonzero((np.arange(len(stamps_s)) >= begin) & (stamps_s < stamps_s[begin] + duration_s))

    def arriving(self, order):
        """Frames by their numbers in the order of arrival: left out, repeated, exchanged."""
        order = np.asarray(order)

        def moved(number):
            return None if number is None else int(np.sum(np.sort(order) < number))

        windows = tuple(
            replace(
                mark,
                first_frame=moved(mark.first_frame),
                end_frame=moved(mark.end_frame),
                turn_first_frame=moved(mark.turn_first_frame),
                turn_end_frame=moved(mark.turn_end_frame),
            )
            for mark in self.marks.windows
        )
        frames = self.frames.take(order)
        stamps_s = np.maximum.accumulate(frames.timestamp_s)
        return Recording(replace(self.marks, windows=windows), frames.with_fields(time_s=stamps_s))

    def without(self, rows):
        """Some frames are lost."""
        return self.arriving(np.delete(np.arange(len(self.frames)), rows))

    def with_second_node(self, identifier, data):
        """A second node sends frames (n, 8) with the same identifier, each just after those of the first."""
        own = np.flatnonzero(self.frames.arbitration_id == identifier)
        order = np.insert(np.arange(len(self.frames)), own + 1, own)
        doubled = self.arriving(order)
        payload = doubled.frames.data.copy()
        payload[own + np.arange(1, len(own) + 1)] = data
        return replace(doubled, frames=doubled.frames.with_fields(data=payload))

    def with_foreign_frames(self, each):
        """``each`` frames of other nodes after each frame."""
        foreign = np.repeat(np.arange(len(self.frames)), 1 + each)
        loaded = self.arriving(foreign)
        identifiers = loaded.frames.arbitration_id.copy()
        identifiers[np.arange(len(foreign)) % (1 + each) != 0] = 0x555
        return replace(loaded, frames=loaded.frames.with_fields(id=identifiers))

    def with_payload(self, rows, data):
        """Other data (n, 8) in some frames."""
        payload = self.frames.data.copy()
        payload[rows] = data
        return replace(self, frames=self.frames.with_fields(data=payload))

    def field(self, rows, byte, kind):
        """Values of a field in some frames; ``kind`` is "i4", "i2", "u2" and the like."""
        width = np.dtype(kind).itemsize
        part = np.ascontiguousarray(self.frames.data[rows, byte : byte + width])
        return part.view(f"<{kind}")[:, 0]

    def with_field(self, rows, byte, kind, values):
        """Set them, wrapping as the field does."""
        width = np.dtype(kind).itemsize
        raw = np.asarray(np.broadcast_to(values, np.shape(rows))).astype(np.int64).astype(f"<{kind}")
        data = self.frames.data[rows]
        data[:, byte : byte + width] = raw[:, np.newaxis].view(np.uint8)
        return self.with_payload(rows, data)

    def with_more(self, rows, byte, kind, change):
        """Add to them."""
        return self.with_field(rows, byte, kind, self.field(rows, byte, kind).astype(np.int64) + change)

    def with_flipped_bit(self, row, byte, bit):
        """One bit of one frame the other way."""
        data = self.frames.data[[row]]
        data[0, byte] ^= 1 << bit
        return self.with_payload([row], data)

    def stuck(self, rows, byte, kind):
        """A field keeps the value of the first of some frames."""
        return self.with_field(rows, byte, kind, self.field(rows[:1], byte, kind)[0])

    def turned_by_hand(self, rows, change_deg):
        """Headings of some HEADING frames turned by angles (n,) about the vertical."""
        heading = self.field(rows, 0, "i4") * 1e-6 + change_deg
        return self.with_field(rows, 0, "i4", np.rint(np.mod(heading, 360.0) * 1e6))
