"""A signal map tied to a DBC file: units checked and converted, values read by arrival.

Bound values are in SI (m/s, rad, s), temperatures in degrees Celsius. A speed or a temperature at the
end of its field's range or beyond the DBC's is no value: it is saturated, or says that there is none.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from cantools.database.can import Signal

from gyrobench.bench.foundations.arrays import FloatArray, IntArray
from gyrobench.bench.foundations.documents import Location, Problem
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.drivers.ins.dbc_codec import DbcCodec
from gyrobench.drivers.ins.frames import FrameBlock
from gyrobench.drivers.ins.signal_map import Dimension, Quantity, SignalMap

Rows = IntArray

_KNOT_MPS = 1852.0 / 3600.0
_DEGREE_RAD = np.pi / 180.0
_ZERO_C_IN_K = 273.15

#: Spellings of the units of each dimension: (gain, offset) to its SI unit or degrees Celsius.
_UNITS: dict[Dimension, dict[str, tuple[float, float]]] = {
    Dimension.TIME: {
        **dict.fromkeys(("s", "sec"), (1.0, 0.0)),
        "ms": (1e-3, 0.0),
        **dict.fromkeys(("us", "µs", "μs"), (1e-6, 0.0)),
        "ns": (1e-9, 0.0),
    },
    Dimension.SPEED: {
        **dict.fromkeys(("m/s", "m.s-1", "mps"), (1.0, 0.0)),
        **dict.fromkeys(("kt", "kn", "knot", "knots"), (_KNOT_MPS, 0.0)),
        **dict.fromkeys(("km/h", "kph"), (1.0 / 3.6, 0.0)),
    },
    Dimension.ANGLE: {
        **dict.fromkeys(("rad", "radian"), (1.0, 0.0)),
        **dict.fromkeys(("deg", "degree", "degrees", "°"), (_DEGREE_RAD, 0.0)),
    },
    Dimension.TEMPERATURE: {
        **dict.fromkeys(("degC", "deg C", "°C", "C"), (1.0, 0.0)),
        "K": (1.0, -_ZERO_C_IN_K),
        **dict.fromkeys(("degF", "deg F", "°F", "F"), (5.0 / 9.0, -160.0 / 9.0)),
    },
}


@dataclass(frozen=True)
class BoundSignal:
    """A quantity's signal and the straight line from its DBC value to SI."""

    message: str
    signal: Signal
    gain: float
    offset: float
    saturates: bool = False

    def to_si(self, physical: FloatArray) -> FloatArray:
        """Values in SI of values in the DBC's unit; NaN where the signal is saturated."""
        values = np.asarray(physical * self.gain + self.offset, np.float64)
        if self.saturates:
            low, high = self._limits
            values[~((physical > low) & (physical < high))] = np.nan
        return values

    @cached_property
    def _limits(self) -> tuple[float, float]:
        """Between which values in the DBC's unit the signal means something."""
        signal = self.signal
        low, high = -np.inf, np.inf
        if not signal.conversion.is_float:
            first = -(2 ** (signal.length - 1)) if signal.is_signed else 0
            ends = [signal.offset + signal.scale * raw for raw in (first, first + 2**signal.length - 1)]
            # Half a step inwards: the end itself need not come out exactly.
            low, high = min(ends) + abs(signal.scale) / 2.0, max(ends) - abs(signal.scale) / 2.0
        if signal.minimum is not None and signal.maximum is not None and signal.minimum < signal.maximum:
            margin = abs(signal.scale) / 2.0 if not signal.conversion.is_float else 0.0
            low = max(low, float(signal.minimum) + margin)
            high = min(high, float(signal.maximum) - margin)
        return low, high

    @property
    def lsb(self) -> float:
        """Smallest step of an integer signal, in SI; zero for a floating-point signal."""
        return 0.0 if self.signal.conversion.is_float else abs(self.signal.scale * self.gain)

    @property
    def modulus(self) -> float:
        """What the value wraps at, in SI, if it counts on for ever; infinite for floating point."""
        return np.inf if self.signal.conversion.is_float else self.lsb * 2.0**self.signal.length


