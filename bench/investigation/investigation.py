"""The loop: search, propose a block, have it measured, search again, until the cause is settled.

Everything that was decided stands in the journal before it is done, and is decided again in the same way from
what was measured: an investigation that was killed continues where it was.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow, read_dwells, write_dwells
from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.loop import Closure, close_loop
from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.errors import GyrobenchError, RunFolderError
from gyrobench.bench.foundations.files import make_folder
from gyrobench.bench.investigation.external_bench import BlockRefusedError, ExternalBench
from gyrobench.bench.investigation.proposal import Proposal, Rival, outcome_probabilities, propose, rivals_of
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.runs.journal import Journal, read_journal

#: A cause is settled at this probability.
SETTLED = 0.99
#: A block that is expected to remove less of the entropy, nats, is not worth its time.
_MIN_GAIN = 0.02
_MAX_BLOCKS = 40
_S_PER_H = 3600.0

Entry = Mapping[str, Any]


@dataclass(frozen=True)
class Stage:
    """One search, and the block that was measured after it."""

    spent_h: float  #: Hours on the bench since the first table.
    closure: Closure  #: The search.
    rivals: tuple[Rival, ...] = ()  #: Hypotheses that were told apart.
    proposal: Proposal | None = None  #: The block measured next; None at the end.
    #: Probability of each rival by the predictions and the outcome alone; None at the end.
    outcome: tuple[float, ...] | None = None
    refused: tuple[tuple[str, str], ...] = ()  #: Blocks that the bench refused, and why.


@dataclass(frozen=True)
class Investigation:
    """Outcome."""

    stages: tuple[Stage, ...]  #: In order of time; at least one.
    ended: str  #: "settled", "budget", "no_block", "declined" or "failed".
    reason: str  #: One sentence.
    rows: tuple[DwellRow, ...]  #: All dwells.

    @property
    def closure(self) -> Closure:
        """The last search."""
        return self.stages[-1].closure

    @property
    def spent_h(self) -> float:
        """Hours on the bench since the first table."""
        return self.stages[-1].spent_h

    @property
    def repeated_campaign_h(self) -> float:
        """Hours of repeating the whole first campaign."""
        first = self.stages[0].closure.campaign
        return float(first.end_s.max() - first.start_s.min() + first.since_power_on_s[0]) / _S_PER_H


@dataclass
class _Progress:
    rows: list[DwellRow]
    held_out: list[int]
    spent_h: float = 0.0
    refused: dict[str, str] = field(default_factory=dict)
    blocks: int = 0


def investigate(
    rows: Sequence[DwellRow],
    folder: Path,
    bench: ExternalBench,
    budget_h: float,
    approve: Callable[[Proposal, Sequence[Rival]], bool],
    clock: Clock,
    noted: Callable[[str], None] = lambda text: None,  # noqa: ARG005
) -> Investigation:
    """Investigate a table on an external bench.

    ``folder`` gets the journal and everything else; an investigation in it is continued. Raises RunFolderError
    if the folder belongs to another table, and GyrobenchError for a table that can't be searched.
    """
    make_folder(folder)
    path = folder / "journal.jsonl"
    entries = read_journal(path) if path.exists() else []
    first = sorted(rows, key=lambda row: (row.start_s, row.dwell))
    _check_same(entries, first, path)
    progress = _Progress(list(first), [max(row.cycle for row in first)])
    stages: list[Stage] = []
    with Journal(path, clock) as journal:
        if not entries:
            journal.record("investigation_started", unit=first[0].unit, dwells=len(first), budget_h=budget_h)
        while True:
            closure = close_loop(campaign_of(progress.rows), progress.held_out)
            rivals = tuple(_rivals(closure))
            journal.record("searched", spent_h=progress.spent_h, **_probabilities(closure))
            ended, proposals = _next(closure, rivals, progress, budget_h)
            if ended:
                stages.append(Stage(progress.spent_h, closure, rivals))
                return _ended(stages, *ended, progress, journal, folder)
            stage = _measure_best(proposals, rivals, closure, progress, folder, bench, approve, journal, noted)
            if isinstance(stage, str):
                stages.append(Stage(progress.spent_h, closure, rivals))
                return _ended(stages, "declined" if stage == "declined" else "no_block", stage, progress, journal, folder)
            stages.append(stage)
