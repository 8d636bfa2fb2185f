"""`gyrobench investigate`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gyrobench.bench.cli.options import (
    EMULATED,
    STATION_HELP,
    WORLD_DEFAULT,
    AcknowledgeOption,
    View,
    ViewOption,
    complete_procedure,
    complete_station,
    complete_world,
)
from gyrobench.bench.cli.output import EXIT_NOT_FINISHED, JsonOption, console, print_json

if TYPE_CHECKING:
    from gyrobench.bench.engine.investigation_runs import InvestigationStart, Observe
    from gyrobench.bench.engine.job import Job
    from gyrobench.bench.engine.observers import RunObserver
    from gyrobench.bench.engine.operator import Operator
    from gyrobench.bench.investigation.choice import Rival
    from gyrobench.bench.investigation.proposal import Proposal
    from gyrobench.bench.investigation.stages import Investigation
    from gyrobench.bench.monitor.terminal import RunConsole
    from gyrobench.bench.verification.compensation_verification import VerificationResult


def investigate(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="PROCEDURE|RUN|TABLE",
            help="Procedure to measure first, or run folders of one unit; with --bench a dwell table.",
            autocompletion=complete_procedure,
        ),
    ],
    bench: Annotated[
        str | None,
        typer.Option(
            metavar="COMMAND",
            help="Command that measures a block instead of the station; called as COMMAND PLAN NEW.",
        ),
    ] = None,
    station: Annotated[
        str | None,
        typer.Option(
            help=f"{STATION_HELP} Default: the run's, or emulated.", autocompletion=complete_station
        ),
    ] = None,
    world: Annotated[
        str | None,
        typer.Option(
            help="World behind emulated instruments; default: the run's, unless another station has one of "
            f"its name; without a run {WORLD_DEFAULT}.",
            autocompletion=complete_world,
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of the emulated world; default: the run's, or 0.")
    ] = None,
    budget_h: Annotated[
        float, typer.Option(min=0.1, help="Longest time on the bench for all blocks, h.")
    ] = 48.0,
    adaptive: Annotated[
        bool,
        typer.Option(
            help="Instead of the whole procedure, measure only until its bias uncertainty is reached and the "
            "effect is identified."
        ),
    ] = False,
    approve: Annotated[
        Literal["ask", "auto"], typer.Option(help="Whether a person approves each block.")
    ] = "ask",
    verification: Annotated[
        str | None,
        typer.Option(
            help="Procedure that verifies the compensation at the end, or none; default: "
            "verify_compensation. Not with --bench.",
            autocompletion=complete_procedure,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the investigation; default: investigation, in the first run or beside the table, "
            "and runs/investigation_PROCEDURE."
        ),
    ] = None,
    bench_time_limit_s: Annotated[
        float | None,
        typer.Option(
            min=1.0, help="Longest time that the command may take for a block, s; default: from the plan."
        ),
    ] = None,
    acknowledge: AcknowledgeOption = None,
    view: ViewOption = "live",
    as_json: JsonOption = False,
) -> None:
    """Choose and run measurements until the effect behind a residual is identified; verify its compensation.

    Each block is the one expected to distinguish best, per hour, between the hypotheses that the search left
    open. The prediction of each hypothesis is recorded in the journal before the block is measured. The same
    command continues an interrupted investigation. Exit code 0: the effect is identified, or nothing was
    found; 1: neither.

    With --json: {"ended", "reason", "folder", "report", "hours", "blocks", "verdict", "effects",
    "uncertainty_ratio", "verification"}; ended is settled, nothing_found, not_on_list, budget, no_block,
    declined, refuted or bench_failed; hours are those of the blocks, with --adaptive all on the bench;
    verification is null, or a list with the columns of comparison.csv as keys.

    Example: gyrobench investigate quick_campaign --station quick --world quick --approve auto
    """
    from gyrobench.bench.bias.dwell_table import read_dwells
    from gyrobench.bench.foundations.clock import WallClock
    from gyrobench.bench.foundations.errors import DocumentError
    from gyrobench.bench.investigation.external_bench import ExternalBench
    from gyrobench.bench.investigation.investigation import Investigator
    from gyrobench.bench.runs.folder import RunFolder

    consent = _Consent(console(as_json, of_run=True), approve == "auto", as_json)
    runs = [Path(source) for source in sources if (Path(source) / RunFolder.journal).exists()]
    if adaptive and (bench is not None or runs):
        raise DocumentError("--adaptive goes with a procedure that is not measured yet. Leave it out")
    if bench is not None:
        if station or world or seed is not None or verification or len(sources) > 1:
            raise DocumentError(
                "--bench goes with one table, without --station, --world, --seed and --verification"
            )
        folder = out or Path(sources[0]).parent / "investigation"
        dwells = read_dwells(Path(sources[0]))
        external = ExternalBench(bench, dwells, bench_time_limit_s, consent.terminal.print)
        investigation = Investigator(external, folder, budget_h, consent).run(WallClock())
        _report(consent.terminal, investigation, folder, sources, None, as_json)
        return
    start = _start(sources, runs, station, world, seed, out, adaptive=adaptive)
    start = replace(start, job=replace(start.job, acknowledged=tuple(acknowledge or ())))
    if approve == "auto" and start.job.station.file.block_approval != "auto":
        raise DocumentError(
            f"{start.job.station.path}: does not allow blocks without approval. Set block_approval: auto, or "
            "leave --approve auto out"
        )
    investigation, verification_result = _with_station(
        start, budget_h, verification or "verify_compensation", view, consent
    )
    _report(consent.terminal, investigation, start.folder, sources, verification_result, as_json)


@dataclass(frozen=True)
class _Consent:
    """Approval of blocks: prints each block and asks the operator, unless approval is automatic."""

    terminal: RunConsole
    is_automatic: bool
    as_json: bool

    def __call__(self, proposal: Proposal, rivals: Sequence[Rival]) -> bool:
        from gyrobench.bench.report.investigation_page import proposal_sentences

        for sentence in proposal_sentences(proposal, rivals):
            self.terminal.print(sentence)
        return self.is_given()

    def is_given(self) -> bool:
        """Whether to measure the printed block."""
        return self.is_automatic or typer.confirm("Measure it?", err=self.as_json)


def _start(
    sources: Sequence[str],
    runs: Sequence[Path],
    station: str | None,
    world: str | None,
    seed: int | None,
    out: Path | None,
    *,
    adaptive: bool,
) -> InvestigationStart:
    """Start of an investigation on a station, from a procedure or from measured runs."""
    from gyrobench.bench.engine.investigation_runs import start_with_procedure, start_with_runs
    from gyrobench.bench.engine.job import require_one_unit
    from gyrobench.bench.foundations.errors import DocumentError
    from gyrobench.bench.station.instruments import Emulation

    if runs and len(runs) == len(sources):
        start = start_with_runs(runs, station, world, seed, out)
    elif len(sources) > 1 or sources[0].endswith(".csv"):
        raise DocumentError(
            f"{sources[0]}: is not a run folder. Name a procedure, run folders, or a table with --bench"
        )
    else:
        emulation = Emulation.of(station or EMULATED, world, seed or 0)
        start = start_with_procedure(sources[0], station or EMULATED, emulation, out, adaptive=adaptive)
    require_one_unit(start.job)
    return start


def _with_station(
    start: InvestigationStart, budget_h: float, procedure: str, view: View, consent: _Consent
) -> tuple[Investigation, VerificationResult | None]:
    """Investigate on a station, and verify the compensation of the identified effect."""
    from gyrobench.bench.engine.investigation_runs import StationBench, measure_campaign
    from gyrobench.bench.foundations.clock import WallClock
    from gyrobench.bench.investigation.investigation import Investigator
    from gyrobench.bench.monitor.terminal_view import observe_in_terminal
    from gyrobench.bench.report.run_report import write_report
    from gyrobench.bench.runs.folder import RunFolder

    def observe(job: Job) -> AbstractContextManager[tuple[RunObserver, Operator]]:
        return observe_in_terminal(consent.terminal, job, view == "live")

    job, first, clock = start.job, RunFolder(start.runs[0]), None
    if start.is_measured_first:
        clock = measure_campaign(job, first, observe)
        write_report(first)
    bench = StationBench(job, start.runs, start.folder, observe, clock)
    investigation = Investigator(bench, start.folder, budget_h, consent, start.profile).run(WallClock())
    verification_result = None
    if investigation.is_conclusive and procedure != "none":
        verification_result = _verify(start, investigation, procedure, observe, consent)
    write_report(first)
    return investigation, verification_result


def _verify(
    start: InvestigationStart,
    investigation: Investigation,
    procedure: str,
    observe: Observe,
    consent: _Consent,
) -> VerificationResult | None:
    """Verify the compensation for the identified effect; None if the operator declines."""
    from gyrobench.bench.engine.investigation_runs import measure_verification, verification_runs
    from gyrobench.bench.runs.folder import RunFolder
    from gyrobench.bench.verification.compensation_verification import IN_WORDS

    campaign, folder = RunFolder(start.runs[0]), start.folder / "verification"
    runs = verification_runs(campaign, investigation.closure, procedure, start.job, folder)
    description = " and ".join(IN_WORDS[name] for name in runs.selected)
    hours = sum(runs.jobs[name].plan.duration_s for name in runs.selected) / 3600.0
    consent.terminal.print(f"Verification in {hours:.1f} h, {description}.")
    missing = [name for name in runs.selected if not runs.is_finished(name)]
    return measure_verification(runs, observe) if not missing or consent.is_given() else None


def _report(
    terminal: RunConsole,
    investigation: Investigation,
    folder: Path,
    sources: Sequence[str],
    verification_result: VerificationResult | None,
    as_json: bool,
) -> None:
    from gyrobench.bench.report.closure_page import write_search
    from gyrobench.bench.report.investigation_page import closing_sentences, write_investigation_page
    from gyrobench.bench.report.verification_page import write_verification_page
    from gyrobench.bench.report.verification_text import outcome_sentence
    from gyrobench.bench.verification.compensation_verification import COMPARISON_TABLE, table_rows

    write_search(investigation.closure, [folder / "dwells.csv"], folder / "closure")
    page = write_investigation_page(folder, investigation, ", ".join(sources), verification_result)
    if verification_result is not None:
        COMPARISON_TABLE.write(
            folder / "verification" / "comparison.csv", table_rows(verification_result.results)
        )
        write_verification_page(folder / "verification", verification_result, folder / "dwells.csv")
    if as_json:
        print_json(
            {
                "ended": investigation.ended,
                "reason": investigation.reason,
                "folder": folder,
                "report": page,
                "hours": investigation.spent_h,
                "blocks": len(investigation.stages) - 1,
                "verdict": investigation.closure.verdict,
                "effects": investigation.closure.posterior.effect_probabilities,
                "uncertainty_ratio": investigation.calibration.ratio if investigation.calibration else None,
                "verification": COMPARISON_TABLE.records(table_rows(verification_result.results))
                if verification_result
                else None,
            }
        )
    else:
        for sentence in closing_sentences(investigation):
            terminal.print(sentence)
        if verification_result is not None:
            terminal.print(outcome_sentence(verification_result))
        terminal.print(
            f"Report   {page}\nTable    {folder / 'dwells.csv'}\nFolder   {folder}", soft_wrap=True
        )
    if not investigation.is_conclusive:
        raise typer.Exit(EXIT_NOT_FINISHED)
