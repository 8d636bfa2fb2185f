"""The proof of a compensation in a terminal of 80 columns, readable without colour."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from gyrobench.bench.closure.loadable_model import LoadableModel
from gyrobench.bench.closure.loop import Closure
from gyrobench.bench.foundations.text import counted, listed
from gyrobench.bench.procedure.timeline import hours_minutes
from gyrobench.bench.report.closure.wording import verdict_sentence
from gyrobench.bench.report.terminal.tables import plain_table, topics
from gyrobench.bench.report.verification.rows import SIZES, UNITS, stop_rows, total_rows
from gyrobench.bench.report.verification.wording import (
    LABELS,
    chain,
    model_sentences,
    outcome,
    outcome_sentence,
    reading_sentences,
)
from gyrobench.bench.verification.comparison import Comparison


def verify_plan(
    closure: Closure, models: Mapping[str, LoadableModel], missing: Sequence[str], run_s: float
) -> RenderableType:
    """Verdict of the search, what is to be loaded, and how long the runs take that are missing."""
    sentences = model_sentences(closure, models)
    if missing:
        runs = listed([LABELS[name] for name in missing])
        total = hours_minutes(len(missing) * run_s)
        sentences.append(
            f"{counted(len(missing), 'run')} of {hours_minutes(run_s)} h to come, {total} h in all: {runs}."
        )
    else:
        sentences.append("All runs are there already.")
    verdict = Text(f"{closure.verdict.capitalize()}. {verdict_sentence(closure)}", style="bold")
    return Group(verdict, *map(Text, sentences), Text())


def verify_summary(comparison: Comparison) -> RenderableType:
    """Judgement, what changed, and the numbers of all stops."""
    return Group(
        Text(f"{outcome(comparison).capitalize()}. {outcome_sentence(comparison)}", style="bold"),
        Text(),
        topics(chain(comparison)),
        Text(),
        Text("All stops: rms over all dwells; of spread, V_E and 24 h the largest", style="bold"),
        _table(["compensation", *SIZES], total_rows(comparison), words=1),
        Text(),
        Text("By gyro temperature, °C", style="bold"),
        _table(["°C", "cycle", "fit", "compensation", *SIZES], stop_rows(comparison), words=4),
        Text(f"{UNITS[0].upper()}{UNITS[1:]}."),
        Text(" ".join(reading_sentences(comparison))),
        Text(),
    )


def _table(headers: Sequence[str], rows: Sequence[Sequence[str]], words: int) -> Table:
    table = plain_table(headers, words, fold=False)
    for row in rows:
        table.add_row(*map(Text, row), end_section=row[words - 1] not in LABELS.values())
    return table
