"""The guard process; :class:`gyrobench.bench.guard.process.GuardProcess` starts it."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from datetime import datetime
from pathlib import Path

from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.guard.watching import (
    LOG_NAME,
    READY,
    EngineEnd,
    EngineProcess,
    GuardConfig,
    GuardLog,
    watch_engine,
)

_IN, _OUT = 0, 1


def main() -> int:
    """Watch the engine, and act if necessary; returns the exit code."""
    for number in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    config = GuardConfig.read(_IN)
    if config is None:
        return 0
    engine = EngineProcess(config.engine_pid)
    clock = WallClock(datetime.fromisoformat(config.epoch), config.now_s, config.speed)
    log = GuardLog(Path(config.folder) / LOG_NAME, clock)
    _report_ready()
    log.add(f"watches process {config.engine_pid}; acts after {config.silence_s:g} s of silence")
    try:
        # Loaded immediately: later the disk may fail or the files may be replaced.
        from gyrobench.bench.guard.rescue import Rescue

        rescue = Rescue(config, engine, clock, log)
        end = watch_engine(_IN, config.silence_s, WallClock())
        if end is EngineEnd.RELEASED:
            log.add(end.value)
        else:
            rescue.act(end)
    except Exception as error:
        log.add(f"ends: unexpected {type(error).__name__}: {error}")
        raise
    return 0


def _report_ready() -> None:
    """Report to the engine and close the answering pipe, so that no process waits for its end."""
    with contextlib.suppress(BrokenPipeError):  # the engine has died; the other pipe reports that
        os.write(_OUT, READY)
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, _OUT)
    os.close(nothing)


if __name__ == "__main__":
    sys.exit(main())
