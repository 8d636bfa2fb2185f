"""A procedure on a station, read and checked before anything moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gyrobench.bench.bias.dwell import DwellPurpose
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.dwells.earlier_calibration import read_calibration
from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.documents import Document
from gyrobench.bench.foundations.errors import DocumentError, RunFolderError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.foundations.text import excerpt
from gyrobench.bench.procedure.checks import find_problems
from gyrobench.bench.procedure.plan import Plan, expand
from gyrobench.bench.procedure.procedure_file import Procedure, load_procedure
from gyrobench.bench.runs.compensation_file import read_compensation
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.provenance import run_options
from gyrobench.bench.station.instruments import Emulation
from gyrobench.bench.station.station import Station
from gyrobench.drivers.ins.compensation import Compensation


@dataclass(frozen=True)
class Job:
    """A checked procedure on a station, with the calibration to check and the compensation to load."""

    document: Document
    plan: Plan
    station: Station
    emulation: Emulation
    calibration: tuple[DwellRow, ...]
    compensation: Compensation | None
    #: Customer, order and item of the certificate; only those that are given.
    certificate_order: Mapping[str, str]
    acknowledged: tuple[str, ...]  #: Instruments past due whose use the operator acknowledges.
    unit: str = ""  #: Serial number of the only INS that it may run on; empty for any.

    def plan_of(self, unit: Station) -> Plan:
        """The plan with the positions of one unit of the station; units may be mounted differently."""
        if unit.file.rate_table.reference_mounting is None:
            return self.plan
        return unit.plan(self.document, self.plan.procedure)

    def calibration_of(self, number: str) -> list[DwellRow]:
        """The calibration of one unit by its number, of several; else all of it."""
        return [row for row in self.calibration if not number or row.unit == number]

    def emulated_world(self) -> dict[str, str | int]:
        """Options of the emulated instruments; empty if none is emulated."""
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
        """Whether the job runs on virtual time, on which no operator can answer."""
        return self.station.is_virtual

    @property
    def options(self) -> dict[str, str | float]:
        """Options of the run as stored in provenance and journal; :func:`emulation_of` reads them."""
        unit, file = {"unit": self.unit} if self.unit else {}, self.station.file
        speed = {"speed": file.speed} if file.speed != 1.0 else {}
        return {"clock": file.clock, **speed, **unit, **self.emulated_world(), **self.certificate_order}

    def past_due(self) -> dict[str, str]:
        """Description of each instrument whose calibration is past due today, by name."""
        return self.station.file.traceability.past_due(WallClock().utc().date())

    def check_calibrations(self) -> None:
        """Raises DocumentError if an instrument is past due and not acknowledged."""
        if unacknowledged := {
            name: text for name, text in self.past_due().items() if name not in self.acknowledged
        }:
            options = " ".join(f"--acknowledge {name}" for name in unacknowledged)
            raise DocumentError(
                f"{self.station.path}: {'; '.join(unacknowledged.values())}. Have it calibrated, or run with "
                f"{options}"
            )


def emulation_of(folder: RunFolder, options: Mapping[str, Any] | None = None) -> Emulation:
    """World, seed and faults of the emulated instruments of a run; defaults for options that it lacks.

    ``options``: options of the run, by default from its provenance. Raises RunFolderError if that is damaged.
    """
    options = run_options(folder) if options is None else options
    seed = options.get("seed", Emulation.seed)
    if type(seed) is not int:
        raise RunFolderError(
            f"{folder.provenance}: damaged: the seed of the emulated instruments must be a whole number; "
            f"found {excerpt(seed)}. Restore the file from a copy"
        )
    return Emulation(str(options.get("world", Emulation.world)), seed, str(options.get("faults", "")))


def prepare_job(
    procedure: str,
    station: str,
    emulation: Emulation | None = None,
    calibration: Path | None = None,
    compensation: Compensation | None = None,
    certificate_order: Mapping[str, str] | None = None,
    acknowledged: Sequence[str] = (),
) -> Job:
    """Read procedure and station and check the procedure against the station.

    Calibration checks are compared with ``calibration``, a run folder or dwell table. ``compensation`` is
    loaded into the INS after each power-on. ``certificate_order``: customer, order and item;
    ``acknowledged``: instruments that may be past due. Raises DocumentError with all problems and their
    places in the files, or if the INS does not accept the compensation.
    """
    bench = Station(find_document("stations", station))
    bench.check_dbc()
    document, model = load_procedure(find_document("procedures", procedure))
    plan = _plan_on_station(bench, document, model)
    if calibration and not any(each.purpose is DwellPurpose.CALIBRATION_CHECK for each in plan.steps):
        raise DocumentError(
            f"{document.path}: checks no calibration, so {calibration} is not used. Leave --calibration out, "
            "or choose a procedure with `purpose: calibration_check`"
        )
    rows = tuple(read_calibration(calibration)) if calibration else ()
    calibrated = {row.unit for row in rows}
    uncalibrated = [unit.number for unit in bench.units if unit.number and unit.number not in calibrated]
    if rows and uncalibrated:
        raise DocumentError(
            f"{calibration}: has no dwell of unit {', '.join(uncalibrated)}. Give a calibration of all units"
        )
    if compensation is not None:
        _check_compensation(bench, compensation)
    order = {name: text for name, text in (certificate_order or {}).items() if text}
    emulation = emulation or Emulation.of(station)
    job = Job(document, plan, bench, emulation, rows, compensation, order, tuple(acknowledged))
    if compensation is not None:
        require_one_unit(job)
    return job


def _plan_on_station(bench: Station, document: Document, procedure: Procedure) -> Plan:
    """Plan the procedure; if only limits of the station forbid it, the error names the station."""
    try:
        return bench.plan(document, procedure)
    except DocumentError as error:
        if find_problems(expand(document, procedure, bench.bench_at_rest())):
            raise
        raise DocumentError(
            f"{error}\nThese are limits of the station {bench.file.station}. Choose another one with "
            "--station, or change the procedure"
        ) from error


def read_job(folder: RunFolder, options: Mapping[str, Any] | None = None) -> Job:
    """Read the job of a run from its folder; ``options`` as in :func:`emulation_of`."""
    compensation = read_compensation(folder.compensation) if folder.compensation.exists() else None
    calibration = folder.calibration if folder.calibration.exists() else None
    options = run_options(folder) if options is None else options
    job = prepare_job(
        str(folder.procedure), str(folder.station), emulation_of(folder, options), calibration, compensation
    )
    return replace(job, unit=str(options.get("unit", "")))


def require_one_unit(job: Job) -> None:
    """Raise DocumentError if the job measures several units at once."""
    if numbers := [unit.number for unit in job.station.units if unit.number]:
        raise DocumentError(
            f"{job.station.path}: has the units {', '.join(numbers)}, and only one can be measured here. Use "
            "a station with that unit alone, as units/NUMBER/station.yaml in a run folder"
        )


def _check_compensation(station: Station, compensation: Compensation) -> None:
    """Raise DocumentError if the INS does not accept the compensation."""
    commands = station.file.ins.commands
    load = commands.load_compensation
    if load is None or commands.apply_compensation is None:
        raise DocumentError(
            f"{station.path}: ins.commands lacks load_compensation or apply_compensation, so no compensation "
            "can be loaded into the INS. Map both commands, or run without --compensation"
        )
    unsupported = load.unsupported(compensation)
    if unsupported:
        raise DocumentError(
            f"{station.path}: ins.commands.load_compensation does not accept {', '.join(unsupported)}. "
            "Map the indices of these terms, or remove the terms from the compensation"
        )
