"""What a station's file says of how well a plan would show an effect, and how a changed plan is made."""

from __future__ import annotations

from dataclasses import replace

from gyrobench.bench.closure.planned_campaign import PlannedUnit
from gyrobench.bench.foundations.documents import Document
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.procedure.procedure_file import checked_procedure
from gyrobench.bench.station.station import Station


def planned_unit(station: Station) -> PlannedUnit:
    """The unit on a station: its sensors, and its noise where that is declared."""
    signals, noise = station.file.ins.signals, station.file.ins.noise
    unit = PlannedUnit(
        has_boards=signals.gyro_electronics_temperature is not None,
        has_case=signals.case_temperature is not None,
    )
    if noise == "estimated":
        return unit
    walk = noise.angle_random_walk_deg_per_sqrt_h
    return replace(unit, angle_random_walk_deg_per_sqrt_h=walk, is_noise_declared=True)


def plan_on(station: Station, document: Document) -> Plan:
    """Plan a procedure that was changed.

    Raises
    ------
    DocumentError
        It is no procedure any more, or the station can't run it.
    """
    return station.plan(document, checked_procedure(document))
