"""`gyrobench new procedure`, `gyrobench new station`, `gyrobench new world` and `gyrobench new effect`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from gyrobench.bench.cli.options import complete_chamber, complete_table, complete_template, complete_world
from gyrobench.bench.foundations.errors import DocumentError

_STANDARD_OUTPUT = Path("-")

new = typer.Typer(
    help="Write a commented template: every key with its meaning, bounds and default.\n\n"
    "Example: gyrobench new procedure my_check --like ten_minute_check",
    no_args_is_help=True,
    rich_markup_mode=None,
)

_Name = Annotated[str, typer.Argument(help="Name: letters, digits, underscore, hyphen.")]
_Out = Annotated[Path | None, typer.Option(help="Output file, - for standard output; default: NAME.yaml.")]


@new.command()
def procedure(
    name: _Name,
    like: Annotated[
        str,
        typer.Option(
            help="Template: six_position, check, calibration_check, a shipped procedure, or a file.",
            autocompletion=complete_template,
        ),
    ] = "check",
    out: _Out = None,
) -> None:
    """Write a procedure file.

    Example: gyrobench new procedure my_check --like ten_minute_check
    """
    from gyrobench.bench.authoring.new_files import new_procedure

    _write(name, out, lambda path: new_procedure(name, like, path), "Next: gyrobench plan")


@new.command()
def station(
    name: _Name,
    table: Annotated[
        str | None,
        typer.Option(help="Dialect of the rate table's controller.", autocompletion=complete_table),
    ] = None,
    chamber: Annotated[
        str | None, typer.Option(help="Dialect of the chamber's controller.", autocompletion=complete_chamber)
    ] = None,
    out: _Out = None,
) -> None:
    """Write a station file: fill in location, ports, limits, noise, mounting and signals.

    Replace each `fill_in` before the bench is used, then run `gyrobench check`.

    Example: gyrobench new station my_bench --chamber watlow_f4
    """
    from gyrobench.bench.authoring.new_files import new_station

    _write(
        name,
        out,
        lambda path: new_station(name, path, table, chamber),
        "Fill it in. Next: gyrobench validate",
    )


@new.command()
def world(
    name: _Name,
    like: Annotated[
        str, typer.Option(help="World to copy: file or shipped name.", autocompletion=complete_world)
    ] = "gyro_b",
    out: _Out = None,
) -> None:
    """Copy a world file, to change the simulated truth of an emulated bench.

    Example: gyrobench new world hidden --like quick
    """
    from gyrobench.bench.authoring.new_files import new_world

    _write(name, out, lambda path: new_world(name, like, path))


@new.command("import")
def import_map(
    name: _Name,
    like: Annotated[str, typer.Option(help="Import map to copy: file or shipped name.")] = "example_log",
    out: _Out = None,
) -> None:
    """Copy an import map, to describe the columns of a log.

    Example: gyrobench new import my_log
    """
    from gyrobench.bench.authoring.new_files import new_import_map

    _write(name, out, lambda path: new_import_map(like, path))


@new.command()
def effect(name: _Name, out: _Out = None) -> None:
    """Write an effect file: a law that `gyrobench close` searches for.

    Save it in a folder named `effects`.

    Example: gyrobench new effect cold_side --out effects/cold_side.yaml
    """
    from gyrobench.bench.authoring.new_files import new_effect

    if out is not None and out.parent == Path("effects"):
        out.parent.mkdir(exist_ok=True)
    _write(name, out, lambda path: new_effect(name, path))


def _write(
    name: str,
    out: Path | None,
    make: Callable[[Path], str],
    next_step: str = "Edit it. Next: gyrobench validate",
) -> None:
    """Write a new file and print the next step; existing files are not overwritten."""
    if name.startswith("-"):  # such a file name would be an option to every command
        raise DocumentError(
            f"a name begins with a letter, digit or underscore; found '{name}'. "
            "For standard output: NAME --out -"
        )
    path = out or Path(f"{name}.yaml")
    text = make(path)
    if path == _STANDARD_OUTPUT:
        typer.echo(text, nl=False)
        return
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except OSError as error:
        reason = "exists already; choose another --out" if path.exists() else str(error.strerror)
        raise DocumentError(f"{path}: {reason}. Nothing was written.") from error
    typer.echo(f"{path}: written. {next_step} {path}")
