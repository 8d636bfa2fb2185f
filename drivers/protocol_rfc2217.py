"""pyserial's handler of ``rfc2217://host:port``, a serial port behind a network server (RFC 2217).

pyserial's own port can't have a write time-out, sends all line settings to the server again at each change
of the read time-out (50 ms or more), and returns one byte of a read without waiting.
"""

from __future__ import annotations

import queue

import serial.rfc2217
from serial.serialutil import PortNotOpenError, Timeout


class Serial(serial.rfc2217.Serial):
    """A port whose time-outs concern this computer alone; a write ends after 5 s, the socket's time-out."""

    timeout: float = 0.0
    write_timeout: float | None = None
    _read_buffer: queue.Queue[bytes | None]

    def read(self, size: int = 1, /) -> bytes:
        """Read up to ``size`` bytes until the time-out; raises SerialException if the server is gone."""
        if not self.is_open:
            raise PortNotOpenError
        timeout, data = Timeout(self.timeout), bytearray()
        while len(data) < size:
            try:
                byte = self._read_buffer.get(timeout=timeout.time_left())
            except queue.Empty:
                break
            if byte is None:
                self._read_buffer.put(None)  # for the next read
                if data:
                    break
                raise serial.SerialException("the server closed the connection")
            data += byte
        return bytes(data)
