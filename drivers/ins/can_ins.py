"""The INS on its CAN bus: frames as they arrive, its present state, commands."""

from __future__ import annotations

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
from gyrobench.drivers.frames import EXTENDED_ID, FrameBlock
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
#: Identifiers of other nodes that are kept for messages.
_MAX_OTHERS = 100
#: Period at which a confirmation is looked for.
POLL_PERIOD_S = 0.05


class CanIns:
    """An INS that a DBC file, a signal map and a command map describe.

    ``bus`` is from :func:`~gyrobench.drivers.ins.can_bus.open_bus`. Where set, ``on_frames`` receives every
    block of frames that is polled, also while a command waits. ``name`` is the instrument in errors.
    ``is_shared``: whether other units send on the bus too; their frames are left out. Raises DocumentError if
    a map does not fit the DBC.
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
        self._own: NDArray[np.uint32] = np.sort(self.codec.arbitration_ids())
        self._is_shared = is_shared
        self._others: set[int] = set()  # identifiers of other nodes
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
        self.frames = 0  #: Number of data frames of the DBC since the first bus was opened.

    def close(self) -> None:
        """Close the bus; a second call does nothing."""
        close_bus(self._bus)

    def replace_bus(self, bus: can.BusABC) -> None:
        """Close the bus and continue on another, after bus-off or a lost adapter; count and state stay."""
        close_bus(self._bus)
        self._bus, self._receive = bus, block_receiver(bus)

    def poll(self) -> FrameBlock:
        """Take the frames that have arrived, in order; frames from before an error come first.

        Raises ConnectionFailedError if the bus is gone. Raises ReplyError if the adapter sent bytes that are
        no frame, or frames are lost.
        """
        try:
            block = self._receive()
        except (ValueError, LookupError) as error:
            raise ReplyError(self.name, f"{self._bus}: received bytes are no CAN frame: {error}") from error
        except (can.CanError, OSError) as error:
            raise self._gone(error) from error
        if not len(block):
            return block
        sent = block.arbitration_id
        is_own = self._own.take(self._own.searchsorted(sent), mode="clip") == sent
        own = block
        if not is_own.all():  # other nodes say nothing about the INS
            own = block.take(is_own)
            if len(self._others) < _MAX_OTHERS:
                self._others.update(block.data_frames().arbitration_id.tolist())
                self._others.difference_update(self._own.tolist())
        self._take(own)
        block = own if self._is_shared else block
        if self.on_frames is not None and len(block):
            self.on_frames(block)
        return block

    def _take(self, own: FrameBlock) -> None:
        data_frames = own.data_frames()
        self.frames += len(data_frames)
        if len(data_frames):
            self._newest.take(data_frames, self._clock.now())

    def other_frames(self) -> str:
        """Describe the frames that are received of other nodes, none of the DBC; empty without any."""
        if not self._others:
            return ""
        first = min(self._in_other_format or self._others)
        name = f"0x{first & ~EXTENDED_ID:03x}"
        if not self._in_other_format:
            return f"frames arrive, such as {name}, but none that is in the DBC file"
        sent, declared = (29, 11) if first & EXTENDED_ID else (11, 29)
        return f"{name} arrives as an identifier of {sent} bits, and has {declared} bits in the DBC file"

    @property
    def has_other_format(self) -> bool:
        """Whether identifiers of the DBC arrive, but with 11 in place of 29 bits or the reverse."""
        return bool(self._in_other_format)

    @property
    def _in_other_format(self) -> set[int]:
        return self._others.intersection((self._own ^ np.uint32(EXTENDED_ID)).tolist())

    def sends_frames(self, timeout_s: float) -> bool:
        """Poll until a data frame arrives; False if none does in this time. Raises as :meth:`poll`."""
        deadline = Deadline(self._clock, timeout_s)
        before = self.frames
        while self.frames == before and not deadline.expired():
            self._clock.sleep(POLL_PERIOD_S)
            self.poll()
        return self.frames > before

    @property
    def keeps_frames(self) -> bool:
        """Whether frames wait on the bus without limit, as on an emulated one: it may be polled late."""
        return getattr(self._bus, "keeps_frames", False)

    def status(self) -> InsStatus:
        """State by the newest frames; does not poll."""
        now_s = self._clock.now()
        snapshot = self._newest.snapshot(now_s)
        return InsStatus(snapshot, self._newest.age_s(now_s), self.signal_map, self._signals)

    def forget(self) -> None:
        """Drop the newest frames: the state is unknown until others arrive."""
        self._newest = NewestFrames(self.codec)
        self._others.clear()

    def identity(self) -> dict[str, int]:
        """Wait for the numbers that identify the INS, none if the map has none; raises NoReplyError."""
        self._wait(lambda status: len(status.identity) == len(self.signal_map.identity), "identity")
        return self.status().identity

    def identify(self) -> str:
        """Identification of the INS, in words; raises as :meth:`identity`."""
        numbers = self.identity()
        if not numbers:
            return f"INS on {self._bus.channel_info}, DBC version '{self.codec.database.version or ''}'"
        return ", ".join(f"{name.replace('_', ' ')} {number}" for name, number in numbers.items())

    def supports(self, command: str) -> bool:
        """Whether the station file defines a command."""
        return getattr(self._commands, command) is not None

    @property
    def reports_mode(self) -> bool:
        """Whether the map has the mode of the INS."""
        return "mode" in self._signals

    def enter(self, mode: InsMode) -> None:
        """Command the INS to align, to navigate or to stand by, and wait until it confirms that.

        Where the map has no signal that confirms it, the command is sent without confirmation. Raises
        RefusedError if the INS has no such command. Raises NoReplyError if the INS did not confirm in time.
        Raises FaultError if the INS reports a fault. Raises ConnectionFailedError if the bus is gone.
        """
        self._complete(self.entering(mode))

    def entering(self, mode: InsMode) -> Iterator[None]:
        """:meth:`enter` in steps: yields until the INS confirms it, for several INS at once.

        :data:`POLL_PERIOD_S` is to be waited at each yield.
        """
        return self._commanding(mode.name.lower(), "mode", lambda status: status.mode is mode)

    def setting_euler_sequence(self, sequence: EulerSequence) -> Iterator[None]:
        """Choose the sequence of the Euler angles, in steps; yields and raises as :meth:`entering`."""
        command = self._commands.set_euler_sequence
        given = {"$sequence": float(command.number(sequence))} if command is not None else {}
        path = "attitude.euler.sequence"
        return self._commanding(
            "set_euler_sequence", path, lambda status: status.euler_sequence is sequence, given
        )

    def send_increments(self, on: bool) -> None:
        """Begin or stop to send increments, without confirmation; raises as :meth:`enter`."""
        self._complete(self._commanding("send_increments", "", lambda _: True, {"$on": float(on)}))

    def clear_compensation(self) -> None:
        """Erase the compensation in the INS; waits and raises as :meth:`enter`."""
        self._complete(
            self._commanding(
                "clear_compensation", "compensation", lambda status: status.compensation is False
            )
        )

    def load_compensation(self, compensation: Compensation) -> int:
        """Load a compensation, for :meth:`apply_compensation` to put into use; returns its checksum.

        Sends all numbers, also zeros, in the units of the DBC. Waits until the INS reports the checksum, if
        the map has a signal for it. Raises RefusedError if the INS has no such command, or does not support a
        term of the compensation. Raises NoReplyError if the INS did not confirm in time: numbers were lost or
        differ. Raises ConnectionFailedError if the bus is gone.
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
        if altered := command.altered(self.codec, compensation):
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

        Where the map has a signal for the checksum in use, that confirms it too. ``loaded``: the checksum of
        what was loaded; by default what the INS reports as loaded.
        """

        def in_use(status: InsStatus) -> bool:
            used = status.compensation_in_use
            expected = status.compensation_loaded if loaded is None else loaded
            return status.compensation is True and (used == expected or None in (used, expected))

        try:
            self._complete(self._commanding("apply_compensation", "compensation", in_use))
        except NoReplyError as error:
            used = self.status().compensation_in_use
            if not self.status().compensation or used is None:
                raise
            raise NoReplyError(
                self.name,
                f"applies a compensation with the checksum {used:08x}, which is not the one that was loaded. "
                "It kept another one, or rounds, limits or ignores coefficients.",
            ) from error

    def _complete(self, steps: Iterator[None]) -> None:
        for _ in steps:
            self._clock.sleep(POLL_PERIOD_S)

    def _commanding(
        self,
        name: str,
        path: str,
        confirms: Callable[[InsStatus], bool],
        given: dict[str, float] | None = None,
    ) -> Iterator[None]:
        """Send a command and wait for a later frame with the quantity ``path`` that confirms it."""
        command: Command | None = getattr(self._commands, name)
        if command is None:
            raise self._no_command(name)
        self.poll()
        self._send(command, given or {})

        def is_confirmed(status: InsStatus) -> bool:
            if status.mode is InsMode.FAULT:
                raise FaultError(
                    self.name, f"reports a fault after '{name}'. Read its fault code; switch it off and on."
                )
            return confirms(status)

        if path in self._signals:
            self._newest.forget(self._signals[path].message)
            yield from self._waiting(is_confirmed, f"confirmation of '{name}'")

    def _wait(self, condition: Callable[[InsStatus], bool], what: str) -> None:
        self._complete(self._waiting(condition, what))

    def _waiting(self, condition: Callable[[InsStatus], bool], what: str) -> Iterator[None]:
        deadline = Deadline(self._clock, _REPLY_TIMEOUT_S)
        while True:
            self.poll()
            status = self.status()
            if condition(status):
                return
            if deadline.expired():
                last = f"last frame {status.age_s:.1f} s ago" if np.isfinite(status.age_s) else "no frame yet"
                is_aligning = status.mode is InsMode.ALIGN and status.alignment is not Alignment.FINE
                advice = "Wait until it is aligned, or check" if is_aligning else "Check its power, the bus,"
                raise NoReplyError(
                    self.name,
                    f"no {what} within {_REPLY_TIMEOUT_S:g} s on {self._bus}; {last}, mode "
                    f"{status.mode_text}. {advice} the DBC and the signal map.",
                )
            yield

    def _send(self, command: Command, given: dict[str, float]) -> None:
        try:
            self._bus.send(command.frame(self.codec, given), timeout=_SEND_TIMEOUT_S)
        except (can.CanError, OSError) as error:
            raise self._gone(error) from error

    def _gone(self, error: Exception) -> ConnectionFailedError:
        return ConnectionFailedError(self.name, f"{self._bus} went away: {error}. Check adapter and cable.")

    def _no_command(self, name: str) -> RefusedError:
        return RefusedError(self.name, f"has no command '{name}'; add it to the station file's ins.commands")
