"""Reading files of limited size: one that is too large is refused before it takes the memory."""

from __future__ import annotations

import json
import re
import stat
from pathlib import Path
from typing import Any

from gyrobench.bench.foundations.errors import DocumentError, RunFolderError

_HALF_CHARACTER = re.compile(r"\\u[dD]")


def read_limited(path: Path, most_bytes: int, error_type: type[DocumentError | RunFolderError]) -> bytes:
    """Content of a file that is no larger than a limit.

    Parameters
    ----------
    path : Path
        A plain file; pipes and devices, which may have no end, are refused.
    most_bytes : int
        Size that is still read.
    error_type : type
        What to raise.

    Raises
    ------
    DocumentError or RunFolderError
        The file can't be read, is no plain file, or is too large.
    """
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            what = "a directory" if stat.S_ISDIR(status.st_mode) else "no plain file"
            raise error_type(f"{path}: can't be read: it is {what}")
        if status.st_size > most_bytes:
            raise error_type(f"{path}: {status.st_size} bytes; at most {most_bytes} are allowed")
        return path.read_bytes()
    except OSError as error:
        if isinstance(error, RunFolderError):
            raise
        raise error_type(f"{path}: can't be read: {error.strerror or error}") from error


def parse_json(text: str | bytes) -> Any:
    """Parse JSON.

    Raises
    ------
    ValueError
        It is no JSON, nested too deeply, or has text that can't be written again (halves of characters).
    """
    try:
        text = text if isinstance(text, str) else text.decode()
        data = json.loads(text)
        if _HALF_CHARACTER.search(text):
            json.dumps(data, ensure_ascii=False).encode()
        return data
    except RecursionError:
        raise ValueError("nested too deeply") from None
