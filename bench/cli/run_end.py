"""How a run ended, as the terminal tells it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from bench.cli.bias_tables import print_biases
from bench.cli.exit_codes import EXIT_NOT_FINISHED

if TYPE_CHECKING:
    from rich.console import Console

    from bench.engine.outcome import RunOutcome
    from bench.run_store.folder import RunFolder


def print_end(console: Console, folder: RunFolder, outcome: RunOutcome) -> None:
    """Report how a run ended; exits with an error where it did not finish."""
    from bench.report.html import write_report
    from bench.report.terminal import durations_table

    safe_state = [
        f"{'FAILED: ' if each.problem else ''}{each.what}{_because(each.problem)}"
        for each in outcome.safe_state
    ]
    is_finished = outcome.ended == "finished"
    if not is_finished:
        console.print(f"The run {outcome.ended}: {outcome.reason}", soft_wrap=True, style="bold red")
        console.print("\n".join(safe_state), soft_wrap=True)
    report = write_report(folder)
    print_biases(console, outcome.results.bins, outcome.results.verification)
    console.print(durations_table(outcome.took_s))
    if is_finished:
        console.print("\n".join(safe_state), soft_wrap=True)
    console.print(f"Report   {report}\nFigures  {folder.figures}\nFolder   {folder.path}", soft_wrap=True)
    if not is_finished:
        console.print(f"Go on    gyrobench resume {folder.path}", soft_wrap=True)
        raise typer.Exit(EXIT_NOT_FINISHED)


def _because(problem: str) -> str:
    return f": {problem}" if problem else ""
