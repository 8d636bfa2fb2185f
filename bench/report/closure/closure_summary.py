"""A search for effects in a terminal of 80 columns, readable without colour."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from gyrobench.bench.closure.loop import Closure
from gyrobench.bench.report.closure.closure_text import (
    chain,
    effect_table,
    evidence_caption,
    evidence_table,
    held_out_cycles,
    noise_dph,
    rms,
    scale_of_errors,
    verdict_sentence,
)
from gyrobench.bench.report.terminal.tables import plain_table, topics


def closure_summary(closure: Closure) -> RenderableType:
    """Verdict, chain of evidence, effects, candidates, and the error before and after."""
    parts: list[RenderableType] = [
        Text(f"{closure.verdict.capitalize()}. {verdict_sentence(closure)}", style="bold"),
        Text(),
        topics(chain(closure)),
        Text(),
    ]
    if closure.effects:
        title = f"Effects found, size rms in {scale_of_errors(closure).unit}"
        parts += _titled(title, _table(*effect_table(closure), words=4))
    parts += _titled("Candidate effects", _table(*evidence_table(closure), words=2))[:-1]
    parts += [Text(f"{evidence_caption(closure)}."), Text()]
    title = f"Error in {held_out_cycles(closure)} (held out), rms in {scale_of_errors(closure).unit}"
    errors = _errors(closure)
    parts += _titled(title, _table(list(errors), [list(errors.values())], words=0))
    return Group(*parts)


def _errors(closure: Closure) -> dict[str, str]:
    scale = scale_of_errors(closure)
    before, after = scale.text(closure.error_before_dph), scale.text(closure.error_after_dph)
    errors = {"before": before, "after": after} if closure.effects else {"error": before}
    return errors | {"noise": scale.text(rms(noise_dph(closure)[~closure.searched]))}


def _titled(title: str, table: Table) -> list[RenderableType]:
    # Not the table's own title: rich folds that to the width of the table.
    return [Text(title, style="bold"), table, Text()]


def _table(headers: Sequence[str], rows: Sequence[Sequence[str]], words: int) -> Table:
    table = plain_table(headers, words)
    for row in rows:
        table.add_row(*map(Text, row))
    return table
