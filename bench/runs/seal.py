"""Seals of a run folder: the hashes of all its files, chained, and signed with an Ed25519 key.

The first seal is made at the end of a run. Files that are added later, such as a search or a certificate, are
in another seal, which states the operator, the time and the command. A seal is a file ``seals/001.jsonl`` of
two lines: the seal, and its signature. Signing needs the extra ``certificate``; a seal without a signature
only detects changes by mistake. In a run of several units each unit has seals, which are sealed with the run.
"""

from __future__ import annotations

import base64
import hashlib
import json
import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType

from gyrobench.bench import __version__
from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.errors import MissingRunError, RunFolderError
from gyrobench.bench.foundations.files import file_sha256, make_folder, parse_json, read_limited, write_whole
from gyrobench.bench.foundations.operator_name import command_line, login_name, operator_name
from gyrobench.bench.foundations.text import counted, listed
from gyrobench.bench.runs.fingerprint import find_change, fingerprint_of
from gyrobench.bench.runs.folder import JOURNAL, UNITS_FOLDER, RunFolder
from gyrobench.bench.runs.journal import broken_links, facts_of, is_linked, journal_lines, read_journal
from gyrobench.bench.runs.seal_keys import public_bytes, signature_of, signature_problem

_SEALS = "seals"
#: Not sealed: files that processes and live views use during a run.
_TRANSIENT = ("live.json",)
#: Logs that may grow after a seal, as when a guard acts after the last report.
_LOGS = ("guard.log",)
#: Measured data and inputs; everything else can be computed again.
_EVIDENCE_FOLDERS = ("can", "telemetry")
_EVIDENCE = (JOURNAL, "procedure.yaml", "station.yaml", "calibration.csv", "compensation.yaml")
_MAX_SEAL_BYTES = 500_000_000
_CHUNK_BYTES = 1 << 20
_MAX_COMMAND_CHARACTERS = 300


@dataclass(frozen=True, slots=True)
class SealedFile:
    """A file as it was sealed; the fingerprint is empty if an earlier seal has the same content."""

    size_bytes: int
    sha256: str
    fingerprint: str = ""


@dataclass(frozen=True)
class SealChanges:
    """Paths of the files that differ between two seals, by kind of change."""

    added: Sequence[str] = ()
    extended: Sequence[str] = ()  #: Journal or log whose sealed content is still at its beginning.
    replaced: Sequence[str] = ()
    removed: Sequence[str] = ()

    def __bool__(self) -> bool:
        return any(asdict(self).values())

    @property
    def evidence(self) -> list[str]:
        """Measured data and inputs that were replaced or removed."""
        return [path for path in (*self.replaced, *self.removed) if _is_evidence(path)]

    def describe(self) -> str:
        """Files by kind of change in one phrase: "added: ...; replaced: ..."."""
        kinds = {kind: paths for kind, paths in asdict(self).items() if paths}
        return "; ".join(
            f"{kind}: {listed(list(paths)) if len(paths) <= 5 else counted(len(paths), 'file')}"
            for kind, paths in kinds.items()
        )


@dataclass(frozen=True)
class Seal:
    """One seal of a run folder; what is not compared is not part of its record."""

    number: int
    operator: str
    login: str
    host: str
    utc: str  #: ISO 8601.
    command: str
    program: str
    previous_sha256: str  #: Of the file of the previous seal; empty for the first.
    changes: SealChanges  #: Since the previous seal.
    journal_broken_links: Sequence[int]  #: Numbers of lines of the journal whose link is broken.
    files: Mapping[str, SealedFile]
    key: str = field(default="", compare=False)  #: Identity of the key that signed; empty without signature.
    unsigned: str = field(default="", compare=False)  #: Reason why it is not signed.
    problem: str = field(default="", compare=False)  #: Problem of the seal itself; empty if there is none.

    @property
    def relative_path(self) -> str:
        """Path of the seal in the run folder."""
        return f"{_SEALS}/{self.number:03d}.jsonl"

    def describe(self) -> str:
        """Time, operator, command, changes and key of the seal, in one line."""
        signed = f"signed by {self.key}" if self.key else f"not signed: {self.unsigned}"
        who = self.operator if self.operator == self.login else f"{self.operator} ({self.login})"
        return (
            f"{self.number}  {self.utc[:19].replace('T', ' ')} UTC, {who} on {self.host}, {self.command}; "
            f"{self.changes.describe()}; {signed}"
        )


