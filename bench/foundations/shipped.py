"""The files that come with the project: procedures, stations, worlds, ... in folders of their own.

They are in the top folder of the repository, and inside the package ``gyrobench`` where it is installed.
"""

from __future__ import annotations

from pathlib import Path
from types import MappingProxyType

#: Shipped procedures that new ones are started from, by what they are for.
TEMPLATES = MappingProxyType(
    {"check": "ten_minute_check", "six_position": "six_position_fig7", "verification": "verification"}
)


def shipped_folders(kind: str) -> list[Path]:
    """Folders with shipped files of a kind, such as ``procedures``; those that exist."""
    folder = (
        Path(__file__).parents[2] / kind
    ).resolve()  # in the repository, parents[2] holds links to the top
    return [folder] if folder.is_dir() else []


def shipped_names(kind: str) -> list[str]:
    """Names of the shipped YAML files of a kind, without their ending."""
    return sorted({path.stem for folder in shipped_folders(kind) for path in folder.glob("*.yaml")})
