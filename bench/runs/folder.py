"""The run folder: creating one, the paths in it, and logs in numbered parts."""

from __future__ import annotations

import itertools
import re
import shlex
from dataclasses import dataclass
from pathlib import Path

from gyrobench.bench.foundations.errors import MissingRunError, RunFolderError, UnusablePathError
from gyrobench.bench.foundations.files import make_folder, make_new_folder
from gyrobench.bench.foundations.text import did_you_mean
from gyrobench.bench.runs.journal import facts_of, read_journal


def part_path(folder: Path, number: int, suffix: str) -> Path:
    """Path of a part of a log; parts are numbered from 1."""
    return folder / f"part-{number:05d}{suffix}"


def find_parts(folder: Path, suffix: str) -> dict[int, Path]:
    """Paths of the parts in a folder by their numbers, in ascending order.

    Raises RunFolderError if the folder can't be read.
    """
    pattern = re.compile(rf"part-(\d{{5,9}}){re.escape(suffix)}")
    try:
        matches = [(pattern.fullmatch(path.name), path) for path in folder.iterdir()]
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise RunFolderError(f"{folder}: can't be read: {error.strerror}") from error
    return dict(sorted((int(match[1]), path) for match, path in matches if match))


#: Parent of runs without --out.
RUNS = Path("runs")
#: Lock file of the process that uses a run folder; the first file that is made in it.
LOCK = ".lock"
#: Names of files and folders, also used for runs in an object store.
PROCEDURE, PROVENANCE, JOURNAL = "procedure.yaml", "provenance.json", "journal.jsonl"
UNITS_FOLDER = "units"
DWELLS, BIAS_BINS = "dwells.csv", "bias_bins.csv"
ACCEPTANCE, COMPENSATION, CLOSURE = "acceptance.json", "compensation.yaml", "closure"
#: Names of files that a run writes before its journal.
_WRITTEN_BEFORE_JOURNAL = re.compile(
    r"units|(procedure|station|compensation)\.yaml|calibration\.csv|provenance\.json|.*\.dbc|\.lock|\..*\.part"
)


