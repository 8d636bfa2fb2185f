"""All receivers of a station."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any

from gyrobench.bench.foundations.clock import Clock, Deadline, WallClock
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.messages.message import Message
from gyrobench.bench.messages.quota import Quota
from gyrobench.bench.messages.sender import PAUSES_S, Sender
from gyrobench.bench.station.messages import Receiver

#: So long a process waits at its end for messages that are still to go.
PATIENCE_S = 15.0
#: Events that every receiver is told of.
_FOR_ALL = ("guard_acted", "test")


class Messenger:
    """Sends messages to those of the receivers that want them; a context manager.

    Leaving it waits until all is sent, but not longer than ``patience_s``.

    Parameters
    ----------
    receivers : sequence of Receiver
        Those of the station file.
    record : callable
        Takes the event of a journal entry and its details; never called by two threads at once, and not
        after the messenger was left.
    patience_s : float
        How long leaving may take.
    pauses_s : sequence of float
        Pauses before a message that could not be sent is tried again.

    Attributes
    ----------
    patience_s : float
        As above; may be changed.
    """

    def __init__(
        self,
        receivers: Sequence[Receiver],
        record: Callable[..., None],
        patience_s: float = 0.0,
        pauses_s: Sequence[float] = PAUSES_S,
    ) -> None:
        self._record = record
        self.patience_s = patience_s
        self._recording = threading.Lock()
        self._is_left = False
        self._clock: Clock = WallClock()  # hours and patience are those of people, on a virtual run too
        self._sendings = [
            (each, Quota(each.most_per_hour), Sender(each, self._record_once, pauses_s)) for each in receivers
        ]

    def __enter__(self) -> Messenger:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        deadline = Deadline(self._clock, self.patience_s)
        for _, _, sender in self._sendings:
            sender.close()
        for _, _, sender in self._sendings:
            sender.wait(deadline.remaining_s())
        with self._recording:
            self._is_left = True

    def send(self, message: Message, about: str) -> None:
        """Send a message; returns at once.

        Parameters
        ----------
        about : str
            What makes a message the same as another one, beside its event.
        """
        for receiver, quota, sender in self._sendings:
            if message.event not in (*receiver.on, *_FOR_ALL):
                continue
            if quota.lets_pass(f"{message.event} {about}", self._clock.now()):
                sender.post(message)
            else:
                self._record_once("message_withheld", to=receiver.name, about=message.event)

    def _record_once(self, event: str, **details: Any) -> None:
        with self._recording:
            if not self._is_left:
                with contextlib.suppress(RunFolderError):  # a full disk is told by the run itself
                    self._record(event, **details)