@dataclass(frozen=True)
class SealFinding:
    """A file that differs from its seal: the first byte, or range of bytes, that may differ."""

    path: str
    text: str
    start: int | None = None
    end: int | None = None


@dataclass(frozen=True)
class SealCheck:
    """Result of the verification of a run folder."""

    seals: Sequence[Seal]
    findings: Sequence[SealFinding]  #: In the order of the paths; empty if nothing changed.
    not_sealed: Sequence[str]  #: Files that were added, and logs that grew, after the last seal.
    files: Mapping[str, SealedFile]  #: All sealed files, including those of each unit.

    @cached_property
    def is_intact(self) -> bool:
        """Whether no sealed file has changed."""
        return not self.findings


def seal_run(folder: RunFolder, key: Path | None = None, *, accept_changes: bool = False) -> Seal | None:
    """Seal a run folder and those of its units, or seal the changes since; None if nothing has changed.

    ``key``: PEM file of an Ed25519 key, by default that of GYROBENCH_SEAL_KEY; without either, the seal is
    not signed. Raises RunFolderError if measured data, inputs or tables have changed since the seal, unless
    ``accept_changes``; or if a file can't be read or written. Raises DocumentError if the key can't be used.
    """
    for unit in folder.unit_folders:
        _seal_folder(unit, key, accept_changes, edited=edited_tables(unit))
    written = _seal_folder(folder, key, accept_changes, edited=edited_tables(folder))
    return _read_seal(written, None) if written else None


def _seal_folder(
    folder: RunFolder,
    key: Path | None,
    accept_changes: bool,
    known: Mapping[str, str] = MappingProxyType({}),
    edited: Sequence[str] = (),
) -> Path | None:
    """Path of the new seal; None if nothing has changed.

    ``known``: hashes of some files, by path. ``edited``: tables that count as changed like measured data.
    """
    seals = _read_seals(folder.path)
    last = seals[-1] if seals else None
    sealed = last.files if last else {}
    files = {
        path: SealedFile(file.stat().st_size, known.get(path) or file_sha256(file))
        for path in _paths_to_seal(folder.path)
        for file in [folder.path / path]
    }
    changes = _changes(folder.path, sealed, files)
    if last and not changes:
        return None
    changed = [*changes.evidence, *edited]
    if last and changed and not accept_changes:
        raise RunFolderError(
            f"{folder.path}: {listed(changed)} changed since seal {last.number}. Restore them, tables by "
            "`gyrobench bins`, or seal with --accept-changes, which records the change"
        )
    seal = Seal(
        number=last.number + 1 if last else 1,
        operator=operator_name(),
        login=login_name(),
        host=platform.node(),
        utc=WallClock().utc().isoformat(),
        command=command_line()[:_MAX_COMMAND_CHARACTERS],
        program=f"gyrobench {__version__}",
        previous_sha256=file_sha256(folder.path / last.relative_path) if last else "",
        changes=changes,
        journal_broken_links=broken_links(journal_lines(folder.journal)),
        files=files,
    )
    text = bytearray()
    for part in _seal_as_json(folder.path, seal, sealed):
        text += part
    signature = {"sha256": hashlib.sha256(text).hexdigest(), **signature_of(text, key)}
    make_folder(folder.path / _SEALS)
    write_whole(folder.path / seal.relative_path, [text, b"\n", json.dumps(signature).encode(), b"\n"])
    return folder.path / seal.relative_path


def _seal_as_json(root: Path, seal: Seal, previous: Mapping[str, SealedFile]) -> Iterator[bytes]:
    """JSON of a seal, file by file; computes the fingerprints, which JSON need not escape."""
    record = {each.name: getattr(seal, each.name) for each in fields(seal) if each.compare}
    yield json.dumps({**record, "changes": asdict(seal.changes), "files": {}}).encode().removesuffix(b"}}")
    separator = ""
    for path, each in seal.files.items():
        is_unchanged = path in previous and previous[path].sha256 == each.sha256
        entry = json.dumps({"size_bytes": each.size_bytes, "sha256": each.sha256}).removesuffix("}")
        yield f'{separator}{json.dumps(path)}: {entry}, "fingerprint": "'.encode()
        yield b"" if is_unchanged else fingerprint_of(root / path).encode()
        yield b'"}'
        separator = ", "
    yield b"}}"


