"""Orders to a run under way, from a signal or from the terminal: pause, continue, hold, skip, abort."""

from __future__ import annotations

import signal
import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import FrameType, MappingProxyType, TracebackType


class Order(StrEnum):
    """What a person can tell a run."""

    PAUSE = "pause"
    CONTINUE = "continue"
    HOLD = "hold"
    SKIP = "skip"
    ABORT = "abort"


#: What each order does, for people.
MEANINGS: Mapping[Order, str] = MappingProxyType(
    {
        Order.PAUSE: "give up the dwell under way and wait; it is repeated on continue",
        Order.CONTINUE: "go on after a pause or a hold",
        Order.HOLD: "finish the dwell under way, then wait at this temperature",
        Order.SKIP: "leave the dwell under way out and go on with the next",
        Order.ABORT: "bring the bench to its safe state and end; the run can be resumed",
    }
)

#: Signals that give an order, the usual one first. Ctrl-Z pauses: a process that merely stopped would
#: leave the bench alone.
SIGNALS: Mapping[signal.Signals, Order] = MappingProxyType(
    {
        signal.SIGTERM: Order.ABORT,
        signal.SIGINT: Order.ABORT,
        signal.SIGHUP: Order.ABORT,
        signal.SIGTSTP: Order.PAUSE,
        signal.SIGCONT: Order.CONTINUE,
        signal.SIGUSR1: Order.HOLD,
        signal.SIGUSR2: Order.SKIP,
    }
)


_OF_THE_TERMINAL = (signal.SIGTTIN, signal.SIGTTOU)


@dataclass(frozen=True)
class GivenOrder:
    """An order and who gave it, for the journal."""

    order: Order
    by: str


class Orders:
    """Orders that nobody has looked at yet; the run looks at every tick.

    As a context manager it catches the signals, so that none of them can end the process in the middle of an
    exchange with an instrument.
    """

    def __init__(self) -> None:
        self._given: deque[GivenOrder] = deque()

    def __enter__(self) -> Orders:
        self._previous = {}
        if threading.current_thread() is threading.main_thread():
            # A signal that is ignored, as SIGHUP under nohup, stays ignored.
            heeded = [number for number in SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
            self._previous = {number: signal.signal(number, self._caught) for number in heeded}
            # A run in the background that finds somebody typing must not be stopped by that.
            for number in _OF_THE_TERMINAL:
                self._previous[number] = signal.signal(number, signal.SIG_IGN)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _caught(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002
        name = signal.Signals(number)
        self.give(SIGNALS[name], name.name)

    def give(self, order: Order, by: str) -> None:
        """Give an order; ``by`` says who or what does, for the journal."""
        self._given.append(GivenOrder(order, by))

    def take(self) -> GivenOrder | None:
        """The oldest order that has not been taken yet, but an abort before all others."""
        if not self._given:
            return None
        abort = next((given for given in self._given if given.order is Order.ABORT), None)
        if abort is not None:
            self._given.clear()
            return abort
        return self._given.popleft()
