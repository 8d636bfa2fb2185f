"""Calls of instruments and servers with a time limit."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError, wait
from typing import Generic, TypeVar

from gyrobench.bench.foundations.clock import Clock, Deadline
from gyrobench.bench.foundations.errors import ConnectionFailedError

_POLL_S = 0.25
_OPENING_TIME_S = 15.0

_ResultT = TypeVar("_ResultT")


def opening_time_s(clock: Clock) -> float:
    """Time limit for opening a port: in real time, expressed on the run's clock."""
    return _OPENING_TIME_S * clock.speed


class LimitedCall(Generic[_ResultT]):
    """A call of ``action`` with a time limit on the run's clock.

    On a wall clock it runs in a separate thread, which is abandoned at the limit. In virtual time nothing can
    hang, and the call is direct. ``discard`` receives a result that comes too late, for instance to close a
    port.
    """

    def __init__(
        self,
        clock: Clock,
        limit_s: float,
        instrument: str,
        action: Callable[[], _ResultT],
        discard: Callable[[_ResultT], None] = lambda _: None,
    ) -> None:
        self._clock, self._deadline, self._instrument = clock, Deadline(clock, limit_s), instrument
        self._discard = discard
        self._outcome: Future[_ResultT] = Future()
        if clock.is_virtual:
            self._perform(action)
        else:
            name = f"limited: {instrument}"
            threading.Thread(target=self._perform, args=(action,), name=name, daemon=True).start()

    def _perform(self, action: Callable[[], _ResultT]) -> None:
        try:
            result = action()
        except BaseException as error:  # noqa: BLE001 - raised again in the waiting thread
            with contextlib.suppress(InvalidStateError):
                self._outcome.set_exception(error)
            return
        try:
            self._outcome.set_result(result)
        except InvalidStateError:  # cancelled: too late
            self._discard(result)

    @property
    def is_over(self) -> bool:
        """Whether it has ended, or its time is over."""
        return self._outcome.done() or self._deadline.expired()

    def result(
        self, limit_s: float | None = None, meanwhile: Callable[[], object] = lambda: None
    ) -> _ResultT:
        """Wait for the result, for at most ``limit_s`` from now if given; calls ``meanwhile`` repeatedly.

        Raises ConnectionFailedError if the time is over. Errors of ``action`` are raised as they are.
        """
        deadline = self._deadline if limit_s is None else Deadline(self._clock, limit_s)
        while not wait([self._outcome], timeout=min(_POLL_S, deadline.remaining_s())).done:
            if deadline.expired() and self._outcome.cancel():
                raise ConnectionFailedError(
                    self._instrument,
                    f"its port did not respond within {deadline.duration_s:g} s. Check cable, adapter and "
                    "power.",
                )
            meanwhile()
        return self._outcome.result()

    def abandon(self) -> None:
        """Discard the result, present or future."""
        if not self._outcome.cancel() and self._outcome.exception() is None:
            self._discard(self._outcome.result())
