"""A limit of time around calls that can't be relied on to end: opening a port, a hanging adapter."""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import TypeVar

from gyrobench.bench.foundations.clock import Clock, Deadline
from gyrobench.bench.foundations.errors import ConnectionFailedError

_LOOK_S = 0.25

ResultT = TypeVar("ResultT")


class _Call:
    """One call in a thread of its own; its result goes to whoever waits, or is discarded."""

    def __init__(self, action: Callable[[], object], discard: Callable[[object], None]) -> None:
        self._action = action
        self._discard = discard
        self._given_up = False
        self._lock = threading.Lock()
        self.answers: SimpleQueue[tuple[object, BaseException | None]] = SimpleQueue()

    def perform(self) -> None:
        result: object = None
        failed: BaseException | None = None
        try:
            result = self._action()
        except BaseException as error:  # noqa: BLE001 - raised again where the result is waited for
            failed = error
        with self._lock:
            self.answers.put((result, failed))
            late = self._given_up and failed is None
        if late:
            self._discard(result)

    def give_up(self) -> bool:
        """Wait no longer; False where the answer came at the last moment."""
        with self._lock:
            self._given_up = self.answers.empty()
        return self._given_up


def within(
    clock: Clock,
    limit_s: float,
    instrument: str,
    action: Callable[[], ResultT],
    discard: Callable[[ResultT], None] = lambda _: None,
    meanwhile: Callable[[], object] = lambda: None,
) -> ResultT:
    """Do something that has to end in a given time.

    On a wall clock it is done in a thread of its own, which is left alone when its time is over;
    in virtual time nothing can hang, and it is done at once.

    Parameters
    ----------
    limit_s : float
        Time allowed, on the run's clock.
    instrument : str
        Named in the error.
    action : callable
        What to do.
    discard : callable
        Gets a result that came too late, for instance to close the port that was opened.
    meanwhile : callable
        Called now and then while waiting.

    Raises
    ------
    ConnectionFailedError
        The time is over. Whatever ``action`` raises is raised as well.
    """
    if clock.is_virtual:
        return action()
    call = _Call(action, discard)  # type: ignore[arg-type]
    threading.Thread(target=call.perform, name=f"limited: {instrument}", daemon=True).start()
    deadline = Deadline(clock, limit_s)
    while True:
        try:
            result, error = call.answers.get(timeout=min(_LOOK_S, deadline.remaining_s()) or 0.001)
            break
        except Empty:
            if deadline.expired() and call.give_up():
                raise ConnectionFailedError(
                    instrument, f"its port hangs: no end after {limit_s:g} s. Check cable, adapter and power."
                ) from None
        meanwhile()
    if error is not None:
        raise error
    return result  # type: ignore[return-value]
