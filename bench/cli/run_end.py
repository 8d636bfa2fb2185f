"""How a run ended, as the terminal tells it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from gyrobench.bench.cli.bias_tables import print_biases
from gyrobench.bench.cli.exit_codes import EXIT_NOT_FINISHED
from gyrobench.bench.cli.json_output import print_json

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import Console

    from gyrobench.bench.engine.observers import RunOutcome
    from gyrobench.bench.runs.folder import RunFolder


def print_end(console: Console, folder: RunFolder, outcome: RunOutcome, as_json: bool = False) -> None:
    """Report how a run ended, also as JSON if wanted; exits with an error where it did not finish."""
    from gyrobench.bench.report.html import write_report
    from gyrobench.bench.report.terminal.tables import durations_table

    safe_state = "\n".join(each.text for each in outcome.safe_state)
    is_finished = outcome.ended == "finished"
    if not is_finished:
        console.print(f"The run {outcome.ended}: {outcome.reason}", soft_wrap=True, style="bold red")
        console.print(safe_state, soft_wrap=True)
    report = write_report(folder)
    results = outcome.results
    print_biases(console, results.bins, results.verification, results.acceptance)
    console.print(durations_table(outcome.took_s))
    if is_finished:
        console.print(safe_state, soft_wrap=True)
    console.print(f"Report   {report}\nFigures  {folder.figures}\nFolder   {folder.path}", soft_wrap=True)
    if as_json:
        print_json(_record(folder, outcome, report))
    if not is_finished:
        console.print(f"Go on    gyrobench resume {folder.path}", soft_wrap=True)
        raise typer.Exit(EXIT_NOT_FINISHED)


def _record(folder: RunFolder, outcome: RunOutcome, report: Path) -> dict[str, object]:
    return {
        "ended": outcome.ended,
        "reason": outcome.reason or None,
        "folder": folder.path,
        "report": report,
        "dwells": len(outcome.dwells) + len(outcome.verifications),
        "verdict": outcome.results.acceptance.verdict,
        "safe_state": outcome.safe_state,
    }
