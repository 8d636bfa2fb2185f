"""The command line: its commands by task, one module a command.

A command's module, and the modules that it needs, are imported only when the command is used.
"""

from __future__ import annotations

import atexit
import errno
import gc
import inspect
import math
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import typer
from typer.core import TyperCommand, TyperGroup

from gyrobench.bench.cli.output import (
    EXIT_CODES_HELP,
    EXIT_INSTRUMENT,
    EXIT_NOT_FINISHED,
    EXIT_WRONG_INPUT,
    fail,
)
from gyrobench.bench.foundations.errors import (
    BenchInUseError,
    DocumentError,
    GyrobenchError,
    InstrumentError,
    MissingPackageError,
    MissingRunError,
    UnusablePathError,
)
from gyrobench.bench.foundations.files import require_utf8

#: Commands by task; each is the function of its name in the module of its name.
GROUPS: dict[str, tuple[str, ...]] = {
    "Before a run": ("plan", "check", "jog", "message"),
    "Measure": ("run", "resume", "control", "monitor"),
    "Find and compensate effects": ("close", "investigate", "verify"),
    "Results": ("report", "export", "seal", "certificate", "bins"),
    "Logs of other benches": ("import", "raw-rate", "calibrate"),
    "Many runs": ("runs", "fleet"),
    "Files": ("new", "validate", "schema"),
    "Try and learn": ("emulate", "record", "replay"),
}
#: Replacements for commands that do not exist.
_SUGGESTIONS = {
    **dict.fromkeys(("status", "watch"), "gyrobench monitor RUN, or gyrobench resume RUN --look"),
    **{each: f"gyrobench control RUN {each}" for each in ("pause", "continue", "hold", "skip", "abort")},
    "stop": "gyrobench control RUN abort",
    "compare": "gyrobench report RUN --before RUN, or gyrobench runs --trend",
    "version": "gyrobench --version",
    "help": "gyrobench --help, or gyrobench COMMAND --help",
    "init": "gyrobench new station NAME",
}
#: What stands for a value of each type in the help.
_VALUE_NAMES = {str: "TEXT", Path: "PATH", int: "INTEGER", float: "NUMBER"}
#: Old names that are still accepted, with module and function.
_HIDDEN = {"tell": "control.tell"}
#: Maximum length of a command's first sentence in the list of commands.
_MAX_HELP = 300


def _callback(name: str) -> Callable[..., None] | typer.Typer:
    """Import a command or group of commands by name."""
    word = "import_log" if name == "import" else name.replace("-", "_")
    module, _, function = _HIDDEN.get(name, word).partition(".")
    callback: Callable[..., None] | typer.Typer = getattr(
        import_module(f"gyrobench.bench.cli.{module}"), function or module
    )
    return callback


class _Command(TyperCommand):
    """A command that rejects inf and nan, which ranges of options accept."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments. Raises BadParameter if one is inf or nan."""
        remaining = super().parse_args(ctx, args)
        for option in self.params:
            given = ctx.params.get(option.name)
            for value in given if isinstance(given, list) else [given]:
                if isinstance(value, float) and not math.isfinite(value):
                    hint = f"'{option.opts[0]}'"
                    raise typer.BadParameter(f"{value} is not a finite number.", ctx, param_hint=hint)
        return remaining


@cache
def _command(name: str) -> Any:
    callback = _callback(name)
    if isinstance(callback, typer.Typer):
        command: Any = typer.main.get_group(callback)
    else:
        single_command_app = typer.Typer(add_completion=False, rich_markup_mode=None)
        single_command_app.command(cls=_Command, hidden=name in _HIDDEN)(callback)
        command = typer.main.get_command(single_command_app)
    command.name = name
    for each in getattr(command, "commands", {name: command}).values():
        for parameter in each.params:
            parameter.secondary_opts = []  # no flag has a second form --no-...
            _name_value(parameter)
    return command


def _name_value(parameter: Any) -> None:
    """Set what stands for the value of an argument or option in the help, in place of its Python type."""
    descriptor = getattr(parameter, "type_descriptor", None)
    if descriptor is None:  # an older typer, which names values as click does
        return
    if parameter.param_type_name == "argument":
        parameter.metavar = parameter.metavar or parameter.name.upper()
        if not descriptor.is_choice:
            parameter.display_type_rich = lambda ctx: ""  # noqa: ARG005
    elif not (parameter.metavar or parameter.is_flag):
        is_list = get_origin(descriptor.annotation) is list
        kind = get_args(descriptor.annotation)[0] if is_list else descriptor.annotation
        choices = "|".join(str(getattr(each, "value", each)) for each in descriptor.choices or ())
        parameter.metavar = choices or _VALUE_NAMES.get(kind)


