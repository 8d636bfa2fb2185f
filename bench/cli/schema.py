"""`gyrobench schema`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gyrobench.bench.cli.validate import FileKindName


def schema(
    kind: Annotated[
        FileKindName | None,
        typer.Argument(help="Kind of file whose schema is printed; default: the first lines for editors."),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for all schemas.")] = None,
) -> None:
    """Print the JSON Schemas of the YAML files, for editors that complete, explain and check.

    An editor with the YAML language server finds the schema by the first line of a file, which
    `gyrobench new` writes; without a kind this prints that line for each.

    Example: gyrobench schema procedure
    """
    from gyrobench.bench.authoring.file_kinds import KINDS, editor_line, schema_of, schema_text, write_schemas

    if kind is not None:
        typer.echo(schema_text(schema_of(KINDS[kind])), nl=False)
    if out is not None:
        write_schemas(out)
    if kind is None and out is None:
        for each in KINDS.values():
            typer.echo(editor_line(each, Path.cwd() / "a.yaml"), nl=False)
