"""The run folder: creating one, the paths in it, and logs in numbered parts."""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass
from pathlib import Path

from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.files import make_folder, make_new_folder


def part_path(folder: Path, number: int, suffix: str) -> Path:
    """Path of a part, numbered from 1."""
    return folder / f"part-{number:05d}{suffix}"


def find_parts(folder: Path, suffix: str) -> dict[int, Path]:
    """Find the parts in a folder, number to path, in the order of their numbers.

    Raises
    ------
    RunFolderError
        The folder can't be read.
    """
    name = re.compile(rf"part-(\d{{5,9}}){re.escape(suffix)}")
    try:
        matches = [(name.fullmatch(path.name), path) for path in folder.iterdir()]
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise RunFolderError(f"{folder}: can't be read: {error.strerror}") from error
    return dict(sorted((int(match[1]), path) for match, path in matches if match))


#: Parent of runs without --out.
RUNS = Path("runs")
#: The file by which a process holds a run folder; the first that is made in it.
LOCK = ".lock"
#: Names of files and folders, which are all that is known of a run in an object store.
PROCEDURE, PROVENANCE, JOURNAL = "procedure.yaml", "provenance.json", "journal.jsonl"
DWELLS, BIAS_BINS = "dwells.csv", "bias_bins.csv"
ACCEPTANCE, COMPENSATION, CLOSURE = "acceptance.json", "compensation.yaml", "closure"
#: Files that a run writes before its journal.
_BEFORE_THE_JOURNAL = re.compile(
    r"(procedure|station|compensation)\.yaml|calibration\.csv|provenance\.json|.*\.dbc|\.lock|\..*\.part"
)


@dataclass(frozen=True)
class RunFolder:
    """Paths of everything in a run folder."""

    path: Path

    @property
    def procedure(self) -> Path:
        """The procedure as run."""
        return self.path / PROCEDURE

    @property
    def station(self) -> Path:
        """The station as run."""
        return self.path / "station.yaml"

    @property
    def provenance(self) -> Path:
        """Versions, identities, hashes, options."""
        return self.path / PROVENANCE

    @property
    def journal(self) -> Path:
        """The journal."""
        return self.path / JOURNAL

    @property
    def live(self) -> Path:
        """The latest snapshot of the run, for its views."""
        return self.path / "live.json"

    @property
    def can(self) -> Path:
        """Folder of the raw CAN log."""
        return self.path / "can"

    @property
    def telemetry(self) -> Path:
        """Folder of the bench's readings."""
        return self.path / "telemetry"

    @property
    def dwells(self) -> Path:
        """The dwell table."""
        return self.path / DWELLS

    @property
    def bias_bins(self) -> Path:
        """Bias per gyro, position and temperature bin."""
        return self.path / BIAS_BINS

    @property
    def joint_biases(self) -> Path:
        """Biases of the dwells of each temperature solved together."""
        return self.path / "joint_biases.csv"

    @property
    def joint(self) -> Path:
        """Parameters common to the dwells of each temperature."""
        return self.path / "joint.csv"

    @property
    def noise(self) -> Path:
        """Noise of the INS."""
        return self.path / "noise.json"

    @property
    def acceptance(self) -> Path:
        """Verdict on the unit."""
        return self.path / ACCEPTANCE

    @property
    def calibration(self) -> Path:
        """The dwell table that a verification was compared with."""
        return self.path / "calibration.csv"

    @property
    def compensation(self) -> Path:
        """The compensation that was loaded into the INS."""
        return self.path / COMPENSATION

    @property
    def verification(self) -> Path:
        """Verification of a calibration."""
        return self.path / "verification.csv"

    @property
    def closure(self) -> Path:
        """Folder of the search for effects in this run."""
        return self.path / CLOSURE

    @property
    def verify(self) -> Path:
        """Folder of the proof of the compensation that the search gave."""
        return self.path / "verify"

    @property
    def figures(self) -> Path:
        """Folder of the figures."""
        return self.path / "figures"

    @property
    def report(self) -> Path:
        """The report."""
        return self.path / "report.html"


def create_run_folder(out: Path | None, name: str) -> RunFolder:
    """Make a run folder; when this returns, it is on the disk.

    Parameters
    ----------
    out : Path or None
        The folder, which must be absent or empty, or contain no more than a run interrupted before its
        journal began; None for a new folder under ``runs/``.
    name : str
        Name of the procedure, for a folder under ``runs/``.

    Raises
    ------
    RunFolderError
        The folder can't be made, or is not empty.
    """
    if out is not None:
        make_folder(out)
        try:
            held = [path.name for path in out.iterdir()]
        except OSError as error:
            raise RunFolderError(f"{out}: can't be read: {error.strerror}") from error
        was_begun = LOCK in held and all(_BEFORE_THE_JOURNAL.fullmatch(name) for name in held)
        if held and not was_begun:
            raise RunFolderError(f"{out}: is not empty. Choose another --out, or omit it for a new folder.")
        return RunFolder(out)
    safe_name = re.sub(r"[^A-Za-z0-9_-]+", "_", name)[:80]
    candidates = (RUNS / f"{safe_name}-{number:03d}" for number in itertools.count(1))
    return RunFolder(next(candidate for candidate in candidates if make_new_folder(candidate)))


def open_run_folder(path: Path) -> RunFolder:
    """Find an existing run folder.

    Raises
    ------
    RunFolderError
        There is none at that path, or one of its folders is a link to elsewhere.
    """
    folder = RunFolder(path)
    for name in (
        "can",
        "telemetry",
        "figures",
        CLOSURE,
        f"{CLOSURE}/figures",
        "verify",
        "verify/figures",
        "export",
    ):
        inner = path / name
        if not inner.resolve().is_relative_to(path.resolve()):
            raise RunFolderError(
                f"{inner}: is a link out of the run folder, to {inner.resolve()}. "
                "Replace the link by a folder"
            )
    if not folder.journal.is_file():
        raise RunFolderError(
            f"{path}: is not a run folder (it has no {folder.journal.name}). A run interrupted before its "
            "start can't be resumed; start it again"
        )
    return folder
