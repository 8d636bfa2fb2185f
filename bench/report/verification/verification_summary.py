"""A verification in a terminal of 80 columns, readable without colour."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from gyrobench.bench.closure.loadable_model import LoadableModel
from gyrobench.bench.closure.loop import Closure
from gyrobench.bench.foundations.text import counted, hours_minutes, listed
from gyrobench.bench.report.closure.closure_text import verdict_sentence
from gyrobench.bench.report.terminal.tables import plain_table, topics
from gyrobench.bench.report.verification.coefficient_sections import (
    coefficient_table,
    mission_sentence,
    mission_table,
)
from gyrobench.bench.report.verification.verification_text import (
    LABELS,
    SIZES,
    UNITS,
    chain,
    model_sentences,
    outcome,
    outcome_sentence,
    plateau_rows,
    reading_sentences,
    total_rows,
)
from gyrobench.bench.verification.compensation_verification import VerificationResult


def verification_plan(
    closure: Closure, models: Mapping[str, LoadableModel], missing: Sequence[str], run_s: float
) -> RenderableType:
    """Verdict of the search, compensations, and duration of the remaining runs."""
    sentences = model_sentences(closure, models)
    if missing:
        runs = listed([LABELS[name] for name in missing])
        total = hours_minutes(len(missing) * run_s)
        sentences.append(
            f"{counted(len(missing), 'run')} of {hours_minutes(run_s)} h remaining, {total} h in total: "
            f"{runs}."
        )
    else:
        sentences.append("All runs are complete.")
    verdict = Text(f"{closure.verdict.capitalize()}. {verdict_sentence(closure)}", style="bold")
    return Group(verdict, *map(Text, sentences), Text())


def verification_summary(result: VerificationResult) -> RenderableType:
    """Judgement, changes, and the numbers of all plateaus."""
    coefficients: list[RenderableType] = []
    if result.coefficients:
        coefficients = [
            Text("All coefficients, rms over the plateaus", style="bold"),
            plain_table(coefficient_table(result)[0], 2, coefficient_table(result)[1]),
            Text(),
            Text("Mission of a rotational INS, position error in nmi (95 % below)", style="bold"),
            plain_table(mission_table(result)[0], 1, mission_table(result)[1]),
            Text(mission_sentence(result)),
            Text(),
        ]
    return Group(
        Text(f"{outcome(result).capitalize()}. {outcome_sentence(result)}", style="bold"),
        Text(),
        topics(chain(result)),
        Text(),
        Text("All plateaus: rms over all dwells; maximum of spread, V_E and 24 h", style="bold"),
        _table(["compensation", *SIZES], total_rows(result), words=1),
        Text(),
        Text("By gyro temperature, °C", style="bold"),
        _table(["°C", "cycle", "fit", "compensation", *SIZES], plateau_rows(result), words=4),
        Text(f"{UNITS[0].upper()}{UNITS[1:]}."),
        Text(),
        *coefficients,
        Text(" ".join(reading_sentences(result))),
        Text(),
    )


def _table(headers: Sequence[str], rows: Sequence[Sequence[str]], words: int) -> Table:
    table = plain_table(headers, words, fold=False)
    for row in rows:
        table.add_row(*map(Text, row), end_section=row[words - 1] not in LABELS.values())
    return table
