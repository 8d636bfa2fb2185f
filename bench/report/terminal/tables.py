"""Tables for a terminal of 80 columns: sections of pages, plan, preflight check."""

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

from gyrobench.bench.foundations.text import hours_minutes, with_micro_sign
from gyrobench.bench.report.page import Mark, Section, SectionTable
from gyrobench.bench.station.check_result import Check, CheckVerdict

if TYPE_CHECKING:
    from gyrobench.bench.procedure.timeline import TimelineRow


def plain_table(
    headers: Sequence[str],
    text_columns: int,
    rows: Iterable[Sequence[str]] = (),
    *,
    fold: bool = True,
    gap: int = 1,
) -> Table:
    """Table whose first ``text_columns`` columns are left-aligned texts, the others right-aligned numbers."""
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, gap, 0, 0))
    for index, header in enumerate(headers):
        justify: JustifyMethod = "left" if index < text_columns else "right"
        table.add_column(header, justify=justify, no_wrap=not fold, overflow="fold")
    for row in rows:
        table.add_row(*map(_text, row))
    return table


def _text(text: str, style: str = "") -> Text:
    return Text(with_micro_sign(text), style=style)


def topics(pairs: Iterable[tuple[str, str]]) -> Table:
    """Table of two columns: topics and sentences."""
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True, style="bold")
    table.add_column()
    for topic, sentence in pairs:
        table.add_row(Text(topic), _text(sentence))
    return table


_COLUMNS = 80
#: Separators before an uncertainty and numbers of spaces between columns, in order of preference.
_SEPARATORS = ((" ± ", 2), (" ± ", 1), ("±", 1), ("\n±", 1))
#: Text columns may be wrapped to this width, in characters.
_MIN_TEXT_WIDTH = 24
_MARK_STYLES: Mapping[Mark, str] = MappingProxyType({"bad": "red", "doubtful": "yellow", "sum": "bold"})


def section_view(section: Section) -> RenderableType:
    """Title, statements, sentences, facts and tables of a section, without its figures.

    The title of a section that contains only figures is also omitted.
    """
    return Group(*_renderables(section))


def _renderables(section: Section) -> list[RenderableType]:
    parts: list[RenderableType] = []
    for each in section.boxes:
        parts += [_text(f"{each.headline} {each.text}".strip(), style="bold"), *map(_text, each.notes)]
    parts += [*map(_text, section.paragraphs), *(Text(f"- {item}") for item in section.items)]
    parts += [topics(section.facts.items())] if section.facts else []
    for table in section.tables:
        parts += [Text()] if parts else []
        parts += [_text(table.caption, style="italic")] if table.caption else []
        parts.append(_FittedTable(table))
    for part in section.sections:
        nested = _renderables(part)
        parts += [*([Text()] if parts and nested else []), *nested]
    return [Text(section.title, style="bold"), *parts] if parts and section.title else parts


class _FittedTable:
    """Table of a section that adapts to the width of the terminal."""

    def __init__(self, content: SectionTable) -> None:
        self._content = content

    def __rich_console__(self, _: Console, options: ConsoleOptions) -> RenderResult:
        yield _table_view(self._content, min(_COLUMNS, options.max_width))