def edited_tables(folder: RunFolder) -> list[str]:
    """Names of tables that differ from their seal though nothing was measured since; empty without a seal."""
    last = _last_seal(folder)
    sealed = last.files if last else {}
    if JOURNAL not in sealed or _differs(folder.journal, sealed[JOURNAL]):
        return []
    return [each.name for each in folder.tables if each.name in sealed and _differs(each, sealed[each.name])]


def _differs(path: Path, sealed: SealedFile) -> bool:
    return not path.is_file() or file_sha256(path) != sealed.sha256


def update_seal(
    folder: RunFolder, hashes: Mapping[str, str] = MappingProxyType({}), are_tables_new: bool = False
) -> None:
    """Seal a run that has ended, or what was added to it; without a signature if the key can't be used.

    Leaves a run of a version without seals as it is, and one whose tables differ from their seal, unless they
    were computed again (``are_tables_new``). ``hashes``: those by path that a new report states, so
    that the seal holds the same. Raises RunFolderError if measured data or inputs have changed since the last
    seal.
    """
    try:
        ended = facts_of(read_journal(folder.journal)).ended
    except RunFolderError:
        return  # damaged: a seal would confirm the damage
    is_due = (folder.path / _SEALS).exists() or is_linked(folder.journal)
    if ended and is_due and (are_tables_new or not edited_tables(folder)):
        _seal_folder(folder, None, accept_changes=False, known=hashes)


def require_sealed_inputs(folder: RunFolder) -> None:
    """Raise RunFolderError if an input of a sealed run changed since its last seal.

    Called before a run resumes, since its report could not be sealed at its end.
    """
    last = _last_seal(folder)
    if not last:
        return
    inputs = [path for path in _EVIDENCE if path != JOURNAL and (folder.path / path).is_file()]
    changed = [
        each for each in inputs if each in last.files and _differs(folder.path / each, last.files[each])
    ]
    if changed:
        raise RunFolderError(
            f"{folder.path}: {listed(changed)} changed since seal {last.number}. Accept the change with "
            f"`gyrobench seal {folder.argument} --accept-changes`, which records it, or restore the file"
        )


def verify_seals(folder: Path, trusted_key: Path | None = None) -> SealCheck:
    """Compare a run folder, and those of its units, with their seals.

    ``trusted_key``: PEM file of the public key that must have signed all seals. Raises MissingRunError
    without a folder or a seal, and DocumentError if the key can't be read.
    """
    if not (seals := _read_seals(folder, trusted_key)):
        if not folder.exists():
            raise MissingRunError(f"{folder}: no such folder")
        advice = f"Make one with: gyrobench seal {RunFolder(folder).argument}"
        raise MissingRunError(f"{folder}: has no seal. {advice}")
    findings = [SealFinding(seal.relative_path, seal.problem) for seal in seals if seal.problem]
    previous = ""
    for number, seal in enumerate(seals, start=1):
        if seal.number != number or (seal.previous_sha256 != previous and not seal.problem):
            findings.append(SealFinding(seal.relative_path, f"does not follow seal {number - 1}"))
        previous = file_sha256(folder / seal.relative_path)
    files = dict(seals[-1].files)
    found = (_finding(folder, *each, seals) for each in sorted(files.items()))
    findings += filter(None, found)
    added = [path for path in _paths_to_seal(folder) if path not in files]
    findings += [SealFinding(path, "was added after the last seal") for path in added if _is_evidence(path)]
    grown = [path for path in _LOGS if path in files and _differs(folder / path, files[path])]
    not_sealed = [path for path in added if not _is_evidence(path)]
    not_sealed += [path for path in grown if path not in {finding.path for finding in findings}]
    for unit in RunFolder(folder).unit_folders:
        if not (unit.path / _SEALS).exists():
            continue  # its files are sealed with this folder
        check, prefix = verify_seals(unit.path, trusted_key), f"{UNITS_FOLDER}/{unit.path.name}/"
        files |= {f"{prefix}{path}": sealed for path, sealed in check.files.items()}
        findings += [replace(each, path=f"{prefix}{each.path}") for each in check.findings]
        unit_seals = {f"{prefix}{seal.relative_path}" for seal in check.seals}
        not_sealed = [path for path in not_sealed if path not in unit_seals]
        not_sealed += [f"{prefix}{path}" for path in check.not_sealed]
    return SealCheck(seals, findings, not_sealed, files)


