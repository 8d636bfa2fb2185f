"""Lines of text to and from an instrument, one reply after each request.

A reply does not say which request it belongs to. So after any failed exchange nothing is sent until
the line has been silent for the reply time-out. A reply that is later than twice the reply time-out
can't be told from a right one.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable

from gyrobench.bench.foundations.clock import Clock, Deadline
from gyrobench.bench.foundations.errors import NoReplyError, ReplyError
from gyrobench.drivers.serial_line import SerialLine

#: A line that is not silent within this many reply time-outs never will be.
_MOST_TIMEOUTS_TO_SILENCE = 5
#: No instrument says more at once.
_LONGEST_REPLY = 256
_SHOWN_BYTES = 60
_NUMBER = re.compile(rb"[-+]?(?:[0-9]{1,15}(?:\.[0-9]{0,15})?|\.[0-9]{1,15})(?:[eE][-+]?[0-9]{1,3})?")

#: Controllers may answer a query before they have done the command before it.
_SETTLING_TIME_S, _SETTLING_LOOK_S = 2.0, 0.1

#: Controllers may keep tenths alone. Of a slow ramp that may be far off in proportion.
_HALF_A_TENTH = 0.051
_RAMP_SHARE = 0.05

LINE_ENDINGS = {"cr": b"\r", "crlf": b"\r\n", "lf": b"\n"}


class TextLine:
    """Requests and replies of text.

    Parameters
    ----------
    line : SerialLine
        The line to the instrument.
    ending : bytes
        Ends each request.
    end_of_reply : bytes
        Any one of these bytes ends a reply; those that come before its first letter are left out.
    reply_timeout_s : float
        Longest wait for a reply.
    """

    def __init__(
        self, line: SerialLine, ending: bytes, end_of_reply: bytes = b"\r\n", reply_timeout_s: float = 1.0
    ) -> None:
        self.line = line
        self._ending = ending
        self._end_of_reply = end_of_reply
        self._reply_timeout_s = reply_timeout_s
        self._out_of_step = False

    def send(self, request: str) -> None:
        """Send a request; what arrived before is thrown away."""
        if self._out_of_step:
            timeout_s = self._reply_timeout_s
            self.line.await_silence(timeout_s, _MOST_TIMEOUTS_TO_SILENCE * timeout_s)
            self._out_of_step = False
        self.line.discard_input()
        self.line.write(request.encode("ascii") + self._ending)

    def receive(self, request: str, *, may_be_empty: bool = False, begun: bytes = b"") -> bytes:
        """Wait for a reply; returns it without its end, spaces around it removed.

        Parameters
        ----------
        request : str
            What was asked, for messages.
        may_be_empty : bool
            Whether an end with nothing before it is a reply.
        begun : bytes
            First byte of it, where that has been read.

        Raises
        ------
        NoReplyError, ReplyError
            None came in time, or more than any reply has.
        ConnectionFailedError
            The port went away.
        """
        self._out_of_step = True
        deadline = Deadline(self.line.clock, self._reply_timeout_s)
        reply = bytearray()
        while True:
            try:
                byte, begun = begun or self.line.read(1, deadline), b""
            except NoReplyError as error:
                raise NoReplyError(self.line.instrument, self._silence(request, reply)) from error
            if byte in self._end_of_reply and (may_be_empty or reply.strip()):
                break
            if byte not in self._end_of_reply:
                reply += byte
            if len(reply) > _LONGEST_REPLY:
                raise self.unexpected(request, bytes(reply))
        self._out_of_step = False
        return bytes(reply).strip()

    def ask(self, request: str) -> bytes:
        """Send a request and wait for its reply; raises what :meth:`receive` raises."""
        self.send(request)
        return self.receive(request)

    def more(self, request: str, within_s: float, *, may_be_empty: bool = False) -> bytes | None:
        """What else comes after a good reply, begun within that time; None for nothing.

        Raises what :meth:`receive` raises where it is begun and does not end.
        """
        deadline = Deadline(self.line.clock, within_s)
        try:
            first = self.line.read(1, deadline)
            while first in self._end_of_reply and not may_be_empty:
                first = self.line.read(1, deadline)
        except NoReplyError:
            return None
        return self.receive(request, may_be_empty=may_be_empty, begun=first)

    def unexpected(self, request: str, reply: bytes) -> ReplyError:
        """Error that says what came in place of a reply; the line has to fall silent after it."""
        self._out_of_step = True
        return ReplyError(
            self.line.instrument,
            f"{request} was answered by {_shown(reply)} on {self.line.url}. Check dialect, baud rate and "
            "parity, and whether another program uses this line.",
        )

    def number(self, request: str, reply: bytes) -> float:
        """Read a reply as a finite decimal number; raises ReplyError."""
        value = float(reply) if _NUMBER.fullmatch(reply) else math.nan
        if not math.isfinite(value):
            raise self.unexpected(request, reply)
        return value

    def _silence(self, request: str, reply: bytearray) -> str:
        came = f", only {_shown(reply)}" if reply else ""
        return (
            f"no reply to {request} within {self._reply_timeout_s:g} s on {self.line.url}{came}. Is it "
            "switched on and set to this baud rate and line ending?"
        )


def settles(clock: Clock, is_so: Callable[[], bool]) -> bool:
    """Whether a controller comes to hold what it was told, looked at until it does or its time is over."""
    deadline = Deadline(clock, _SETTLING_TIME_S)
    while not is_so():
        if deadline.expired():
            return False
        clock.sleep(_SETTLING_LOOK_S)
    return True


def agrees(held: float, written: float) -> bool:
    """Whether a number read back is the one written, as far as a controller keeps it."""
    return abs(held - written) < _HALF_A_TENTH and (held != 0.0 or written == 0.0)


def ramp_agrees(held: float, written: float) -> bool:
    """Whether a ramp read back is the one written, and not far faster or slower in proportion."""
    return agrees(held, written) and abs(held - written) <= _RAMP_SHARE * abs(written)


def _shown(reply: bytes | bytearray) -> str:
    return repr(bytes(reply[:_SHOWN_BYTES])).removeprefix("b")
