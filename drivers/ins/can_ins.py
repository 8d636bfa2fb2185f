"""The INS on its CAN bus: receives frames, gives its present state, and sends commands."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator

import can
import numpy as np
from cantools.database import Database
from numpy.typing import NDArray

from gyrobench.bench.foundations.clock import Clock, Deadline
from gyrobench.bench.foundations.errors import (
    ConnectionFailedError,
    DocumentError,
    FaultError,
    NoReplyError,
    RefusedError,
    ReplyError,
)
from gyrobench.bench.foundations.text import counted
from gyrobench.drivers.frames import ERROR_FRAME, EXTENDED_ID, FrameBlock, concatenate
from gyrobench.drivers.ins.attitude import EulerSequence
from gyrobench.drivers.ins.can_bus import INSTRUMENT, block_receiver, close_bus
from gyrobench.drivers.ins.command_map import Command, CommandMap, check_commands
from gyrobench.drivers.ins.compensation import Compensation, checksum
from gyrobench.drivers.ins.dbc_codec import DbcCodec
from gyrobench.drivers.ins.ins_status import InsStatus, NewestFrames
from gyrobench.drivers.ins.readout import Alignment, InsMode
from gyrobench.drivers.ins.signal_map import SignalMap, bind_signals

#: The status is sent about once a second, and the INS needs time for a command.
_REPLY_TIMEOUT_S = 5.0
_SEND_TIMEOUT_S = 1.0
#: Most identifiers of other nodes that are stored for messages.
_MAX_FOREIGN_IDS = 100
#: Most blocks of frames that are kept to compare counts of epochs; smallest number of counts that is
#: compared, epochs by which frames of one node may arrive out of order, share of steps back of two nodes.
_RECENT_BLOCKS, _MIN_COUNTS, _MAX_DISORDER, _TWO_NODES_SHARE = 64, 16, 3.0, 1.0 / 3.0
#: Classes of errors, bits of the identifier of an error frame from SocketCAN, socketcand and gs_usb.
_NO_ACKNOWLEDGEMENT, _BUS_OFF, _RESTARTED = 0x20, 0x40, 0x100
#: Period at which a confirmation is polled.
POLL_PERIOD_S = 0.05


class CanIns:
    """An INS described by a DBC file, a signal map and a command map.

    ``bus`` is from :func:`~gyrobench.drivers.ins.can_bus.open_bus`. If ``on_frames`` is set, it is called
    with every block of frames that is polled, also while a command waits. ``name`` is the instrument in
    errors, ``is_shared`` whether other units send on the same bus; their frames are then dropped. Raises
    DocumentError if a map does not fit the DBC.
    """

    def __init__(
        self,
        bus: can.BusABC,
        signal_map: SignalMap,
        database: Database,
        clock: Clock,
        commands: CommandMap | None = None,
        name: str = INSTRUMENT,
        is_shared: bool = False,
    ) -> None:
        self.name = name
        self.codec = DbcCodec(database)
        self._own_ids: NDArray[np.uint32] = np.sort(self.codec.arbitration_ids())
        self._is_shared = is_shared
        self._foreign_ids: set[int] = set()  # identifiers of other nodes
        self.error_frames = 0  #: Number of error frames since the first bus was opened.
        self._new_errors, self._error_classes = 0, 0  # since the last data frame of any node
        self._earlier_refusals = 0  # of the bus before the last frame was sent
        self.signal_map = signal_map
        self._signals = bind_signals(signal_map, self.codec)
        self._commands = commands or CommandMap()
        if problems := check_commands(self._commands, self.codec):
            raise DocumentError("\n".join(f"ins.commands.{problem.text}" for problem in problems))
        self._bus = bus
        self._receive = block_receiver(bus)
        self._clock = clock
        self.on_frames: Callable[[FrameBlock], None] | None = None
        self._newest = NewestFrames(self.codec)
        self._recent: deque[FrameBlock] = deque(maxlen=_RECENT_BLOCKS)
        self.frames = 0  #: Number of data frames of the DBC since the first bus was opened.

    def close(self) -> None:
        """Close the bus; a second call does nothing."""
        close_bus(self._bus)

    def replace_bus(self, bus: can.BusABC) -> None:
        """Close the bus and continue on another, after bus-off or a lost adapter; keeps state and count."""
        close_bus(self._bus)
        self._bus, self._receive = bus, block_receiver(bus)

    def poll(self) -> FrameBlock:
        """Return the frames that have arrived, in order, and update the state from them.

        Frames received before an error are returned first. Raises ConnectionFailedError if the bus is gone.
        Raises ReplyError if the adapter sent invalid bytes, or frames are lost.
        """
        try:
            block = self._receive()
        except ReplyError as error:  # the bus does not know the name of the INS
            raise ReplyError(self.name, error.message) from error
        except (ValueError, LookupError) as error:
            raise ReplyError(self.name, f"{self._bus}: received bytes are no CAN frame: {error}") from error
        except (can.CanError, OSError) as error:
            raise self._gone(error) from error
        if not len(block):
            return block
        sent = block.arbitration_id
        is_own = self._own_ids.take(self._own_ids.searchsorted(sent), mode="clip") == sent
        ins_frames = block
        if not is_own.all():  # frames of other nodes do not describe the INS
            ins_frames = block.take(is_own | (block.flags & ERROR_FRAME != 0))
            if len(self._foreign_ids) < _MAX_FOREIGN_IDS:
                self._foreign_ids.update(block.data_frames().arbitration_id.tolist())
                self._foreign_ids.difference_update(self._own_ids.tolist())
        data_frames = ins_frames.data_frames()
        self.frames += len(data_frames)
        if len(data_frames):
            self._newest.take(data_frames, self._clock.now())
            self._recent.append(data_frames)
        self._count_errors(block)
        block = ins_frames if self._is_shared else block
        if self.on_frames is not None and len(block):
            self.on_frames(block)
        return block

    def _count_errors(self, block: FrameBlock) -> None:
        """Count the error frames of a block."""
        data_frames = block.data_frames()
        if len(data_frames):
            self._new_errors, self._error_classes = 0, 0
        if data_frames is block:
            return
        is_error = block.flags & ERROR_FRAME != 0
        self.error_frames += int(np.count_nonzero(is_error))
        if len(data_frames):
            is_error[: np.flatnonzero(block.flags == 0)[-1]] = False
        self._new_errors += int(np.count_nonzero(is_error))
        classes = block.arbitration_id[is_error]
        if len(restarts := np.flatnonzero(classes & _RESTARTED)):  # ends bus-off
            self._error_classes, classes = 0, classes[restarts[-1] + 1 :]
        self._error_classes |= int(np.bitwise_or.reduce(classes, initial=0))

    def describe_bus_errors(self) -> str:
        """Describe the error frames that arrived since the last data frame of any node; empty if none."""
        if self._error_classes & _BUS_OFF:
            return (
                "the adapter is bus-off after too many errors, as with a wrong bit rate or no termination; "
                "a Linux interface without restart-ms stays so until `ip link set can0 type can restart`"
            )
        if self._error_classes & _NO_ACKNOWLEDGEMENT:
            return "no node acknowledges the adapter's frames, as with an INS that is off or disconnected"
        errors = counted(self._new_errors, "bus error")
        return f"the adapter reports {errors}, as with a wrong bit rate" if self._new_errors else ""

    @property
    def has_foreign_frames(self) -> bool:
        """Whether frames that are not in the DBC describe the bus, rather than errors after them."""
        return self.has_other_format or (bool(self._foreign_ids) and not self.describe_bus_errors())

    def describe_foreign_frames(self) -> str:
        """Describe frames in the other format, else errors, else frames not in the DBC; empty if none."""
        if not self.has_foreign_frames:
            return self.describe_bus_errors()
        first = min(self._ids_in_other_format or self._foreign_ids)
        name = f"0x{first & ~EXTENDED_ID:03x}"
        if not self._ids_in_other_format:
            return f"frames arrive, such as {name}, but none that is in the DBC file"
        sent, declared = (29, 11) if first & EXTENDED_ID else (11, 29)
        return f"{name} arrives as an identifier of {sent} bits, and has {declared} bits in the DBC file"

    @property
    def has_other_format(self) -> bool:
        """Whether identifiers of the DBC arrive with 11 bits instead of 29, or the reverse."""
        return bool(self._ids_in_other_format)

    @property
    def _ids_in_other_format(self) -> set[int]:
        return self._foreign_ids.intersection((self._own_ids ^ np.uint32(EXTENDED_ID)).tolist())

    def sends_frames(self, timeout_s: float) -> bool:
        """Poll until a data frame arrives; False at the time-out. Raises as :meth:`poll`."""
        deadline = Deadline(self._clock, timeout_s)
        before = self.frames
        while self.frames == before and not deadline.expired():
            self._clock.sleep(POLL_PERIOD_S)
            self.poll()
        return self.frames > before

    @property
    def keeps_frames(self) -> bool:
        """Whether the bus keeps all frames until they are polled, as an emulated one does."""
        return getattr(self._bus, "keeps_frames", False)

    def status(self) -> InsStatus:
        """Return the state according to the newest frames; does not poll."""
        return InsStatus(self._newest, self._clock.now(), self.signal_map, self._signals)

    def forget(self) -> None:
        """Drop the newest frames, and errors except bus-off: the state is unknown until new ones arrive."""
        self._newest = NewestFrames(self.codec)
        self._recent.clear()
        self._foreign_ids.clear()
        self._new_errors = 0
        self._error_classes &= _BUS_OFF

    def describe_second_node(self) -> str:
        """Describe that two nodes send the frames of the INS: its count of epochs jumps to and fro.

        Empty if one node sends them, without a counter of epochs, or before some epochs have arrived.
        """
        bound = self._signals.get("epoch_counter")
        if bound is None or not self._recent:
            return ""
        frames = concatenate(list(self._recent))
        rows = frames.rows[frames.arbitration_id == bound.arbitration_id][-2 * _MIN_COUNTS :]
        counts = np.array([bound.decode_si(row["data"][: row["length"]].tobytes()) for row in rows])
        half = bound.modulus / 2.0
        steps = (np.diff(counts) + half) % bound.modulus - half
        if len(counts) < _MIN_COUNTS or np.mean(steps < -_MAX_DISORDER) < _TWO_NODES_SHARE:
            return ""
        return (
            "two nodes send the frames of the INS: its count of epochs "
            f"({bound.message}.{bound.signal.name}) jumps back and forth. Disconnect the other node, "
            "or give it other identifiers"
        )

    def identity(self) -> dict[str, int]:
        """Wait for the numbers that identify the INS, by name; empty if the map has none.

        Raises NoReplyError if they do not arrive.
        """
        self._wait(lambda status: len(status.identity) == len(self.signal_map.identity), "identity")
        return self.status().identity

    def identify(self) -> str:
        """Return the identification of the INS as text; raises as :meth:`identity`."""
        numbers = self.identity()
        if not numbers:
            version = self.codec.database.version
            return f"INS on {self._bus.channel_info}{f', DBC version {version!r}' if version else ''}"
        return ", ".join(f"{name.replace('_', ' ')} {number}" for name, number in numbers.items())

    def supports(self, command: str) -> bool:
        """Whether the station file defines a command."""
        return getattr(self._commands, command) is not None

    @property
    def reports_mode(self) -> bool:
        """Whether the signal map contains the mode of the INS."""
        return "mode" in self._signals

    def enter(self, mode: InsMode) -> None:
        """Command the INS to align, to navigate or to stand by, and wait for its confirmation.

        Does not wait if the signal map has no signal for the mode. Raises RefusedError if the INS has no such
        command, NoReplyError if it did not confirm in time, FaultError if it reports a fault, and
        ConnectionFailedError if the bus is gone.
        """
        self._complete(self.enter_stepwise(mode))

    def enter_stepwise(self, mode: InsMode) -> Iterator[None]:
        """:meth:`enter` as a generator that yields until the INS confirms, to command several INS at once.

        The caller waits :data:`POLL_PERIOD_S` at each yield.
        """
        return self._command_stepwise(mode.name.lower(), "mode", lambda status: status.mode is mode)

    def set_euler_sequence_stepwise(self, sequence: EulerSequence) -> Iterator[None]:
        """Set the sequence of the Euler angles; yields and raises as :meth:`enter_stepwise`."""
        command = self._commands.set_euler_sequence
        placeholders = {"$sequence": float(command.number(sequence))} if command is not None else {}
        path = "attitude.euler.sequence"
        return self._command_stepwise(
            "set_euler_sequence", path, lambda status: status.euler_sequence is sequence, placeholders
        )

    def send_increments(self, on: bool) -> None:
        """Switch the output of increments on or off, without confirmation; raises as :meth:`enter`."""
        self._complete(self._command_stepwise("send_increments", "", lambda _: True, {"$on": float(on)}))

    def clear_compensation(self) -> None:
        """Erase the compensation in the INS; waits and raises as :meth:`enter`."""
        self._complete(
            self._command_stepwise(
                "clear_compensation", "compensation", lambda status: status.compensation is False
            )
        )

    def load_compensation(self, compensation: Compensation) -> int:
        """Load a compensation, which :meth:`apply_compensation` then puts into use; returns its checksum.

        Sends all numbers, including zeros, in the units of the DBC. Waits until the INS reports the checksum,
        if the map has a signal for it. Raises RefusedError if the INS has no such command, does not support a
        term of the compensation, or its signals can't carry a number. Raises NoReplyError if the INS did not
        report the checksum in time, as when numbers were lost. Raises ConnectionFailedError if the bus is
        gone.
        """
        command = self._commands.load_compensation
        if command is None:
            raise self._no_command("load_compensation")
        unsupported = command.unsupported(compensation)
        if unsupported:
            raise RefusedError(
                self.name,
                f"can't compensate {', '.join(unsupported)}. It supports a polynomial of degree "
                f"{command.coefficients - 1}{''.join(f', {term}' for term in command.supported_terms())}, by "
                "the station file's ins.commands.load_compensation",
            )
        if altered := command.altered_numbers(self.codec, compensation):
            raise RefusedError(
                self.name,
                f"can't take {', '.join(altered)}: the signals of {command.message} round or clip them. "
                "Check the DBC's scale, or load a polynomial of lower degree",
            )
        numbers = command.numbers(compensation)
        for axis, gyro_numbers in enumerate(numbers):
            for index, value in gyro_numbers.items():
                self._send(command, {"$axis": axis, "$index": index, "$value": value})
        expected = checksum(value for gyro_numbers in numbers for value in gyro_numbers.values())
        if "compensation_loaded" in self._signals:
            self._wait(
                lambda status: status.compensation_loaded == expected,
                f"checksum {expected:08x} of the loaded compensation",
            )
        return expected

    def apply_compensation(self, loaded: int | None = None) -> None:
        """Put the loaded compensation into use; waits and raises as :meth:`enter`.

        If the map has a signal for the checksum in use, waits for that too. ``loaded``: checksum of the
        loaded compensation; by default the one that the INS reports as loaded.
        """

        def is_in_use(status: InsStatus) -> bool:
            present = status.compensation_in_use
            expected = status.compensation_loaded if loaded is None else loaded
            return status.compensation is True and (present == expected or None in (present, expected))

        try:
            self._complete(self._command_stepwise("apply_compensation", "compensation", is_in_use))
        except NoReplyError as error:
            present = self.status().compensation_in_use
            if not self.status().compensation or present is None:
                raise
            raise NoReplyError(
                self.name,
                f"applies a compensation with the checksum {present:08x}, which is not the one that was "
                "loaded. It kept another one, or rounds, limits or ignores coefficients.",
            ) from error

    def _complete(self, steps: Iterator[None]) -> None:
        for _ in steps:
            self._clock.sleep(POLL_PERIOD_S)

    def _command_stepwise(
        self,
        name: str,
        path: str,
        confirms: Callable[[InsStatus], bool],
        placeholders: dict[str, float] | None = None,
    ) -> Iterator[None]:
        """Send a command; yield until a later frame with the quantity ``path`` confirms it.

        Does not wait if the quantity is not mapped. ``placeholders``: values of the command's placeholders.
        """
        command: Command | None = getattr(self._commands, name)
        if command is None:
            raise self._no_command(name)
        self.poll()
        self._send(command, placeholders or {})

        def is_confirmed(status: InsStatus) -> bool:
            if status.mode is InsMode.FAULT:
                raise FaultError(
                    self.name, f"reports a fault after '{name}'. Read its fault code; switch it off and on."
                )
            return confirms(status)

        if path in self._signals:
            self._newest.forget(self._signals[path].message)
            yield from self._wait_stepwise(is_confirmed, f"confirmation of '{name}'")

    def _wait(self, condition: Callable[[InsStatus], bool], subject: str) -> None:
        self._complete(self._wait_stepwise(condition, subject))

    def _wait_stepwise(self, condition: Callable[[InsStatus], bool], subject: str) -> Iterator[None]:
        """Yield until the status meets a condition; raises NoReplyError with ``subject`` at the time-out."""
        deadline = Deadline(self._clock, _REPLY_TIMEOUT_S)
        while True:
            self.poll()
            status = self.status()
            if condition(status):
                return
            if deadline.expired():
                last = f"last frame {status.age_s:.1f} s ago" if np.isfinite(status.age_s) else "no frame yet"
                errors = self.describe_bus_errors() or self._describe_refusal()
                problem = f"; {errors}" if errors else ""
                is_aligning = status.mode is InsMode.ALIGN and status.alignment is not Alignment.FINE
                advice = "Wait until it is aligned, or check" if is_aligning else "Check its power, the bus,"
                raise NoReplyError(
                    self.name,
                    f"no {subject} within {_REPLY_TIMEOUT_S:g} s on {self._bus}; {last}, mode "
                    f"{status.mode_text}{problem}. {advice} the DBC and the signal map.",
                )
            yield

    def _describe_refusal(self) -> str:
        """Describe that an slcan adapter has refused what was sent last; empty if it has not."""
        if getattr(self._bus, "refusals", 0) <= self._earlier_refusals:
            return ""
        return "the adapter refuses to send, as in listen-only mode, bus-off, or if no node acknowledges"

    def _send(self, command: Command, placeholders: dict[str, float]) -> None:
        self._earlier_refusals = getattr(self._bus, "refusals", 0)
        try:
            self._bus.send(command.frame(self.codec, placeholders), timeout=_SEND_TIMEOUT_S)
        except (can.CanError, OSError) as error:
            raise self._gone(error) from error

    def _gone(self, error: Exception) -> ConnectionFailedError:
        return ConnectionFailedError(self.name, f"{self._bus} went away: {error}. Check adapter and cable.")

    def _no_command(self, name: str) -> RefusedError:
        return RefusedError(self.name, f"has no command '{name}'; add it to the station file's ins.commands")
