"""Common part of the instruments with text protocols: requests ended by CR or LF, decimal numbers."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod

_MAX_CHARACTERS = 200
_ENDS = re.compile(rb"[\r\n]+")
_NUMBER = re.compile(r"[-+]?(?:[0-9]{1,9}(?:\.[0-9]{0,9})?|\.[0-9]{1,9})")


class TextInstrument(ABC):
    """An instrument that answers lines of text; a subclass gives the answer to each."""

    def __init__(self, latency_s: float) -> None:
        self.latency_s = latency_s
        self._now_s = 0.0
        self._discard_input()

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Take bytes at time ``now_s``; return the replies to the requests that they complete."""
        self._now_s = now_s
        return b"".join(self._reply(request) for request in self._take_requests(data))

    @abstractmethod
    def _reply(self, request: str) -> bytes:
        """Execute one request, never empty, and return the bytes of the reply."""

    def _discard_input(self) -> None:
        """Discard an incomplete request, as on power-off."""
        self._input, self._overlong = b"", False

    def _take_requests(self, data: bytes) -> list[str]:
        """Requests that these bytes complete; overlong ones are dropped."""
        *complete, self._input = _ENDS.split(self._input + data)
        requests = []
        for request in complete:
            too_long, self._overlong = self._overlong or len(request) > _MAX_CHARACTERS, False
            if request and not too_long:
                requests.append(request.decode("latin-1").strip())
        if len(self._input) > _MAX_CHARACTERS:
            self._input, self._overlong = b"", True
        return requests


def decimal(text: str) -> float | None:
    """Value of a plain decimal number; None for any other text."""
    return float(text) if _NUMBER.fullmatch(text.strip()) else None
