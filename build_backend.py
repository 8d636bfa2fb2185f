"""Build backend: hatchling, with the JSON Schemas written from the models before a wheel is built.

A wheel ships them at ``gyrobench/schemas/``. They are written by the package itself, so building a wheel
requires what running requires; an editable installation does not need them.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

from hatchling import build as _hatchling
from hatchling.build import *  # noqa: F403 - the hooks that stay as they are

_ROOT = Path(__file__).parent
_PACKAGE = _ROOT / "src" / "gyrobench"
#: Folders at the top that are links in the package; a source archive comes without the links.
_LINKED = (
    "bench",
    "drivers",
    "procedures",
    "stations",
    "worlds",
    "faults",
    "imports",
    "rotations",
    "schemas",
    "conformance",
)


def get_requires_for_build_wheel(config_settings: dict[str, Any] | None = None) -> list[str]:
    """Requirements of hatchling and of the package."""
    project = tomllib.loads((_ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return [*_hatchling.get_requires_for_build_wheel(config_settings), *project["dependencies"]]


def build_wheel(
    wheel_directory: str, config_settings: dict[str, Any] | None = None, metadata_directory: str | None = None
) -> str:
    """Write the schemas, then build the wheel."""
    for name in _LINKED:
        (_ROOT / name).mkdir(exist_ok=True)
        if not (_PACKAGE / name).exists():
            (_PACKAGE / name).symlink_to(Path("..", "..", name))
    command = [sys.executable, "-m", "gyrobench", "schema", "--out", str(_PACKAGE / "schemas")]
    # pip names the packages installed for the build in PYTHONPATH.
    paths = os.pathsep.join(filter(None, [str(_ROOT / "src"), os.environ.get("PYTHONPATH")]))
    subprocess.run(command, env=os.environ | {"PYTHONPATH": paths}, check=True)  # noqa: S603
    return _hatchling.build_wheel(wheel_directory, config_settings, metadata_directory)
