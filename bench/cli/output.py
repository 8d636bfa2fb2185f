"""Output of commands: console, JSON, tables of biases, the end of a run, exit codes."""

from __future__ import annotations

import dataclasses
import math
import sys
from datetime import date
from enum import Enum
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, TypeVar

import typer

from gyrobench.bench.foundations.errors import GyrobenchError, RunFolderError
from gyrobench.bench.foundations.text import of_units, with_micro_sign

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from rich.console import Console, RenderableType

    from gyrobench.bench.engine.run_outcome import FailOn, RunOutcome
    from gyrobench.bench.monitor.terminal import RunConsole
    from gyrobench.bench.runs.folder import RunFolder

_Row = TypeVar("_Row")

#: The run did not finish, or a check failed.
EXIT_NOT_FINISHED = 1
#: A file, table or option is wrong, the named run does not exist, or a package is missing.
EXIT_WRONG_INPUT = 2
#: An instrument can't be reached.
EXIT_INSTRUMENT = 3

_EMULATED_BENCH = "the bench was emulated, no bias or verdict is that of a real unit."

#: For the help; line breaks are kept.
EXIT_CODES_HELP = """\b
Exit codes of all commands:
  0  success; run and resume: the run finished
  1  not finished, or a check failed
  2  a file, table, path or option is wrong, there is no such run, or an extra is not installed
  3  an instrument can't be reached, or another run uses the bench

Codes of a single command: gyrobench COMMAND --help
"""


def fail(error: GyrobenchError, code: int) -> NoReturn:
    """Print the error and exit."""
    typer.echo(f"gyrobench: {error}", err=True)
    sys.exit(code)


def console(as_json: bool = False, of_run: bool = False) -> RunConsole:
    """Create a console for plain text; on standard error if standard output is for JSON.

    Output that can't be written to a full disk is an error, but not that ``of_run``, a run in progress.
    """
    from gyrobench.bench.monitor.terminal import RunConsole

    return RunConsole(raises_full_disk=not of_run, stderr=as_json, markup=False, highlight=False)


_JSON_HELP = "Print one JSON object instead of text; messages go to standard error."
JsonOption = Annotated[bool, typer.Option("--json", help=_JSON_HELP)]


def print_json(content: dict[str, Any]) -> None:
    """Print an object; numbers that are not finite become null.

    Where standard output is not UTF-8, other characters than those of ASCII are escaped.
    """
    import codecs
    import json

    is_utf8 = codecs.lookup(sys.stdout.encoding or "utf-8").name == "utf-8"
    typer.echo(json.dumps(plain(content), indent=1, ensure_ascii=not is_utf8, allow_nan=False))


def print_result(content: dict[str, Any], as_json: bool, *views: RenderableType) -> None:
    """Print a result as a JSON object, or as views with each path on a separate line."""
    if as_json:
        print_json(content)
        return
    terminal = console()
    for view in views:
        terminal.print(view, soft_wrap=isinstance(view, str))


def plain(value: Any) -> Any:
    """Convert records, arrays, times and paths to JSON types; other objects to their text."""
    from decimal import Decimal

    if hasattr(value, "model_dump"):  # models of pydantic
        return value.model_dump(mode="json", by_alias=True)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(each) for each in value]
    if hasattr(value, "tolist"):  # arrays and numbers of numpy
        return plain(value.tolist())
    if isinstance(value, Enum):
        return plain(value.value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, date):  # a datetime is one too
        return value.isoformat()
    if isinstance(value, Decimal):
        return plain(float(value))
    return value if isinstance(value, str | int | None) else str(value)


