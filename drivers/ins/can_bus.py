"""The CAN bus of the INS: opened and closed, and its frames in blocks of numpy arrays.

Adapters that send lines of text, slcan and socketcand, have buses here. A thread takes their bytes as they
come, since a port's buffer in the kernel may be 4 kB, which fills in 15 ms at 10,000 frames per second, while
the bench polls once a second. It takes them every few milliseconds rather than at each arrival, which costs a
tenth. The lines are converted by :meth:`recv_block`, all at once.
"""

from __future__ import annotations

import contextlib
import re
import select
import socket
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Any

import can
import numpy as np
from can.interfaces.slcan import slcanBus
from numpy.typing import NDArray

from gyrobench.bench.foundations.arrays import BoolArray, IntArray
from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.errors import ConnectionFailedError, DocumentError, ReplyError
from gyrobench.drivers.frames import (
    ERROR_FRAME,
    EXTENDED_ID,
    FRAME_DTYPE,
    REMOTE_FRAME,
    FrameBlock,
    concatenate,
)
from gyrobench.drivers.serial_line import port_advice, system_reason

_READ_PERIOD_S = 0.005
_MAX_READ = 1 << 16
#: Text that waits to be converted: a minute of a full bus of 1 Mbit/s.
_MAX_QUEUED = 16 << 20
_MAX_LINE = 1000
_CONNECT_S = 5.0
#: Frames that differ in length, kind or number of data bytes, in one block; a bus has some 40.
_MAX_LAYOUTS = 200
_BLANKS = b" \t\r\n"

_NIBBLE = np.full(256, 255, np.uint8)
_NIBBLE[list(b"0123456789abcdef")] = np.arange(16)
_NIBBLE[list(b"ABCDEF")] = np.arange(10, 16)


