"""Contents of a run folder for its report; missing or damaged files of an interrupted run are noted."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from gyrobench.bench.bias.bins import DEFAULT_WIDTH_C, BiasBin, bin_biases, read_bins, with_power_cycles
from gyrobench.bench.bias.dwell_table import DwellRow, read_dwells, read_packed_dwells
from gyrobench.bench.bias.noise_estimate import NoiseEstimate
from gyrobench.bench.bias.verdicts import Acceptance, read_acceptance
from gyrobench.bench.characteristics.results import TestResult, read_characteristics
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.documents import read_document
from gyrobench.bench.foundations.errors import GyrobenchError, RunFolderError
from gyrobench.bench.foundations.files import file_sha256
from gyrobench.bench.foundations.text import hours_minutes, run_ending
from gyrobench.bench.procedure.plan import DwellPurpose
from gyrobench.bench.report.journal_sections import Entry, KindDuration, add_step
from gyrobench.bench.report.page import FINDINGS_FILE, Findings, read_findings_file
from gyrobench.bench.runs.folder import DWELLS, JOURNAL, RunFolder
from gyrobench.bench.runs.journal import RunFacts, facts_of, read_journal
from gyrobench.bench.runs.marks import purpose_of
from gyrobench.bench.runs.provenance import SIMULATED, is_emulated, read_provenance
from gyrobench.bench.runs.seal import edited_tables
from gyrobench.bench.runs.tables.budget_table import BudgetSummary, read_budget
from gyrobench.bench.runs.tables.calibration_check_table import CalibrationCheckRow, read_calibration_check
from gyrobench.bench.runs.tables.coefficient_table import PlateauCoefficientRow, read_coefficients
from gyrobench.bench.runs.tables.joint_table import (
    JointPlateauRow,
    JointSigmas,
    read_joint_biases,
    read_joint_plateaus,
)
from gyrobench.bench.runs.tables.noise_file import read_noise
from gyrobench.bench.runs.telemetry import read_telemetry

_T = TypeVar("_T")


@dataclass(frozen=True, eq=False)
class RunContent:
    """Contents of a run folder."""

    name: str  #: Name of the folder: of the run, or of one of its several units its number.
    #: Its entries, up to the first damaged one, but for steps and dwells without flags, which are many.
    journal: list[Entry]
    #: provenance, procedure, station: Content of these files; empty where missing.
    provenance: Entry
    procedure: Entry
    station: Entry
    #: dwells, bins, telemetry: The tables; empty where missing. Bins are computed from the dwells if only
    #: their file is missing.
    dwells: Sequence[DwellRow]
    bins: list[BiasBin]
    telemetry: Mapping[str, FloatArray]
    #: joint_sigmas, joint_plateaus: Joint solution; empty without one, and before :func:`with_joint`.
    joint_sigmas: Mapping[tuple[int, bool], JointSigmas] = field(default_factory=dict)
    joint_plateaus: list[JointPlateauRow] = field(default_factory=list)
    #: noise, calibration_check: Of the INS; biases of the calibration check; empty without results.
    noise: NoiseEstimate | None = None
    #: Uncertainty budgets; empty where missing.
    budget: BudgetSummary = field(default_factory=BudgetSummary)
    calibration_check: list[CalibrationCheckRow] = field(default_factory=list)
    coefficients: list[PlateauCoefficientRow] = field(default_factory=list)  #: Of the sensors.
    characteristics: list[TestResult] = field(default_factory=list)  #: Results of the procedure's tests.
    acceptance: Acceptance | None = None  #: Verdict on the unit, or None.
    #: Results of the search for effects and of the verification on these dwells.
    chapters: list[Findings] = field(default_factory=list)
    #: Who approved or declined the blocks of an investigation that this run belongs to.
    approvals: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)  #: Missing or unreadable files.
    #: What makes the run impossible to judge, see :func:`damage_of`; then ``acceptance`` is None.
    damage: Mapping[str, str] = field(default_factory=dict)
    #: Number of finished dwells by what they are for.
    dwell_purposes: Counter[DwellPurpose] = field(default_factory=Counter)
    run_name: str = ""  #: Name of the run, also in the folder of one of its units.
    facts: RunFacts = field(default_factory=RunFacts)  #: Summary of the journal.
    #: took, last_step: Durations of the finished steps, and the last entry of a step; empty without any.
    took: list[KindDuration] = field(default_factory=list)
    last_step: Entry = field(default_factory=dict)

    @property
    def ending(self) -> str:
        """How the run ended, as a sentence; of a unit that was dropped from it, when."""
        if JOURNAL in self.damage:
            return "How the run ended is not known."
        dropped, ended = self.last("unit_dropped"), self.facts.ended
        if ended == "failed" and dropped.get("why") == self.facts.reason:
            after = hours_minutes(self.facts.last_s)
            return f"Unit {dropped.get('unit')} was dropped from the run {self.run_name} after {after} h."
        how = run_ending(ended, self.facts.reason, with_reason=False)
        return f"The run {how}." if ended else "The run has not ended."

    @property
    def reason(self) -> str:
        """Why the run did not finish; empty where :attr:`ending` states it."""
        return "" if self.facts.reason in self.ending else self.facts.reason

    @property
    def has_readings(self) -> bool:
        """Whether the telemetry has any row."""
        return len(self.telemetry.get("time_s", ())) > 0

    @property
    def is_simulated(self) -> bool:
        """Whether instruments were emulated."""
        return is_emulated(self.provenance, self.facts.options)

    @property
    def watermark(self) -> str:
        """Word across its pages and figures; empty for real instruments."""
        return SIMULATED if self.is_simulated else ""

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
        """Entries of the journal of one kind of event, in order."""
        return [entry for entry in self.journal if entry.get("event") == event]

    def last(self, event: str) -> Entry:
        """Last entry of one kind; empty without one."""
        return next(iter(reversed(self.entries(event))), {})


class _Files:
    """Reads the files of a run folder; those missing or damaged become problems, not errors."""

    def __init__(self, problems: list[str]) -> None:
        self.problems = problems
        self.errors: dict[Path, Exception] = {}

    def read(self, path: Path, reader: Callable[[Path], _T], missing: _T, *, is_optional: bool = False) -> _T:
        if not path.exists():
            self.problems += [] if is_optional else [f"{path.name} is missing."]
            return missing
        try:
            return reader(path)
        except (GyrobenchError, json.JSONDecodeError) as error:
            self.errors[path] = error
            self.problems.append(f"{path.name} can't be used: {error}")
            return missing


def with_joint(content: RunContent, folder: RunFolder) -> RunContent:
    """The content with the joint solution; no figure shows it, so it is read after the figures."""
    read = _Files(content.problems).read
    return replace(
        content,
        joint_sigmas=read(folder.joint_biases, _joint_sigmas, {}, is_optional=True),
        joint_plateaus=read(folder.joint, read_joint_plateaus, [], is_optional=True),
    )


def read_run(folder: RunFolder, are_tables_new: bool = False) -> RunContent:
    """Read a run folder; missing or damaged files become problems, not errors.

    ``are_tables_new``: they were computed again, and need not be as sealed.
    """
    problems: list[str] = []
    journal, files = _Journal(), _Files(problems)
    read = files.read
    read(folder.journal, journal.read, None)
    procedure: Entry = read(folder.procedure, _mapping, {})
    calibration_check: list[CalibrationCheckRow] = read(
        folder.calibration_check, read_calibration_check, [], is_optional=True
    )
    # Dwells with rotations, for noise or for calibration checks have no rows in this table.
    purposes = Counter(journal.purposes.values())
    is_optional = bool(calibration_check or purposes) and not purposes[DwellPurpose.CALIBRATION]
    dwells: Sequence[DwellRow] = read(folder.dwells, read_packed_dwells, (), is_optional=is_optional)
    damage = _damage(folder, journal, files.errors, are_tables_new)
    bins: list[BiasBin] = read(folder.bias_bins, read_bins, [])
    return RunContent(
        name=folder.path.resolve().name,
        run_name=folder.run_name,
        journal=journal.entries,
        facts=journal.facts,
        took=list(journal.took.values()),
        last_step=journal.last_step,
        provenance=read(folder.provenance, lambda _: read_provenance(folder), {}),
        procedure=procedure,
        station=read(folder.station, _mapping, {}),
        dwells=dwells,
        dwell_purposes=purposes,
        bins=_bins(bins, dwells, procedure, problems),
        telemetry=read(folder.telemetry, read_telemetry, {}),
        budget=read(folder.budget, _budget, BudgetSummary(), is_optional=True),
        noise=read(folder.noise, read_noise, None, is_optional=True),
        calibration_check=calibration_check,
        coefficients=read(folder.coefficients, read_coefficients, [], is_optional=True),
        characteristics=read(folder.characteristics, read_characteristics, [], is_optional=True),
        acceptance=None if damage else read(folder.acceptance, read_acceptance, None, is_optional=True),
        chapters=_chapters(folder, problems),
        approvals=_approvals(folder),
        problems=problems,
        damage=damage,
    )


def damage_of(folder: RunFolder) -> dict[str, str]:
    """Why its journal or its dwell table can't be used and what to do, by the name of the file.

    Empty for an intact run. An interrupted run need not have a dwell table yet; a finished one that measured
    biases does.
    """
    journal, errors = _Journal(), dict[Path, Exception]()
    for path, reader in ((folder.journal, journal.read), (folder.dwells, read_dwells)):
        try:
            if path.exists():
                reader(path)
        except GyrobenchError as error:
            errors[path] = error
    return _damage(folder, journal, errors)


def _damage(
    folder: RunFolder, journal: _Journal, errors: Mapping[Path, Exception], are_tables_new: bool = False
) -> dict[str, str]:
    """See :func:`damage_of`; ``errors``: of the files that were read."""
    damage = {}
    if error := errors.get(folder.journal):
        damage[JOURNAL] = f"{error}. Restore the file from a copy."
    again = f"Write it again with `gyrobench bins {folder.path}`."
    if error := errors.get(folder.dwells):
        damage[DWELLS] = f"{error}. {again}"
    measured_biases = (
        journal.facts.ended == "finished" and DwellPurpose.CALIBRATION in journal.purposes.values()
    )
    if measured_biases and not folder.dwells.exists():
        damage[DWELLS] = f"{folder.dwells}: is missing. {again}"
    try:
        edited = [] if are_tables_new else edited_tables(folder)
    except RunFolderError:  # a damaged seal, which `gyrobench seal --verify` names
        edited = []
    for name in edited:
        damage.setdefault(name, f"{folder.path / name}: has changed since it was sealed. {again}")
    return damage


class _Journal:
    """What a report needs of a journal, gathered entry by entry; see :class:`RunContent`."""

    def __init__(self) -> None:
        self.entries: list[Entry] = []
        self.facts = RunFacts()
        self.took: dict[str, KindDuration] = {}
        self._finished: set[object] = set()  # numbers of steps
        self.last_step: Entry = {}
        self.purposes: dict[Any, DwellPurpose] = {}  #: Of each finished dwell.
        self._given_up: set[str] = set()

    def read(self, path: Path) -> None:
        """Read a journal. Raises RunFolderError where it is damaged, with all before it."""
        damage: list[GyrobenchError] = []

        def intact() -> Iterator[Entry]:
            try:
                yield from read_journal(path)
            except GyrobenchError as error:
                damage.append(error)

        self.facts = facts_of(map(self._add, intact()))
        if damage:
            raise damage[0]

    def _add(self, entry: Entry) -> Entry:
        event = entry.get("event")
        purpose = purpose_of(entry.get("marks")) if event == "dwell_finished" else None
        if event in ("step_started", "step_finished"):
            self.last_step = entry
            add_step(self.took, entry, self._finished)
        elif purpose is not None:
            dwell = entry["marks"].get("dwell")
            self.purposes[dwell] = purpose
            if entry.get("flags") or str(dwell) in self._given_up:
                self.entries.append({**entry, "marks": {"dwell": dwell}})
        else:
            self._given_up |= {str(entry.get("dwell"))} if event == "dwell_given_up" else set()
            self.entries.append(entry)
        return entry


def approvals_in(folder: Path) -> list[str]:
    """Who approved or declined each block of the investigation in a folder, in the order of time.

    None without one. Raises RunFolderError if its journal can't be read.
    """
    path = folder / RunFolder.journal
    return [
        f"Block {entry.get('number')} {entry['event']} by {entry.get('operator', 'an unknown operator')}, "
        f"{str(entry.get('utc', ''))[:16].replace('T', ' ')} UTC."
        for entry in (read_journal(path) if path.is_file() else ())
        if entry.get("event") in ("approved", "declined")
    ]


def _approvals(folder: RunFolder) -> list[str]:
    """Approvals in the folder ``investigation`` of a run, or in those that hold a campaign or a block."""
    own = folder.path.resolve()
    try:
        return [text for each in (own / "investigation", *own.parents[:2]) for text in approvals_in(each)]
    except GyrobenchError:
        return []  # of another folder: its own page says so


def _chapters(folder: RunFolder, problems: list[str]) -> list[Findings]:
    """Results of search and verification, unless the dwells have changed since."""
    chapters = []
    for place, command in ((folder.closure, "close"), (folder.verify, "verify")):
        again = f"Repeat `gyrobench {command} {folder.path.name}`."
        if not (place / FINDINGS_FILE).exists():
            if any(place.glob("*.html")):
                problems.append(f"{place.name}/{FINDINGS_FILE} is missing and not in this report. {again}")
            continue
        try:
            found = read_findings_file(place)
            if found.dwells_sha256 == file_sha256(folder.dwells):
                chapters.append(found)
            else:
                problems.append(f"{place.name}: left out because dwells.csv has changed since. {again}")
        except GyrobenchError as error:
            problems.append(f"{place.name} can't be used: {error}")
    return chapters


def _budget(path: Path) -> BudgetSummary:
    return BudgetSummary.of(read_budget(path))


def _joint_sigmas(path: Path) -> dict[tuple[int, bool], JointSigmas]:
    return JointSigmas.of(read_joint_biases(path))


def _mapping(path: Path) -> Entry:
    data = read_document(path).data
    return data if isinstance(data, dict) else {}


def _bins(
    bins: Sequence[BiasBin], dwells: Sequence[DwellRow], procedure: Entry, problems: list[str]
) -> list[BiasBin]:
    """Those of the file with the means by power cycle; without a file those of the dwells."""
    width_c = procedure.get("bin_width_c", DEFAULT_WIDTH_C)
    try:
        if bins:
            return with_power_cycles(bins, dwells)
        return bin_biases([row for row in dwells if not row.flags], float(width_c))
    except (GyrobenchError, TypeError, ValueError, ZeroDivisionError) as error:
        problems.append(f"The dwells can't be binned by temperature: {error}")
        return list(bins)
