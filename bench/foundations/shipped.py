"""Finds the files that come with the project: procedures, stations, worlds, ..., in one folder per kind.

These folders are at the top of the repository, and inside the package ``gyrobench`` if it is installed.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.text import did_you_mean

#: World that is emulated if there is no shipped world with the name of the station.
DEFAULT_WORLD = "gyro_a"
#: Shipped procedures that are templates of new ones, by purpose.
TEMPLATES: Mapping[str, str] = {
    "check": "ten_minute_check",
    "six_position": "six_position_fig7",
    "calibration_check": "calibration_check",
}
#: New names of renamed shipped files by kind and old name; the old names are accepted too.
_NEW_NAMES: Mapping[str, Mapping[str, str]] = {"procedures": {"verification": "calibration_check"}}


_RUN_FOLDER = "is a run folder. Give it to report, close, verify or resume"
#: Advice for a file of another kind than expected, by the key that identifies its kind.
USES: Mapping[str, str] = {
    "procedure": "Run it with: gyrobench run {0} --station STATION, or check it with its bench: "
    "gyrobench check STATION --procedure {0}",
    "station": "Give it with --station, as in: gyrobench run PROCEDURE --station {0}",
    "world": "Give it with: --world {0}",
    "faults": "Give it with: --faults {0}",
    "rotation_list": "Show what it determines with: gyrobench plan {0} --observability",
}


@cache
def shipped_folder(kind: str) -> Path:
    """Folder with the shipped files of a kind, such as ``procedures``; it may not exist."""
    # In the repository, parents[2] holds links to the folders at the top.
    return (Path(__file__).parents[2] / kind).resolve()


def shipped_names(kind: str) -> list[str]:
    """Names of the shipped YAML files of a kind, without suffix."""
    return sorted(path.stem for path in shipped_folder(kind).glob("*.yaml"))


def world_for(station: str, world: str | None, default: str = DEFAULT_WORLD) -> str:
    """World to emulate: the selected one, else the shipped one with the station's name, else ``default``."""
    return world or (station if station in shipped_names("worlds") else default)


def find_document(kind: str, name: str) -> Path:
    """Find a file by path, or a shipped file by name.

    ``kind``: folder of the shipped files. ``name``: a path, or the name of a shipped file without suffix.
    Raises DocumentError if there is no such file; the message suggests the nearest shipped name and lists
    all.
    """
    path = Path(name)
    if path.suffix in {".yaml", ".yml"} or len(path.parts) > 1:
        if path.is_file():
            return path
        if (path / "journal.jsonl").is_file():
            raise DocumentError(f"{name}: {_RUN_FOLDER}")
        beside = [each.name for each in sorted(path.parent.glob("*.y*ml"))]
        raise DocumentError(
            f"{name}: there is no such file{did_you_mean(path.name, beside) or _suggestion(kind, path.stem)}"
        )
    new_name = _NEW_NAMES.get(kind, {}).get(name)
    if new_name is not None:
        logging.getLogger("gyrobench").warning(f"{name}: this {kind.removesuffix('s')} is called {new_name}")
    candidate = shipped_folder(kind) / f"{new_name or name}.yaml"
    if candidate.is_file():
        return candidate
    if (path / "journal.jsonl").is_file():
        raise DocumentError(f"{name}: {_RUN_FOLDER}")
    if (file := Path(f"{name}.yaml")).is_file():
        raise DocumentError(f"{name}: not a shipped name. Give the file as {file}")
    raise DocumentError(f"{name}: no such file or shipped name{_suggestion(kind, name)}")


_CHOOSE_ROTATIONS = "Choose a list of rotations, a file or a shipped one: {}"


def _suggestion(kind: str, name: str) -> str:
    names = shipped_names(kind)
    for other, use in USES.items():
        folder = {"faults": "faults", "rotation_list": "rotations"}.get(other, f"{other}s")
        if name not in names and name in shipped_names(folder):
            advice = _CHOOSE_ROTATIONS.format(", ".join(names)) if kind == "rotations" else use.format(name)
            return f", but a shipped {other.replace('_', ' ')}. {advice}"
    return f"{did_you_mean(name, names)}. Shipped {kind}: {', '.join(names)}"
