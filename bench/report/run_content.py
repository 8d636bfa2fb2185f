"""Content of a run folder for its report; missing or damaged files are listed as problems."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import cached_property, partial
from pathlib import Path
from typing import Any, TypeVar

from gyrobench.bench.bias.bins import BIAS_BINS_TABLE, DEFAULT_WIDTH_C, BiasBin, bin_biases, with_power_cycles
from gyrobench.bench.bias.dwell import DwellPurpose
from gyrobench.bench.bias.dwell_table import DwellRow, read_dwells, read_packed_dwells
from gyrobench.bench.bias.noise_estimate import NoiseEstimate
from gyrobench.bench.bias.verdicts import Acceptance, read_acceptance
from gyrobench.bench.characteristics.results import TestResult, read_characteristics
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.clock import parse_utc
from gyrobench.bench.foundations.documents import read_document
from gyrobench.bench.foundations.errors import GyrobenchError, RunFolderError
from gyrobench.bench.foundations.files import file_sha256
from gyrobench.bench.foundations.text import hours_minutes, run_ending
from gyrobench.bench.report.journal_sections import Entry, KindDuration, add_step_duration
from gyrobench.bench.report.page import FINDINGS_FILE, Findings, read_findings_file
from gyrobench.bench.report.run_findings import identities_sentence, run_findings
from gyrobench.bench.runs.folder import DWELLS, JOURNAL, RunFolder
from gyrobench.bench.runs.journal import RunFacts, facts_of, read_journal
from gyrobench.bench.runs.marks import purpose_of
from gyrobench.bench.runs.provenance import SIMULATED, is_emulated, read_provenance
from gyrobench.bench.runs.seal import edited_tables
from gyrobench.bench.runs.tables.budget_table import BUDGET_TABLE, BudgetSummary
from gyrobench.bench.runs.tables.calibration_check_table import CALIBRATION_CHECK_TABLE, CalibrationCheckRow
from gyrobench.bench.runs.tables.coefficient_table import COEFFICIENT_TABLE, PlateauCoefficientRow
from gyrobench.bench.runs.tables.joint_table import (
    JOINT_BIASES_TABLE,
    JOINT_PLATEAUS_TABLE,
    JointPlateauRow,
    JointSigmas,
)
from gyrobench.bench.runs.tables.noise_file import read_noise
from gyrobench.bench.runs.telemetry import TELEMETRY_COLUMNS, read_telemetry

_T = TypeVar("_T")


@dataclass(frozen=True, eq=False)
class RunContent:
    """Content of a run folder."""

    name: str  #: Name of the folder: that of the run, or the serial number of one of its units.
    #: Entries of the journal up to the first damaged one, without steps and unflagged dwells, which are many.
    journal: list[Entry]
    #: provenance, procedure, station: Content of these files; empty if missing.
    provenance: Entry
    procedure: Entry
    station: Entry
    #: dwells, bins, telemetry: The tables; empty if missing. Bins are computed from the dwells if only their
    #: file is missing; telemetry has the columns that were read.
    dwells: Sequence[DwellRow]
    bins: list[BiasBin]
    telemetry: Mapping[str, FloatArray]
    #: joint_sigmas, joint_plateaus: Joint solution; empty without one or before :func:`with_joint_solution`.
    joint_sigmas: Mapping[tuple[int, bool], JointSigmas] = field(default_factory=dict)
    joint_plateaus: list[JointPlateauRow] = field(default_factory=list)
    #: noise, calibration_check: Noise of the INS, biases of the calibration check; empty without results.
    noise: NoiseEstimate | None = None
    #: Uncertainty budgets; empty if missing.
    budget: BudgetSummary = field(default_factory=BudgetSummary)
    calibration_check: list[CalibrationCheckRow] = field(default_factory=list)
    coefficients: list[PlateauCoefficientRow] = field(default_factory=list)  #: Of the sensors.
    characteristics: list[TestResult] = field(default_factory=list)  #: Results of the procedure's tests.
    acceptance: Acceptance | None = None  #: Verdict on the unit, or None.
    #: Findings of the search for effects and of the verification on these dwells.
    chapters: list[Findings] = field(default_factory=list)
    #: Approvals and refusals of the blocks of an investigation to which this run belongs, with operators.
    approvals: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)  #: Missing or unreadable files.
    #: Damage that prevents a verdict, see :func:`damage_of`; then ``acceptance`` is None.
    damage: Mapping[str, str] = field(default_factory=dict)
    #: Number of finished dwells by purpose.
    dwell_purposes: Counter[DwellPurpose] = field(default_factory=Counter)
    run_name: str = ""  #: Name of the run, also if the folder is that of one of its units.
    facts: RunFacts = field(default_factory=RunFacts)  #: Summary of the journal.
    #: step_durations, last_step: Durations of the finished steps; last journal entry of a step.
    step_durations: list[KindDuration] = field(default_factory=list)
    last_step: Entry = field(default_factory=dict)
    #: See :func:`gyrobench.bench.report.temperature_findings.sensors_sentence`; empty before the report.
    sensors: str = ""

    @property
    def ending(self) -> str:
        """How the run ended, as a sentence; for a unit dropped from the run, when it was dropped."""
        if JOURNAL in self.damage:
            return "How the run ended is not known."
        dropped, ended = self.last("unit_dropped"), self.facts.ended
        if ended == "failed" and dropped.get("why") == self.facts.reason:
            duration = hours_minutes(self.facts.last_s)
            return f"Unit {dropped.get('unit')} was dropped from the run {self.run_name} after {duration} h."
        ending_text = run_ending(ended, self.facts.reason, with_reason=False)
        return f"The run {ending_text}." if ended else "The run has not ended."

    @property
    def reason(self) -> str:
        """Why the run did not finish; empty if :attr:`ending` states it."""
        return "" if self.facts.reason in self.ending else self.facts.reason

    @property
    def started(self) -> datetime | None:
        """Calendar time of the start; None if it is not known."""
        return parse_utc(self.provenance.get("started_utc") or self.facts.started_utc)

    @cached_property
    def doubts(self) -> dict[str, str]:
        """See :func:`gyrobench.bench.report.run_findings.run_findings`."""
        sources = self.dwells, self.station, self.noise, self.joint_plateaus
        identities = identities_sentence(self.facts)
        doubts = {"The INS changed.": identities} if identities else {}
        return doubts | run_findings(*sources, self.facts.reason, self.sensors)

    @property
    def has_readings(self) -> bool:
        """Whether the telemetry has at least one row."""
        return len(self.telemetry.get("time_s", ())) > 0

    @property
    def is_simulated(self) -> bool:
        """Whether any instrument was emulated."""
        return is_emulated(self.provenance, self.facts.options)

    @property
    def watermark(self) -> str:
        """Word printed across pages and figures; empty for real instruments."""
        return SIMULATED if self.is_simulated else ""

    @property
    def marked_temperatures_c(self) -> list[float]:
        """Temperatures in degC that the procedure marks in figures."""
        temperatures_c = self.procedure.get("marked_temperatures_c", [])
        return (
            [float(each) for each in temperatures_c if isinstance(each, int | float)]
            if isinstance(temperatures_c, list)
            else []
        )

    def entries(self, event: str) -> list[Entry]:
        """Journal entries of one kind of event, in order."""
        return [entry for entry in self.journal if entry.get("event") == event]

    @property
    def skipped(self) -> tuple[int, ...]:
        """Numbers of the dwells that the operator skipped, and that were not measured later."""
        skipped, finished = (
            {entry.get("dwell") for entry in self.entries(event)}
            for event in ("dwell_skipped", "dwell_finished")
        )
        finished |= {row.dwell for row in self.dwells}
        return tuple(sorted(each for each in skipped - finished if isinstance(each, int)))

    @property
    def replaced(self) -> tuple[int, ...]:
        """Numbers of the dwells whose measurement replaces an earlier one, on command."""
        entries = (entry for entry in self.entries("dwell_finished") if entry.get("replaces_earlier"))
        return tuple(sorted({entry["marks"]["dwell"] for entry in entries}))

    def last(self, event: str) -> Entry:
        """Last journal entry of one kind of event; empty without one."""
        return next(iter(reversed(self.entries(event))), {})


class _FileReader:
    """Reader for the files of a run folder; missing or damaged files become problems, not errors."""

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


def with_joint_solution(content: RunContent, folder: RunFolder) -> RunContent:
    """Content with the joint solution, which no figure needs: it is read after the figures are drawn."""
    read = _FileReader(content.problems).read
    return replace(
        content,
        joint_sigmas=read(
            folder.joint_biases,
            lambda path: JointSigmas.of(JOINT_BIASES_TABLE.iterate(path)),
            {},
            is_optional=True,
        ),
        joint_plateaus=read(folder.joint, JOINT_PLATEAUS_TABLE.read, [], is_optional=True),
    )


def read_run(
    folder: RunFolder, are_tables_new: bool = False, telemetry_columns: Sequence[str] = TELEMETRY_COLUMNS
) -> RunContent:
    """Read a run folder; missing or damaged files become problems, not errors.

    ``are_tables_new``: the tables were recomputed, so they may differ from the sealed ones.
    """
    problems: list[str] = []
    journal, files = _JournalContent(), _FileReader(problems)
    read = files.read
    read(folder.journal, journal.read, None)
    procedure: Entry = read(folder.procedure, _read_mapping, {})
    calibration_check: list[CalibrationCheckRow] = read(
        folder.calibration_check, CALIBRATION_CHECK_TABLE.read, [], is_optional=True
    )
    # Dwells with rotations, for noise or for calibration checks have no rows in this table.
    purposes = Counter(journal.purposes.values())
    is_optional = bool(calibration_check or purposes) and not purposes[DwellPurpose.CALIBRATION]
    dwells: Sequence[DwellRow] = read(folder.dwells, read_packed_dwells, (), is_optional=is_optional)
    damage = _damage(folder, journal, files.errors, are_tables_new)
    bins: list[BiasBin] = read(folder.bias_bins, BIAS_BINS_TABLE.read, [])
    return RunContent(
        name=folder.path.resolve().name,
        run_name=folder.run_name,
        journal=journal.entries,
        facts=journal.facts,
        step_durations=list(journal.step_durations.values()),
        last_step=journal.last_step,
        provenance=read(folder.provenance, lambda _: read_provenance(folder), {}),
        procedure=procedure,
        station=read(folder.station, _read_mapping, {}),
        dwells=dwells,
        dwell_purposes=purposes,
        bins=_bins_with_power_cycles(bins, dwells, procedure, problems),
        telemetry=read(folder.telemetry, partial(read_telemetry, columns=telemetry_columns), {}),
        budget=read(
            folder.budget,
            lambda path: BudgetSummary.of(BUDGET_TABLE.iterate(path)),
            BudgetSummary(),
            is_optional=True,
        ),
        noise=read(folder.noise, read_noise, None, is_optional=True),
        calibration_check=calibration_check,
        coefficients=read(folder.coefficients, COEFFICIENT_TABLE.read, [], is_optional=True),
        characteristics=read(folder.characteristics, read_characteristics, [], is_optional=True),
        acceptance=None if damage else read(folder.acceptance, read_acceptance, None, is_optional=True),
        chapters=_chapters(folder, problems),
        approvals=_approvals_of(folder),
        problems=problems,
        damage=damage,
    )


def damage_of(folder: RunFolder) -> dict[str, str]:
    """Why the journal or the dwell table can't be used and what to do, by file name.

    Empty for an intact run. An interrupted run need not have a dwell table; a finished run that measured
    biases must have one.
    """
    journal, errors = _JournalContent(), dict[Path, Exception]()
    for path, reader in ((folder.journal, journal.read), (folder.dwells, read_dwells)):
        try:
            if path.exists():
                reader(path)
        except GyrobenchError as error:
            errors[path] = error
    return _damage(folder, journal, errors)


def _damage(
    folder: RunFolder,
    journal: _JournalContent,
    errors: Mapping[Path, Exception],
    are_tables_new: bool = False,
) -> dict[str, str]:
    """See :func:`damage_of`; ``errors``: errors of the files that were read."""
    damage = {}
    if error := errors.get(folder.journal):
        damage[JOURNAL] = f"{error}. Restore the file from a copy."
    advice = f"Write it again with `gyrobench bins {folder.argument}`."
    if error := errors.get(folder.dwells):
        damage[DWELLS] = f"{error}. {advice}"
    measured_biases = (
        journal.facts.ended == "finished" and DwellPurpose.CALIBRATION in journal.purposes.values()
    )
    if measured_biases and not folder.dwells.exists():
        damage[DWELLS] = f"{folder.dwells}: is missing. {advice}"
    try:
        edited = [] if are_tables_new else edited_tables(folder)
    except RunFolderError:  # a damaged seal, which `gyrobench seal --verify` reports
        edited = []
    for name in edited:
        damage.setdefault(name, f"{folder.path / name}: has changed since it was sealed. {advice}")
    return damage


class _JournalContent:
    """Content of a journal for the report, collected entry by entry; see :class:`RunContent`."""

    def __init__(self) -> None:
        self.entries: list[Entry] = []
        self.facts = RunFacts()
        self.step_durations: dict[str, KindDuration] = {}
        self._finished_steps: set[object] = set()  # step numbers
        self.last_step: Entry = {}
        self.purposes: dict[Any, DwellPurpose] = {}  #: Purpose of each finished dwell.
        self._repeated_dwells: set[str] = set()

    def read(self, path: Path) -> None:
        """Read a journal. Raises RunFolderError if it is damaged, after reading the entries before that."""
        errors: list[GyrobenchError] = []

        def intact_entries() -> Iterator[Entry]:
            try:
                yield from read_journal(path)
            except GyrobenchError as error:
                errors.append(error)

        self.facts = facts_of(map(self._add, intact_entries()))
        if errors:
            raise errors[0]

    def _add(self, entry: Entry) -> Entry:
        event = entry.get("event")
        purpose = purpose_of(entry.get("marks")) if event == "dwell_finished" else None
        if event in ("step_started", "step_finished"):
            self.last_step = entry
            add_step_duration(self.step_durations, entry, self._finished_steps)
        elif purpose is not None:
            dwell = entry["marks"].get("dwell")
            self.purposes[dwell] = purpose
            if entry.get("flags") or str(dwell) in self._repeated_dwells:
                self.entries.append({**entry, "marks": {"dwell": dwell}})
        else:
            self._repeated_dwells |= {str(entry.get("dwell"))} if event == "dwell_given_up" else set()
            if event == "repeat_commanded" and isinstance(dwells := entry.get("dwells"), list):
                self._repeated_dwells |= set(map(str, dwells))
            self.entries.append(entry)
        return entry


def approvals_in(folder: Path) -> list[str]:
    """Approval or refusal of each block of the investigation in a folder, with operator and time, in order.

    Empty without an investigation. Raises RunFolderError if its journal can't be read.
    """
    path = folder / RunFolder.journal
    return [
        f"Block {entry.get('number')} {entry['event']} by {entry.get('operator', 'an unknown operator')}, "
        f"{str(entry.get('utc', ''))[:16].replace('T', ' ')} UTC."
        for entry in (read_journal(path) if path.is_file() else ())
        if entry.get("event") in ("approved", "declined")
    ]


def _approvals_of(folder: RunFolder) -> list[str]:
    """Approvals in the folder ``investigation`` of a run, or in the folders that contain this run."""
    path = folder.path.resolve()
    try:
        return [text for each in (path / "investigation", *path.parents[:2]) for text in approvals_in(each)]
    except GyrobenchError:
        return []  # an error of another folder, which its own page reports


def _chapters(folder: RunFolder, problems: list[str]) -> list[Findings]:
    """Findings of search and verification, unless the dwells have changed since."""
    chapters = []
    for page_folder, command in ((folder.closure, "close"), (folder.verify, "verify")):
        advice = f"Repeat `gyrobench {command} {folder.path.name}`."
        if not (page_folder / FINDINGS_FILE).exists():
            if any(page_folder.glob("*.html")):
                problems.append(
                    f"{page_folder.name}/{FINDINGS_FILE} is missing and not in this report. {advice}"
                )
            continue
        try:
            findings = read_findings_file(page_folder)
            if findings.dwells_sha256 == file_sha256(folder.dwells):
                chapters.append(findings)
            else:
                problems.append(
                    f"{page_folder.name}: left out because dwells.csv has changed since. {advice}"
                )
        except GyrobenchError as error:
            problems.append(f"{page_folder.name} can't be used: {error}")
    return chapters


def _read_mapping(path: Path) -> Entry:
    data = read_document(path).data
    return data if isinstance(data, dict) else {}


def _bins_with_power_cycles(
    bins: Sequence[BiasBin], dwells: Sequence[DwellRow], procedure: Entry, problems: list[str]
) -> list[BiasBin]:
    """Bins of the file with the means by power cycle; without a file, bins computed from the dwells."""
    width_c = procedure.get("bin_width_c", DEFAULT_WIDTH_C)
    try:
        if bins:
            return with_power_cycles(bins, dwells)
        return bin_biases([row for row in dwells if not row.flags], float(width_c))
    except (GyrobenchError, TypeError, ValueError, ZeroDivisionError) as error:
        problems.append(f"The dwells can't be binned by temperature: {error}")
        return list(bins)
