"""`gyrobench check`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from gyrobench.bench.cli.options import (
    EMULATED,
    AcknowledgeOption,
    FaultsOption,
    OperatorOption,
    SeedOption,
    StationArgument,
    WorldOption,
    complete_procedure,
)
from gyrobench.bench.cli.output import EXIT_INSTRUMENT, EXIT_NOT_FINISHED, JsonOption, console, print_json


def check(
    station: StationArgument = EMULATED,
    procedure: Annotated[
        str | None,
        typer.Option(help="Procedure to be run: file or shipped name.", autocompletion=complete_procedure),
    ] = None,
    world: WorldOption = None,
    seed: SeedOption = 0,
    faults: FaultsOption = None,
    out: Annotated[Path, typer.Option(help="Folder for the run folder.")] = Path("runs"),
    signs: Annotated[
        bool, typer.Option(help="Then measure one dwell, to test the signs and axes of the signal map.")
    ] = False,
    acknowledge: AcknowledgeOption = None,
    operator: OperatorOption = "",  # noqa: ARG001 - read from the environment
    as_json: JsonOption = False,
) -> None:
    """Preflight check: is the bench ready? Moves nothing without --signs.

    A unit that is off is switched on during the check. With --signs the table turns: one dwell of half an
    hour at room temperature.

    With --json: {"station", "fit", "checks": [{"subject", "what", "verdict", "found", "advice"}]}; a
    verdict is pass, fail or skipped.

    Exit codes: 0 ready, 1 not ready, 3 no instrument replies or a run uses the bench.

    Example: gyrobench check my_bench.yaml --procedure six_position_fig7
    """
    from gyrobench.bench.engine.job import prepare_job
    from gyrobench.bench.engine.preflight.bench_check import (
        SIGNAL_MAP_CHECK,
        check_bench,
        no_instrument_answers,
        signal_map_checks,
    )
    from gyrobench.bench.engine.run import run_job
    from gyrobench.bench.monitor.terminal_view import observe_in_terminal
    from gyrobench.bench.report.terminal.tables import preflight_report
    from gyrobench.bench.runs.folder import create_run_folder
    from gyrobench.bench.station.check_result import Check, CheckVerdict
    from gyrobench.bench.station.instruments import Emulation

    terminal, emulation = console(as_json, of_run=True), Emulation.of(station, world, seed, faults)

    def is_fit() -> bool:
        return all(each.verdict is not CheckVerdict.FAIL for each in checks)

    checks = check_bench(station, procedure, emulation, out, acknowledged=acknowledge or ())
    if signs and is_fit():
        job = prepare_job(SIGNAL_MAP_CHECK, station, emulation, acknowledged=acknowledge or ())
        folder = create_run_folder(None, SIGNAL_MAP_CHECK, out)
        with observe_in_terminal(terminal, job, False) as (progress, answers):
            _, outcome = run_job(job, folder.path, progress, answers)
        checks.extend(signal_map_checks(outcome, folder))
    elif signs:
        advice = "Correct what failed, then repeat."
        checks.append(Check.skipped("INS", "signs and axes", "not measured: another check failed", advice))
    if as_json:
        records = [{**asdict(each), "verdict": each.verdict.lower()} for each in checks]
        print_json({"station": station, "fit": is_fit(), "checks": records})
    else:
        terminal.print(preflight_report(checks))
    if no_instrument_answers(checks):
        raise typer.Exit(EXIT_INSTRUMENT)
    if not is_fit():
        raise typer.Exit(EXIT_NOT_FINISHED)
