"""A table that is told to stop: waiting for rest, and what to say where it does not come."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from gyrobench.bench.foundations.clock import Clock, Deadline
from gyrobench.bench.foundations.errors import FaultError, NoReplyError, ReplyError

#: Longest wait for rest.
LONGEST_S = 30.0


def await_standstill(
    clock: Clock, read_rates_dps: Callable[[], Sequence[float]], standstill_dps: float, poll_s: float
) -> tuple[float, ...]:
    """Wait until all axes rest, but not for ever.

    Parameters
    ----------
    read_rates_dps : callable
        Asks the table for the rate of each axis.
    standstill_dps : float
        An axis that turns no faster rests.
    poll_s : float
        Time between two looks.

    Returns
    -------
    tuple of float
        Rates at the end; NaN where none could be read, since the table may still turn then.
    """
    deadline = Deadline(clock, LONGEST_S)
    while not _rest(rates_dps := _known(read_rates_dps), standstill_dps) and not deadline.expired():
        clock.sleep(poll_s)
    return rates_dps


def require_rest(instrument: str, rates_dps: Sequence[float], standstill_dps: float, done: str) -> None:
    """Raise FaultError where the rates of :func:`await_standstill` are none of a table at rest.

    Parameters
    ----------
    done : str
        What was done all the same, for people: "its motor was switched off".
    """
    if not _rest(rates_dps, standstill_dps):
        raise FaultError(
            instrument,
            f"{turns_still(rates_dps, LONGEST_S)}; {done}. Keep away from it until it rests, and use its "
            "emergency stop.",
        )


def turns_still(rates_dps: Sequence[float], waited_s: float) -> str:
    """Say that a table still turns, or may do so.

    Parameters
    ----------
    rates_dps : sequence of float
        Last known rate of each axis; NaN where none could be read.
    waited_s : float
        Time since the stop.
    """
    if any(math.isnan(rate_dps) for rate_dps in rates_dps):
        return f"tells no rate {waited_s:g} s after the stop and may still turn"
    fastest_dps = max(rates_dps, key=abs)
    return f"still turns at {fastest_dps:.3g} deg/s {waited_s:g} s after the stop"


def _known(read_rates_dps: Callable[[], Sequence[float]]) -> tuple[float, ...]:
    try:
        return tuple(read_rates_dps())
    except (NoReplyError, ReplyError):
        return (math.nan,)


def _rest(rates_dps: Sequence[float], standstill_dps: float) -> bool:
    return all(abs(rate_dps) <= standstill_dps for rate_dps in rates_dps)
