"""The loop: search, propose a block, have it measured, search again, until the cause is settled.

What was decided stands in the journal before it is done. All decisions follow from what was measured, so that
an investigation that was killed decides the same again and continues.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow, format_dwells, read_dwells, write_dwells
from gyrobench.bench.closure.campaign import Campaign, campaign_of
from gyrobench.bench.closure.loop import Closure, close_loop
from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.errors import GyrobenchError, RunFolderError
from gyrobench.bench.foundations.files import make_folder, write_whole
from gyrobench.bench.foundations.text import listed
from gyrobench.bench.investigation.blocks import BlockPlanner
from gyrobench.bench.investigation.external_bench import BlockPlan, BlockRefusedError
from gyrobench.bench.investigation.proposal import Outcome, Proposal, Rival, outcome_of, proposal_of, propose
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.runs.journal import Journal, read_journal

#: A cause is settled at this probability.
SETTLED = 0.99
#: Hypotheses less probable than this, and more than so many, are not predicted.
_MIN_PROBABILITY = 1e-3
_MAX_RIVALS = 6
#: A block that is expected to remove less of the entropy, nats, is not worth its time.
_MIN_GAIN = 0.02
#: The plan of a block, once it was approved, and its dwells, once they were checked.
_PLAN, _DONE = "plan.json", "dwells.csv"
#: Times that a kind of block is measured while the blocks bring only dwells with flags.
_MAX_FLAGGED = 2
_S_PER_H = 3600.0


@dataclass(frozen=True)
class Stage:
    """One search, and the block that was measured after it."""

    spent_h: float  #: Hours on the bench since the first table, before the block.
    closure: Closure  #: The search.
    rivals: tuple[Rival, ...]  #: The hypotheses that a block has to distinguish.
    proposal: Proposal | None = None  #: The block measured next; None at the end.
    #: What the block says about the rivals; None at the end, and if all its dwells have flags.
    outcome: Outcome | None = None


@dataclass(frozen=True)
class Investigation:
    """Outcome of an investigation."""

    stages: tuple[Stage, ...]  #: In the order of time; the last one has no block.
    ended: str  #: "settled", "budget", "no_block", "declined", "refuted" or "bench_failed".
    reason: str  #: Why it ended, one sentence.
    rows: tuple[DwellRow, ...]  #: All dwells.
    refused: Mapping[tuple[str, ...], str]  #: Reasons of the bench by the kinds of a block.
    #: The block that confirms a settled cause; its rivals are the cause and the declared model alone.
    confirmation: Stage | None = None

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


class Bench(Protocol):
    """What measures the blocks."""

    def measure(self, plan: BlockPlan, folder: Path) -> list[DwellRow]:
        """Measure a block, or what is left of it; files of the bench are written into ``folder``.

        Raises BlockRefusedError if the bench can't do it, and GyrobenchError if it fails.
        """


class Investigator:
    """An investigation of a table.

    ``folder`` gets the journal and all results; an investigation in it is continued. ``approve`` is asked
    before a block is measured. ``planner`` is what the bench says about blocks beforehand, by default
    nothing; ``campaign`` makes the campaign of dwells that is searched.

    Raises RunFolderError if the folder belongs to another table.
    """

    def __init__(
        self,
        rows: Sequence[DwellRow],
        folder: Path,
        bench: Bench,
        budget_h: float,
        approve: Callable[[Proposal, Sequence[Rival]], bool],
        planner: BlockPlanner | None = None,
        campaign: Callable[[Sequence[DwellRow]], Campaign] = campaign_of,
    ) -> None:
        make_folder(folder)
        self._rows = sorted(rows, key=lambda row: (row.start_s, row.dwell))
        self._planner, self._campaign = planner, campaign
        self._held_out = [campaign(self._rows).last_cycle]
        self._folder, self._bench, self._budget_h = folder, bench, budget_h
        self._approve = approve
        self._refused: dict[tuple[str, ...], str] = {}
        self._spent_h, self._blocks = 0.0, 0
        self._flagged: list[tuple[str, ...]] = []
        table = folder / "start.csv"
        if not table.exists():
            write_dwells(table, self._rows)
        elif table.read_text(encoding="utf-8") != format_dwells(self._rows):
            raise RunFolderError(f"{folder}: is the investigation of another table. Choose another --out")

    def run(self, clock: Clock) -> Investigation:
        """Measure block after block until the cause is settled, or no block can help, or the time is spent.

        A settled cause is confirmed by one more block, predicted before it is measured. A bench that
        fails ends the investigation; a later call continues it. What was measured before is taken from the
        folder.
        """
        path = self._folder / "journal.jsonl"
        earlier = list(read_journal(path)) if path.exists() else []
        stages: list[Stage] = []
        confirmation = None
        with Journal(path, clock) as journal:
            event = "investigation_resumed" if earlier else "investigation_started"
            journal.record(event, budget_h=self._budget_h)
            self._refused = {
                tuple(entry["kinds"]): entry["reason"] for entry in earlier if entry["event"] == "refused"
            }
            ended = None
            while ended is None:
                stage = self._searched()
                journal.record("searched", spent_h=stage.spent_h, **probabilities(stage.closure))
                ended = self._end(stage)
                if ended is None:
                    stage, ended = self._with_block(stage, journal)
                stages.append(stage)
            if ended[0] == "settled" and stages[-1].rivals[0].names:
                confirmation, failed = self._confirmation(stages[-1], journal)
                ended = failed or self._refuted(confirmation) or ended
            journal.record("investigation_ended", ended=ended[0], reason=ended[1])
            write_dwells(self._folder / "dwells.csv", self._rows)
        return Investigation(tuple(stages), *ended, tuple(self._rows), dict(self._refused), confirmation)

    def _with_block(
        self,
        stage: Stage,
        journal: Journal,
        value: Callable[[Proposal], float] = lambda each: each.gain_per_h,
    ) -> tuple[Stage, tuple[str, str] | None]:
        """The stage with the block of largest value that the bench can do, or why there is none."""
        folder, scale = self._block_folder, stage.closure.noise_scale
        done = folder / _DONE
        decided = self._decided(stage)
        if decided is not None and done.exists():
            return self._with_outcome(stage, decided, read_dwells(done), journal), None
        while True:
            left_h = self._budget_h - self._spent_h
            idle = [kinds for kinds in self._flagged if self._flagged.count(kinds) >= _MAX_FLAGGED]
            if decided is not None:
                best, decided = decided, None
            else:
                found = propose(
                    self._rows, stage.rivals, scale, [*self._refused, *idle], left_h, self._planner
                )
                useful = [each for each in found if each.entropy - each.expected_entropy > _MIN_GAIN]
                if not useful:
                    return stage, ("no_block", self._no_block(stage))
                best = max(useful, key=value)
                if not self._is_approved(best, stage, journal):
                    return stage, ("declined", "The proposed block was declined.")
            try:
                rows = self._bench.measure(best.block.plan, folder)
            except BlockRefusedError as error:
                kinds = best.block.kinds
                self._refused[kinds] = str(error)
                journal.record("refused", number=self._blocks + 1, kinds=kinds, reason=str(error))
                continue
            except GyrobenchError as error:
                problem = "; ".join(str(error).splitlines()).rstrip(".")
                return stage, ("bench_failed", f"The bench failed: {problem}.")
            write_dwells(done, rows)
            return self._with_outcome(stage, best, rows, journal), None

    def _no_block(self, stage: Stage) -> str:
        names = sorted({name for each in stage.rivals for name in each.names})
        effects = {each.effect.name: each.effect for each in stage.closure.evidence}
        experiments = "; ".join(effects[name].experiment for name in names if name in effects)
        return (
            "No block of this bench is expected to distinguish what is left. What would: "
            f"{experiments or 'a measurement of other quantities'}."
        )

    def _confirmation(self, last: Stage, journal: Journal) -> tuple[Stage | None, tuple[str, str] | None]:
        """A block in which the cause and the declared model alone differ most, and a failure of the bench."""
        cause = replace(last.rivals[0], probability=0.5)
        stage = replace(last, rivals=(cause, Rival((), (), 0.5)))
        stage, ended = self._with_block(stage, journal, lambda each: each.difference)
        return (None if ended else stage), ended if ended and ended[0] == "bench_failed" else None

    def _refuted(self, confirmation: Stage | None) -> tuple[str, str] | None:
        """The end of a cause that predicted the last block worse than the declared model did."""
        if confirmation is None or confirmation.outcome is None:
            return None
        if confirmation.outcome.probabilities[0] >= 0.5:
            return None
        return "refuted", f"A block contradicts what {confirmation.rivals[0].title} predicted for it."

    def _searched(self) -> Stage:
        closure = close_loop(self._campaign(self._rows), self._held_out)
        return Stage(self._spent_h, closure, rivals_of(closure))

    def _end(self, stage: Stage) -> tuple[str, str] | None:
        best = stage.closure.posterior.hypotheses[0]
        is_stated = stage.closure.verdict in ("explained", "clean")
        if best.probability >= SETTLED and not best.has_remainder and is_stated:
            what = listed(sorted(map(stage.closure.label, best.names))) or "nothing beside the declared model"
            return "settled", f"{what.capitalize()}: probability {best.probability:.4f}."
        if self._spent_h >= self._budget_h and not (self._block_folder / _DONE).exists():
            return "budget", f"{self._spent_h:.1f} h of {self._budget_h:g} h on the bench are spent."
        return None

    @property
    def _block_folder(self) -> Path:
        return self._folder / f"block-{self._blocks + 1}"

    def _is_approved(self, proposal: Proposal, stage: Stage, journal: Journal) -> bool:
        """Whether a block may be measured; the plan of one that may is in its folder."""
        journal.record("proposed", number=self._blocks + 1, **proposed(proposal, stage.rivals))
        answer = self._approve(proposal, stage.rivals)
        if answer:
            make_folder(self._block_folder)
            write_whole(self._block_folder / _PLAN, proposal.block.plan.text().encode())
        journal.record("approved" if answer else "declined", number=self._blocks + 1)
        return answer

    def _decided(self, stage: Stage) -> Proposal | None:
        """The next block if it was approved before, and not refused since."""
        entries = [
            entry
            for entry in read_journal(self._folder / "journal.jsonl")
            if entry.get("number") == self._blocks + 1
        ]
        events = [entry["event"] for entry in entries]
        if not {"approved", "measured"} & set(events[-1:]):
            return None
        name = next(entry["block"] for entry in reversed(entries) if entry["event"] == "proposed")
        plan = BlockPlan.model_validate_json((self._block_folder / _PLAN).read_text(encoding="utf-8"))
        scale = stage.closure.noise_scale
        return proposal_of(plan, name.split(", then "), self._rows, stage.rivals, scale)

    def _with_outcome(
        self, stage: Stage, proposal: Proposal, rows: Sequence[DwellRow], journal: Journal
    ) -> Stage:
        """The stage with its block; the dwells are added to the table."""
        outcome = outcome_of(self._rows, rows, stage.rivals, stage.closure.noise_scale)
        hours = (max(row.end_s for row in rows) - proposal.block.plan.start_s) / _S_PER_H
        self._flagged = [] if outcome else [*self._flagged, proposal.block.kinds]
        self._rows += rows
        self._spent_h += hours
        self._blocks += 1
        journal.record(
            "measured",
            number=self._blocks,
            hours=hours,
            dwells=len(rows),
            noise_dph=outcome.noise_dph if outcome else None,
            hypotheses=outcome
            and [
                {"hypothesis": rival.title, "probability": probability, "error_dph": error_dph}
                for rival, probability, error_dph in zip(
                    stage.rivals, outcome.probabilities, outcome.error_dph, strict=True
                )
            ],
        )
        return replace(stage, proposal=proposal, outcome=outcome)


def rivals_of(closure: Closure) -> tuple[Rival, ...]:
    """The most probable hypotheses of a search; together they have probability 1."""
    best = [each for each in closure.posterior.hypotheses if each.probability > _MIN_PROBABILITY]
    best = best[:_MAX_RIVALS]
    total = sum(each.probability for each in best)
    residual_dph = (closure.campaign.bias_dph - closure.model.bias_dph)[closure.searched]
    variance = float(np.mean(residual_dph**2)) - closure.noise_dph**2
    remainder_dph = max(np.sqrt(max(variance, 0.0)), 0.5 * closure.noise_dph)
    return tuple(
        Rival(
            tuple(sorted(each.names)),
            each.candidates,
            each.probability / total,
            remainder_dph if each.has_remainder else 0.0,
        )
        for each in best
    )


def probabilities(closure: Closure) -> dict[str, Any]:
    """What a search found, for the journal."""
    return {
        "verdict": closure.verdict,
        "effects": closure.posterior.of_effect,
        "nothing": closure.posterior.nothing,
        "not_on_the_list": closure.posterior.not_on_list,
    }


def proposed(proposal: Proposal, rivals: Sequence[Rival]) -> dict[str, Any]:
    """A proposal with its predictions, for the journal."""
    return {
        "block": proposal.block.name,
        "hours": proposal.block.plan.duration_h,
        "entropy": proposal.entropy,
        "expected_entropy": proposal.expected_entropy,
        "dwells": [row.dwell for row in proposal.rows],
        "predictions": [
            {
                "hypothesis": rival.title,
                "probability": rival.probability,
                **{
                    f"bias_{axis}_dph": prediction.mean_dph.reshape(3, -1)[gyro].tolist()
                    for gyro, axis in enumerate(AXES)
                },
                **{
                    f"sigma_{axis}_dph": np.sqrt(np.diag(prediction.covariance)).reshape(3, -1)[gyro].tolist()
                    for gyro, axis in enumerate(AXES)
                },
            }
            for rival, prediction in zip(rivals, proposal.predictions, strict=True)
        ],
    }
