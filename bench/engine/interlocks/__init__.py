"""Interlocks: the station's limits, watched at every tick whatever the procedure does.

``watch`` asks the checks of ``table_checks``, ``chamber_checks`` and ``ins_checks``. They look at
levels, never at changes: what is wrong already when a run begins trips at once, and goes on to trip
until it is good again.
"""

from gyrobench.bench.engine.interlocks.expected import Expected
from gyrobench.bench.engine.interlocks.findings import Finding
from gyrobench.bench.engine.interlocks.watch import InterlockWatch, Trip, text_of

__all__ = ["Expected", "Finding", "InterlockWatch", "Trip", "text_of"]
