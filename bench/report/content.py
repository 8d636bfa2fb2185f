"""All that a run folder holds, read with patience: a run that was cut off has a report as well."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from gyrobench.bench.bias.bins import DEFAULT_WIDTH_C, BiasBin, bin_biases, read_bins
from gyrobench.bench.bias.dwell_table import DwellRow, read_dwells
from gyrobench.bench.bias.noise_estimate import NoiseEstimate
from gyrobench.bench.bias.verdicts import Acceptance, read_acceptance
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.documents import read_document
from gyrobench.bench.foundations.errors import GyrobenchError
from gyrobench.bench.foundations.files import file_sha256
from gyrobench.bench.report.page import FINDINGS_FILE, Findings, read_findings_file
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import RunFacts, facts_of, read_journal
from gyrobench.bench.runs.provenance import read_provenance
from gyrobench.bench.runs.tables.calibration_check_table import CalibrationCheckRow, read_calibration_check
from gyrobench.bench.runs.tables.joint_table import (
    JointBiasRow,
    JointPlateauRow,
    read_joint_biases,
    read_joint_plateaus,
)
from gyrobench.bench.runs.tables.noise_file import read_noise
from gyrobench.bench.runs.telemetry import read_telemetry

T = TypeVar("T")
Entry = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class RunContent:
    """What was found in a run folder.

    Attributes
    ----------
    name : str
        Name of the folder.
    journal : list of mapping
        Its entries, up to the first damaged one.
    provenance, procedure, station : mapping
        Content of these files; empty where missing.
    dwells, bins, telemetry
        Content of the tables; empty where missing. Bins are worked out from the dwells where
        only their own file is missing.
    joint_biases, joint_plateaus, noise, verification
        What solving dwells together, the noise of the INS and verifying a calibration gave; empty
        where there is none.
    acceptance : Acceptance or None
        Verdict on the unit; None where there is none.
    chapters : list of Findings
        What was found by the search for effects, and by its proof, on these dwells.
    problems : list of str
        What is missing or can't be read.
    """

    name: str
    journal: list[Entry]
    provenance: Entry
    procedure: Entry
    station: Entry
    dwells: list[DwellRow]
    bins: list[BiasBin]
    telemetry: Mapping[str, FloatArray]
    joint_biases: list[JointBiasRow] = field(default_factory=list)
    joint_plateaus: list[JointPlateauRow] = field(default_factory=list)
    noise: NoiseEstimate | None = None
    verification: list[CalibrationCheckRow] = field(default_factory=list)
    acceptance: Acceptance | None = None
    chapters: list[Findings] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    @cached_property
    def facts(self) -> RunFacts:
        """What the journal tells in short."""
        return facts_of(self.journal)

    @property
    def marked_temperatures_c(self) -> list[float]:
        """Temperatures in degC that the procedure marks in figures."""
        marked = self.procedure.get("marked_temperatures_c", [])
        return (
            [float(each) for each in marked if isinstance(each, int | float)]
            if isinstance(marked, list)
            else []
        )

    def entries(self, event: str) -> list[Entry]:
        """Entries of the journal that tell of one kind of event, in order."""
        return [entry for entry in self.journal if entry.get("event") == event]

    def last(self, event: str) -> Entry:
        """Return the last entry of one kind; empty where there is none."""
        return next(iter(reversed(self.entries(event))), {})


def read_run(folder: RunFolder) -> RunContent:
    """Read a run folder; what is missing or damaged is noted, not raised."""
    problems: list[str] = []
    journal: list[Entry] = []
    nothing: Entry = {}
    no_dwells: list[DwellRow] = []
    no_bins: list[BiasBin] = []
    no_readings: Mapping[str, FloatArray] = {}

    def read(path: Path, reader: Callable[[], T], missing: T) -> T:
        if not path.exists():
            problems.append(f"{path.name} is missing.")
            return missing
        try:
            return reader()
        except (GyrobenchError, json.JSONDecodeError) as error:
            problems.append(f"{path.name} can't be used: {error}")
            return missing

    def read_if_there(path: Path, reader: Callable[[], T], missing: T) -> T:
        return read(path, reader, missing) if path.exists() else missing

    no_joint_biases: list[JointBiasRow] = []
    no_joint_stops: list[JointPlateauRow] = []
    no_verification: list[CalibrationCheckRow] = []
    read(folder.journal, lambda: journal.extend(read_journal(folder.journal)), None)
    procedure = read(folder.procedure, lambda: _mapping(folder.procedure), nothing)
    verification = read_if_there(
        folder.calibration_check, lambda: read_calibration_check(folder.calibration_check), no_verification
    )
    # A run of verifications only has no dwells to put into a table.
    read_dwell_table = read_if_there if verification else read
    dwells = read_dwell_table(folder.dwells, lambda: read_dwells(folder.dwells), no_dwells)
    bins = read(folder.bias_bins, lambda: read_bins(folder.bias_bins), no_bins)
    return RunContent(
        name=folder.path.resolve().name,
        journal=journal,
        provenance=read(folder.provenance, lambda: read_provenance(folder), nothing),
        procedure=procedure,
        station=read(folder.station, lambda: _mapping(folder.station), nothing),
        dwells=dwells,
        bins=bins or _bins(dwells, procedure, problems),
        telemetry=read(folder.telemetry, lambda: read_telemetry(folder.telemetry), no_readings),
        joint_biases=read_if_there(
            folder.joint_biases, lambda: read_joint_biases(folder.joint_biases), no_joint_biases
        ),
        joint_plateaus=read_if_there(folder.joint, lambda: read_joint_plateaus(folder.joint), no_joint_stops),
        noise=read_if_there(folder.noise, lambda: read_noise(folder.noise), None),
        verification=verification,
        acceptance=read_if_there(folder.acceptance, lambda: read_acceptance(folder.acceptance), None),
        chapters=_chapters(folder, problems),
        problems=problems,
    )


def _chapters(folder: RunFolder, problems: list[str]) -> list[Findings]:
    """Read what search and proof found; of another state of the dwells it would mislead."""
    chapters = []
    for place, command in ((folder.closure, "close"), (folder.verify, "verify")):
        again = f"`gyrobench {command} {folder.path.name}` makes it anew."
        if not (place / FINDINGS_FILE).exists():
            if any(place.glob("*.html")):
                problems.append(
                    f"{place.name}/{FINDINGS_FILE} is missing, so it is not in this report. {again}"
                )
            continue
        try:
            found = read_findings_file(place)
            if found.dwells_sha256 == file_sha256(folder.dwells):
                chapters.append(found)
            else:
                problems.append(f"{place.name}: dwells.csv has changed since, so it is left out. {again}")
        except GyrobenchError as error:
            problems.append(f"{place.name} can't be used: {error}")
    return chapters


def _mapping(path: Path) -> Entry:
    data = read_document(path).data
    return data if isinstance(data, dict) else {}


def _bins(dwells: Sequence[DwellRow], procedure: Entry, problems: list[str]) -> list[BiasBin]:
    width_c = procedure.get("bin_width_c", DEFAULT_WIDTH_C)
    try:
        return bin_biases([row for row in dwells if not row.flags], float(width_c))
    except (GyrobenchError, TypeError, ValueError) as error:
        problems.append(f"The dwells can't be sorted into temperature bins: {error}")
        return []
