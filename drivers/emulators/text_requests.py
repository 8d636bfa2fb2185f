"""Requests of text as they come over a line, byte by byte or several at once."""

from __future__ import annotations

import re

_LONGEST = 200
_ENDS = re.compile(rb"[\r\n]+")
_NUMBER = re.compile(r"[-+]?(?:[0-9]{1,9}(?:\.[0-9]{0,9})?|\.[0-9]{1,9})")


class TextRequests:
    """Cuts what arrives into requests, which carriage returns or line feeds end."""

    def __init__(self) -> None:
        self._buffer = b""
        self._overlong = False

    def take(self, data: bytes) -> list[str]:
        """Take bytes; returns the requests that they complete. Overlong ones are dropped."""
        *complete, self._buffer = _ENDS.split(self._buffer + data)
        requests = []
        for request in complete:
            too_long, self._overlong = self._overlong or len(request) > _LONGEST, False
            if request and not too_long:
                requests.append(request.decode("latin-1").strip())
        if len(self._buffer) > _LONGEST:
            self._buffer, self._overlong = b"", True
        return requests

    def forget(self) -> None:
        """Lose half a request, as without power."""
        self._buffer, self._overlong = b"", False


def decimal(text: str) -> float | None:
    """Value of a plain decimal number; None for any other text."""
    return float(text) if _NUMBER.fullmatch(text.strip()) else None
