"""What makes a command language of table controllers a dialect of the station file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.drivers.dialects import LineDefaults
from gyrobench.drivers.rate_table import RateTable
from gyrobench.drivers.serial_line import SerialLine

OptionsT = TypeVar("OptionsT", bound=StrictModel)


@dataclass(frozen=True)
class TableDialect(Generic[OptionsT]):
    """One dialect; offered as an entry point of the group ``gyrobench.rate_tables``.

    Attributes
    ----------
    open : callable
        Makes the driver from the line to the controller, the numbers of the axes in use in
        ascending order, and the options; the driver closes the line.
    options : type of StrictModel
        The keys of its own in the station file's section ``rate_table``.
    line : LineDefaults
        How such a controller is usually reached.
    most_axes : int
        How many axes such a controller has at most.
    """

    open: Callable[[SerialLine, Sequence[int], OptionsT], RateTable]
    options: type[OptionsT]
    line: LineDefaults = field(default_factory=LineDefaults)
    most_axes: int = 9
