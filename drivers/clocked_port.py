"""A serial port for pyserial handlers whose instrument is inside this process.

A read with a time-out waits on a clock: on a virtual clock it returns at once, with the bytes that
arrive within the time-out.
"""

from __future__ import annotations

from abc import abstractmethod

from serial.serialutil import SerialBase

from gyrobench.bench.foundations.clock import Clock


class ClockedPort(SerialBase):
    """A port on a clock; a subclass's ``open`` sets ``clock``, ``_arrived`` and ``is_open``."""

    clock: Clock
    timeout: float | None = None  # nothing has to be configured when it changes
    _arrived: bytearray

    @abstractmethod
    def next_due_s(self) -> float | None:
        """Time on the clock at which the next bytes arrive; None if no bytes are to arrive."""

    @abstractmethod
    def collect(self) -> None:
        """Append new bytes to ``_arrived``; raises SerialException if the port is gone."""

    def close(self) -> None:
        """Disconnect; the instrument continues unchanged."""
        self.is_open = False

    def _reconfigure_port(self) -> None:
        """Do nothing: baud rate and parity have no effect."""

    def _update_rts_state(self) -> None:
        """Do nothing: control lines have no effect."""

    def _update_dtr_state(self) -> None:
        """Do nothing: control lines have no effect."""

    @property
    def in_waiting(self) -> int:
        """Number of bytes that have arrived."""
        self.collect()
        return len(self._arrived)

    def read(self, size: int = 1, /) -> bytes:
        """Read up to ``size`` bytes, waiting on the clock until the time-out."""
        arrived = self._arrived
        if len(arrived) < size:
            self._await(size)
        data = bytes(arrived[:size])
        del arrived[:size]
        return data

    def _await(self, size: int) -> None:
        end_s = None if self.timeout is None else self.clock.now() + self.timeout * self.clock.speed
        self.collect()
        while len(self._arrived) < size:
            due_s = self.next_due_s()
            if due_s is None or (end_s is not None and due_s > end_s):
                if end_s is not None:
                    self.clock.sleep_until(end_s)
                break
            self.clock.sleep_until(due_s)
            self.collect()

    def flush(self) -> None:
        """Do nothing: written bytes are sent at once."""

    def reset_input_buffer(self) -> None:
        """Discard the bytes that have arrived."""
        self.collect()
        self._arrived.clear()

    def reset_output_buffer(self) -> None:
        """Do nothing: there is no pending output."""
