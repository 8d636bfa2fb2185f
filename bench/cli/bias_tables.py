"""The biases of a run, as the terminal shows them."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from bench.bias.bins import BiasBin
    from bench.bias.tables.verification_table import VerificationRow


def print_biases(console: Console, bins: list[BiasBin], verification: list[VerificationRow]) -> None:
    """Print bins with the comparison of positions, or what a verification showed."""
    from bench.bias.equality import compare_positions
    from bench.report.terminal import bins_table
    from bench.report.verification_terminal import verification_table

    if bins or not verification:
        console.print(bins_table(bins, compare_positions(bins)))
    if verification:
        console.print(verification_table(verification))
