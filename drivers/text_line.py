"""Requests and replies as lines of text, one reply to each request.

A reply does not name its request, and an instrument answers in the order of the requests. So after a failed
exchange nothing is sent until the line has been silent for the reply time-out; if several replies then
follow the next request, the last one is its reply.

Some adapters and controllers echo what is sent. No query is its own reply, so its echo is skipped, and with
it that of the command before.
"""

from __future__ import annotations

import math
import re
from collections import deque

from gyrobench.bench.foundations.clock import Deadline
from gyrobench.bench.foundations.errors import NoReplyError, ReplyError
from gyrobench.drivers.serial_line import NEXT_REPLY_S, SerialLine

_MAX_REPLY_BYTES = 256
_MAX_QUOTED_BYTES = 60
_NUMBER = re.compile(rb"[-+]?(?:[0-9]{1,15}(?:\.[0-9]{0,15})?|\.[0-9]{1,15})(?:[eE][-+]?[0-9]{1,3})?")

LINE_ENDINGS = {"cr": b"\r", "crlf": b"\r\n", "lf": b"\n"}


class TextLine:
    """Sends requests and receives replies as text.

    ``ending`` is appended to each request. Any byte of ``end_of_reply`` ends a reply; such bytes before the
    first character of a reply are skipped. Every wait for a reply ends after ``reply_timeout_s``.
    """

    def __init__(
        self, line: SerialLine, ending: bytes, end_of_reply: bytes = b"\r\n", reply_timeout_s: float = 1.0
    ) -> None:
        self.line = line
        self._ending = ending
        self._end_of_reply = end_of_reply
        self._reply_timeout_s = reply_timeout_s
        self._out_of_sync = False
        self._late_reply_is_possible = False
        self._sent: deque[bytes] = deque(maxlen=2)  # the last two requests

    def send(self, request: str) -> None:
        """Send a request; discards input that arrived before."""
        if self._out_of_sync:
            self.line.await_silence(self._reply_timeout_s)
            self._out_of_sync = False
        self.line.discard_input()
        self._sent.append(request.encode("ascii"))
        self.line.write(self._sent[-1] + self._ending)

    def receive(self, request: str, *, may_be_empty: bool = False, first_byte: bytes = b"") -> bytes:
        """Wait for the reply to ``request``; returns it without its end and surrounding spaces.

        With ``may_be_empty``, an end without text before it is a reply. ``first_byte`` is the first byte of
        the reply, if it has already been read. Raises NoReplyError if no reply arrived in time, ReplyError if
        it is too long, ConnectionFailedError if the port is gone.
        """
        self._out_of_sync = True
        deadline = Deadline(self.line.clock, self._reply_timeout_s)
        reply = bytearray()
        while True:
            try:
                byte, first_byte = first_byte or self.line.read(1, deadline), b""
            except NoReplyError as error:
                self._late_reply_is_possible = True
                part = f", only {_quoted(reply)}" if reply else ""
                raise NoReplyError(
                    self.line.instrument,
                    f"no reply to {request} within {self._reply_timeout_s:g} s on {self.line.address}{part}. "
                    "Is it switched on and set to this baud rate and line ending?",
                ) from error
            if byte in self._end_of_reply and (may_be_empty or reply.strip()):
                break
            if byte not in self._end_of_reply:
                reply += byte
            if len(reply) > _MAX_REPLY_BYTES:
                raise self.unexpected(request, bytes(reply))
        self._out_of_sync = False
        return bytes(reply).strip()

    def ask(self, request: str) -> bytes:
        """Send a request and wait for its reply, after the echo of a query; raises as :meth:`receive`."""
        may_be_late, self._late_reply_is_possible = self._late_reply_is_possible, False
        self.send(request)
        reply = self.receive(request)
        while request.endswith("?") and reply in self._sent:
            reply = self.receive(request)
        while may_be_late and (following := self.more(request, NEXT_REPLY_S)):
            reply = following
        return reply

    def more(self, request: str, within_s: float, *, may_be_empty: bool = False) -> bytes | None:
        """Wait for a further reply to ``request``; None if none begins within ``within_s``.

        Raises as :meth:`receive`.
        """
        deadline = Deadline(self.line.clock, within_s)
        try:
            first = self.line.read(1, deadline)
            while first in self._end_of_reply and not may_be_empty:
                first = self.line.read(1, deadline)
        except NoReplyError:
            return None
        return self.receive(request, may_be_empty=may_be_empty, first_byte=first)

    def unexpected(self, request: str, reply: bytes) -> ReplyError:
        """Return the error for an invalid reply; the next request waits for silence."""
        self._out_of_sync = True
        return ReplyError(
            self.line.instrument,
            f"{request} was answered by {_quoted(reply)} on {self.line.address}. Check dialect, baud rate "
            "and parity, and whether another program uses this line.",
        )

    def number(self, request: str, reply: bytes) -> float:
        """Parse a reply as a finite decimal number; raises ReplyError if it is none."""
        value = float(reply) if _NUMBER.fullmatch(reply) else math.nan
        if not math.isfinite(value):
            raise self.unexpected(request, reply)
        return value


def _quoted(reply: bytes | bytearray) -> str:
    return repr(bytes(reply[:_MAX_QUOTED_BYTES])).removeprefix("b")
