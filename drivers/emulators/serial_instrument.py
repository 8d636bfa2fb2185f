"""What every emulated serial instrument offers to the line that it hangs on."""

from __future__ import annotations

from typing import Protocol


class SerialInstrument(Protocol):
    """An instrument that takes bytes and answers with bytes.

    Attributes
    ----------
    latency_s : float
        Time from the last byte of a request to the first byte of its reply.
    """

    latency_s: float

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Take bytes from the line at time ``now_s`` and return the reply, if one is complete.

        The world has already been brought to ``now_s``. Any byte sequence is accepted.
        """
        ...


class Connection:
    """The plug between an instrument and its clients.

    Attributes
    ----------
    broken : bool
        Whether nothing goes through at present.
    number : int
        Changes with every break and every mend: what a client opened before is dead.
    """

    def __init__(self) -> None:
        self.broken = False
        self.number = 0

    def cut(self) -> None:
        """Pull the plug."""
        self.broken = True
        self.number += 1

    def mend(self) -> None:
        """Put it back."""
        self.broken = False
        self.number += 1
