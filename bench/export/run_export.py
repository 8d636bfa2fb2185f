"""Writes what is wanted of a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from gyrobench.bench.closure.files import read_held_out_cycles
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.dwells.campaign import read_campaign
from gyrobench.bench.dwells.setup import measurement_setup
from gyrobench.bench.export.can_blf import write_blf
from gyrobench.bench.export.compensation import compensation_files, export_compensation
from gyrobench.bench.export.destination import Destination
from gyrobench.bench.export.navigation import export_navigation
from gyrobench.bench.export.origin import origin_of
from gyrobench.bench.export.placed_parts import PlacedLog
from gyrobench.bench.export.tables import export_csv
from gyrobench.bench.export.telemetry import export_telemetry
from gyrobench.bench.export.wanted import Wanted, What
from gyrobench.bench.foundations.errors import MeasurementError, RunFolderError
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.provenance import started_utc
from gyrobench.bench.station.station import Station

_TABLES = MappingProxyType(
    {
        What.DWELLS: ("dwells",),
        What.BINS: ("bias_bins",),
        What.JOINT: ("joint", "joint_biases"),
        What.VERIFICATION: ("verification",),
    }
)
_MADE_ANEW = "{} is not there, as where a run was cut off; `gyrobench bins {}` makes it"


@dataclass(frozen=True)
class Exported:
    """What was written, and what was not.

    Attributes
    ----------
    files : list of Path
        In order.
    lacks : dict of What to str
        What the run does not hold, and why.
    """

    files: list[Path]
    lacks: dict[What, str]


def export_run(folder: RunFolder, wanted: Wanted, out: Path, force: bool = False) -> Exported:
    """Write what is wanted of a run, as far as the run holds it; one that was cut off holds less.

    Parameters
    ----------
    out : Path
        Folder to write to; made if it isn't there.
    force : bool
        Whether files that are there are replaced.

    Raises
    ------
    DocumentError
        A table, station or DBC file is wrong.
    RunFolderError
        Files are there already, something can't be read or written, or the run holds nothing of what is
        wanted.
    """
    lacks = {what: why for what in wanted.kinds() if (why := _why_missing(folder, what))}
    kinds = [what for what in wanted.kinds() if what not in lacks]
    if not kinds:
        raise RunFolderError(f"{folder.path}: " + "; ".join(f"{what}: {why}" for what, why in lacks.items()))
    destination = Destination(out, origin_of(folder), force)
    destination.refuse_existing([name for what in kinds for name in _files(what, wanted)])
    for what in kinds:
        _write(folder, what, wanted, destination)
    destination.finish()
    return Exported(destination.written, lacks)


def _why_missing(folder: RunFolder, what: What) -> str:
    """Why the run does not hold something; empty where it does."""
    match what:
        case What.VERIFICATION:
            return "" if folder.verification.exists() else "the run verified nothing"
        case What.TELEMETRY:
            return "" if any(folder.telemetry.glob("part-*")) else "there are no readings"
        case What.NAVIGATION | What.CAN:
            return "" if any(folder.can.glob("part-*")) else "there are no CAN frames"
        case What.COMPENSATION:
            is_closed = (folder.closure / "closure.json").exists()
            return "" if is_closed else f"the run was not searched; `gyrobench close {folder.path}` does that"
    names = [f"{table}.csv" for table in _TABLES[what]]
    missing = [name for name in names if not (folder.path / name).exists()]
    return _MADE_ANEW.format(missing[0], folder.path) if missing else ""


def _files(what: What, wanted: Wanted) -> list[str]:
    """Names of the files that something is written to."""
    suffixes = wanted.suffixes(what)
    if what is What.COMPENSATION:
        return compensation_files(suffixes)
    names = _TABLES.get(what, (str(what),))
    if what is What.NAVIGATION and wanted.dwell is not None:
        names = (f"{what}_dwell_{wanted.dwell}",)
    return [name + suffix for name in names for suffix in suffixes]


def _write(folder: RunFolder, what: What, wanted: Wanted, destination: Destination) -> None:
    if what is What.COMPENSATION:
        _write_compensation(folder, wanted.suffixes(what), destination)
        return
    for name in _files(what, wanted):
        match what:
            case What.TELEMETRY:
                export_telemetry(folder, started_utc(folder), name, destination)
            case What.NAVIGATION:
                setup = measurement_setup(Station(folder.station))
                export_navigation(folder, setup, name, destination, wanted.dwell)
            case What.CAN:
                _write_can(folder, name, destination)
            case _:
                export_csv((folder.path / name).with_suffix(".csv"), name, destination)


def _write_can(folder: RunFolder, name: str, destination: Destination) -> None:
    log, dbc = PlacedLog(folder), Station(folder.station).dbc_path
    about = {"source": folder.can.name, "dbc": dbc.name, "parts_with_estimated_time": log.estimated}
    with destination.file(name, **about) as path:
        if name.endswith(".blf"):
            write_blf(path, log)
        else:
            _write_mf4(path, log, dbc, destination.origin)


def _write_mf4(path: Path, log: PlacedLog, dbc: Path, origin: Mapping[str, Any]) -> None:
    """Write MDF4; its library is optional, since python-can loads it with every use of CAN where it is."""
    try:
        from gyrobench.bench.export.can_mf4 import write_mf4
    except ImportError as error:
        raise RunFolderError(
            f"{path}: MDF4 needs asammdf, which is not installed. Install it: pip install 'gyrobench[mf4]'"
        ) from error
    write_mf4(path, log, dbc, origin)


def _write_compensation(folder: RunFolder, suffixes: list[str], destination: Destination) -> None:
    try:
        closure = close_loop(read_campaign(folder.path), read_held_out_cycles(folder.closure))
    except MeasurementError as error:
        raise RunFolderError(f"{folder.path}: {error}") from error
    export_compensation(closure, suffixes, destination)
