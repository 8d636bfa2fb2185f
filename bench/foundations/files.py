"""Reads files up to a size limit, writes files atomically even through a power cut, and hashes files.

The content of a file is on the disk after the file is synced, its name after its folder is synced.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import math
import os
import re
import stat
from collections.abc import Iterable, Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import Any, BinaryIO

from gyrobench.bench.foundations.errors import DocumentError, RunFolderError, UnusablePathError

_SURROGATE_ESCAPE = re.compile(r"\\u[dD]")


def read_limited(path: Path, max_bytes: int, error_type: type[DocumentError | RunFolderError]) -> bytes:
    """Read a regular file of at most ``max_bytes``; refuses pipes and devices, which may never end.

    Raises error_type if the file can't be read, is not a plain file, or is too large.
    """
    with _open_limited(path, max_bytes, error_type) as stream:
        return stream.read()


def decode_text(path: Path, content: bytes, encoding: str = "utf-8") -> str:
    """Decode the content of a file to text; raises DocumentError if it is not UTF-8."""
    try:
        return content.decode(encoding)
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise DocumentError(
            f"{path}: is not UTF-8 text: {error.reason} in line {line}. Save it with the encoding UTF-8"
        ) from error


def read_lines(
    path: Path, max_bytes: int, error_type: type[DocumentError | RunFolderError]
) -> Iterator[bytes]:
    """Read the lines of a file, with their ends, one at a time; limits and raises as :func:`read_limited`."""
    with _open_limited(path, max_bytes, error_type) as stream:
        yield from stream


@contextlib.contextmanager
def _open_limited(
    path: Path, max_bytes: int, error_type: type[DocumentError | RunFolderError]
) -> Iterator[BinaryIO]:
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            kind = "a folder" if stat.S_ISDIR(status.st_mode) else "not a plain file"
            raise error_type(f"{path}: can't be read: it is {kind}")
        if status.st_size > max_bytes:
            raise error_type(f"{path}: {status.st_size} bytes; at most {max_bytes} are allowed")
        with path.open("rb") as stream:
            yield stream
    except OSError as error:
        if isinstance(error, RunFolderError):
            raise
        raise error_type(f"{path}: can't be read: {error.strerror or error}") from error


def parse_json(text: str | bytes) -> Any:
    """Parse JSON.

    Raises ValueError if it is not JSON, is nested too deeply, or contains unpaired surrogates, which can't be
    encoded.
    """
    try:
        text = text if isinstance(text, str) else text.decode()
        data = json.loads(text)
        if _SURROGATE_ESCAPE.search(text):
            json.dumps(data, ensure_ascii=False).encode()
        return data
    except RecursionError:
        raise ValueError("nested too deeply") from None


def with_nan_as_none(value: Any) -> Any:
    """Value for JSON: numbers that are not finite become None."""
    if isinstance(value, dict):
        return {key: with_nan_as_none(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [with_nan_as_none(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_whole(path: Path, data: bytes | Iterable[bytes | bytearray], *, is_synced: bool = True) -> None:
    """Write a file atomically, from one or more parts; on return it is on the disk.

    Replaces an existing file, but no device or pipe. ``is_synced``: False for a file that need not survive a
    power cut, which is faster. Raises RunFolderError if it can't be written.
    """
    is_synced = is_synced and not _is_synced_later.get()
    if _is_special(path):
        raise UnusablePathError(f"{path}: can't be written: it is not a plain file. Choose another path.")
    temporary = temporary_path(path)
    try:
        with temporary.open("wb") as stream:
            stream.writelines([data] if isinstance(data, bytes) else data)
            if is_synced:
                stream.flush()
                os.fsync(stream.fileno())
        temporary.replace(path)
        if is_synced:
            sync_folder(path.parent)
    except OSError as error:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise write_error(path, error) from error


def _is_special(path: Path) -> bool:
    """Whether a path exists and is no plain file; False if that can't be seen."""
    try:
        return path.exists() and not path.is_file()
    except OSError:
        return False


