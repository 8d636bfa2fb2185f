"""What is to be run, checked before anything moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.dwells.earlier_calibration import read_calibration
from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.documents import Document
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.procedure.checks import find_problems
from gyrobench.bench.procedure.plan import DwellPurpose, Plan, expand
from gyrobench.bench.procedure.procedure_file import Procedure, load_procedure
from gyrobench.bench.runs.compensation_file import read_compensation
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.provenance import run_options
from gyrobench.bench.station.instruments import Emulation
from gyrobench.bench.station.station import Station
from gyrobench.drivers.ins.compensation import Compensation


@dataclass(frozen=True)
class Job:
    """A checked procedure on a station, with what it is compared with and what the INS is given."""

    document: Document
    plan: Plan
    station: Station
    emulation: Emulation
    calibration: tuple[DwellRow, ...]
    compensation: Compensation | None
    #: Customer, order and item of the certificate, as far as they are given.
    certificate_order: Mapping[str, str]
    acknowledged: tuple[str, ...]  #: Instruments past due whose use the operator acknowledges.
    unit: str = ""  #: Serial number of the only INS that it is for; empty for any.

    def plan_of(self, unit: Station) -> Plan:
        """The plan with the positions of one unit of the station, whose mounting may differ."""
        if unit.file.rate_table.reference_mounting is None:
            return self.plan
        return unit.plan(self.document, self.plan.procedure)

    def calibration_of(self, number: str) -> list[DwellRow]:
        """The calibration of one unit by its number, of several; else all of it."""
        return [row for row in self.calibration if not number or row.unit == number]

    def emulated_world(self) -> dict[str, str | int]:
        """Options of the emulated instruments; empty where none is emulated."""
        if not self.station.file.is_emulated():
            return {}
        faults = {"faults": self.emulation.faults} if self.emulation.faults else {}
        return {"world": self.emulation.world, "seed": self.emulation.seed, **faults}

    def has_world_of(self, folder: RunFolder) -> bool:
        """Whether a run had the same world, seed and faults; always where nothing is emulated."""
        options = run_options(folder)
        return all(options.get(key) == value for key, value in self.emulated_world().items())

    @property
    def is_virtual(self) -> bool:
        """Whether it runs on virtual time, where no operator can answer."""
        return self.station.is_virtual

    @property
    def options(self) -> dict[str, str | int]:
        """How it is run, as provenance and journal keep it; :func:`emulation_of` reads it."""
        unit = {"unit": self.unit} if self.unit else {}
        return {"clock": self.station.file.clock, **unit, **self.emulated_world(), **self.certificate_order}

    def past_due(self) -> dict[str, str]:
        """Instruments whose calibration is past due today, and since when."""
        return self.station.file.traceability.past_due(WallClock().utc().date())

    def check_calibrations(self) -> None:
        """Raises DocumentError if an instrument is past due and not acknowledged."""
        if left := {name: text for name, text in self.past_due().items() if name not in self.acknowledged}:
            options = " ".join(f"--acknowledge {name}" for name in left)
            raise DocumentError(
                f"{self.station.path}: {'; '.join(left.values())}. Have it calibrated, or run with {options}"
            )


def emulation_of(folder: RunFolder, options: Mapping[str, Any] | None = None) -> Emulation:
    """World, seed and faults behind the emulated instruments of a run; the default without any.

    ``options``: those of the run, by default from its provenance.
    """
    options = run_options(folder) if options is None else options
    return Emulation(
        str(options.get("world", Emulation.world)),
        int(options.get("seed", Emulation.seed)),
        str(options.get("faults", "")),
    )


def prepare_job(
    procedure: str,
    station: str,
    emulation: Emulation | None = None,
    calibration: Path | None = None,
    compensation: Compensation | None = None,
    certificate_order: Mapping[str, str] | None = None,
    acknowledged: Sequence[str] = (),
) -> Job:
    """Read procedure and station and check the one against the other.

    Calibration checks are compared with ``calibration``, a run folder or dwell table. ``compensation`` is
    loaded into the INS after each power-on. ``certificate_order``: customer, order and item;
    ``acknowledged``: instruments that may be past due. Raises DocumentError with everything wrong with
    them and its places, or if the INS does not accept the compensation.
    """
    bench = Station(find_document("stations", station))
    bench.check_dbc()
    document, model = load_procedure(find_document("procedures", procedure))
    plan = _planned(bench, document, model)
    if calibration and not any(each.purpose is DwellPurpose.CALIBRATION_CHECK for each in plan.steps):
        raise DocumentError(
            f"{document.path}: checks no calibration, so {calibration} is not used. Leave --calibration out, "
            "or choose a procedure with `purpose: calibration_check`"
        )
    rows = tuple(read_calibration(calibration)) if calibration else ()
    known = {row.unit for row in rows}
    lacking = [unit.number for unit in bench.units if unit.number and unit.number not in known]
    if rows and lacking:
        raise DocumentError(
            f"{calibration}: has no dwell of unit {', '.join(lacking)}. Give a calibration of all units"
        )
    if compensation is not None:
        _check_compensation(bench, compensation)
    given = {name: text for name, text in (certificate_order or {}).items() if text}
    emulation = emulation or Emulation.of(station)
    job = Job(document, plan, bench, emulation, rows, compensation, given, tuple(acknowledged))
    if compensation is not None:
        require_one_unit(job)
    return job


def _planned(bench: Station, document: Document, procedure: Procedure) -> Plan:
    """The plan on this bench; an error for the limits of its station alone names that station."""
    try:
        return bench.plan(document, procedure)
    except DocumentError as error:
        if find_problems(expand(document, procedure, bench.bench_at_rest())):
            raise
        raise DocumentError(
            f"{error}\nThese are limits of the station {bench.file.station}. Choose another one with "
            "--station, or change the procedure"
        ) from error


def job_in(folder: RunFolder, options: Mapping[str, Any] | None = None) -> Job:
    """The job of a run as its folder holds it; ``options`` as in :func:`emulation_of`."""
    compensation = read_compensation(folder.compensation) if folder.compensation.exists() else None
    calibration = folder.calibration if folder.calibration.exists() else None
    options = run_options(folder) if options is None else options
    job = prepare_job(
        str(folder.procedure), str(folder.station), emulation_of(folder, options), calibration, compensation
    )
    return replace(job, unit=str(options.get("unit", "")))


def require_one_unit(job: Job) -> None:
    """Raise DocumentError if a job measures several units at once, where that is not possible."""
    if numbers := [unit.number for unit in job.station.units if unit.number]:
        raise DocumentError(
            f"{job.station.path}: has the units {', '.join(numbers)}, and only one can be measured here. Use "
            "a station with that unit alone, as units/NUMBER/station.yaml in a run folder"
        )


def _check_compensation(station: Station, compensation: Compensation) -> None:
    """Refuse what the INS does not accept, before anything moves."""
    commands = station.file.ins.commands
    load = commands.load_compensation
    if load is None or commands.apply_compensation is None:
        raise DocumentError(
            f"{station.path}: ins.commands lacks load_compensation or apply_compensation, so no compensation "
            "can be loaded into the INS. Map both commands, or run without --compensation"
        )
    refused = load.unsupported(compensation)
    if refused:
        raise DocumentError(
            f"{station.path}: ins.commands.load_compensation does not accept {', '.join(refused)}. "
            "Map the indices of these terms, or remove the terms from the compensation"
        )