def print_tables(console: Console, folder: RunFolder) -> None:
    """Print a run's tables: biases or calibration check, the verdict, coefficients, characteristics."""
    from gyrobench.bench.bias.bins import BIAS_BINS_TABLE, with_power_cycles
    from gyrobench.bench.bias.dwell_table import read_dwells
    from gyrobench.bench.bias.verdicts import read_acceptance
    from gyrobench.bench.characteristics.results import read_characteristics
    from gyrobench.bench.report.bias_sections import acceptance_summary, bins_summary
    from gyrobench.bench.report.calibration_check_section import calibration_check_section
    from gyrobench.bench.report.characteristic_sections import characteristics_sections
    from gyrobench.bench.report.coefficient_sections import coefficients_section
    from gyrobench.bench.report.terminal.tables import section_view
    from gyrobench.bench.runs.tables.calibration_check_table import CALIBRATION_CHECK_TABLE
    from gyrobench.bench.runs.tables.coefficient_table import COEFFICIENT_TABLE

    def read(path: Path, reader: Callable[[Path], list[_Row]]) -> list[_Row]:
        return reader(path) if path.exists() else []

    bins = with_power_cycles(read(folder.bias_bins, BIAS_BINS_TABLE.read), read(folder.dwells, read_dwells))
    check = read(folder.calibration_check, CALIBRATION_CHECK_TABLE.read)
    coefficients = read(folder.coefficients, COEFFICIENT_TABLE.read)
    characteristics = read(folder.characteristics, read_characteristics)
    sections = [
        bins_summary(bins) if bins or not (check or coefficients or characteristics) else None,
        calibration_check_section(check),
        acceptance_summary(read_acceptance(folder.acceptance)) if folder.acceptance.exists() else None,
        coefficients_section(coefficients),
        *characteristics_sections(characteristics),
    ]
    for section in filter(None, sections):
        console.print(section_view(section))
        console.print()


def print_unfinished(paths: Iterable[Path], on_stderr: bool = False) -> None:
    """Print which of the paths are unfinished runs, and how to resume them."""
    from gyrobench.bench.runs.folder import RunFolder
    from gyrobench.bench.runs.locks import holder_of

    for folder in filter(lambda each: each.is_unfinished, map(RunFolder, paths)):
        is_held = holder_of(folder.run.path) is not None
        state = "is still in progress: these are its dwells so far" if is_held else "has not finished"
        resume = "" if is_held else f" Resume it with: gyrobench resume {folder.run.argument}"
        console(on_stderr).print(
            f"{folder.path}: the run {state}.{resume}", soft_wrap=True, style="bold yellow"
        )


def print_damage(folders: Iterable[RunFolder], on_stderr: bool = False) -> bool:
    """Print which of the runs are damaged, as by an edited dwell table; returns whether any is."""
    from gyrobench.bench.report.run_content import damage_of

    texts = [text for folder in folders for text in damage_of(folder).values()]
    for text in texts:
        console(on_stderr).print(text, soft_wrap=True, style="bold red")
    return bool(texts)


def print_end(
    console: Console,
    folder: RunFolder,
    outcome: RunOutcome,
    station_name: str | Path,
    as_json: bool = False,
    fail_on: FailOn | None = None,
) -> None:
    """Report the end of a run, with ``as_json`` also as JSON; frees its dwells and results.

    ``station_name``: name of the run's station file in commands. Exits with an error if the run did not
    finish, or meets the condition ``fail_on``.
    """
    from gyrobench.bench.foundations.memory import free_memory

    is_finished, resume = outcome.ended == "finished", _resume_text(folder, outcome)
    safe_state = "\n".join(each.text for each in outcome.safe_state)
    if not is_finished:
        _print_failure(console, outcome, resume, safe_state)
    if not folder.journal.exists():
        raise RunFolderError(
            f"{folder.path}: the run folder has disappeared, and no report was written. Rename it back, or "
            f"mount its disk, then: gyrobench resume {folder.argument}"
        )
    record = _end_record(folder, outcome)
    shortcoming, skipped = outcome.shortcoming(fail_on), outcome.skipped_text
    units = [*outcome.units.values()] or [outcome]
    is_flagged = any(dwell.flags for unit in units for dwell in unit.results.dwells)
    repeatable = [name for name, exists in (("flagged", is_flagged), ("skipped", skipped)) if exists]
    outcome.release()
    free_memory()  # reused by the modules of the report
    try:
        _print_report(console, folder, station_name, has_units=bool(outcome.units))
    except RunFolderError:  # for instance a full disk
        if is_finished:
            console.print(
                f"{safe_state}\nAll steps are finished, and all dwells are kept.\n"
                f"Report   gyrobench resume {folder.argument}",
                soft_wrap=True,
            )
        raise
    if skipped:
        console.print(skipped, style="bold yellow")
    _print_durations(console, folder)
    if is_finished:
        console.print(safe_state, soft_wrap=True)
    figures = "" if outcome.units else f"Figures  {folder.figures}\n"
    console.print(f"Report   {folder.report}\n{figures}Folder   {folder.path}", soft_wrap=True)
    if is_finished and repeatable:
        again = f"gyrobench resume {folder.argument} --repeat {','.join(repeatable)} --look"
        console.print(f"Repeat   {again}", soft_wrap=True)
    if as_json:
        print_json(record)
    if not is_finished:
        console.print(resume, soft_wrap=True)
        raise typer.Exit(EXIT_NOT_FINISHED)
    if shortcoming:
        console.print(shortcoming, soft_wrap=True, style="bold red")
        raise typer.Exit(EXIT_NOT_FINISHED)


