"""Files: read up to a limit of size, written whole or not at all even through a power cut, hashed.

A file's content is on the disk once the file is synced; its name, once its folder is.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import re
import stat
from collections.abc import Iterable, Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import Any, BinaryIO

from gyrobench.bench.foundations.errors import DocumentError, RunFolderError, UnusablePathError

_HALF_CHARACTER = re.compile(r"\\u[dD]")


def read_limited(path: Path, max_bytes: int, error_type: type[DocumentError | RunFolderError]) -> bytes:
    """Content of a plain file of at most ``max_bytes``; pipes and devices, which may never end, are refused.

    Raises error_type if the file can't be read, is not a plain file, or is too large.
    """
    with _limited(path, max_bytes, error_type) as stream:
        return stream.read()


def decoded(path: Path, content: bytes, encoding: str = "utf-8") -> str:
    """Text of a file's content; raises DocumentError if it is not UTF-8."""
    try:
        return content.decode(encoding)
    except UnicodeDecodeError as error:
        raise DocumentError(f"{path}: is not UTF-8 text: {error.reason} at byte {error.start}") from error


def read_lines(
    path: Path, max_bytes: int, error_type: type[DocumentError | RunFolderError]
) -> Iterator[bytes]:
    """Lines of such a file with their ends, one at a time; raises as :func:`read_limited`."""
    with _limited(path, max_bytes, error_type) as stream:
        yield from stream


@contextlib.contextmanager
def _limited(
    path: Path, max_bytes: int, error_type: type[DocumentError | RunFolderError]
) -> Iterator[BinaryIO]:
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            what = "a folder" if stat.S_ISDIR(status.st_mode) else "not a plain file"
            raise error_type(f"{path}: can't be read: it is {what}")
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

    Raises ValueError if it is not JSON, nested too deeply, or has halves of characters, which can't be
    written again.
    """
    try:
        text = text if isinstance(text, str) else text.decode()
        data = json.loads(text)
        if _HALF_CHARACTER.search(text):
            json.dumps(data, ensure_ascii=False).encode()
        return data
    except RecursionError:
        raise ValueError("nested too deeply") from None


def write_whole(path: Path, data: bytes | Iterable[bytes | bytearray], *, is_synced: bool = True) -> None:
    """Write a file, from one or more parts, whole or not at all; when this returns, it is on the disk.

    An existing file of that name is replaced atomically.

    ``is_synced``: false for a file that need not survive a power cut; faster. Raises RunFolderError if it
    can't be written.
    """
    is_synced = is_synced and not _is_synced_later.get()
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
        raise cant_be_written(path, error) from error


#: Whether files are written within :func:`synced_later`.
_is_synced_later = ContextVar("_is_synced_later", default=False)


@contextlib.contextmanager
def synced_later() -> Iterator[None]:
    """Files written within are whole, but not on the disk until :func:`sync_all`: nothing waits for it."""
    token = _is_synced_later.set(True)
    try:
        yield
    finally:
        _is_synced_later.reset(token)


def sync_all() -> None:
    """Put all that was written on the disk, where the system can."""
    if hasattr(os, "sync"):
        os.sync()


def temporary_path(path: Path) -> Path:
    """Where a file is written before it gets its name."""
    return path.with_name(f".{path.name}.part")


def file_sha256(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal digits. Raises RunFolderError if it can't be read."""
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise RunFolderError(f"{path}: can't be read: {error.strerror}") from error


def remove(path: Path) -> None:
    """Remove a file if it is there; when this returns, it is gone from the disk.

    Raises RunFolderError if it can't be removed.
    """
    try:
        if path.exists():
            path.unlink()
            sync_folder(path.parent)
    except OSError as error:
        raise RunFolderError(f"{path}: can't be removed: {error.strerror}") from error


def make_folder(path: Path) -> None:
    """Make a folder, and those above it, unless it is there; when this returns, it is on the disk.

    Raises RunFolderError if it can't be made.
    """
    if not make_new_folder(path) and not path.is_dir():
        raise UnusablePathError(f"{path}: is a file where a folder should be")


def make_new_folder(path: Path) -> bool:
    """Make a folder and return whether it was made: False if something of that name exists.

    Raises RunFolderError if it can't be made.
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
        if isinstance(error, FileExistsError) and path.exists():  # made by another process meanwhile
            return False
        raise _type_of(error)(f"{path}: can't be made: {_reason(error)}") from error
    return True


def sync_folder(folder: Path) -> None:
    """Bring the names in a folder to the disk. Raises OSError if it can't be done."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def cant_be_written(path: Path, error: OSError) -> RunFolderError:
    """Make the error of a file that can't be written."""
    return _type_of(error)(f"{path}: can't be written: {_reason(error)}")


def _type_of(error: OSError) -> type[RunFolderError]:
    return UnusablePathError if error.errno in _WRONG_PATH else RunFolderError


def _reason(error: OSError) -> str:
    """Reason given by the operating system, and what to do about it."""
    advice = _ADVICE.get(error.errno or 0, "")
    return f"{error.strerror or error}.{advice}"


#: Errors of the path itself, not of its disk.
_WRONG_PATH = {
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
