"""Listening to the engine."""

from __future__ import annotations

import os
import select
from enum import Enum

from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.guard.orders import RELEASE

_LOOK_S = 0.5
_CHUNK = 4096


class Ending(Enum):
    """How the engine's beats came to an end."""

    RELEASED = "the engine released the guard"
    CLOSED = "the engine ended without a word"
    SILENT = "the engine hangs"


def watch(descriptor: int, silence_s: float, clock: Clock) -> Ending:
    """Wait until the engine releases the guard, is gone, or has been silent for too long.

    A look that took much longer than it should counts as a short one: then the whole machine was
    suspended or the guard not let run, and the engine neither.
    """
    silent_s, last_s = 0.0, clock.now()
    while silent_s < silence_s:
        ready, _, _ = select.select([descriptor], [], [], min(_LOOK_S, silence_s - silent_s))
        now_s = clock.now()
        silent_s, last_s = silent_s + min(now_s - last_s, 2.0 * _LOOK_S), now_s
        if ready:
            data = os.read(descriptor, _CHUNK)
            if not data:
                return Ending.CLOSED
            if RELEASE in data:
                return Ending.RELEASED
            silent_s = 0.0
    return Ending.SILENT
