"""A search for effects in a terminal of 80 columns, readable without colour."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.text import Text

from gyrobench.bench.closure.loop import Closure
from gyrobench.bench.foundations.arrays import rms_of_known
from gyrobench.bench.report.closure.closure_tables import (
    COMPOSED,
    composed_table,
    effect_table,
    evidence_caption,
    evidence_table,
    rotation_table,
)
from gyrobench.bench.report.closure.closure_text import (
    chain,
    held_out_cycles,
    noise_dph,
    scale_of_errors,
    verdict_sentence,
)
from gyrobench.bench.report.terminal.tables import plain_table, topics


def closure_summary(closure: Closure) -> RenderableType:
    """Verdict, chain of evidence, effects, candidates, and the error before and after."""
    # Titles are not the tables' own: rich folds those to the width of the table.
    parts: list[RenderableType] = [
        Text(f"{closure.verdict.capitalize()}. {verdict_sentence(closure)}", style="bold"),
        Text(),
        topics(chain(closure)),
        Text(),
    ]
    if closure.effects:
        title = f"Effects found, size rms in {scale_of_errors(closure).unit}"
        headers, rows = effect_table(closure)
        parts += [Text(title, style="bold"), plain_table(headers, 4, rows), Text()]
    if closure.composed:
        headers, rows = composed_table(closure)
        parts += [Text("Composed laws (empirical)", style="bold"), plain_table(headers, 3, rows)]
        parts += [Text(COMPOSED), Text()]
    headers, rows = evidence_table(closure)
    parts += [Text("Candidate effects", style="bold"), plain_table(headers, 2, rows)]
    parts += [Text(f"{evidence_caption(closure)}."), Text()]
    if not closure.searched.all():
        title = f"Error in {held_out_cycles(closure)} (held out), rms in {scale_of_errors(closure).unit}"
        errors = _errors(closure)
        table = plain_table(list(errors), 0, [list(errors.values())])
        parts += [Text(title, style="bold"), table, Text()]
    if closure.rotation:
        title = f"Each cycle held out in turn, rms in {scale_of_errors(closure).unit}"
        headers, rows = rotation_table(closure)
        parts += [Text(title, style="bold"), plain_table(headers, 3, rows), Text()]
    return Group(*parts)


def _errors(closure: Closure) -> dict[str, str]:
    scale = scale_of_errors(closure)
    before = scale.with_sigma(closure.error_before_dph, closure.error_before_sigma_dph)
    after = scale.with_sigma(closure.error_after_dph, closure.error_after_sigma_dph)
    errors = {"before": before, "after": after} if closure.effects else {"error": before}
    return errors | {"noise": scale.text(rms_of_known(noise_dph(closure)[~closure.searched]))}
