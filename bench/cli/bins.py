"""`gyrobench bins`."""

from __future__ import annotations

from gyrobench.bench.cli.options import RunArgument
from gyrobench.bench.cli.output import JsonOption, console, print_json, print_tables


def bins(run_folder: RunArgument, as_json: JsonOption = False) -> None:
    """Recompute the tables of a run from its raw CAN log.

    With --json: {"folder", "report", "bins", "budget", "verification", "acceptance"}; bins and verification
    are lists with the columns of their tables as keys, and by_power_cycle of each bin has the means of power
    cycles that measured other positions too; acceptance is what acceptance.json holds. The budget has an
    object for each dwell and bin, with its sum and its contributions by name.

    Example: gyrobench bins runs/six_position_fig7-001
    """
    from gyrobench.bench.bias.bins import BIAS_BINS_TABLE, with_power_cycles
    from gyrobench.bench.bias.dwell_table import read_dwells
    from gyrobench.bench.bias.verdicts import read_acceptance
    from gyrobench.bench.dwells.run_results import recompute_run
    from gyrobench.bench.foundations.clock import WallClock
    from gyrobench.bench.report.run_report import write_report
    from gyrobench.bench.runs.folder import open_run_folder
    from gyrobench.bench.runs.locks import RunLock
    from gyrobench.bench.runs.tables.budget_table import BUDGET_TABLE, budget_records
    from gyrobench.bench.runs.tables.calibration_check_table import CALIBRATION_CHECK_TABLE

    # A run in progress writes the same files.
    with RunLock(open_run_folder(run_folder).run.path, WallClock()):
        folder = recompute_run(run_folder, is_sealed=False)
        report = write_report(folder, are_tables_new=True).path
    if as_json:
        check = folder.calibration_check
        print_json(
            {
                "folder": folder.path,
                "report": report,
                "bins": with_power_cycles(BIAS_BINS_TABLE.read(folder.bias_bins), read_dwells(folder.dwells)),
                "budget": budget_records(
                    BUDGET_TABLE.iterate(folder.budget) if folder.budget.exists() else []
                ),
                "verification": CALIBRATION_CHECK_TABLE.read(check) if check.exists() else [],
                "acceptance": read_acceptance(folder.acceptance),
            }
        )
        return
    terminal = console()
    print_tables(terminal, folder)
    terminal.print(f"Tables   {', '.join(path.name for path in folder.tables)}")
    terminal.print(f"Report   {report}\nFolder   {folder.path}", soft_wrap=True)
