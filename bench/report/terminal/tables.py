"""Results for a terminal of 80 columns: sections of pages, plan, preflight check."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from textwrap import wrap
from types import MappingProxyType
from typing import TYPE_CHECKING

from rich import box
from rich.console import Console, ConsoleOptions, Group, JustifyMethod, RenderableType, RenderResult
from rich.table import Table
from rich.text import Text

from gyrobench.bench.foundations.text import hours_minutes
from gyrobench.bench.report.page import Mark, Section, SectionTable
from gyrobench.bench.station.check_result import Check, CheckVerdict

if TYPE_CHECKING:
    from gyrobench.bench.procedure.timeline import TimelineRow


def plain_table(
    headers: Sequence[str], words: int, rows: Iterable[Sequence[str]] = (), *, fold: bool = True, gap: int = 1
) -> Table:
    """Table with columns of words at the left and of numbers after them."""
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, gap, 0, 0))
    for number, header in enumerate(headers):
        justify: JustifyMethod = "left" if number < words else "right"
        table.add_column(header, justify=justify, no_wrap=not fold, overflow="fold")
    for row in rows:
        table.add_row(*map(Text, row))
    return table


def topics(pairs: Iterable[tuple[str, str]]) -> Table:
    """Two columns: topics and sentences."""
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True, style="bold")
    table.add_column()
    for topic, sentence in pairs:
        table.add_row(Text(topic), Text(sentence))
    return table


_COLUMNS = 80
#: Signs before an uncertainty and spaces between columns, in order of preference.
_SEPARATORS = ((" ± ", 2), (" ± ", 1), ("±", 1), ("\n±", 1))
#: Columns of words may be wrapped down to this width, in characters.
_WORDS_WIDTH = 24
_MARKS: Mapping[Mark, str] = MappingProxyType({"bad": "red", "doubtful": "yellow", "sum": "bold"})


def section_view(section: Section) -> RenderableType:
    """Title, statements, sentences, facts and tables of a section; figures are left out.

    Sections that hold figures alone have no title either.
    """
    return Group(*_parts(section))


def _parts(section: Section) -> list[RenderableType]:
    parts: list[RenderableType] = []
    for each in section.boxes:
        parts += [Text(f"{each.gist} {each.text}".strip(), style="bold"), *map(Text, each.notes)]
    parts += [*map(Text, section.paragraphs), *(Text(f"- {item}") for item in section.items)]
    parts += [topics(section.facts.items())] if section.facts else []
    for table in section.tables:
        parts += [Text()] if parts else []
        parts += [Text(table.caption, style="italic")] if table.caption else []
        parts.append(_FittedTable(table))
    for part in section.sections:
        inner = _parts(part)
        parts += [*([Text()] if parts and inner else []), *inner]
    return [Text(section.title, style="bold"), *parts] if parts and section.title else parts


class _FittedTable:
    """Table of a section that fits the terminal it is printed on."""

    def __init__(self, content: SectionTable) -> None:
        self._content = content

    def __rich_console__(self, _: Console, options: ConsoleOptions) -> RenderResult:
        yield _table_view(self._content, min(_COLUMNS, options.max_width))


def _table_view(content: SectionTable, columns: int) -> Table:
    """Table of a section; uncertainties stand below their values if the rows are too wide.

    Where even that is too wide for ``columns``, numbers are wrapped, so that no column is lost.
    """
    head, count = content.header, len(content.header)
    rows = [[*row, *[""] * (count - len(row))] for row in content.rows]
    for between, gap in _SEPARATORS:
        widths = []
        for number, column in enumerate(zip(head, *rows, strict=True)):
            lines = [line for each in column[1:] for line in each.replace(" ± ", between).split("\n")]
            if number < content.words:
                lines = [part for line in lines for part in wrap(line, _WORDS_WIDTH, break_long_words=False)]
            widths.append(max(map(len, [*lines, *head[number].split(), ""])))
        if (spare := columns - sum(widths) - gap * count) >= 0:
            break
    natural = [max(width, len(each)) for width, each in zip(widths, head, strict=True)]
    table = plain_table(head, content.words, gap=gap - 1)
    for number in range(content.words, count if spare >= 0 else 0):
        table.columns[number].width = (natural if sum(natural) - sum(widths) <= spare else widths)[number]
    has_groups = any(not row[0] for row in rows)
    for number, row in enumerate(rows):
        ends = has_groups and all(after[0] for after in rows[number + 1 : number + 2])
        style = _MARKS.get(content.marks[number]) if content.marks else None
        table.add_row(*(_cell(each, between) for each in row), style=style, end_section=ends)
    return table


def _cell(text: str, between: str) -> Text:
    lines = text.split("\n")
    if len(lines) > 1 and "\n" in between and " ± " not in text:  # beside values that take two lines each
        lines = [f"{line}\n" for line in lines]
    first, *below = (line.replace(" ± ", between) for line in lines)
    return Text.assemble(first, *((f"\n{line}", "dim") for line in below))


def timeline_table(rows: Sequence[TimelineRow], total_s: float) -> Table:
    """Steps of a plan, their start and duration."""
    dwells = sum(row.dwells for row in rows)
    table = titled_table("Plan, times in h:mm", show_footer=True)
    table.add_column("start", footer="all", justify="right", no_wrap=True)
    table.add_column("duration", footer=hours_minutes(total_s), justify="right", no_wrap=True)
    table.add_column("dwells", footer=str(dwells), justify="right", no_wrap=True)
    table.add_column("where", ratio=2)
    table.add_column("what", ratio=3)
    for row in rows:
        table.add_row(
            row.start, row.duration, str(row.dwells or ""), Text(row.positions_text), Text(row.steps_text)
        )
    return table


def titled_table(
    title: str | None = None,
    headers: Sequence[str] = (),
    words: Sequence[str] = (),
    *,
    show_footer: bool = False,
) -> Table:
    """Table without room between its columns; ``words`` are the headers of those that may be wrapped."""
    table = Table(
        title=title,
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
        padding=0,
        show_footer=show_footer,
    )
    for header in headers:
        is_word = header in words
        table.add_column(header, justify="left" if is_word else "right", no_wrap=not is_word)
    return table


_STYLES = {CheckVerdict.PASS: "green", CheckVerdict.FAIL: "bold red", CheckVerdict.SKIPPED: "yellow"}


def preflight_report(checks: Sequence[Check]) -> RenderableType:
    """Every check with verdict, finding and advice, and a summary."""
    parts: list[RenderableType] = []
    for subject, group in itertools.groupby(checks, key=lambda check: check.subject):
        parts += [Text(subject, style="bold"), _check_table(list(group))]
    return Group(*parts, Text(), _sum(checks))


def _check_table(checks: Sequence[Check]) -> Table:
    table = Table.grid(padding=(0, 1, 0, 0))
    table.add_column(width=9)
    table.add_column(width=19)
    table.add_column(overflow="fold")
    for check in checks:
        found = Text(check.found)
        if check.advice:
            found.append(f"\n{check.advice}", style="italic")
        table.add_row(Text(f"  {check.verdict}", style=_STYLES[check.verdict]), Text(check.what), found)
    return table


def _sum(checks: Sequence[Check]) -> Text:
    counts = Counter(check.verdict for check in checks)
    passed, failed, skipped = (counts[verdict] for verdict in CheckVerdict)
    numbers = f"{passed} passed, {failed} failed, {skipped} skipped"
    if failed:
        return Text(f"{numbers}: not ready for a run.", style="bold red")
    return Text(f"{numbers}: ready for a run{' as far as checked' if skipped else ''}.", style="bold")