def _table_view(content: SectionTable, columns: int) -> Table:
    """Table of a section; uncertainties are below their values if the rows are too wide.

    If that is still wider than ``columns`` characters, numbers are wrapped, so that no column is lost.
    """
    header, column_count = content.header, len(content.header)
    rows = [[*row, *[""] * (column_count - len(row))] for row in content.rows]
    for separator, gap in _SEPARATORS:
        widths = []
        for index, column in enumerate(zip(header, *rows, strict=True)):
            lines = [line for each in column[1:] for line in each.replace(" ± ", separator).split("\n")]
            if index < content.words:
                lines = [
                    part for line in lines for part in wrap(line, _MIN_TEXT_WIDTH, break_long_words=False)
                ]
            widths.append(max(map(len, [*lines, *header[index].split(), ""])))
        if (spare_width := columns - sum(widths) - gap * column_count) >= 0:
            break
    natural_widths = [max(width, len(each)) for width, each in zip(widths, header, strict=True)]
    table = plain_table(header, content.words, gap=gap - 1)
    for index in range(content.words, column_count if spare_width >= 0 else 0):
        table.columns[index].width = (
            natural_widths if sum(natural_widths) - sum(widths) <= spare_width else widths
        )[index]
    has_groups = any(not row[0] for row in rows)
    for index, row in enumerate(rows):
        ends_group = has_groups and all(next_row[0] for next_row in rows[index + 1 : index + 2])
        style = _MARK_STYLES.get(content.marks[index]) if content.marks else None
        table.add_row(*(_cell(each, separator) for each in row), style=style, end_section=ends_group)
    return table


def _cell(text: str, separator: str) -> Text:
    lines = with_micro_sign(text).split("\n")
    # In a row whose values take two lines each, other texts with several lines are spaced accordingly.
    if len(lines) > 1 and "\n" in separator and " ± " not in text:
        lines = [f"{line}\n" for line in lines]
    first, *other_lines = (line.replace(" ± ", separator) for line in lines)
    return Text.assemble(first, *((f"\n{line}", "dim") for line in other_lines))


def timeline_table(rows: Sequence[TimelineRow], total_s: float) -> Table:
    """Table of the steps of a plan, with start and duration."""
    dwells = sum(row.dwells for row in rows)
    table = titled_table("Plan, times in h:mm", show_footer=True)
    table.add_column("start", footer="all", justify="right", no_wrap=True)
    table.add_column("duration", footer=hours_minutes(total_s), justify="right", no_wrap=True)
    table.add_column("dwells", footer=str(dwells), justify="right", no_wrap=True)
    table.add_column("where", ratio=2)
    table.add_column("what", ratio=3)
    for row in rows:
        times = hours_minutes(row.start_s), hours_minutes(row.duration_s)
        table.add_row(*times, str(row.dwells or ""), Text(row.positions_text), Text(row.steps_text))
    return table


def titled_table(
    title: str | None = None,
    headers: Sequence[str] = (),
    wrapped: Sequence[str] = (),
    *,
    show_footer: bool = False,
) -> Table:
    """Table without space between its columns; columns with a header in ``wrapped`` may be wrapped."""
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
        is_wrapped = header in wrapped
        table.add_column(header, justify="left" if is_wrapped else "right", no_wrap=not is_wrapped)
    return table


_VERDICT_STYLES = {CheckVerdict.PASS: "green", CheckVerdict.FAIL: "bold red", CheckVerdict.SKIPPED: "yellow"}


def preflight_report(checks: Sequence[Check]) -> RenderableType:
    """All checks with verdict, finding and advice, followed by a summary."""
    parts: list[RenderableType] = []
    for subject, group in itertools.groupby(checks, key=lambda check: check.subject):
        table = Table.grid(padding=(0, 1, 0, 0))
        table.add_column(width=9)
        table.add_column(width=19)
        table.add_column(overflow="fold")
        for check in group:
            finding = Text(check.found)
            if check.advice:
                finding.append(f"\n{check.advice}", style="italic")
            verdict = Text(f"  {check.verdict}", style=_VERDICT_STYLES[check.verdict])
            table.add_row(verdict, Text(check.what), finding)
        parts += [Text(subject, style="bold"), table]
    counts = Counter(check.verdict for check in checks)
    passed, failed, skipped = (counts[verdict] for verdict in CheckVerdict)
    outcome = "not ready for a run" if failed else f"ready for a run{' as far as checked' if skipped else ''}"
    total = f"{passed} passed, {failed} failed, {skipped} skipped: {outcome}."
    return Group(*parts, Text(), Text(total, style="bold red" if failed else "bold"))
