"""Sends messages to the receivers of a station, each with a thread, hourly limit and repeated attempts."""

from __future__ import annotations

import contextlib
import threading
from collections import defaultdict, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain, count, repeat
from types import TracebackType
from typing import Any

from gyrobench.bench.foundations.arrays import S_PER_H
from gyrobench.bench.foundations.clock import Clock, Deadline, WallClock
from gyrobench.bench.foundations.documents import DocumentProblem
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.messages.delivery import Message, UndeliveredError, deliver
from gyrobench.bench.station.receivers import Receiver
from gyrobench.bench.station.station_file import load_station_file


class Quota:
    """Limits the messages per hour about the same event."""

    def __init__(self, max_per_hour: int) -> None:
        self._sent_s: defaultdict[str, deque[float]] = defaultdict(lambda: deque(maxlen=max_per_hour))

    def lets_pass(self, about: str, now_s: float) -> bool:
        """Whether one more may be sent now; if so, it is counted."""
        sent_s = self._sent_s[about]
        if len(sent_s) == sent_s.maxlen and now_s - sent_s[0] < S_PER_H:
            return False
        sent_s.append(now_s)
        return True


#: Pauses between attempts.
_PAUSES_S = (5.0, 15.0, 60.0, 300.0, 600.0)
#: Maximum number of attempts, over about twelve hours.
_MAX_ATTEMPTS = 75
#: Pause between attempts while the process waits to end.
_LAST_PAUSE_S = 1.0


class _Sender:
    """Delivers messages to one receiver in order, with repeated attempts, by a daemon thread.

    A message stays in the queue until it is delivered, so that undelivered ones can be recorded.

    ``record``: called by the thread with the event of a journal entry and its details. ``pauses_s``: pauses
    between attempts; the last one repeats.
    """

    def __init__(
        self, receiver: Receiver, record: Callable[..., None], pauses_s: Sequence[float] = _PAUSES_S
    ) -> None:
        self._receiver = receiver
        self._pauses_s = pauses_s
        self._record = record
        self._queue: deque[Message] = deque()
        self._changed = threading.Condition()
        self._closing = threading.Event()
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._work, name=f"messages to {receiver.kind}", daemon=True)

    def post(self, message: Message) -> None:
        """Queue a message."""
        with self._changed:
            if self._thread.ident is None:
                self._thread.start()
            self._queue.append(message)
            self._changed.notify()

    def close(self) -> None:
        """Accept no more messages; queued ones are sent at once, then retried every second."""
        with self._changed:
            self._closing.set()
            self._changed.notify()

    def wait(self, duration_s: float) -> None:
        """Wait at most ``duration_s`` until the queue is empty, then abandon the remaining messages."""
        if self._thread.ident is not None:
            self._thread.join(duration_s)
        self._is_over.set()
        with self._changed:
            for message in self._queue:
                self._log("message_not_sent", message, why="the process ended first")

    def _work(self) -> None:
        while (message := self._next_message()) is not None:
            self._send(message)
            with self._changed:
                self._queue.popleft()

    def _next_message(self) -> Message | None:
        """The oldest queued message, which stays queued; None at the end."""
        with self._changed:
            while not self._queue and not self._closing.is_set():
                self._changed.wait()
            return self._queue[0] if self._queue and not self._is_over.is_set() else None

    def _send(self, message: Message) -> None:
        for attempt, pause_s in zip(
            count(1), chain(self._pauses_s, repeat(self._pauses_s[-1])), strict=False
        ):
            try:
                answer = deliver(self._receiver, message)
            except UndeliveredError as error:
                if error.is_final or attempt == _MAX_ATTEMPTS:
                    self._log("message_not_sent", message, why=str(error), attempts=attempt)
                    return
                if attempt == 1:
                    self._log("message_delayed", message, why=str(error))
                if self._closing.is_set():
                    self._is_over.wait(_LAST_PAUSE_S)
                else:
                    self._closing.wait(pause_s)
                if self._is_over.is_set():
                    return
            else:
                self._log("message_sent", message, answer=answer, attempts=attempt)
                return

    def _log(self, event: str, message: Message, **details: Any) -> None:
        self._record(event, to=self._receiver.name, about=message.event, **details)


#: Time for which a process waits at its end for queued messages.
PATIENCE_S = 15.0
#: Events that go to every receiver.
_EVENTS_FOR_ALL = ("guard_acted", "test")


class Messenger:
    """Sends messages to the receivers that chose their event; a context manager.

    Parameters
    ----------
    record : callable
        Called with the event of a journal entry and its details; never by two threads at once, nor after
        the exit.
    patience_s : float
        Time for which the exit waits for queued messages; also an attribute that may be changed.
    pauses_s : sequence of float
        Pauses between attempts.
    """

    def __init__(
        self,
        receivers: Sequence[Receiver],
        record: Callable[..., None],
        patience_s: float = 0.0,
        pauses_s: Sequence[float] = _PAUSES_S,
    ) -> None:
        self._record = record
        self.patience_s = patience_s
        self._record_lock = threading.Lock()
        self._has_exited = False
        self._clock: Clock = WallClock()  # real time, on a virtual run too
        self._channels = [
            (each, Quota(each.max_per_hour), _Sender(each, self._record_safely, pauses_s))
            for each in receivers
        ]

    def __enter__(self) -> Messenger:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        deadline = Deadline(self._clock, self.patience_s)
        for _, _, sender in self._channels:
            sender.close()
        for _, _, sender in self._channels:
            sender.wait(deadline.remaining_s())
        with self._record_lock:
            self._has_exited = True

    def send(self, message: Message, about: str) -> None:
        """Queue a message; those with the same event and ``about`` are limited per hour."""
        for receiver, quota, sender in self._channels:
            if message.event not in (*receiver.on, *_EVENTS_FOR_ALL):
                continue
            if quota.lets_pass(f"{message.event} {about}", self._clock.now()):
                sender.post(message)
            else:
                self._record_safely("message_withheld", to=receiver.name, about=message.event)

    def _record_safely(self, event: str, **details: Any) -> None:
        with self._record_lock:
            if not self._has_exited:
                with contextlib.suppress(RunFolderError):  # the run itself reports a full disk
                    self._record(event, **details)


@dataclass(frozen=True)
class Attempt:
    """Result of sending a message to one receiver."""

    receiver: str
    is_sent: bool
    reply: str


def send_test(station: str, text: str) -> list[Attempt]:
    """Send a test message once to each receiver of a station, by file or shipped name.

    Raises DocumentError if the station file is wrong, or has no receivers.
    """
    document, file = load_station_file(find_document("stations", station))
    if not file.messages:
        raise document.error([DocumentProblem((), "no receivers: the section `messages` is missing")])
    message = Message("test", text, file.station, WallClock().utc())
    attempts = []
    for receiver in file.messages:
        try:
            attempts.append(Attempt(receiver.name, True, deliver(receiver, message)))
        except UndeliveredError as error:
            attempts.append(Attempt(receiver.name, False, str(error)))
    return attempts
