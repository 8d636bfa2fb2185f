"""Angles of the gyros in a long navigation at rest, for their Allan variance."""

from __future__ import annotations

import numpy as np

from gyrobench.bench.characteristics.allan_test import RateRecord
from gyrobench.bench.dwells.dwell import MeasurementSetup
from gyrobench.bench.dwells.marks import DwellMarks
from gyrobench.bench.dwells.plateau_calibration import navigated_increments
from gyrobench.drivers.frames import FrameBlock

#: Longest segments are thinned to so many samples: the integral of the rate loses nothing between them.
_MAX_SAMPLES = 50_000


def rate_record(marks: DwellMarks, frames: FrameBlock, setup: MeasurementSetup) -> RateRecord:
    """Integrated rates of the gyros over the window of a noise record, in pieces where epochs are missing."""
    increments = navigated_increments(setup.decode(frames), setup.site)
    first, end = marks.windows[0].first_frame, marks.windows[-1].end_frame
    inside = (increments.row > first) & (increments.row < end)
    angle, follows = increments.angle[inside], increments.follows[inside]
    every = int(np.ceil(max(len(angle), 1) / _MAX_SAMPLES))
    pieces = np.split(angle, np.flatnonzero(~follows[1:]) + 1)
    segments = [np.vstack([np.zeros(3), np.cumsum(piece, axis=0)])[::every] for piece in pieces]
    return RateRecord(increments.interval_s * every, segments)
