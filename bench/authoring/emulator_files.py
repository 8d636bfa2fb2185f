"""World files and lists of faults, which the emulators alone read: their program is asked about them.

It runs as a process of its own, so that nothing of the simulated truth comes into the bench.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from gyrobench.bench.foundations.errors import DocumentError, GyrobenchError

_PROGRAM = "gyrobench.drivers.emulators.documents"
_LONGEST_S = 120.0
_WRONG_FILE = 2


def emulator_schema(kind: str) -> dict[str, Any]:
    """Give the JSON Schema of ``world`` or ``faults`` files.

    Raises
    ------
    GyrobenchError
        The emulators' program does not run.
    """
    schema: dict[str, Any] = json.loads(_asked("schema", kind))
    return schema


def check_emulator_file(kind: str, path: Path) -> None:
    """Check a ``world`` or ``faults`` file.

    Raises
    ------
    DocumentError
        Lists everything wrong with it, with places.
    GyrobenchError
        The emulators' program does not run.
    """
    _asked("check", kind, str(path))


def _asked(*arguments: str) -> str:
    # -P: nothing out of the present folder
    command = [sys.executable, "-P", "-m", _PROGRAM, *arguments]
    try:
        answer = subprocess.run(  # noqa: S603 - our own program; a file is one argument of it
            command, capture_output=True, text=True, timeout=_LONGEST_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise GyrobenchError(f"the emulators' program can't be asked: {error}") from error
    if answer.returncode == _WRONG_FILE:
        raise DocumentError(answer.stderr.strip())
    if answer.returncode:
        raise GyrobenchError(f"the emulators' program failed: {answer.stderr.strip()[-500:]}")
    return answer.stdout