def bind_signals(signal_map: SignalMap, codec: DbcCodec) -> dict[str, BoundSignal]:
    """Find each mapped quantity's signal, by the path of :meth:`SignalMap.quantities`.

    Raises
    ------
    DocumentError
        A message or signal does not exist, or its unit can't be converted; lists all such.
    """
    bound, problems = _bind(signal_map, codec)
    if problems:
        lines = [f"ins.signals.{'.'.join(map(str, p.location))}: {p.message}" for p in problems]
        raise DocumentError("\n".join(lines))
    return bound


def check_signals(signal_map: SignalMap, codec: DbcCodec, at: Location = ()) -> list[Problem]:
    """List what :func:`bind_signals` would raise, with the map standing at ``at`` in its file."""
    return [Problem((*at, *found.location), found.message) for found in _bind(signal_map, codec)[1]]


def _bind(signal_map: SignalMap, codec: DbcCodec) -> tuple[dict[str, BoundSignal], list[Problem]]:
    bound: dict[str, BoundSignal] = {}
    problems: list[Problem] = []
    for path, quantity in signal_map.quantities().items():
        try:
            bound[path] = _bind_one(quantity, codec)
        except DocumentError as error:
            problems.append(Problem(quantity.location, str(error)))
    for index, name in enumerate(signal_map.epoch_messages or []):
        try:
            codec.arbitration_id(name)
        except DocumentError as error:
            problems.append(Problem(("epoch_messages", index), str(error)))
    return bound, problems


def _bind_one(quantity: Quantity, codec: DbcCodec) -> BoundSignal:
    message, _, name = quantity.source.signal.partition(".")
    signal = codec.signal(message, name)
    gain, offset = _conversion(quantity, signal)
    factor = quantity.source.sign * quantity.source.scale
    saturates = quantity.dimension in (Dimension.SPEED, Dimension.TEMPERATURE)
    return BoundSignal(message, signal, factor * gain, factor * offset, saturates)


def _conversion(quantity: Quantity, signal: Signal) -> tuple[float, float]:
    allowed = _UNITS.get(quantity.dimension)
    if allowed is None:
        return 1.0, 0.0
    unit = quantity.source.unit if quantity.source.unit is not None else (signal.unit or "")
    if unit.strip() not in allowed:
        raise DocumentError(
            f"the signal {quantity.source.signal} has the unit '{unit}', which is no {quantity.dimension}; "
            f"allowed: {', '.join(allowed)}. If the DBC is wrong, give 'unit' beside 'signal'."
        )
    return allowed[unit.strip()]


class BlockReader:
    """Values of bound signals in one block; each message is decoded once."""

    def __init__(self, block: FrameBlock, codec: DbcCodec) -> None:
        self.block = block
        self.codec = codec
        self._decoded: dict[str, tuple[Rows, dict[str, FloatArray]]] = {}

    def rows(self, message: str) -> Rows:
        """Where in the block the frames of a message stand."""
        return self._message(message)[0]

    def held(self, bound: BoundSignal, rows: Rows) -> FloatArray:
        """Last value that had arrived at each of those rows of the block; NaN before the first."""
        frames, decoded = self._message(bound.message)
        values = np.append(bound.to_si(decoded[bound.signal.name]), np.nan)
        # Index -1, where nothing had arrived yet, is the NaN at the end.
        return np.asarray(values[np.searchsorted(frames, rows, side="right") - 1])

    def _message(self, message: str) -> tuple[Rows, dict[str, FloatArray]]:
        if message not in self._decoded:
            rows = self.codec.rows(self.block, message)
            self._decoded[message] = rows, self.codec.decode(self.block, message)
        return self._decoded[message]
