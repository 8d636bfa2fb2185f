"""`gyrobench investigate`."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gyrobench.bench.cli.output import EXIT_NOT_FINISHED, JsonOption, console, print_json

if TYPE_CHECKING:
    from gyrobench.bench.investigation.proposal import Proposal, Rival
    from gyrobench.bench.monitor.terminal import RunConsole


class Approval(StrEnum):
    """Who approves a block."""

    ASK = "ask"
    AUTO = "auto"


def investigate(
    table: Annotated[Path, typer.Argument(metavar="TABLE", help="Dwell table of a unit.")],
    bench: Annotated[
        str, typer.Option(metavar="COMMAND", help="Measures a block: COMMAND PLAN.json NEW.csv.")
    ],
    budget_h: Annotated[float, typer.Option(min=0.1, help="Longest time on the bench, h.")] = 48.0,
    approve: Annotated[Approval, typer.Option(help="Whether a person approves each block.")] = Approval.ASK,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of the investigation; default: investigation, beside the table."),
    ] = None,
    bench_time_limit_s: Annotated[
        float | None,
        typer.Option(
            min=1.0, help="Longest time that the command may take for a block, s; default: by the plan."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Choose and run measurements on another program's bench until the cause of a residual is settled.

    Each block is the one that is expected to distinguish most, per hour, what the search left open. What each
    hypothesis predicts is written to the journal before the block is measured. The same command continues an
    investigation that was interrupted. Exit code 1: ended without a settled cause.

    With --json: {"ended", "reason", "folder", "report", "hours", "blocks", "verdict", "effects"}; ended is
    settled, not_on_list, budget, no_block, declined, refuted or bench_failed.

    Example: gyrobench investigate dwells.csv --bench "python my_bench.py" --approve auto
    """
    from gyrobench.bench.bias.dwell_table import read_dwells
    from gyrobench.bench.foundations.clock import WallClock
    from gyrobench.bench.investigation.external_bench import ExternalBench
    from gyrobench.bench.investigation.investigation import Investigator
    from gyrobench.bench.report.closure.closure_page import write_search
    from gyrobench.bench.report.investigation.investigation_page import write_investigation_page
    from gyrobench.bench.report.investigation.investigation_text import end_sentence, test_sentence

    terminal = console(as_json)
    folder = out or table.parent / "investigation"

    def approved(proposal: Proposal, rivals: Sequence[Rival]) -> bool:
        _show(terminal, proposal, rivals)
        return approve is Approval.AUTO or typer.confirm("Measure it?", err=as_json)

    investigator = Investigator(
        read_dwells(table),
        folder,
        ExternalBench(bench, bench_time_limit_s, terminal.print),
        budget_h,
        approved,
    )
    found = investigator.run(WallClock())
    write_search(found.closure, [folder / "dwells.csv"], folder / "closure")
    page = write_investigation_page(folder, found, str(table))
    if as_json:
        print_json(
            {
                "ended": found.ended,
                "reason": found.reason,
                "folder": folder,
                "report": page,
                "hours": found.spent_h,
                "blocks": len(found.stages) - 1,
                "verdict": found.closure.verdict,
                "effects": found.closure.posterior.of_effect,
            }
        )
    else:
        for sentence in filter(None, [end_sentence(found), test_sentence(found)]):
            terminal.print(sentence)
        terminal.print(
            f"Report   {page}\nTable    {folder / 'dwells.csv'}\nFolder   {folder}", soft_wrap=True
        )
    if found.ended != "settled":
        raise typer.Exit(EXIT_NOT_FINISHED)


def _show(terminal: RunConsole, proposal: Proposal, rivals: Sequence[Rival]) -> None:
    from gyrobench.bench.report.investigation.investigation_text import proposal_sentences

    for sentence in proposal_sentences(proposal, rivals):
        terminal.print(sentence)
