"""The record of a fleet, ``fleet.json``: what became of each run, so that only the rest is done next time."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from pydantic import BaseModel, ValidationError

from gyrobench.bench import __version__
from gyrobench.bench.fleet.jobs import JobKind, JobResult, JobState, inputs_of
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.files import make_folder, read_limited, write_whole

RECORD = "fleet.json"
_MAX_BYTES = 500_000_000


class RunEntry(BaseModel):
    """What became of one run; ``inputs`` is what it was made from."""

    state: JobState
    text: str
    took_s: float
    inputs: str


class _Content(BaseModel):
    kind: JobKind
    gyrobench: str
    runs: dict[str, RunEntry]


@dataclass
class FleetRecord:
    """What became of the runs of a fleet.

    Attributes
    ----------
    kind : JobKind
        What is done with them.
    folder : Path
        Where the record is kept.
    runs : dict of str to RunEntry
        By run folder.
    """

    kind: JobKind
    folder: Path
    runs: dict[str, RunEntry] = field(default_factory=dict)

    def left_of(self, paths: list[Path]) -> list[Path]:
        """Runs that are new, were not done, or have changed since."""
        return [path for path in paths if not self._is_done(path)]

    def add(self, result: JobResult) -> None:
        """Note what became of a run; :meth:`write` brings it to the disk."""
        self.runs[result.path] = RunEntry(
            state=result.state,
            text=result.text,
            took_s=round(result.took_s, 3),
            inputs=inputs_of(self.kind, Path(result.path)),
        )

    def write(self) -> None:
        """Write the record.

        Raises
        ------
        RunFolderError
            It can't be written.
        """
        content = _Content(kind=self.kind, gyrobench=__version__, runs=dict(sorted(self.runs.items())))
        make_folder(self.folder)
        write_whole(self.folder / RECORD, (content.model_dump_json(indent=1) + "\n").encode())

    def _is_done(self, path: Path) -> bool:
        entry = self.runs.get(str(path))
        return (
            entry is not None and entry.state == JobState.DONE and entry.inputs == inputs_of(self.kind, path)
        )


def read_record(kind: JobKind, folder: Path) -> FleetRecord:
    """Read the record that an earlier call left; an empty one where there is none.

    Raises
    ------
    RunFolderError
        It can't be read, is damaged, or is of another job.
    """
    path = folder / RECORD
    if not path.exists():
        return FleetRecord(kind, folder)
    try:
        content = _Content.model_validate_json(read_limited(path, _MAX_BYTES, RunFolderError))
    except ValidationError as error:
        raise RunFolderError(
            f"{path}: is damaged: {error.errors()[0]['msg']}. Remove it, or do all runs with --again"
        ) from error
    if content.kind != kind:
        raise RunFolderError(
            f"{path}: is the record of `gyrobench fleet {content.kind}`. Give another folder with --out"
        )
    return FleetRecord(kind, folder, content.runs)
