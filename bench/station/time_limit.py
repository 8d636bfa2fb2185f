"""Calls of instruments and servers with a time limit."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError, wait
from typing import TypeVar

from gyrobench.bench.foundations.clock import Clock, Deadline
from gyrobench.bench.foundations.errors import ConnectionFailedError

_POLL_S = 0.25

_ResultT = TypeVar("_ResultT")


def call_within(
    clock: Clock,
    limit_s: float,
    instrument: str,
    action: Callable[[], _ResultT],
    discard: Callable[[_ResultT], None] = lambda _: None,
    meanwhile: Callable[[], object] = lambda: None,
) -> _ResultT:
    """Call ``action`` with a time limit and return its result.

    On a wall clock it runs in a separate thread, which is abandoned at the limit. In virtual time nothing can
    hang, and the call is direct. ``limit_s`` is on the run's clock. ``discard`` receives a result that comes
    too late, for instance to close a port; ``meanwhile`` is called repeatedly while waiting. Raises
    ConnectionFailedError if the time is over. Errors of ``action`` are raised as they are.
    """
    if clock.is_virtual:
        return action()
    outcome = begin_call(instrument, action, discard)
    return await_call(Deadline(clock, limit_s), instrument, outcome, meanwhile)


def begin_call(
    instrument: str, action: Callable[[], _ResultT], discard: Callable[[_ResultT], None]
) -> Future[_ResultT]:
    """Call ``action`` in a separate thread; ``discard`` receives the result if the future was cancelled."""
    outcome: Future[_ResultT] = Future()

    def perform() -> None:
        try:
            result = action()
        except BaseException as error:  # noqa: BLE001 - raised again in the waiting thread
            with contextlib.suppress(InvalidStateError):
                outcome.set_exception(error)
            return
        try:
            outcome.set_result(result)
        except InvalidStateError:  # cancelled: too late
            discard(result)

    threading.Thread(target=perform, name=f"limited: {instrument}", daemon=True).start()
    return outcome


def await_call(
    deadline: Deadline,
    instrument: str,
    outcome: Future[_ResultT],
    meanwhile: Callable[[], object] = lambda: None,
) -> _ResultT:
    """Return the result of a call that was begun; waits and raises as :func:`call_within`."""
    while not wait([outcome], timeout=min(_POLL_S, deadline.remaining_s())).done:
        if deadline.expired() and outcome.cancel():
            raise ConnectionFailedError(
                instrument,
                f"its port did not respond within {deadline.duration_s:g} s. Check cable, adapter and power.",
            )
        meanwhile()
    return outcome.result()
