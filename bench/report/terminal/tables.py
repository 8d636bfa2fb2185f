"""Tables for a terminal of 80 columns: biases, plan, durations, acceptance, preflight."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Sequence

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from gyrobench.bench.bias.bins import BiasBin, PositionComparison, compare_positions, paper_bins
from gyrobench.bench.bias.verdicts import Acceptance
from gyrobench.bench.foundations.text import bin_label, hours_minutes
from gyrobench.bench.navigation.positions import AXES, POSITIONS, gyro_label, position_label
from gyrobench.bench.procedure.timeline import TimelineRow
from gyrobench.bench.report.journal_sections import Took, durations_by_kind
from gyrobench.bench.report.number_format import (
    NO_PAPER,
    BiasScale,
    bins_by_temperature,
    p_text,
    scale_of_bins,
)
from gyrobench.bench.report.statements import (
    NOTHING_TO_COMPARE,
    agreement_sentence,
    differing,
    equality_sentence,
    place_of,
    scatter_sentence,
    verdict_sentence,
)
from gyrobench.bench.station.preflight_check import Check, Verdict


def plain_table(
    headers: Sequence[str], words: int, rows: Iterable[Sequence[str]] = (), *, fold: bool = True, gap: int = 1
) -> Table:
    """Table with columns of words at the left and of numbers after them."""
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, gap, 0, 0))
    for number, header in enumerate(headers):
        table.add_column(header, justify="left" if number < words else "right", no_wrap=not fold)
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
_P_VALUE = (
    "p equal: probability of differences this large if the bias were the same in all positions; "
    "* significant."
)
_PAPER = "paper"
_PAPER_METHOD = (
    f"{_PAPER}: result of the paper's method, which neglects the Schuler loop, the coupling by the Earth's "
    "rotation and the accelerometers; its uncertainty does not include the resulting errors."
)


def bins_table(bins: Sequence[BiasBin], comparisons: Sequence[PositionComparison]) -> RenderableType:
    """Each gyro's bias by temperature bin and position, and the comparison of positions, of one unit.

    Results of the paper's method are in a second row; a note gives the reason if it does not apply.
    """
    parts: list[RenderableType] = []
    paper_comparisons = compare_positions(paper_bins(bins))
    for gyro in AXES:
        own = [each for each in bins if each.gyro == gyro]
        if own:
            compared = [each for each in comparisons if each.gyro == gyro]
            by_paper = [each for each in paper_comparisons if each.gyro == gyro]
            parts += _gyro_part(gyro, own, compared, by_paper, is_compared=bool(comparisons))
    if not parts:
        return Text("No dwell gave a bias, so there are no temperature bins.")
    has_paper = any(not each.is_empty for each in paper_bins(bins))
    notes = [_P_VALUE if comparisons else NOTHING_TO_COMPARE, _PAPER_METHOD if has_paper else NO_PAPER]
    return Group(*parts, *map(Text, notes))


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
        table.add_row(row.start, row.duration, str(row.dwells or ""), Text(row.where), Text(row.what))
    return table


def durations_table(took: Took) -> RenderableType:
    """Planned and actual duration by kind of step."""
    kinds = durations_by_kind(took)
    if not kinds:
        return Text("No step was finished.")
    table = titled_table("Planned and actual duration, h:mm:ss")
    table.add_column("kind of step")
    for header in ("steps", "planned", "actual", "difference"):
        table.add_column(header, justify="right", no_wrap=True)
    for each in kinds:
        table.add_row(*each.cells)
    return table


def _gyro_part(
    gyro: str,
    bins: Sequence[BiasBin],
    comparisons: Sequence[PositionComparison],
    paper_comparisons: Sequence[PositionComparison],
    *,
    is_compared: bool,
) -> list[RenderableType]:
    scale = scale_of_bins([*bins, *paper_bins(bins)])
    # Not the table's title: rich wraps titles at the width of the table.
    heading = Text(
        f"{gyro_label(gyro)}: bias ± 1 sigma in {scale.unit} by gyro temperature, °C", style="bold"
    )
    sentences = [
        equality_sentence(comparisons) if is_compared else "",
        agreement_sentence(comparisons, paper_comparisons),
        scatter_sentence(bins),
    ]
    table = _gyro_table(bins, scale, _p_values(comparisons), _p_values(paper_comparisons))
    return [heading, table, *(Text(one) for one in sentences if one), Text()]


def _gyro_table(
    bins: Sequence[BiasBin], scale: BiasScale, p_values: dict[float, str], paper_p_values: dict[float, str]
) -> Table:
    measured = {each.position for each in bins}
    positions = [name for name in POSITIONS if name in measured]
    rows = []
    for low, high, members in bins_by_temperature(bins):
        cells = _bias_cells(members, positions, scale)
        rows.append([bin_label(low, high, ".."), *cells, p_values.get(low, "")])
        by_paper = paper_bins(members)
        if not all(each.is_empty for each in by_paper):
            rows.append([_PAPER, *_bias_cells(by_paper, positions, scale), paper_p_values.get(low, "")])
    headers = ["bin", *map(position_label, positions), "p equal"]
    if p_values:
        return _filled_table(headers, rows)
    return _filled_table(headers[:-1], [row[:-1] for row in rows])


def _bias_cells(bins: Iterable[BiasBin], positions: Iterable[str], scale: BiasScale) -> list[str]:
    texts = {
        each.position: scale.with_sigma(each.bias_dph, each.sigma_dph, "±")
        for each in bins
        if not each.is_empty
    }
    return [texts.get(position, "empty") for position in positions]


def _filled_table(headers: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """Table with uncertainties below their biases if the rows are wider than the terminal."""
    table = titled_table()
    for header in headers:
        table.add_column(header, justify="right", no_wrap=header in ("bin", "p equal"))
    between = "±" if _width(headers, rows) <= _COLUMNS else "\n±"
    for row in rows:
        style = "dim" if row[0] == _PAPER else None
        table.add_row(*(Text(cell.replace("±", between)) for cell in row), style=style)
    return table


def _p_values(comparisons: Sequence[PositionComparison]) -> dict[float, str]:
    """P-values by the lower end of their bin; a star marks a significant difference."""
    different = differing(comparisons)
    return {
        each.bin_low_c: f"{p_text(each.p_value)}{'*' if each in different else ' '}" for each in comparisons
    }


def _width(headers: Sequence[str], rows: Sequence[Sequence[str]]) -> int:
    """Width of a table with one space between its cells."""
    widths = [max(map(len, column)) for column in zip(headers, *rows, strict=True)]
    return sum(widths) + len(widths) - 1


def titled_table(title: str | None = None, *, show_footer: bool = False) -> Table:
    """Table without room between its columns."""
    return Table(
        title=title,
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
        padding=0,
        show_footer=show_footer,
    )


def acceptance_summary(acceptance: Acceptance) -> RenderableType:
    """A row for each gyro, and the verdict on the unit."""
    verdict = Text(f"Unit {acceptance.verdict}. {verdict_sentence(acceptance)}", style="bold")
    judged = acceptance.judgements
    if not judged:
        return verdict
    scale = BiasScale.of([each.limit_dph for each in judged], [each.sigma_dph for each in judged])
    heading = f"Acceptance: largest differences in {scale.unit}, with confidence interval"
    headers = ["gyro", "verdict", "positions", "bin/°C", "measured", "interval", "limit"]
    table = plain_table(headers, words=4, fold=False)
    for gyro in AXES:
        deciding = acceptance.deciding(gyro)
        cells = ["", "", "", "", ""]
        if deciding is not None:
            cells = [
                place_of(deciding).replace(" above ", " - "),
                bin_label(deciding.bin_low_c, deciding.bin_high_c, ".."),
                scale.text(deciding.value_dph),
                f"{scale.text(deciding.at_least_dph)}..{scale.text(deciding.at_most_dph)}",
                scale.text(deciding.limit_dph),
            ]
        table.add_row(gyro_label(gyro), acceptance.gyros.get(gyro, ""), *map(Text, cells))
    return Group(Text(heading, style="bold"), table, verdict)


_STYLES = {Verdict.PASS: "green", Verdict.FAIL: "bold red", Verdict.SKIPPED: "yellow"}


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
    table.add_column()
    for check in checks:
        found = Text(check.found)
        if check.advice:
            found.append(f"\n{check.advice}", style="italic")
        table.add_row(Text(f"  {check.verdict}", style=_STYLES[check.verdict]), Text(check.what), found)
    return table


def _sum(checks: Sequence[Check]) -> Text:
    counts = Counter(check.verdict for check in checks)
    numbers = (
        f"{counts[Verdict.PASS]} passed, {counts[Verdict.FAIL]} failed, {counts[Verdict.SKIPPED]} skipped"
    )
    if counts[Verdict.FAIL]:
        return Text(f"{numbers}: not ready for a run.", style="bold red")
    return Text(
        f"{numbers}: ready for a run{' as far as checked' if counts[Verdict.SKIPPED] else ''}.", style="bold"
    )