class PathInside:
    """Path of a file or folder in a run folder; accessed on the class, the path relative to it."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __get__(self, folder: RunFolder | None, owner: type[RunFolder]) -> Path:
        return Path(self._name) if folder is None else folder.path / self._name


@dataclass(frozen=True)
class RunFolder:
    """Paths of everything in a run folder."""

    path: Path

    procedure = PathInside(PROCEDURE)  #: The procedure as run.
    station = PathInside("station.yaml")  #: The station as run.
    provenance = PathInside(PROVENANCE)  #: Versions, identities, hashes, options.
    journal = PathInside(JOURNAL)  #: The journal.
    live = PathInside("live.json")  #: The latest snapshot of the run, for its views.
    can = PathInside("can")  #: Folder of the raw CAN log.
    telemetry = PathInside("telemetry")  #: Folder of the bench's readings.
    dwells = PathInside(DWELLS)  #: The dwell table.
    first_dwells = PathInside("start.csv")  #: Initial dwells of an investigation.
    bias_bins = PathInside(BIAS_BINS)  #: Bias per gyro, position and temperature bin.
    budget = PathInside("budget.csv")  #: Uncertainty budget of each dwell and bin.
    joint_biases = PathInside("joint_biases.csv")  #: Biases of the dwells of each plateau solved together.
    joint = PathInside("joint.csv")  #: Parameters common to the dwells of each plateau.
    coefficients = PathInside("coefficients.csv")  #: Coefficients of the sensors at each plateau.
    correlations = PathInside("correlations.csv")  #: Correlations of the coefficients.
    noise = PathInside("noise.json")  #: Noise of the INS.
    characteristics = PathInside("characteristics.json")  #: Results of the procedure's tests.
    acceptance = PathInside(ACCEPTANCE)  #: Verdict on the unit.
    calibration = PathInside("calibration.csv")  #: The dwell table of the calibration that was checked.
    compensation = PathInside(COMPENSATION)  #: The compensation that was loaded into the INS.
    calibration_check = PathInside("verification.csv")  #: Table of the calibration check.
    closure = PathInside(CLOSURE)  #: Folder of the search for effects in this run.
    verify = PathInside("verify")  #: Folder of the verification of a compensation.
    figures = PathInside("figures")  #: Folder of the figures.
    report = PathInside("report.html")  #: The report.
    units = PathInside(UNITS_FOLDER)  #: Folder of the run folders of the units, if there are several.

    @property
    def tables(self) -> list[Path]:
        """Existing tables that are computed from the data."""
        computed = (
            self.dwells, self.bias_bins, self.budget, self.joint, self.joint_biases, self.coefficients,
            self.correlations, self.noise, self.characteristics, self.calibration_check, self.acceptance,
        )  # fmt: skip
        return [path for path in computed if path.exists()]

    def unit(self, number: str) -> RunFolder:
        """Run folder of a unit; without a number, as for a single unit, this one."""
        return RunFolder(self.units / number) if number else self

    @property
    def run(self) -> RunFolder:
        """Folder of the run: this one, or its parent run if this is the folder of one of several units."""
        path = self.path.resolve()
        run = RunFolder(path.parent.parent)
        return run if path.parent.name == UNITS_FOLDER and run.journal.exists() else self

    @property
    def run_name(self) -> str:
        """Name of the folder of the whole run."""
        return self.run.path.resolve().name

    @property
    def argument(self) -> str:
        """The path as an argument of a command in a shell."""
        return shlex.quote(f"{self.path}")

    @property
    def is_unfinished(self) -> bool:
        """Whether it holds a run that has not finished; False if its journal is missing or damaged."""
        try:
            return facts_of(read_journal(self.run.journal)).ended != "finished"
        except RunFolderError:
            return False

    @property
    def unit_folders(self) -> list[RunFolder]:
        """Run folders of the units, in the order of their numbers; empty for a run of a single unit."""
        journals = self.units.glob(f"*/{JOURNAL}")
        return [RunFolder(path.parent) for path in sorted(journals)]


def create_run_folder(out: Path | None, name: str, parent: Path = RUNS) -> RunFolder:
    """Make a run folder; it is on the disk when this returns.

    ``out``: the folder, which must not exist, or be empty, or hold only files of a run that was interrupted
    before its journal began; None for a new folder under ``parent``. ``name``: name of the procedure, for a
    new folder. Raises UnusablePathError if the folder can't be made, or is not empty.
    """
    if out is not None:
        make_folder(out)
        try:
            existing = [path.name for path in out.iterdir()]
        except OSError as error:
            raise RunFolderError(f"{out}: can't be read: {error.strerror}") from error
        is_interrupted_start = LOCK in existing and all(
            _WRITTEN_BEFORE_JOURNAL.fullmatch(name) for name in existing
        )
        if existing and not is_interrupted_start:
            resume_text = f"continue the run with `gyrobench resume {RunFolder(out).argument}`"
            alternative = resume_text if RunFolder(out).is_unfinished else "omit it for a new folder"
            raise UnusablePathError(f"{out}: is not empty. Choose another --out, or {alternative}.")
        return RunFolder(out)
    safe_name = re.sub(r"[^A-Za-z0-9_-]+", "_", name)[:80]
    candidates = (parent / f"{safe_name}-{number:03d}" for number in itertools.count(1))
    return RunFolder(next(candidate for candidate in candidates if make_new_folder(candidate)))


def open_run_folder(path: Path, may_have_units: bool = False) -> RunFolder:
    """Open an existing run folder; that of a run of several units only if it ``may_have_units``.

    Raises MissingRunError if there is no run folder at that path, or one of several units. Raises
    RunFolderError if one of its folders is a link out of it.
    """
    folder = RunFolder(path)
    for name in (
        "can", "telemetry", "figures", CLOSURE, f"{CLOSURE}/figures", "verify", "verify/figures", "export",
        "seals", "certificate", UNITS_FOLDER,
    ):  # fmt: skip
        inner = path / name
        if not inner.resolve().is_relative_to(path.resolve()):
            raise RunFolderError(
                f"{inner}: is a link out of the run folder, to {inner.resolve()}. "
                "Replace the link by a folder"
            )
    if not folder.journal.is_file():
        lack = f"is not a run folder (it has no {folder.journal.name})"
        if not path.exists():
            others = [each.name for each in path.parent.iterdir()] if path.parent.is_dir() else []
            lack = f"no such folder{did_you_mean(path.name, others)}"
        raise MissingRunError(f"{path}: {lack}. Give the folder of a run that has started")
    if not may_have_units and (units := folder.unit_folders):
        raise MissingRunError(
            f"{path}: holds a run of several units. Give the folder of one of them: "
            f"{', '.join(str(unit.path) for unit in units)}"
        )
    return folder