def _is_evidence(path: str) -> bool:
    return path in _EVIDENCE or path.startswith(tuple(f"{name}/" for name in _EVIDENCE_FOLDERS))


def _paths_to_seal(root: Path, prefix: str = "") -> Iterator[str]:
    """Sorted paths, relative to the run folder, of the files to be sealed below ``prefix``."""
    try:
        entries = sorted((root / prefix).iterdir(), key=lambda each: each.name)
    except OSError as error:
        raise RunFolderError(f"{root / prefix}: can't be read: {error.strerror}") from error
    for each in entries:
        path = f"{prefix}{each.name}"
        is_evidence = _is_evidence(path) or path in _EVIDENCE_FOLDERS
        if each.name.startswith(".") or path in _TRANSIENT or path == _SEALS:
            continue
        if each.is_symlink() and not is_evidence:
            continue
        if not each.is_dir():
            yield path
        elif is_evidence or not (each / _SEALS).exists():
            yield from _paths_to_seal(root, f"{path}/")
        elif prefix == f"{UNITS_FOLDER}/":
            yield from (f"{path}/{_SEALS}/{seal.name}" for seal in _seal_paths(each))
        # Other runs inside the folder have their own seals.


def _changes(root: Path, previous: Mapping[str, SealedFile], files: Mapping[str, SealedFile]) -> SealChanges:
    """Changes of the files since the previous seal."""
    changed = [path for path in files if path in previous and files[path].sha256 != previous[path].sha256]
    growing = (path for path in changed if path in _LOGS or _is_evidence(path))
    extended = [path for path in growing if _starts_with(root / path, previous[path])]
    return SealChanges(
        added=[path for path in files if path not in previous],
        extended=extended,
        replaced=[path for path in changed if path not in extended],
        removed=[path for path in previous if path not in files],
    )


def _starts_with(path: Path, sealed: SealedFile) -> bool:
    """Whether a file begins with its sealed content."""
    digest, remaining = hashlib.sha256(), sealed.size_bytes
    with path.open("rb") as file:
        while content := file.read(min(remaining, _CHUNK_BYTES)):
            digest.update(content)
            remaining -= len(content)
    return digest.hexdigest() == sealed.sha256


def _finding(root: Path, path: str, sealed: SealedFile, seals: Sequence[Seal]) -> SealFinding | None:
    """How a file differs from its seal; None if it does not."""
    file = root / path
    if not file.is_file():
        return SealFinding(path, "is missing")
    if file_sha256(file) == sealed.sha256 or (path in _LOGS and _starts_with(file, sealed)):
        return None
    versions = (seal.files[path] for seal in seals if path in seal.files)
    fingerprints = (each.fingerprint for each in versions if each.sha256 == sealed.sha256)
    fingerprint = next(filter(None, fingerprints), "")
    change = find_change(file, fingerprint) if fingerprint else None
    if change is None:
        return SealFinding(path, "differs at an unknown position")
    return SealFinding(path, change.text, change.start, change.end)


def _read_seals(root: Path, trusted_key: Path | None = None) -> list[Seal]:
    trusted = public_bytes(trusted_key) if trusted_key else None
    return [_read_seal(path, trusted) for path in _seal_paths(root)]


def _last_seal(folder: RunFolder) -> Seal | None:
    paths = _seal_paths(folder.path)
    return _read_seal(paths[-1], None) if paths else None


def _seal_paths(root: Path) -> list[Path]:
    """Seals of a folder, in their order."""
    return sorted((root / _SEALS).glob("*.jsonl"))


def _read_seal(path: Path, trusted: bytes | None) -> Seal:
    """Read a seal and verify its signature. Raises RunFolderError if it is damaged beyond reading."""
    text, _, rest = read_limited(path, _MAX_SEAL_BYTES, RunFolderError).partition(b"\n")
    try:
        record, signature = parse_json(text), parse_json(rest)
        files = {name: SealedFile(**each) for name, each in record.pop("files").items()}
        seal = Seal(**{**record, "files": files, "changes": SealChanges(**record["changes"])})
        key = base64.b64decode(signature.get("public_key", ""))
        problem = signature_problem(text, signature, key, trusted)
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise RunFolderError(f"{path}: this seal is damaged: {error}. Restore it from a copy") from error
    identity = f"Ed25519 key {hashlib.sha256(key).hexdigest()[:16]}" if key else ""
    return replace(seal, key=identity, unsigned=signature.get("unsigned", ""), problem=problem)
