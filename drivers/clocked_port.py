"""A serial port without wires, for handlers of pyserial whose instrument lives inside this program.

It lives on a clock: a read with a time-out waits there, so on a virtual clock it returns at once with
what would have come in that time.
"""

from __future__ import annotations

from abc import abstractmethod

from serial.serialutil import PortNotOpenError, SerialBase

from gyrobench.bench.foundations.clock import Clock


class ClockedPort(SerialBase):
    """What both kinds of such ports have in common; ``open`` is a matter of each.

    Attributes
    ----------
    clock : Clock
        Set by ``open``, as is ``is_open``.
    """

    clock: Clock
    _arrived: bytearray

    @abstractmethod
    def next_due_s(self) -> float | None:
        """When the next bytes arrive, on the clock; None where none are under way."""

    @abstractmethod
    def take(self) -> bytes:
        """Bytes that have arrived since the last call; raises SerialException where the port is gone."""

    def close(self) -> None:
        """Disconnect; the instrument goes on as it is."""
        self.is_open = False

    def _reconfigure_port(self) -> None:
        """Baud rate and parity have no effect."""

    def _update_rts_state(self) -> None:
        """Control lines have no effect."""

    def _update_dtr_state(self) -> None:
        """Control lines have no effect."""

    @property
    def in_waiting(self) -> int:
        """Number of bytes that have arrived."""
        self._collect()
        return len(self._arrived)

    def read(self, size: int = 1, /) -> bytes:
        """Read up to ``size`` bytes, waiting for them on the clock until the time-out."""
        self._collect()
        end_s = None if self.timeout is None else self.clock.now() + self.timeout * self.clock.speed
        while len(self._arrived) < size:
            due_s = self.next_due_s()
            if due_s is None or (end_s is not None and due_s > end_s):
                if end_s is not None:
                    self.clock.sleep_until(end_s)
                break
            self.clock.sleep_until(due_s)
            self._collect()
        data = bytes(self._arrived[:size])
        del self._arrived[:size]
        return data

    def flush(self) -> None:
        """Everything has been sent already."""

    def reset_input_buffer(self) -> None:
        """Throw away what has arrived."""
        self._collect()
        self._arrived.clear()

    def reset_output_buffer(self) -> None:
        """Nothing waits to be sent."""

    def _collect(self) -> None:
        if not self.is_open:
            raise PortNotOpenError
        self._arrived += self.take()
