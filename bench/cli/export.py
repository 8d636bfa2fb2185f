"""`gyrobench export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gyrobench.bench.cli.options import RunArgument, complete_list
from gyrobench.bench.foundations.errors import DocumentError

_DATA_KINDS = ("dwells", "bins", "joint", "verification", "telemetry", "navigation", "can", "compensation")
_FORMATS = ("parquet", "csv", "blf", "mf4")


def export(
    run_folder: RunArgument,
    what: Annotated[
        str,
        typer.Option(
            help=f"Comma-separated list of {', '.join(_DATA_KINDS)}; default: all but navigation.",
            autocompletion=complete_list(_DATA_KINDS),
        ),
    ] = "",
    formats: Annotated[
        str,
        typer.Option(
            "--format",
            help=f"Comma-separated list of {', '.join(_FORMATS)}; default: parquet,blf.",
            autocompletion=complete_list(_FORMATS),
        ),
    ] = "",
    dwell: Annotated[
        int | None, typer.Option(min=1, help="Navigation data of this dwell only; default: whole run.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Output folder; default: export in the run.")] = None,
    force: Annotated[bool, typer.Option(help="Replace existing files.")] = False,
) -> None:
    """Export the data of a run for other tools, with units and provenance.

    Tables, telemetry and decoded navigation data are written as Parquet or CSV, raw CAN frames as one BLF or
    MDF4 file, the compensation as tables and as the YAML file that `gyrobench run` loads. An interrupted run
    is exported as far as it was recorded.

    Example: gyrobench export runs/six_position_fig7-001 --what dwells,can --format csv,mf4
    """
    from gyrobench.bench.exchange.run_export import DataKind, ExportSelection, Format, export_run
    from gyrobench.bench.runs.folder import open_run_folder

    selection = ExportSelection(
        [DataKind(name) for name in _parse_names(what, list(DataKind), "--what")],
        [Format(name) for name in _parse_names(formats, list(Format), "--format")],
        dwell,
    )
    folder = open_run_folder(run_folder)
    exported = export_run(folder, selection, out or folder.path / "export", force)
    for path in exported.files:
        typer.echo(f"{_size(path):>9}  {path}")
    for kind, reason in exported.missing.items():
        typer.echo(f"not exported: {kind}: {reason}")


def _parse_names(text: str, allowed: list[str], option: str) -> list[str]:
    names = [name.strip() for name in text.split(",") if name.strip()]
    for name in names:
        if name not in allowed:
            hint = ". Excel opens csv" if name in ("xlsx", "xls", "excel") else ""
            raise DocumentError(f"{option}: '{name}' is not one of {', '.join(allowed)}{hint}")
    return list(dict.fromkeys(names))


def _size(path: Path) -> str:
    size = float(path.stat().st_size)
    for unit in ("B", "kB"):
        if size < 1000.0:
            return f"{size:.0f} {unit}"
        size /= 1000.0
    return f"{size:.1f} MB"
