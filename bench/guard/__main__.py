"""The guard process; :class:`gyrobench.bench.guard.link.GuardLink` starts it."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from pathlib import Path

from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.guard.engine_process import EngineProcess
from gyrobench.bench.guard.log import GuardLog
from gyrobench.bench.guard.orders import LOG_NAME, READY, Orders
from gyrobench.bench.guard.watch import Ending, watch

_IN, _OUT = 0, 1


def main() -> int:
    """Watch the engine, and act if need be; returns the exit code."""
    for number in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    orders = Orders.read(_IN)
    if orders is None:
        return 0
    engine = EngineProcess(orders.engine_pid)
    clock = WallClock(orders.began, orders.now_s)
    log = GuardLog(Path(orders.folder) / LOG_NAME, clock)
    _say_ready()
    log.add(f"watches process {orders.engine_pid}; acts after {orders.silence_s:g} s of silence")
    try:
        # Loaded now, while everything is there: later the disk may fail or the files be replaced.
        from gyrobench.bench.guard.rescue import Rescue

        rescue = Rescue(orders, engine, clock, log)
        ending = watch(_IN, orders.silence_s, clock)
        if ending is Ending.RELEASED:
            log.add(ending.value)
        else:
            rescue.act(ending)
    except Exception as error:
        log.add(f"ends: unexpected {type(error).__name__}: {error}")
        raise
    return 0


def _say_ready() -> None:
    """Tell the engine and close the way back, so that nobody waits for its end."""
    with contextlib.suppress(BrokenPipeError):  # the engine is gone already, which the other pipe tells
        os.write(_OUT, READY)
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, _OUT)
    os.close(nothing)


if __name__ == "__main__":
    sys.exit(main())
