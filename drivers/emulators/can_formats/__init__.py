"""What an emulated INS puts on the bus and understands there, one module a set of frames."""

from __future__ import annotations

from collections.abc import Callable
from types import MappingProxyType

from gyrobench.drivers.emulators.can_formats.can_format import CanFormat
from gyrobench.drivers.emulators.can_formats.canaerospace import CanaerospaceFormat
from gyrobench.drivers.emulators.can_formats.gyrobench_ins import GyrobenchFormat
from gyrobench.drivers.emulators.can_formats.sbg import SbgFormat
from gyrobench.drivers.emulators.world.world import World

#: Makes each set of frames, by the name of its DBC file: given the world, and calendar time at its zero.
CAN_FORMATS: MappingProxyType[str, Callable[[World, float], CanFormat]] = MappingProxyType(
    {"gyrobench_ins": GyrobenchFormat, "sbg": SbgFormat, "canaerospace": CanaerospaceFormat}
)

__all__ = ["CAN_FORMATS", "CanFormat"]