#: Whether files are being written within :func:`defer_sync`.
_is_synced_later = ContextVar("_is_synced_later", default=False)


@contextlib.contextmanager
def defer_sync() -> Iterator[None]:
    """Context in which files are written atomically, but not synced to the disk until :func:`sync_all`."""
    token = _is_synced_later.set(True)
    try:
        yield
    finally:
        _is_synced_later.reset(token)


def sync_all() -> None:
    """Sync all written files to the disk, if the system supports it."""
    if hasattr(os, "sync"):
        os.sync()


def temporary_path(path: Path) -> Path:
    """Temporary path at which a file is written before it is renamed to ``path``."""
    return path.with_name(f".{path.name}.part")


def file_sha256(path: Path) -> str:
    """Compute the SHA-256 of a file, in hexadecimal digits. Raises RunFolderError if it can't be read."""
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise RunFolderError(f"{path}: can't be read: {error.strerror}") from error


def remove(path: Path) -> None:
    """Remove a file if it exists; on return it is removed from the disk.

    Raises RunFolderError if it can't be removed.
    """
    try:
        if path.exists():
            path.unlink()
            sync_folder(path.parent)
    except OSError as error:
        raise RunFolderError(f"{path}: can't be removed: {error.strerror}") from error


def make_folder(path: Path) -> None:
    """Create a folder and its parents unless it exists; on return it is on the disk.

    Raises RunFolderError if it can't be created.
    """
    if not make_new_folder(path) and not path.is_dir():
        raise UnusablePathError(f"{path}: is a file where a folder should be")


def make_new_folder(path: Path) -> bool:
    """Create a folder and its parents; returns False if something of that name exists.

    Raises RunFolderError if it can't be created.
    """
    try:
        missing = [folder for folder in (path, *path.parents) if not folder.exists()]
        if not missing:
            return False
        path.parent.mkdir(parents=True, exist_ok=True)
        path.mkdir()
        for folder in missing:
            sync_folder(folder.parent)
    except OSError as error:
        if isinstance(error, FileExistsError) and path.exists():  # another process has created it meanwhile
            return False
        raise _error_type(error)(f"{path}: can't be made: {_reason(error)}") from error
    return True


def sync_folder(folder: Path) -> None:
    """Sync the names in a folder to the disk. Raises OSError if that fails."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def require_utf8(name: str) -> None:
    """Raise UnusablePathError if a name has bytes that could not be decoded."""
    try:
        name.encode()
    except UnicodeEncodeError as error:
        problem = f"{name!a}: not valid UTF-8 in this locale. Set LC_ALL=C.UTF-8, or rename it"
        raise UnusablePathError(problem) from error


def write_error(path: Path, error: OSError) -> RunFolderError:
    """Return the exception for a file that can't be written."""
    return _error_type(error)(f"{path}: can't be written: {_reason(error)}")


def _error_type(error: OSError) -> type[RunFolderError]:
    return UnusablePathError if error.errno in _PATH_ERRORS else RunFolderError


def _reason(error: OSError) -> str:
    """Reason given by the operating system, with advice."""
    advice = _ADVICE.get(error.errno or 0, "")
    return f"{error.strerror or error}.{advice}"


#: Error numbers that concern the path, not the disk.
_PATH_ERRORS = {
    *(errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.EEXIST, errno.EACCES, errno.EPERM, errno.EROFS),
    *(errno.ENAMETOOLONG, errno.ELOOP, errno.EINVAL),
}
_ADVICE = {
    **dict.fromkeys((errno.ENOENT, errno.ENOTDIR), " Choose a path in an existing folder."),
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT), " Free some space on its disk."),
    **dict.fromkeys((errno.EACCES, errno.EPERM), " Check the permissions of its folder."),
    errno.EFBIG: " Raise the limit of file sizes (`ulimit -f`).",
    errno.EROFS: " Choose a folder on a writable disk.",
}
