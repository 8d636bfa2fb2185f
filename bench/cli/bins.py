"""`gyrobench bins`."""

from __future__ import annotations

from bench.cli.bias_tables import print_biases
from bench.cli.console import console
from bench.cli.json_output import JsonOption, print_json
from bench.cli.options import RunArgument


def bins(run_folder: RunArgument, as_json: JsonOption = False) -> None:
    """Measure a run anew from its raw CAN log and write its tables again.

    With --json: {"folder", "report", "bins", "verification", "acceptance"}; bins and verification are
    lists with the columns of their tables as keys, acceptance is what acceptance.json holds.

    Example: gyrobench bins runs/six_position_fig7-001
    """
    from bench.bias.bins import read_bins
    from bench.bias.tables.acceptance_file import read_acceptance
    from bench.bias.tables.verification_table import read_verification
    from bench.engine.session import measure_again
    from bench.report.html import write_report

    folder = measure_again(run_folder)
    verification = read_verification(folder.verification) if folder.verification.exists() else []
    if as_json:
        print_json(
            {
                "folder": folder.path,
                "report": write_report(folder),
                "bins": read_bins(folder.bias_bins),
                "verification": verification,
                "acceptance": read_acceptance(folder.acceptance),
            }
        )
        return
    terminal = console()
    print_biases(terminal, read_bins(folder.bias_bins), verification, read_acceptance(folder.acceptance))
    results = (
        folder.bias_bins,
        folder.joint,
        folder.joint_biases,
        folder.noise,
        folder.verification,
        folder.acceptance,
    )
    tables = [path.name for path in (folder.dwells, *results) if path.exists()]
    terminal.print(f"Tables   {', '.join(tables)}")
    terminal.print(f"Report   {write_report(folder)}\nFolder   {folder.path}", soft_wrap=True)
