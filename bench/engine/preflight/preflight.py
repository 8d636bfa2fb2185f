"""All checks of a bench."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gyrobench.bench.engine.preflight.chamber import chamber_checks
from gyrobench.bench.engine.preflight.disk import disk_check
from gyrobench.bench.engine.preflight.ins import Listened, ins_checks
from gyrobench.bench.engine.preflight.table import table_checks
from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.station.check import Check
from gyrobench.bench.station.instruments import Outputs
from gyrobench.bench.station.station import Station
from gyrobench.drivers.ins.can_ins import CanIns


def preflight(
    station: Station,
    outputs: Outputs,
    ins: Callable[[], CanIns],
    clock: Clock,
    folder: Path,
    plan: Plan | None = None,
) -> list[Check]:
    """Look at a bench without moving anything.

    A unit that is off and that the bench can switch on is on for the time of the check.

    Parameters
    ----------
    outputs : Outputs
        Rate table and chamber.
    ins : callable
        Gives the driver of the INS, or raises where it can't be opened.
    folder : Path
        Where the run folder is to be.
    plan : Plan, optional
        What is to be run.

    Returns
    -------
    list of Check
        In the order in which they were looked at; a bench that is not fit for a run is told by
        them and raises nothing.
    """
    listened = Listened()
    return [
        *table_checks(station, lambda: outputs.table),
        *chamber_checks(station, lambda: outputs.chamber),
        *ins_checks(station, outputs, ins, clock, listened),
        disk_check(station, folder, plan, listened.frames_per_s),
    ]
