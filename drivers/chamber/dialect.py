"""What makes a command language of chamber controllers a dialect of the station file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.drivers.chamber import Chamber
from gyrobench.drivers.dialects import LineDefaults
from gyrobench.drivers.serial_line import SerialLine

OptionsT = TypeVar("OptionsT", bound=StrictModel)


@dataclass(frozen=True)
class ChamberDialect(Generic[OptionsT]):
    """One dialect; offered as an entry point of the group ``gyrobench.chambers``.

    Attributes
    ----------
    open : callable
        Makes the driver from the line to the controller and the options; the driver closes the line.
    options : type of StrictModel
        The keys of its own in the station file's section ``chamber``.
    line : LineDefaults
        How such a controller is usually reached.
    """

    open: Callable[[SerialLine, OptionsT], Chamber]
    options: type[OptionsT]
    line: LineDefaults = field(default_factory=LineDefaults)
