"""Telling people off the bench that the guard had to act: nobody else can any more."""

from __future__ import annotations

import contextlib
from types import TracebackType
from typing import Any

from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.errors import GyrobenchError
from gyrobench.bench.guard.log import GuardLog
from gyrobench.bench.guard.watch import Ending
from gyrobench.bench.messages.message import Message
from gyrobench.bench.messages.messenger import Messenger
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import RunFacts, facts_of, read_journal
from gyrobench.bench.station.station import Station

#: The guard has nothing else to do; networks come back.
_PATIENCE_S = 900.0


class AlarmSender:
    """Sends what the guard has to tell; leaving it waits until that has gone, for a quarter of an hour.

    Parameters
    ----------
    station, folder, clock, log
        Those of the guard.
    """

    def __init__(self, station: Station, folder: RunFolder, clock: Clock, log: GuardLog) -> None:
        self._station = station
        self._folder = folder
        self._clock = clock
        self._log = log
        self._messenger = Messenger(station.file.messages, self._note, _PATIENCE_S)

    def __enter__(self) -> AlarmSender:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._messenger.__exit__(kind, error, trace)

    def raise_for(self, ending: Ending, found: str) -> None:
        """Say how the engine ended, and how the bench is."""
        known = self._facts()
        message = Message(
            event="guard_acted",
            why=f"{ending.value[0].upper()}{ending.value[1:]}, so the guard acted. {found}\n"
            f"When all is in order: gyrobench resume {self._folder.path}",
            station=self._station.file.station,
            time=self._clock.utc(),
            folder=self._folder.path,
            procedure=known.procedure,
            unit=known.unit,
        )
        self._messenger.send(message, about=found)

    def _facts(self) -> RunFacts:
        """What the journal tells, up to where it is damaged."""
        entries: list[dict[str, Any]] = []
        with contextlib.suppress(GyrobenchError):
            entries.extend(read_journal(self._folder.journal))
        return facts_of(entries)

    def _note(self, event: str, **details: Any) -> None:
        told = ", ".join(f"{key} {value}" for key, value in details.items())
        self._log.add(f"{event.replace('_', ' ')}: {told}")
