"""A preflight from file names: opens the bench, looks at it, and closes it again."""

from __future__ import annotations

import contextlib
from pathlib import Path

from gyrobench.bench.engine.preflight.messages import message_checks
from gyrobench.bench.engine.preflight.preflight import preflight
from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.procedure.procedure_file import load_procedure
from gyrobench.bench.procedure.timeline import hours_minutes
from gyrobench.bench.station.check import Check
from gyrobench.bench.station.instruments import Emulation, Outputs, open_ins
from gyrobench.bench.station.locks import BenchLock
from gyrobench.bench.station.station import Station
from gyrobench.drivers.ins.can_ins import CanIns


def check_bench(
    station: str, procedure: str | None, emulation: Emulation, folder: Path, clock: Clock | None = None
) -> list[Check]:
    """Look whether a bench is fit for a procedure, or for any where none is given.

    Parameters
    ----------
    station, procedure : str
        Files, or names of shipped ones.
    folder : Path
        Where the run folder is to be.
    clock : Clock, optional
        One of the station's kind without it.

    Raises
    ------
    DocumentError
        The station file is wrong.
    BenchInUseError
        A run holds the bench.
    """
    bench = Station(find_document("stations", station))
    bench.check_dbc()
    clock = clock or bench.new_clock()
    plan, of_plan = _plan(bench, procedure)
    with (
        BenchLock(bench, folder, clock),
        contextlib.ExitStack() as opened,
        Outputs(bench, clock, emulation) as outputs,
    ):

        def ins() -> CanIns:
            driver = open_ins(bench, clock, emulation)
            opened.callback(driver.close)
            return driver

        return [of_plan, *preflight(bench, outputs, ins, clock, folder, plan), *message_checks(bench)]


def _plan(station: Station, procedure: str | None) -> tuple[Plan | None, Check]:
    subject, what = "procedure", "keeps the limits"
    if procedure is None:
        return None, Check.skipped(subject, what, "none was given", "Give --procedure to have it looked at.")
    try:
        document, model = load_procedure(find_document("procedures", procedure))
        plan = station.plan(document, model)
    except DocumentError as error:
        return None, Check.of(subject, what, False, str(error), "Correct the procedure.")
    dwells = f"{plan.dwell_count} dwell{'s' if plan.dwell_count != 1 else ''}"
    return plan, Check.of(subject, what, True, f"{dwells} in {hours_minutes(plan.duration_s)} h", "")
