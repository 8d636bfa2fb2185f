"""The loop: search, propose a block, have it measured, search again, until the cause is settled.

What was decided stands in the journal before it is done. All decisions follow from what was measured, so that
an investigation that was killed decides the same again and continues.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow, format_dwells, read_dwells, write_dwells
from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.loop import Closure, close_loop
from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.files import make_folder
from gyrobench.bench.investigation.external_bench import BlockRefusedError, ExternalBench, checked_rows
from gyrobench.bench.investigation.proposal import Proposal, Rival, outcome_probabilities, propose, rivals_of
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.runs.journal import Journal, read_journal

#: A cause is settled at this probability.
SETTLED = 0.99
#: A block that is expected to remove less of the entropy, nats, is not worth its time.
_MIN_GAIN = 0.02
_S_PER_H = 3600.0


@dataclass(frozen=True)
class Stage:
    """One search, and the block that was measured after it."""

    spent_h: float  #: Hours on the bench since the first table, before the block.
    closure: Closure  #: The search.
    rivals: tuple[Rival, ...]  #: The hypotheses that a block has to distinguish.
    proposal: Proposal | None = None  #: The block measured next; None at the end.
    #: Probability of each rival by its prediction and the outcome; empty at the end.
    outcome: tuple[float, ...] = ()


@dataclass(frozen=True)
class Investigation:
    """Outcome of an investigation."""

    stages: tuple[Stage, ...]  #: In the order of time; the last one has no block.
    ended: str  #: "settled", "budget", "no_block" or "declined".
    reason: str  #: Why it ended, one sentence.
    rows: tuple[DwellRow, ...]  #: All dwells.
    refused: Mapping[str, str]  #: Reasons of the bench by kind of block.

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
        """Hours of repeating the first campaign."""
        first = self.stages[0].closure.campaign
        return float(first.end_s.max() - first.start_s.min()) / _S_PER_H


class Investigator:
    """An investigation of a table on an external bench.

    ``folder`` gets the journal and all results; an investigation in it is continued. ``approve`` is asked
    before a block is measured. ``noted`` takes lines of progress.

    Raises RunFolderError if the folder belongs to another table.
    """

    def __init__(
        self,
        rows: Sequence[DwellRow],
        folder: Path,
        bench: ExternalBench,
        budget_h: float,
        approve: Callable[[Proposal, Sequence[Rival]], bool],
        noted: Callable[[str], None],
    ) -> None:
        make_folder(folder)
        self._rows = sorted(rows, key=lambda row: (row.start_s, row.dwell))
        self._held_out = [max(row.cycle for row in self._rows)]
        self._folder, self._bench, self._budget_h = folder, bench, budget_h
        self._approve, self._noted = approve, noted
        self._refused: dict[str, str] = {}
        self._spent_h, self._blocks = 0.0, 0
        table = folder / "start.csv"
        if not table.exists():
            write_dwells(table, self._rows)
        elif table.read_text(encoding="utf-8") != format_dwells(self._rows):
            raise RunFolderError(f"{folder}: is the investigation of another table. Choose another --out")

    def run(self, clock: Clock) -> Investigation:
        """Measure block after block until the cause is settled, or no block can help, or the time is spent.

        Raises GyrobenchError if the bench fails; a later call continues.
        """
        path = self._folder / "journal.jsonl"
        earlier = list(read_journal(path)) if path.exists() else []
        stages: list[Stage] = []
        with Journal(path, clock) as journal:
            journal.record("investigation_resumed" if earlier else "investigation_started", budget_h=self._budget_h)
            while True:
                stage = self._search()
                journal.record("searched", spent_h=stage.spent_h, **probabilities(stage.closure))
                ended, proposal = self._decide(stage, journal, earlier)
                if proposal is None:
                    stages.append(stage)
                    journal.record("investigation_ended", ended=ended[0], reason=ended[1])
                    write_dwells(self._folder / "dwells.csv", self._rows)
                    return Investigation(
                        tuple(stages), *ended, rows=tuple(self._rows), refused=dict(self._refused)
                    )
