"""A proxy between an instrument and any program that speaks to it, which records both."""

from __future__ import annotations

from gyrobench.bench.foundations.clock import Clock
from gyrobench.drivers.recording.tap import LinePort, RecordingFile
from gyrobench.drivers.served_ports import Port

_PERIOD_S = 0.001
_MOST_BYTES = 4096


class Proxy:
    """Passes everything between a served port and an instrument's own.

    Parameters
    ----------
    served : Port
        Where programs connect.
    instrument : LinePort
        The instrument's port, open.
    file : RecordingFile
        Keeps what goes through.
    """

    def __init__(self, served: Port, instrument: LinePort, file: RecordingFile, clock: Clock) -> None:
        self._served = served
        self._instrument = instrument
        self._file = file
        self._clock = clock
        self._unsent = b""

    def pass_on(self, duration_s: float | None = None) -> None:
        """Pass everything for so long, or for ever.

        Raises
        ------
        OSError
            The instrument's port went away; pyserial's SerialException is one.
        """
        self._instrument.timeout = 0
        end_s = None if duration_s is None else self._clock.now() + duration_s
        while end_s is None or self._clock.now() < end_s:
            if not self._exchange():
                self._clock.sleep(_PERIOD_S)

    def _exchange(self) -> bool:
        """Pass what is there now; False for nothing."""
        asked = self._served.read()
        if asked:
            self._file.add(True, asked)
            self._instrument.write(asked)
        reply = bytes(self._instrument.read(_MOST_BYTES))
        if reply:
            self._file.add(False, reply)
        self._unsent = (self._unsent + reply)[-_MOST_BYTES:]
        if self._unsent:
            self._unsent = self._unsent[self._served.write(self._unsent) :]
        return bool(asked or reply)
