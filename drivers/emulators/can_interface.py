"""python-can interface ``emulator``: the emulated INS as a CAN bus."""

from __future__ import annotations

from collections import deque
from typing import Any

import can

from bench.errors import GyrobenchError
from drivers.emulators.bench import BenchAddress, emulated_bench


class EmulatorBus(can.BusABC):
    """A bus with the emulated INS on it, living on the bench's clock.

    Parameters
    ----------
    channel : str
        ``ins``.
    clock, world, seed
        Which emulated bench; see :mod:`drivers.emulators.bench`.

    Raises
    ------
    can.CanInitializationError
        There is no such channel, clock or world.
    """

    def __init__(
        self, channel: str = "ins", clock: str = "", world: str = "gyro_a", seed: int = 0, **options: Any
    ) -> None:
        if channel != "ins":
            raise can.CanInitializationError(f"no emulated CAN channel {channel!r}; there is: ins")
        try:
            self._bench = emulated_bench(BenchAddress(clock, world, seed))
        except GyrobenchError as error:
            raise can.CanInitializationError(str(error)) from error
        self._queue: deque[can.Message] = deque()
        self._bench.ins.listeners.append(self._queue.extend)
        self.channel_info = f"emulated INS, world {world}, seed {seed}"
        super().__init__(channel, **options)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002
        """Send a frame to the INS; it arrives at once."""
        self._bench.advance()
        self._bench.ins.receive(msg)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._queue:
            self._wait(timeout)
        return (self._queue.popleft() if self._queue else None), True

    def _wait(self, timeout: float | None) -> None:
        clock = self._bench.clock
        self._bench.advance()
        end_s = float("inf") if timeout is None else clock.now() + timeout
        while not self._queue and clock.now() < end_s:
            clock.sleep(min(self._bench.world.file.ins.epoch_period_s, end_s - clock.now()))
            self._bench.advance()

    def shutdown(self) -> None:
        """Leave the bus; the INS goes on."""
        listeners = self._bench.ins.listeners
        if self._queue.extend in listeners:
            listeners.remove(self._queue.extend)
        super().shutdown()
