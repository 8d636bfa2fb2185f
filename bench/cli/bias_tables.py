"""The biases of a run, as the terminal shows them."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from gyrobench.bench.bias.bins import BiasBin
    from gyrobench.bench.bias.verdicts import Acceptance
    from gyrobench.bench.runs.tables.verification_table import VerificationRow


def print_biases(
    console: Console, bins: list[BiasBin], verification: list[VerificationRow], acceptance: Acceptance
) -> None:
    """Print bins with the comparison of positions, or what a verification showed; and the verdict."""
    from gyrobench.bench.bias.equality import compare_positions
    from gyrobench.bench.report.calibration_check.terminal import verification_table
    from gyrobench.bench.report.terminal.acceptance import acceptance_summary
    from gyrobench.bench.report.terminal.tables import bins_table

    if bins or not verification:
        console.print(bins_table(bins, compare_positions(bins)))
    if verification:
        console.print(verification_table(verification))
    console.print(acceptance_summary(acceptance))
