"""Opens and closes the CAN bus of the INS, and receives its frames in blocks of numpy arrays.

Adapters that send frames as text, slcan and socketcand, have their own bus classes here. A thread reads their
bytes: a port's buffer in the kernel may be 4 kB, which fills in 15 ms at 10,000 frames per second, while the
bench polls once a second. The thread reads every few milliseconds rather than at each arrival, which takes a
tenth of the processor time. :meth:`recv_block` converts all received lines at once.
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
from gyrobench.drivers.ins.read_ahead_bus import ReadAheadBus, await_reader
from gyrobench.drivers.serial_line import port_advice, system_reason

_READ_PERIOD_S = 0.005
_MAX_READ_BYTES = 1 << 16
#: Most bytes that wait for conversion: a minute of a full bus of 1 Mbit/s.
_MAX_QUEUED_BYTES = 16 << 20
_MAX_LINE_BYTES = 1000
_CONNECT_S = 5.0
#: Most layouts of lines (length, kind and number of data bytes) in one block; a bus has some 40.
_MAX_LAYOUTS = 200
_BLANKS = b" \t\r\n"
_BEL = b"\a"

_NIBBLE = np.full(256, 255, np.uint8)
_NIBBLE[list(b"0123456789abcdef")] = np.arange(16)
_NIBBLE[list(b"ABCDEF")] = np.arange(10, 16)


@dataclass(frozen=True)
class _Format:
    """Text format of an adapter's frames.

    A line counts as a frame if its character at ``letter_index`` is one of ``letters``; other lines, such as
    answers to commands and frames of CAN FD, are skipped.
    """

    ends: bytes  #: Characters that end a line.
    letter_index: int
    letters: bytes
    #: Matches a line without its end. Groups: ``kind``, ``id``, ``data``, and either ``length``, or ``whole``
    #: and ``fraction`` of the time stamp.
    frame: re.Pattern[bytes]

    def frames(self, data: bytes) -> tuple[FrameBlock, IntArray, bytes, int]:
        """Convert complete lines; those of one layout together, for at most :data:`_MAX_LAYOUTS` layouts.

        Returns the frames, the indices in ``data`` where their lines end, the first invalid line (empty if
        there is none), and the number of lines that were not converted because of too many layouts.
        """
        text = np.frombuffer(data, np.uint8)
        end = np.flatnonzero(np.isin(text, list(self.ends)) if len(self.ends) > 1 else text == self.ends[0])
        begin = self._without_blanks(text, np.concatenate([[0], end[:-1] + 1]))
        letters = text[np.minimum(begin + self.letter_index, end)]
        remaining = np.flatnonzero(np.isin(letters, list(self.letters)))
        rows, is_frame = np.zeros(len(end), FRAME_DTYPE), np.zeros(len(end), np.bool_)
        for _ in range(_MAX_LAYOUTS):
            matches = (
                (index, self._match(data, begin[line], end[line])) for index, line in enumerate(remaining)
            )
            first, match = next((each for each in matches if each[1]), (len(remaining), None))
            remaining = remaining[first:]
            if match is None:
                break
            converted = self._convert_layout(match, text, begin[remaining], end[remaining], rows, remaining)
            is_frame[remaining[converted]] = True
            remaining = remaining[~converted]
        invalid = np.zeros(len(end), np.bool_)
        invalid[np.searchsorted(end, np.flatnonzero(text > 127))] = True
        invalid[np.isin(letters, list(self.letters))] = True
        invalid[remaining] = False
        invalid_lines = np.flatnonzero(invalid & ~is_frame)
        line = data[begin[invalid_lines[0]] : end[invalid_lines[0]]] if len(invalid_lines) else b""
        return FrameBlock(rows).take(is_frame), end[is_frame], line, len(remaining)

    def _without_blanks(self, text: NDArray[np.uint8], begin: IntArray) -> IntArray:
        """Indices of the first characters of lines, after blanks that the adapter may send before them."""
        blanks = [each for each in _BLANKS if each not in self.ends]
        if not np.any(np.isin(text[begin], blanks)):
            return begin
        non_blank = np.flatnonzero(np.isin(text, blanks, invert=True))
        return np.asarray(non_blank[np.searchsorted(non_blank, begin)])

    def _match(self, data: bytes, begin: np.intp, end: np.intp) -> re.Match[bytes] | None:
        """Match a line; None if it is no frame, or has fewer data than its length."""
        match = self.frame.fullmatch(data, int(begin), int(end))
        if match is None or match["kind"] in (b"r", b"R") or "length" not in match.re.groupindex:
            return match
        return match if len(match["data"]) >= 2 * int(match["length"]) else None

    def _convert_layout(
        self,
        match: re.Match[bytes],
        text: NDArray[np.uint8],
        begin: IntArray,
        end: IntArray,
        rows: NDArray[np.void],
        line_numbers: IntArray,
    ) -> BoolArray:
        """Fill the rows of the lines that have the layout of the first one; returns a mask of these lines.

        ``match`` is the match of the first line. ``begin``, ``end`` and ``line_numbers``, shape (k,), give
        the lines in ``text`` and their indices in ``rows``.
        """
        has_layout = np.zeros(len(begin), np.bool_)
        length = end[0] - begin[0]
        same_length = np.flatnonzero(end - begin == length)
        lines = text[begin[same_length, np.newaxis] + np.arange(length)]
        columns = {
            name: np.arange(*match.span(name)) - begin[0]
            for name in match.re.groupindex
            if match[name] is not None
        }
        none = np.zeros(0, np.int64)
        time = np.concatenate([columns.get("whole", none), columns.get("fraction", none)])
        size = int(match["length"]) if "length" in columns else len(columns["data"]) // 2
        kind = match["kind"]
        remote = kind in (b"r", b"R")
        payload = columns["data"][: 0 if remote else 2 * size]
        fixed = np.setdiff1d(np.arange(length), np.concatenate([columns["id"], time, columns["data"]]))
        nibbles = _NIBBLE[lines]
        is_valid = (
            np.all(lines[:, fixed] == lines[0, fixed], axis=1)
            & np.all(nibbles[:, payload] < 16, axis=1)
            & np.all(nibbles[:, columns["id"]] < 16, axis=1)
            & np.all(nibbles[:, time] < 10, axis=1)
        )
        nibbles, filled = nibbles[is_valid], line_numbers[same_length[is_valid]]
        extended = len(columns["id"]) != 3
        rows["id"][filled] = _number(nibbles[:, columns["id"]], 16) & 0x1FFF_FFFF | EXTENDED_ID * extended
        rows["length"][filled] = size
        rows["flags"][filled] = REMOTE_FRAME * remote | ERROR_FRAME * (kind == b"error")
        if len(payload):
            bytes_ = nibbles[:, payload[::2]] << 4 | nibbles[:, payload[1::2]]
            rows["data"][filled, : len(payload) // 2] = bytes_
        if len(time):
            rows["time_s"][filled] = _number(nibbles[:, time], 10) / 10.0 ** len(columns["fraction"])
        if kind == b"error":  # as in python-can: socketcand sends no details
            rows["length"][filled], rows["id"][filled] = 1, rows["id"][filled] | np.uint32(EXTENDED_ID)
        has_layout[same_length[is_valid]] = True
        return has_layout


def _number(digits: NDArray[np.uint8], base: int) -> IntArray:
    """Numbers (n,) from their digits (n, k) in a base."""
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
    refusals = 0  #: Negative answers (BEL) of an slcan adapter.
    max_queued_bytes = 0  #: Largest size of the queue so far.

    def _begin(self, clock: Clock, received: bytes = b"") -> None:
        """Start the reading thread; ``received``: bytes that have already been read."""
        self._clock = clock
        self._period_s = max(_READ_PERIOD_S / clock.speed, 0.001)
        self._chunks: deque[tuple[bytes, float]] = deque()
        self._queued_bytes = self._reported_lost = 0
        self._lock = threading.Lock()
        self._arrived, self._stopping, self._has_read = (threading.Event() for _ in range(3))
        self._failure: Exception | None = None  # permanent, ended the thread
        self._error: ReplyError | None = None
        self._buffered = concatenate([])
        self._thread = threading.Thread(target=self._read_all, args=(received,), daemon=True)
        self._thread.start()

    def _read_available(self) -> bytes:
        """Read the bytes that have arrived, without waiting; raises OSError if the adapter is gone."""
        raise NotImplementedError

    def _read_all(self, rest: bytes) -> None:
        try:
            while not self._stopping.wait(self._period_s):
                data = self._read_available()
                if not data:
                    self._has_read.set()
                    continue
                data = rest + data
                lines_end = 1 + max(data.rfind(end) for end in self._format.ends)
                rest = data[lines_end:]
                if len(rest) > _MAX_LINE_BYTES:
                    data, lines_end, rest = data + self._format.ends[:1], len(data) + 1, b""
                if lines_end:
                    self._put(data[:lines_end])
                self._has_read.set()
        except Exception as error:  # noqa: BLE001 - raised by recv_block
            self._failure = error
        self._arrived.set()

    def _put(self, lines: bytes) -> None:
        self.refusals += lines.count(_BEL)
        with self._lock:
            if self._queued_bytes + len(lines) > _MAX_QUEUED_BYTES:
                self.lost += sum(lines.count(end) for end in self._format.ends)
            else:
                self._chunks.append((lines, self._clock.epoch.timestamp() + self._clock.now()))
                self._queued_bytes += len(lines)
                self.max_queued_bytes = max(self.max_queued_bytes, self._queued_bytes)
        self._arrived.set()

    def recv_block(self) -> FrameBlock:
        """Return the frames that have arrived; see :func:`gyrobench.drivers.ins.can_bus.block_receiver`.

        Raises ReplyError once after invalid bytes, and once after lost frames. Raises OSError if the adapter
        is gone.
        """
        if self._error is not None:
            error, self._error = self._error, None
            raise error
        if not self._chunks and not len(self._buffered) and self._failure is None:
            await_reader(self._has_read)
        failure = self._failure
        with self._lock:
            chunks, self._chunks, self._queued_bytes = self._chunks, deque(), 0
        block, self._buffered = self._buffered, self._buffered.take(slice(0, 0))
        problems = []
        if chunks:
            arrived, line = self._convert(chunks)
            block = concatenate([block, arrived]) if len(block) else arrived
            if line:
                text = line[:40].decode("ascii", "backslashreplace")
                problems.append(f"received bytes are no CAN frame: '{text}'")
        lost, self._reported_lost = self.lost - self._reported_lost, self.lost
        if lost:
            problems.append(f"{lost} frames are lost, since they came too fast or in too many layouts")
        if problems:
            advice = "Check the adapter and the load of this computer."
            self._error = ReplyError("INS", f"{self}: {'; '.join(problems)}. {advice}")
        if len(block) == 0:
            if self._error is not None:
                return self.recv_block()
            if failure is not None:
                raise failure
        return block.matching(self._filters) if self._filters else block

    def _convert(self, chunks: deque[tuple[bytes, float]]) -> tuple[FrameBlock, bytes]:
        texts, stamps_s = zip(*chunks, strict=True)
        block, ends, line, left_out = self._format.frames(b"".join(texts))
        with self._lock:
            self.lost += left_out
        if "length" in self._format.frame.groupindex:  # slcan frames have no time stamps
            chunk = np.searchsorted(np.cumsum([len(text) for text in texts]), ends, side="right")
            block.rows["time_s"] = np.array(stamps_s)[chunk]
        return block, line

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not len(self._buffered):
            self._arrived.clear()
            self._buffered = self.recv_block()
        if not len(self._buffered) and self._arrived.wait(timeout):
            self._buffered = self.recv_block()
        if not len(self._buffered):
            return None, True
        first, self._buffered = self._buffered.take(slice(0, 1)), self._buffered.take(slice(1, None))
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
        try:
            self.serialPortOrig.exclusive = True  # two readers would take each other's frames
            self.serialPortOrig.timeout = 0.0
        except BaseException:
            self._is_shutdown = True  # the command to close would be for the adapter of the other reader
            self.serialPortOrig.close()
            raise
        self._begin(clock)

    def _read_available(self) -> bytes:
        return bytes(self.serialPortOrig.read(_MAX_READ_BYTES))

    def shutdown(self) -> None:
        """Close the adapter and the port, even if the adapter is gone."""
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
            received = self._await_answer(b"", b"< hi >")
            for command in (f"< open {channel} >", "< rawmode >"):
                self._socket.sendall(command.encode())
                received = self._await_answer(received, b"< ok >")
            super().__init__(channel, **options)
        except BaseException:
            self._socket.close()
            raise
        self._begin(clock, received)

    def _await_answer(self, received: bytes, expected: bytes) -> bytes:
        """Wait for the ``expected`` answer; returns the bytes after it."""
        while b">" not in received:
            received += self._receive()
        answer, _, rest = received.partition(b">")
        if answer.lstrip() + b">" != expected:
            raise can.CanInitializationError(f"expected '{expected.decode()}', received {answer + b'>'!r}")
        return rest

    def _receive(self) -> bytes:
        data = self._socket.recv(_MAX_READ_BYTES)
        if not data:
            raise ConnectionError("the server closed the connection")
        return data

    def _read_available(self) -> bytes:
        return self._receive() if select.select([self._socket], [], [], 0.0)[0] else b""

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

#: Bus classes of the adapters that send frames as text.
_TEXT_BUSES: dict[str, Callable[..., can.BusABC]] = {"slcan": _SlcanBus, "socketcand": _SocketcandBus}

#: Most frames in one block; a bus of 1 Mbit/s carries fewer than 10,000 in a second.
_MAX_FRAMES = 100_000


def open_bus(
    interface: str,
    channel: str | int | None,
    clock: Clock,
    bitrate: int | None = None,
    *,
    instrument: str = INSTRUMENT,
    **options: Any,
) -> can.BusABC:
    """Open a CAN bus by its python-can interface name, without python-can's configuration files.

    In real time a thread reads the frames. ``instrument`` is the name of the INS in errors. Raises
    ConnectionFailedError if the interface or channel does not exist or can't be opened. Raises
    DocumentError if the world behind an emulated bus is wrong.
    """
    if bitrate is not None:
        options["bitrate"] = bitrate
    try:
        if interface in _TEXT_BUSES:
            return _TEXT_BUSES[interface](channel, clock, **options)
        if interface in ("emulator", "replay"):
            options["clock"] = clock.name
        bus = can.Bus(channel=channel, interface=interface, ignore_config=True, **options)
        return bus if clock.is_virtual or hasattr(bus, "recv_block") else ReadAheadBus(bus)
    except (can.CanError, OSError, ValueError, TypeError, ImportError, NotImplementedError) as error:
        if isinstance(error.__cause__, DocumentError):  # the world behind an emulated bus is wrong
            raise error.__cause__ from None
        raise ConnectionFailedError(
            instrument,
            f"can't open the CAN interface '{interface}', channel {channel}: {system_reason(error)}. "
            + port_advice(
                str(channel), "Check the station file's interface, channel and options, and the adapter."
            ),
        ) from error


def close_bus(bus: can.BusABC) -> None:
    """Close a bus, even if its adapter is gone; a second call does nothing."""
    with contextlib.suppress(can.CanError, OSError):  # the adapter is gone
        bus.shutdown()


def block_receiver(bus: can.BusABC) -> Callable[[], FrameBlock]:
    """Return a function that returns the frames that have arrived, in order and without waiting.

    It is the bus's method ``recv_block`` if there is one; any other bus is read message by message. If the
    bus fails, the function first returns the frames received before, and raises the error at the next call.
    """
    return getattr(bus, "recv_block", None) or _MessageReader(bus).recv_block


class _MessageReader:
    """Collects the messages of a bus into blocks."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self._error: Exception | None = None

    def recv_block(self) -> FrameBlock:
        messages: list[can.Message] = []
        try:
            if self._error is not None:
                raise self._error
            # extend() keeps the frames received before an exception.
            messages.extend(islice(iter(partial(self._bus.recv, 0.0), None), _MAX_FRAMES))
        except Exception as error:
            self._error = error if messages else None
            if not messages:
                raise
        return FrameBlock.from_messages(messages)