class _Commands(Mapping[str, Any]):
    """All commands by their names, in the order of the groups."""

    def __iter__(self) -> Iterator[str]:
        yield from (name for names in GROUPS.values() for name in names)
        yield from _HIDDEN

    def __len__(self) -> int:
        return sum(map(len, GROUPS.values())) + len(_HIDDEN)

    def __getitem__(self, name: str) -> Any:
        if name not in list(self):
            raise KeyError(name)
        return _command(name)


class _CommandGroups(TyperGroup):
    """Lists its commands group by group."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.commands = _Commands()  # type: ignore[assignment]  # nothing adds to them

    def invoke(self, ctx: Any) -> Any:
        """Execute a command; the error for a wrong value suggests the nearest allowed one."""
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            from gyrobench.bench.foundations.documents import plain_message
            from gyrobench.bench.foundations.text import did_you_mean

            message = plain_message(error.message).rstrip(".")
            message = message.replace(
                "does not match the formats '%Y-%m-%d'", "is no date such as 2026-03-31"
            )
            found, _, allowed = message.partition(" is not one of ")
            near = did_you_mean(found.strip("'"), re.findall(r"'([^']+)'", allowed))
            error.message = f"{message}{near}{'.' if message else ''}"  # empty if a value is missing
            raise

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command; the error for an unknown command suggests another one."""
        if args and (suggestion := _SUGGESTIONS.get(args[0])):
            ctx.fail(f"No such command '{args[0]}'. Use {suggestion}.")
        return super().resolve_command(ctx, args)

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002
        """Names of all commands, in the order of the groups."""
        return list(self.commands)

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ARG002
        """Write the groups of commands to the help."""
        widest = max(map(len, self.commands))
        for group, names in GROUPS.items():
            with formatter.section(group):
                formatter.write_dl([(name.ljust(widest), _summary(name)) for name in names])


def _summary(name: str) -> str:
    callback = _callback(name)
    text = callback.info.help if isinstance(callback, typer.Typer) else inspect.getdoc(callback)
    return str(TyperCommand(name, help=text).get_short_help_str(_MAX_HELP))


# The matrices of this project are small: threads of the linear algebra would only slow each other down.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Its tables are small too: a memory pool would allocate 4 MB in advance.
os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")
# Searching for plugins, pydantic would read the metadata of all packages.
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
# If they are installed, numba would import coverage, which takes a tenth of its import time, and
# pyarrow.parquet the clients of remote file systems, 3.5 MB.
for _unused in ("coverage", "pyarrow._azurefs", "pyarrow._gcsfs", "pyarrow._hdfs", "pyarrow._s3fs"):
    sys.modules.setdefault(_unused, None)  # type: ignore[arg-type]

#: Imports leave half a million permanent objects: searching them for cycles at Python's default rate takes a
#: fifth of the start-up time.
_GC_THRESHOLD = (50_000, 10, 10)

app = typer.Typer(
    epilog=EXIT_CODES_HELP,
    cls=_CommandGroups,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=True,
    rich_markup_mode=None,
)


def _print_version(is_requested: bool) -> None:
    if is_requested:
        from gyrobench.bench import __version__

        typer.echo(f"gyrobench {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Bench controller for calibrating the gyros of inertial navigation systems."""


def _end_quickly() -> None:
    """Freeze the objects at exit: Python would otherwise search all of them for cycles again."""
    if "duckdb" not in sys.modules:  # duckdb reports the remaining objects as leaks
        gc.freeze()


def main() -> None:
    """Run the command line; known errors become a message and an exit code."""
    gc.set_threshold(*_GC_THRESHOLD)
    atexit.register(_end_quickly)
    # Processes that a command starts import nothing from the current folder, which another user may write.
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        Path.cwd()
    except FileNotFoundError:
        fail(GyrobenchError("the current folder was deleted. Change to another one"), EXIT_WRONG_INPUT)
    try:
        for argument in sys.argv[1:]:  # JSON, pages, messages and the index would fail in the middle of a run
            require_utf8(argument)
        app()
    except (DocumentError, MissingRunError, UnusablePathError, MissingPackageError) as error:
        fail(error, EXIT_WRONG_INPUT)
    except (InstrumentError, BenchInUseError) as error:
        fail(error, EXIT_INSTRUMENT)
    except GyrobenchError as error:
        fail(error, EXIT_NOT_FINISHED)
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            fail(GyrobenchError(f"{error.filename}: the path is too long"), EXIT_WRONG_INPUT)
        if error.errno != errno.ENOSPC:
            raise
        fail(GyrobenchError(f"the output can't be written: {error.strerror}"), EXIT_NOT_FINISHED)
