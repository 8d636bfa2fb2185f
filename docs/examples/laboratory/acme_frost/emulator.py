"""Emulator of the Acme Frost."""

from __future__ import annotations

from gyrobench.drivers.emulators.dialect import ChamberEmulation, OnEvent
from gyrobench.drivers.emulators.world.thermal import ChamberAir

_MAX_REQUEST_BYTES = 64


class FrostEmulator:
    """An Acme Frost that controls the air of an emulated chamber."""

    latency_s = 0.01

    def __init__(self, air: ChamberAir, on_event: OnEvent) -> None:
        self._air, self._on_event = air, on_event
        self._outputs, self._buffer = 0, b""

    def feed(self, data: bytes, now_s: float) -> bytes:
        *requests, rest = (self._buffer + data).split(b"\n")
        self._buffer = rest[-_MAX_REQUEST_BYTES:]
        return b"".join(self._reply(request) + b"\n" for request in requests)

    def _reply(self, request: bytes) -> bytes:
        try:
            return self._answer(request.decode("ascii")).encode("ascii")
        except (ValueError, KeyError):
            return b"E"

    def _answer(self, request: str) -> str:
        name, value = request[:1], request[1:]
        air = self._air
        if value == "?":
            answers = {
                "T": air.air_c,
                "S": air.set_point_c,
                "R": air.ramp_rate_c_per_min or 0.0,
                "C": air.running,
                "O": self._outputs,
            }
            return f"{answers[name]:.2f}"
        if name == "S":
            air.set_point_c = _within(float(value), air.parameters.low_c, air.parameters.high_c)
        elif name == "R":
            air.ramp_rate_c_per_min = _within(float(value), 0.0, 10.0) or None
        elif name == "C":
            air.running = {"0": False, "1": True}[value]
        else:
            self._switch(int(value), {"+": True, "-": False}[name])
        return "ok"

    def _switch(self, number: int, on: bool) -> None:
        self._outputs = self._outputs | 1 << number if on else self._outputs & ~(1 << number)
        self._on_event(number, on)


def _within(value: float, low: float, high: float) -> float:
    if not low <= value <= high:
        raise ValueError(value)
    return value


DIALECT = ChamberEmulation(FrostEmulator)
