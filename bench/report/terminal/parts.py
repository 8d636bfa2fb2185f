"""Tables of words and numbers for a terminal of 80 columns."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rich import box
from rich.table import Table
from rich.text import Text


def plain_table(headers: Sequence[str], words: int, *, fold: bool = True) -> Table:
    """Make an empty table: columns of words at the left, those of numbers after them."""
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
    for number, header in enumerate(headers):
        table.add_column(header, justify="left" if number < words else "right", no_wrap=not fold)
    return table


def topics(pairs: Iterable[tuple[str, str]]) -> Table:
    """Put sentences beside what they are about."""
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True, style="bold")
    table.add_column()
    for topic, sentence in pairs:
        table.add_row(Text(topic), Text(sentence))
    return table
