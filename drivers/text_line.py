"""Lines of text to and from an instrument, one reply after each request.

A reply does not name its request. So after a failed exchange nothing is sent until the line has been
silent for the reply time-out, and of the next replies the last one counts: an instrument answers in the
order of the requests.
"""

from __future__ import annotations

import math
import re

from gyrobench.bench.foundations.clock import Deadline
from gyrobench.bench.foundations.errors import NoReplyError, ReplyError
from gyrobench.drivers.serial_line import NEXT_REPLY_S, SerialLine

_MAX_REPLY_BYTES = 256
_SHOWN_BYTES = 60
_NUMBER = re.compile(rb"[-+]?(?:[0-9]{1,15}(?:\.[0-9]{0,15})?|\.[0-9]{1,15})(?:[eE][-+]?[0-9]{1,3})?")

LINE_ENDINGS = {"cr": b"\r", "crlf": b"\r\n", "lf": b"\n"}


class TextLine:
    """Requests and replies of text.

    ``ending`` ends each request. Any one byte of ``end_of_reply`` ends a reply; those before its first letter
    are dropped.
    """

    def __init__(
        self, line: SerialLine, ending: bytes, end_of_reply: bytes = b"\r\n", reply_timeout_s: float = 1.0
    ) -> None:
        self.line = line
        self._ending = ending
        self._end_of_reply = end_of_reply
        self._reply_timeout_s = reply_timeout_s
        self._out_of_step = False
        self._awaits_late_reply = False

    def send(self, request: str) -> None:
        """Send a request; input that arrived before is discarded."""
        if self._out_of_step:
            self.line.await_silence(self._reply_timeout_s)
            self._out_of_step = False
        self.line.discard_input()
        self.line.write(request.encode("ascii") + self._ending)

    def receive(self, request: str, *, may_be_empty: bool = False, begun: bytes = b"") -> bytes:
        """Wait for a reply; returns it without its end and surrounding spaces.

        With ``may_be_empty`` an end with nothing before it is a reply. ``begun`` is the first byte of the
        reply, if it has been read. Raises NoReplyError or ReplyError if no reply arrived in time, or it is
        too long. Raises ConnectionFailedError if the port went away.
        """
        self._out_of_step = True
        deadline = Deadline(self.line.clock, self._reply_timeout_s)
        reply = bytearray()
        while True:
            try:
                byte, begun = begun or self.line.read(1, deadline), b""
            except NoReplyError as error:
                self._awaits_late_reply = True
                part = f", only {_shown(reply)}" if reply else ""
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
        self._out_of_step = False
        return bytes(reply).strip()

    def ask(self, request: str) -> bytes:
        """Send a request and wait for its reply; raises what :meth:`receive` raises."""
        may_be_late, self._awaits_late_reply = self._awaits_late_reply, False
        self.send(request)
        reply = self.receive(request)
        while may_be_late and (following := self.more(request, NEXT_REPLY_S)):
            reply = following
        return reply

    def more(self, request: str, within_s: float, *, may_be_empty: bool = False) -> bytes | None:
        """Wait for a further reply that begins within a time, else None; raises as :meth:`receive`."""
        deadline = Deadline(self.line.clock, within_s)
        try:
            first = self.line.read(1, deadline)
            while first in self._end_of_reply and not may_be_empty:
                first = self.line.read(1, deadline)
        except NoReplyError:
            return None
        return self.receive(request, may_be_empty=may_be_empty, begun=first)

    def unexpected(self, request: str, reply: bytes) -> ReplyError:
        """Error for a reply that makes no sense; the next request waits for silence."""
        self._out_of_step = True
        return ReplyError(
            self.line.instrument,
            f"{request} was answered by {_shown(reply)} on {self.line.address}. Check dialect, baud rate and "
            "parity, and whether another program uses this line.",
        )

    def number(self, request: str, reply: bytes) -> float:
        """Read a reply as a finite decimal number; raises ReplyError."""
        value = float(reply) if _NUMBER.fullmatch(reply) else math.nan
        if not math.isfinite(value):
            raise self.unexpected(request, reply)
        return value


def _shown(reply: bytes | bytearray) -> str:
    return repr(bytes(reply[:_SHOWN_BYTES])).removeprefix("b")
