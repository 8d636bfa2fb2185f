"""Files: written so that they are there whole or not at all, also after a power cut; and their hashes.

A file's content is on the disk once the file is synced; its name, once its folder is.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from pathlib import Path

from gyrobench.bench.foundations.errors import RunFolderError


def write_whole(path: Path, data: bytes, *, is_synced: bool = True) -> None:
    """Write a file whole or not at all; when this returns, it is on the disk.

    A file of that name is there as it was until the new one takes its place at one stroke.

    Parameters
    ----------
    is_synced : bool
        False for what need not outlive a power cut: that is quicker, and spares the disk.

    Raises
    ------
    RunFolderError
        It can't be written.
    """
    temporary = temporary_path(path)
    try:
        with temporary.open("wb") as stream:
            stream.write(data)
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


def temporary_path(path: Path) -> Path:
    """Where a file is written before it takes its place."""
    return path.with_name(f".{path.name}.part")


def file_sha256(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal digits.

    Raises
    ------
    RunFolderError
        It can't be read.
    """
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise RunFolderError(f"{path}: can't be read: {error.strerror}") from error


def remove(path: Path) -> None:
    """Remove a file if it is there; when this returns, it is gone from the disk.

    Raises
    ------
    RunFolderError
        It can't be removed.
    """
    try:
        if path.exists():
            path.unlink()
            sync_folder(path.parent)
    except OSError as error:
        raise RunFolderError(f"{path}: can't be removed: {error.strerror}") from error


def make_folder(path: Path) -> None:
    """Make a folder, and those above it, unless it is there; when this returns, it is on the disk.

    Raises
    ------
    RunFolderError
        It can't be made.
    """
    if not make_new_folder(path) and not path.is_dir():
        raise RunFolderError(f"{path}: is a file where a folder should be")


def make_new_folder(path: Path) -> bool:
    """Make a folder and tell whether it was made: False if something of that name is there.

    Raises
    ------
    RunFolderError
        It can't be made.
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
        raise RunFolderError(f"{path}: can't be made: {error.strerror}. Is the disk full?") from error
    return True


def sync_folder(folder: Path) -> None:
    """Bring the names in a folder to the disk.

    Raises
    ------
    OSError
        It can't be done.
    """
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def cant_be_written(path: Path, error: OSError) -> RunFolderError:
    """Say that a file can't be written, and why."""
    return RunFolderError(f"{path}: can't be written: {error.strerror or error}. Is the disk full?")
