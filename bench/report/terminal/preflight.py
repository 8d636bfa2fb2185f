"""What a preflight found, in a terminal of 80 columns, readable without colour."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from gyrobench.bench.station.check import Check, Verdict

_STYLES = {Verdict.PASS: "green", Verdict.FAIL: "bold red", Verdict.SKIPPED: "yellow"}


def preflight_report(checks: Sequence[Check]) -> RenderableType:
    """Every check with its verdict, what was found and what to do, and the sum of them."""
    parts: list[RenderableType] = []
    for subject, group in itertools.groupby(checks, key=lambda check: check.subject):
        parts += [Text(subject, style="bold"), _table(list(group))]
    return Group(*parts, Text(), _sum(checks))


def _table(checks: Sequence[Check]) -> Table:
    table = Table.grid(padding=(0, 1, 0, 0))
    table.add_column(width=9)
    table.add_column(width=19)
    table.add_column()
    for check in checks:
        found = Text(check.found)
        if check.advice:
            found.append(f"\n{check.advice}", style="italic")
        table.add_row(Text(f"  {check.verdict}", style=_STYLES[check.verdict]), Text(check.what), found)
    return table


def _sum(checks: Sequence[Check]) -> Text:
    counts = {verdict: sum(check.verdict is verdict for check in checks) for verdict in Verdict}
    numbers = (
        f"{counts[Verdict.PASS]} passed, {counts[Verdict.FAIL]} failed, {counts[Verdict.SKIPPED]} skipped"
    )
    if counts[Verdict.FAIL]:
        return Text(f"{numbers}: not ready for a run.", style="bold red")
    return Text(f"{numbers}: nothing speaks against a run.", style="bold")
