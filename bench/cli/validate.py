"""`gyrobench validate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from gyrobench.bench.cli.options import complete_station
from gyrobench.bench.cli.output import EXIT_WRONG_INPUT, JsonOption, print_json

#: Kinds of file; the names are those of gyrobench.bench.authoring.file_kinds.
FileKindName = Literal[
    "procedure", "station", "world", "faults", "import", "effect", "compensation", "plan", "rotation_list"
]


def validate(
    files: Annotated[list[Path], typer.Argument(metavar="FILE", help="YAML files.")],
    as_kind: Annotated[
        FileKindName | None,
        typer.Option("--as", help="Kind of the files; default: detected from their keys."),
    ] = None,
    station: Annotated[
        str | None,
        typer.Option(
            help="Station of the procedures: their plans are checked too.", autocompletion=complete_station
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Check YAML files and list every mistake with its place.

    Ranges of temperature, ramps and rates are limits of a station: they are checked with --station only.

    With --json: {"files": [{"file", "kind", "ok", "found", "problems": [{"line", "column", "message"}]}]}.

    Exit codes: 0 all files are valid, 2 a file is invalid or of unknown kind.

    Example: gyrobench validate my_procedure.yaml --station my_bench.yaml
    """
    from gyrobench.bench.authoring.file_kinds import KINDS, check_file
    from gyrobench.bench.foundations.shipped import find_document
    from gyrobench.bench.station.station import Station

    kind = KINDS[as_kind] if as_kind else None
    bench = Station(find_document("stations", station)) if station else None
    checks = [check_file(path, kind, bench) for path in files]
    if as_json:
        records = [
            {
                "file": check.path,
                "kind": check.kind or None,
                "ok": check.is_good,
                "found": check.found or None,
                "problems": check.problems(),
            }
            for check in checks
        ]
        print_json({"files": records})
    else:
        for check in checks:
            noun = "import map" if check.kind == "import" else f"{check.kind.replace('_', ' ')} file"
            valid = f"{check.path}: valid {noun}{f', {check.found}' if check.found else ''}"
            typer.echo(valid if check.is_good else check.text)
    if not all(check.is_good for check in checks):
        raise typer.Exit(EXIT_WRONG_INPUT)