@dataclass(frozen=True)
class _Format:
    """How an adapter writes frames.

    ``frame`` matches a line without its end; its groups are ``kind``, ``id``, ``data``, and either ``length``
    or ``whole`` and ``fraction`` of the time stamp. A line is to be a frame if it has one of ``letters`` at
    ``place``; other lines, as answers to commands and frames of CAN FD, are passed over.
    """

    ends: bytes
    place: int
    letters: bytes
    frame: re.Pattern[bytes]

    def frames(self, data: bytes) -> tuple[FrameBlock, IntArray, bytes, int]:
        """Convert whole lines: frames, places where they end, the first invalid line, lines left out.

        Lines are left out where more than :data:`_MAX_LAYOUTS` layouts are found.
        """
        text = np.frombuffer(data, np.uint8)
        end = np.flatnonzero(np.isin(text, list(self.ends)) if len(self.ends) > 1 else text == self.ends[0])
        begin = self._without_blanks(text, np.concatenate([[0], end[:-1] + 1]))
        letters = text[np.minimum(begin + self.place, end)]
        left = np.flatnonzero(np.isin(letters, list(self.letters)))
        rows, is_frame = np.zeros(len(end), FRAME_DTYPE), np.zeros(len(end), np.bool_)
        for _ in range(_MAX_LAYOUTS):
            matches = ((index, self._found(data, begin[line], end[line])) for index, line in enumerate(left))
            first, found = next((match for match in matches if match[1]), (len(left), None))
            left = left[first:]
            if found is None:
                break
            like = self._rows_like_first(found, text, begin[left], end[left], rows, left)
            is_frame[left[like]] = True
            left = left[~like]
        invalid = np.zeros(len(end), np.bool_)
        invalid[np.searchsorted(end, np.flatnonzero(text > 127))] = True
        invalid[np.isin(letters, list(self.letters))] = True
        invalid[left] = False
        wrong = np.flatnonzero(invalid & ~is_frame)
        line = data[begin[wrong[0]] : end[wrong[0]]] if len(wrong) else b""
        return FrameBlock(rows).take(is_frame), end[is_frame], line, len(left)

    def _without_blanks(self, text: NDArray[np.uint8], begin: IntArray) -> IntArray:
        """Places of the first characters of lines, also where the adapter sends blanks before them."""
        blanks = [each for each in _BLANKS if each not in self.ends]
        if not np.any(np.isin(text[begin], blanks)):
            return begin
        others = np.flatnonzero(np.isin(text, blanks, invert=True))
        return np.asarray(others[np.searchsorted(others, begin)])

    def _found(self, data: bytes, begin: np.intp, end: np.intp) -> re.Match[bytes] | None:
        """Match a line; None if it is no frame, or has less data than its length."""
        found = self.frame.fullmatch(data, int(begin), int(end))
        if found is None or found["kind"] in (b"r", b"R") or "length" not in found.re.groupindex:
            return found
        return found if len(found["data"]) >= 2 * int(found["length"]) else None

    def _rows_like_first(
        self,
        found: re.Match[bytes],
        text: NDArray[np.uint8],
        begin: IntArray,
        end: IntArray,
        rows: NDArray[np.void],
        numbers: IntArray,
    ) -> BoolArray:
        """Fill the rows of those lines that are laid out as the first; returns which these are."""
        like = np.zeros(len(begin), np.bool_)
        length = end[0] - begin[0]
        same = np.flatnonzero(end - begin == length)
        lines = text[begin[same, np.newaxis] + np.arange(length)]
        place = {
            name: np.arange(*found.span(name)) - begin[0]
            for name in found.re.groupindex
            if found[name] is not None
        }
        none = np.zeros(0, np.int64)
        time = np.concatenate([place.get("whole", none), place.get("fraction", none)])
        size = int(found["length"]) if "length" in place else len(place["data"]) // 2
        kind = found["kind"]
        remote = kind in (b"r", b"R")
        payload = place["data"][: 0 if remote else 2 * size]
        fixed = np.setdiff1d(np.arange(length), np.concatenate([place["id"], time, place["data"]]))
        nibbles = _NIBBLE[lines]
        good = (
            np.all(lines[:, fixed] == lines[0, fixed], axis=1)
            & np.all(nibbles[:, payload] < 16, axis=1)
            & np.all(nibbles[:, place["id"]] < 16, axis=1)
            & np.all(nibbles[:, time] < 10, axis=1)
        )
        nibbles, chosen = nibbles[good], numbers[same[good]]
        extended = len(place["id"]) != 3
        rows["id"][chosen] = _number(nibbles[:, place["id"]], 16) & 0x1FFF_FFFF | EXTENDED_ID * extended
        rows["length"][chosen] = size
        rows["flags"][chosen] = REMOTE_FRAME * remote | ERROR_FRAME * (kind == b"error")
        if len(payload):
            bytes_ = nibbles[:, payload[::2]] << 4 | nibbles[:, payload[1::2]]
            rows["data"][chosen, : len(payload) // 2] = bytes_
        if len(time):
            rows["time_s"][chosen] = _number(nibbles[:, time], 10) / 10.0 ** len(place["fraction"])
        if kind == b"error":  # as python-can has it: socketcand sends no details
            rows["length"][chosen], rows["id"][chosen] = 1, rows["id"][chosen] | np.uint32(EXTENDED_ID)
        like[same[good]] = True
        return like


def _number(digits: NDArray[np.uint8], base: int) -> IntArray:
    return np.asarray(digits.astype(np.int64) @ base ** np.arange(digits.shape[1])[::-1])


_HEX = rb"[0-9A-Fa-f]"
_SLCAN = _Format(
    b"\r\a",
    0,
    b"tTxrR",
    re.compile(
        rb"(?P<kind>[tTxrR])(?P<id>(?<=[tr])%(x)s{3}|(?<=[TxR])%(x)s{8})(?P<length>[0-8])(?P<data>%(x)s*)"
        % {b"x": _HEX}
    ),
)
_SOCKETCAND = _Format(
    b">",
    3,
    b"r",
    re.compile(
        rb"< (?P<kind>frame|error) (?P<id>%(x)s{1,8}) (?P<whole>\d{1,10})\.(?P<fraction>\d{1,6}) "
        rb"(?P<data>(?:%(x)s{2}){0,8}) ?" % {b"x": _HEX}
    ),
)


class _TextBus(can.BusABC):
    """A bus whose frames arrive as text."""

    _format: _Format
    _thread: threading.Thread | None = None
    lost = 0  #: Frames that arrived while the queue was full.
    largest_queue = 0  #: Largest size of the queue so far, in bytes.

    def _begin(self, clock: Clock, received: bytes = b"") -> None:
        """Begin to read; ``received`` was read already."""
        self._clock = clock
        self._period_s = max(_READ_PERIOD_S / clock.speed, 0.001)
        self._chunks: deque[tuple[bytes, float]] = deque()
        self._queued = self._reported = 0
        self._lock = threading.Lock()
        self._arrived, self._stopping = threading.Event(), threading.Event()
        self._failure: Exception | None = None  # for good
        self._error: ReplyError | None = None
        self._ahead = concatenate([])
        self._thread = threading.Thread(target=self._read_all, args=(received,), daemon=True)
        self._thread.start()

    def _available(self) -> bytes:
        """Read the bytes that are there, if any; raises OSError if the adapter is gone."""
        raise NotImplementedError

    def _read_all(self, rest: bytes) -> None:
        try:
            while not self._stopping.wait(self._period_s):
                data = self._available()
                if not data:
                    continue
                data = rest + data
                whole = 1 + max(data.rfind(end) for end in self._format.ends)
                rest = data[whole:]
                if len(rest) > _MAX_LINE:
                    data, whole, rest = data + self._format.ends[:1], len(data) + 1, b""
                if whole:
                    self._put(data[:whole])
        except Exception as error:  # noqa: BLE001 - raised in the thread of the bench
            self._failure = error
        self._arrived.set()

    def _put(self, lines: bytes) -> None:
        with self._lock:
            if self._queued + len(lines) > _MAX_QUEUED:
                self.lost += sum(lines.count(end) for end in self._format.ends)
            else:
                self._chunks.append((lines, self._clock.epoch.timestamp() + self._clock.now()))
                self._queued += len(lines)
                self.largest_queue = max(self.largest_queue, self._queued)
        self._arrived.set()

    def recv_block(self) -> FrameBlock:
        """Return what has arrived; see :func:`gyrobench.drivers.ins.can_bus.block_receiver`.

        Raises ReplyError once after bytes that are no frame, and after frames that were lost. Raises OSError
        if the adapter is gone.
        """
        if self._error is not None:
            error, self._error = self._error, None
            raise error
        gone = self._failure
        with self._lock:
            chunks, self._chunks, self._queued = self._chunks, deque(), 0
        block, self._ahead = self._ahead, self._ahead.take(slice(0, 0))
        problems = []
        if chunks:
            arrived, line = self._converted(chunks)
            block = concatenate([block, arrived]) if len(block) else arrived
            if line:
                text = line[:40].decode("ascii", "backslashreplace")
                problems.append(f"received bytes are no CAN frame: '{text}'")
        lost, self._reported = self.lost - self._reported, self.lost
        if lost:
            problems.append(f"{lost} frames are lost, since they came too fast or in too many layouts")
        if problems:
            advice = "Check the adapter and the load of this computer."
            self._error = ReplyError("INS", f"{self}: {'; '.join(problems)}. {advice}")
        if len(block) == 0:
            if self._error is not None:
                return self.recv_block()
            if gone is not None:
                raise gone
        return block.matching(self._filters) if self._filters else block

    def _converted(self, chunks: deque[tuple[bytes, float]]) -> tuple[FrameBlock, bytes]:
        texts, stamps_s = zip(*chunks, strict=True)
        block, ends, line, left_out = self._format.frames(b"".join(texts))
        with self._lock:
            self.lost += left_out
        if "length" in self._format.frame.groupindex:  # it has no time stamps
            chunk = np.searchsorted(np.cumsum([len(text) for text in texts]), ends, side="right")
            block.rows["time_s"] = np.array(stamps_s)[chunk]
        return block, line

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not len(self._ahead):
            self._arrived.clear()
            self._ahead = self.recv_block()
        if not len(self._ahead) and self._arrived.wait(timeout):
            self._ahead = self.recv_block()
        if not len(self._ahead):
            return None, True
        first, self._ahead = self._ahead.take(slice(0, 1)), self._ahead.take(slice(1, None))
        return first.messages()[0], True

    def shutdown(self) -> None:
        """Stop reading and close the port."""
        if self._thread is not None:
            self._stopping.set()
            self._thread.join(_CONNECT_S)
        super().shutdown()


class _SlcanBus(_TextBus, slcanBus):
    """An slcan adapter on a serial port, or on an address such as ``socket://HOST:PORT``.

    Takes the options of python-can's own class. Frames are stamped by ``clock`` when their bytes are read.
    """

    _format = _SLCAN

    def __init__(self, channel: str, clock: Clock, **options: Any) -> None:
        try:
            super().__init__(channel, **options)
        except BaseException:
            if hasattr(self, "serialPortOrig"):
                self.serialPortOrig.close()
            raise
        self.channel_info = f"slcan on {channel}"
        self.serialPortOrig.timeout = 0.0
        self._begin(clock)

    def _available(self) -> bytes:
        return bytes(self.serialPortOrig.read(_MAX_READ))

    def shutdown(self) -> None:
        """Close the adapter and the port, also where the adapter is gone."""
        try:
            super().shutdown()
        finally:
            self.serialPortOrig.close()


class _SocketcandBus(_TextBus):
    """A bus that a socketcand server offers; takes the options of python-can's own class."""

    _format = _SOCKETCAND

    def __init__(
        self, channel: str, clock: Clock, host: str, port: int, tcp_tune: bool = False, **options: Any
    ) -> None:
        self.channel_info = f"socketcand on {channel}@{host}:{port}"
        try:
            self._socket = socket.create_connection((host, int(port)), _CONNECT_S)
        except OSError as error:
            raise ConnectionError(
                f"no socketcand server at {host}:{port} ({error.strerror or error})"
            ) from error
        try:
            if tcp_tune:
                self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            received = self._answered(b"", b"< hi >")
            for command in (f"< open {channel} >", "< rawmode >"):
                self._socket.sendall(command.encode())
                received = self._answered(received, b"< ok >")
            super().__init__(channel, **options)
        except BaseException:
            self._socket.close()
            raise
        self._begin(clock, received)

    def _answered(self, received: bytes, expected: bytes) -> bytes:
        """Wait for an answer; returns what follows it."""
        while b">" not in received:
            received += self._received()
        answer, _, rest = received.partition(b">")
        if answer.lstrip() + b">" != expected:
            raise can.CanInitializationError(f"expected '{expected.decode()}', received {answer + b'>'!r}")
        return rest

    def _received(self) -> bytes:
        data = self._socket.recv(_MAX_READ)
        if not data:
            raise ConnectionError("the server closed the connection")
        return data

    def _available(self) -> bytes:
        return self._received() if select.select([self._socket], [], [], 0.0)[0] else b""

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame; raises OSError if the server is gone."""
        self._socket.settimeout(timeout or _CONNECT_S)
        identifier = f"{msg.arbitration_id:08X}" if msg.is_extended_id else f"{msg.arbitration_id:03X}"
        data = " ".join(f"{byte:x}" for byte in msg.data)
        self._socket.sendall(f"< send {identifier} {msg.dlc:X} {data} >".encode("ascii"))

    def shutdown(self) -> None:
        """Close the connection."""
        super().shutdown()
        self._socket.close()


#: Name of the instrument in errors.
INSTRUMENT = "INS"

#: Adapters that are read in blocks from their bytes.
_TEXT_BUSES: dict[str, Callable[..., can.BusABC]] = {"slcan": _SlcanBus, "socketcand": _SocketcandBus}

#: Frames taken at once; a bus of 1 Mbit/s carries fewer than 10,000 in a second.
_MAX_FRAMES = 100_000


_BUS_ADVICE = "Check the station file's interface, channel and options, and the adapter."


def open_bus(
    interface: str, channel: str | int | None, clock: Clock, bitrate: int | None = None, **options: Any
) -> can.BusABC:
    """Open a CAN bus by its python-can interface name, without python-can's configuration files.

    Raises ConnectionFailedError if the interface or channel does not exist or can't be opened. Raises
    DocumentError if the world behind an emulated bus is wrong.
    """
    if bitrate is not None:
        options["bitrate"] = bitrate
    try:
        if interface in _TEXT_BUSES:
            return _TEXT_BUSES[interface](channel, clock, **options)
        if interface in ("emulator", "replay"):
            options["clock"] = clock.name
        return can.Bus(channel=channel, interface=interface, ignore_config=True, **options)
    except (can.CanError, OSError, ValueError, TypeError, ImportError, NotImplementedError) as error:
        if isinstance(error.__cause__, DocumentError):  # the world behind an emulated bus is wrong
            raise error.__cause__ from None
        raise ConnectionFailedError(
            INSTRUMENT,
            f"can't open the CAN interface '{interface}', channel {channel}: {system_reason(error)}. "
            + port_advice(str(channel), _BUS_ADVICE),
        ) from error


def close_bus(bus: can.BusABC) -> None:
    """Close a bus, also one whose adapter is gone; a second call does nothing."""
    with contextlib.suppress(can.CanError, OSError):  # the adapter is gone
        bus.shutdown()


def block_receiver(bus: can.BusABC) -> Callable[[], FrameBlock]:
    """Return the function that takes the frames that have arrived, in order and without waiting.

    A bus that can hand over blocks has it as its method ``recv_block``; any other is read message by message.
    An error of the bus is raised by the first call that has no frame from before it.
    """
    return getattr(bus, "recv_block", None) or _MessageReader(bus).recv_block


class _MessageReader:
    """Blocks from a bus that hands over messages."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self._error: Exception | None = None

    def recv_block(self) -> FrameBlock:
        messages: list[can.Message] = []
        try:
            if self._error is not None:
                raise self._error
            # extend() keeps the frames before an exception.
            messages.extend(islice(iter(partial(self._bus.recv, 0.0), None), _MAX_FRAMES))
        except Exception as error:
            self._error = error if messages else None
            if not messages:
                raise
        return FrameBlock.from_messages(messages)
