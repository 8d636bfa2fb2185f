"""The raw CAN log, part by part, every frame with its calendar time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import can

from gyrobench.bench.dwells.run_dwells import finished_marks
from gyrobench.bench.runs.can_log import read_can_log
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.provenance import started_utc

#: 1990-01-01 UTC: no time before it is one of the calendar, for the BLF format neither.
_FIRST_CALENDAR_S = 631_152_000.0


@dataclass(frozen=True)
class PlacedPart:
    """One part of the log.

    Attributes
    ----------
    number : int
        Of the part.
    messages : list of can.Message
        In the order received, time stamps in seconds since 1970 UTC.
    """

    number: int
    messages: list[can.Message]


class PlacedLog:
    """The parts of a run's log that hold frames, one after the other; one is in memory at a time.

    A part that was never closed, and any part where the CAN adapter has a clock of its own, tells times
    from its first frame on only. Where a finished dwell is in it, that tells the time.

    Attributes
    ----------
    finished : dict of int to DwellMarks
        Marks of the finished dwells by their part.
    estimated : list of int
        Parts met so far whose time is not known exactly: they are put behind the part before.

    Raises
    ------
    RunFolderError
        Log, journal or provenance can't be read.
    """

    def __init__(self, folder: RunFolder) -> None:
        self.finished = {marks.log_part: marks for marks in finished_marks(folder)}
        self.estimated: list[int] = []
        self.began_s = started_utc(folder).timestamp()
        self._folder = folder.can

    def __iter__(self) -> Iterator[PlacedPart]:
        end_s = self.began_s
        for number, messages in read_can_log(self._folder):
            if not messages:
                continue
            if messages[0].timestamp < _FIRST_CALENDAR_S:
                shift_s = self._shift_s(number, messages, end_s)
                for message in messages:
                    message.timestamp += shift_s
            end_s = messages[-1].timestamp
            yield PlacedPart(number, messages)

    def _shift_s(self, number: int, messages: list[can.Message], end_s: float) -> float:
        """What to add to the times of a part."""
        marks = self.finished.get(number)
        if marks is not None and marks.windows[0].first_frame < len(messages):
            begin_s = self.began_s + marks.start_s
            return begin_s - messages[marks.windows[0].first_frame].timestamp
        self.estimated.append(number)
        return end_s - messages[0].timestamp
