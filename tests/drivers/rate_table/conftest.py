"""A pseudo-terminal with an emulated instrument at its far end, on wall time."""

import os
import select
import threading
import tty
from contextlib import contextmanager

import pytest

from gyrobench.bench.foundations.clock import WallClock
from gyrobench.drivers.serial_line import SerialLine


@contextmanager
def served(instrument):
    """Yield a line to the instrument, which a thread serves until the end of the block."""
    master, slave = os.openpty()
    tty.setraw(slave)
    clock, ended = WallClock(), threading.Event()

    def serve():
        while not ended.is_set():
            if select.select([master], [], [], 0.01)[0]:
                reply = instrument.feed(os.read(master, 65536), clock.now())
                while reply:
                    reply = reply[os.write(master, reply) :]

    thread = threading.Thread(target=serve)
    thread.start()
    line = SerialLine("rate table", os.ttyname(slave), clock)
    try:
        yield line
    finally:
        ended.set()
        thread.join()
        line.close()
        os.close(master)
        os.close(slave)


@pytest.fixture
def serve():
    """Return the context manager :func:`served`."""
    return served


class Scripted:
    """Answers every message with the next of the given replies, or not at all."""

    latency_s = 0.0

    def __init__(self, *replies):
        self.replies = list(replies)
        self.received = b""

    def feed(self, data, now_s):
        self.received += data
        return b"".join(self.replies.pop(0) for _ in range(data.count(b"\n")) if self.replies)


@pytest.fixture
def scripted():
    """Return the class :class:`Scripted`."""
    return Scripted
