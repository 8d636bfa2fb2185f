"""Writing files so that they are there whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

from bench.errors import RunFolderError


def write_whole(path: Path, data: bytes) -> None:
    """Write a file whole or not at all, also after a power cut.

    Raises
    ------
    RunFolderError
        It can't be written.
    """
    temporary = path.with_name(f".{path.name}.part")
    try:
        with temporary.open("wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(path)
    except OSError as error:
        raise RunFolderError(f"{path}: can't be written: {error.strerror}. Is the disk full?") from error
