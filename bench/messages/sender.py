"""One receiver's messages, sent in order by a thread of their own."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from itertools import chain, count, repeat
from typing import Any

from gyrobench.bench.messages.delivery import deliver
from gyrobench.bench.messages.message import Message
from gyrobench.bench.messages.undelivered import UndeliveredError
from gyrobench.bench.station.messages import Receiver

#: Pauses between attempts.
PAUSES_S = (5.0, 15.0, 60.0, 300.0, 600.0)
#: So many attempts take some twelve hours.
_MOST_ATTEMPTS = 75
#: Pause between attempts while the process waits to end.
_LAST_PAUSE_S = 1.0


class Sender:
    """Delivers messages to one receiver, and tries again where that fails.

    The thread ends with the process, whatever it is doing: a network that hangs holds nothing up.

    Parameters
    ----------
    receiver : Receiver
        Who gets the messages.
    record : callable
        Takes the event of a journal entry and its details; called by the thread.
    pauses_s : sequence of float
        Pauses between attempts; the last one again and again.
    """

    def __init__(
        self, receiver: Receiver, record: Callable[..., None], pauses_s: Sequence[float] = PAUSES_S
    ) -> None:
        self._receiver = receiver
        self._pauses_s = pauses_s
        self._record = record
        self._waiting: deque[Message] = deque()
        self._changed = threading.Condition()
        self._is_closing = False
        self._is_over = threading.Event()
        self._hurry = threading.Event()
        self._thread = threading.Thread(target=self._work, name=f"messages to {receiver.kind}", daemon=True)

    def post(self, message: Message) -> None:
        """Have a message sent; returns at once."""
        with self._changed:
            if self._thread.ident is None:
                self._thread.start()
            self._waiting.append(message)
            self._changed.notify()

    def close(self) -> None:
        """Take no more messages; what still waits is tried at once, and again every second."""
        with self._changed:
            self._is_closing = True
            self._changed.notify()
        self._hurry.set()

    def wait(self, duration_s: float) -> None:
        """Wait until all is sent, but not longer than that, then give up what is left."""
        if self._thread.ident is not None:
            self._thread.join(duration_s)
        self._is_over.set()
        with self._changed:
            for message in self._waiting:
                self._tell("message_not_sent", message, why="the process that had to send it ended")

    def _work(self) -> None:
        while (message := self._next()) is not None:
            self._send(message)
            with self._changed:
                self._waiting.popleft()

    def _next(self) -> Message | None:
        """The oldest message that waits; it goes on waiting until it is sent. None at the end."""
        with self._changed:
            while not self._waiting and not self._is_closing:
                self._changed.wait()
            return self._waiting[0] if self._waiting and not self._is_over.is_set() else None

    def _send(self, message: Message) -> None:
        for attempt, pause_s in zip(
            count(1), chain(self._pauses_s, repeat(self._pauses_s[-1])), strict=False
        ):
            try:
                answer = deliver(self._receiver, message)
            except UndeliveredError as error:
                if error.is_final or attempt == _MOST_ATTEMPTS:
                    self._tell("message_not_sent", message, why=str(error), attempts=attempt)
                    return
                if attempt == 1:
                    self._tell("message_delayed", message, why=str(error))
                self._pause(pause_s)
                if self._is_over.is_set():
                    return
            else:
                self._tell("message_sent", message, answer=answer, attempts=attempt)
                return

    def _pause(self, pause_s: float) -> None:
        if self._hurry.is_set():
            self._is_over.wait(_LAST_PAUSE_S)
        else:
            self._hurry.wait(pause_s)

    def _tell(self, event: str, message: Message, **details: Any) -> None:
        self._record(event, to=self._receiver.name, about=message.event, **details)
