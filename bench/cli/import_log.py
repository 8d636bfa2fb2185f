"""`gyrobench import`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gyrobench.bench.cli.options import complete_import_map


def import_log(
    logs: Annotated[
        list[Path], typer.Argument(metavar="LOG", help="Log of a real IMU; several in order of time.")
    ],
    mapping: Annotated[
        str,
        typer.Option("--map", help="Import map: file or shipped name.", autocompletion=complete_import_map),
    ],
    out: Annotated[Path, typer.Option(help="Dwell table to write.")] = Path("dwells.csv"),
) -> None:
    """Import logs of a real IMU or INS into a dwell table.

    Example: gyrobench import imu.csv --map my_imu.yaml --out dwells.csv
    """
    from gyrobench.bench.exchange.log_import import import_logs, write_import

    imported = import_logs(logs, mapping)
    record = write_import(out, imported)
    typer.echo(f"{imported.summary()}\nTable    {out}\nRecord   {record}")