def _print_failure(console: Console, outcome: RunOutcome, resume: str, safe_state: str) -> None:
    contradicting = outcome.contradicting_dwell
    # The flag of that dwell was printed when it was measured.
    flagged = f"failed: dwell {contradicting} contradicts the station file, see its flag above."
    ending = outcome.ending if contradicting is None else flagged
    console.print(f"The run {ending}", soft_wrap=True, style="bold red")
    if not outcome.is_station_wrong:  # otherwise the text is long, and follows at the end
        console.print(resume, soft_wrap=True)
    console.print(safe_state, soft_wrap=True)


def _print_report(console: Console, folder: RunFolder, station_name: str | Path, *, has_units: bool) -> None:
    """Write the report of a run, and print its tables and what is doubtful in it."""
    from gyrobench.bench.report.run_findings import signs_sentence
    from gyrobench.bench.report.run_report import write_report
    from gyrobench.bench.report.terminal.tables import section_view
    from gyrobench.bench.report.units_report import write_units_report
    from gyrobench.bench.runs.provenance import watermark_of

    if has_units:
        report = write_units_report(folder)
        contents = report.units
        console.print(section_view(report.comparison))
    else:
        contents = [write_report(folder).content]
        print_tables(console, folder)
    if word := watermark_of(folder.path):
        console.print(f"{word}: {_EMULATED_BENCH}", soft_wrap=True, style="bold yellow")
    # By style and text, as several units often have the same.
    numbers_by_text: dict[tuple[str, str], list[str]] = {}
    for content in contents:
        doubts = [("bold red", " ".join(doubt)) for doubt in content.doubts.items()]
        note = "bold yellow", signs_sentence(content.facts, content.station, station_name)
        for styled_text in (*doubts, note):
            numbers_by_text.setdefault(styled_text, []).append(content.name if has_units else "")
    for (style, text), numbers in sorted(numbers_by_text.items(), key=lambda each: each[0][0]):
        if text:
            console.print(with_micro_sign(of_units(numbers, text)), style=style)


def _print_durations(console: Console, folder: RunFolder) -> None:
    from gyrobench.bench.report.journal_sections import durations_section, step_durations
    from gyrobench.bench.report.terminal.tables import section_view
    from gyrobench.bench.runs.journal import read_journal

    console.print(section_view(durations_section(step_durations(read_journal(folder.journal)))))


def _resume_text(folder: RunFolder, outcome: RunOutcome) -> str:
    """Text on how to resume an unfinished run, and what to correct in a wrong station file before."""
    resume = f"gyrobench resume {folder.argument}"
    if not outcome.is_station_wrong:
        return f"Resume   {resume}"
    new_run = "New run  correct your own station file or DBC file: a new run reads that one."
    if outcome.units or not (outcome.dwells or outcome.check_dwells):  # units have a copy each too
        return new_run
    lines = (
        f"Resume   correct the copy {folder.station} or the DBC file beside it:",
        "resume reads no other, and evaluates the dwells measured so far again with it. Then",
        f"gyrobench seal {folder.argument} --accept-changes",
        resume,
    )
    return "\n         ".join(lines) + f"\n{new_run}"


def _end_record(folder: RunFolder, outcome: RunOutcome) -> dict[str, object]:
    units = {
        number: {
            "ended": unit.ended,
            "reason": unit.reason or None,
            "dwells": len(unit.dwells) + len(unit.check_dwells),
            "skipped": sorted(unit.skipped),
            "verdict": unit.results.acceptance.verdict,
        }
        for number, unit in outcome.units.items()
    }
    return {
        "ended": outcome.ended,
        "reason": outcome.reason or None,
        "folder": folder.path,
        "report": folder.report,
        "dwells": len(outcome.dwells) + len(outcome.check_dwells),
        "skipped": sorted(outcome.skipped),
        "verdict": outcome.results.acceptance.verdict,
        "safe_state": outcome.safe_state,
        **({"units": units} if units else {}),
    }
