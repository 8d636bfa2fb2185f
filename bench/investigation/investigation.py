"""The loop: search, propose a block, measure it, search again, until one hypothesis is settled.

Each decision is written to the journal before it is carried out. All decisions follow from the measurements,
so that a killed investigation makes the same decisions again and continues.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from gyrobench.bench.bias.dwell_table import DwellRow, format_dwells, read_dwells, write_dwells
from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.loop import composed
from gyrobench.bench.closure.outcome import Closure
from gyrobench.bench.closure.posterior import CLEAN, RIVAL
from gyrobench.bench.closure.search import MAX_EFFECTS
from gyrobench.bench.foundations.arrays import S_PER_H
from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.errors import GyrobenchError, RunFolderError
from gyrobench.bench.foundations.files import make_folder, write_whole
from gyrobench.bench.foundations.operator_name import operator_name
from gyrobench.bench.foundations.text import listed
from gyrobench.bench.investigation.blocks import NEW_CYCLE, Block, BlockPlanner
from gyrobench.bench.investigation.choice import Rival
from gyrobench.bench.investigation.external_bench import BlockPlan, BlockRefusedError
from gyrobench.bench.investigation.forecast import Forecast
from gyrobench.bench.investigation.open_hypotheses import (
    SLOW,
    confirming_rivals,
    inexact_law_rivals,
    is_settled,
    only_unconfirmed,
    probability_of_found,
    remainder_dph,
    remainder_share,
    rivals_of,
    search_campaign,
)
from gyrobench.bench.investigation.profile import Profile
from gyrobench.bench.investigation.proposal import (
    MIN_GAIN,
    SETTLED,
    Outcome,
    PossibleBlocks,
    Proposal,
    calibration_of,
    is_confirmed_by,
    outcome_of,
    proposal_entry,
    proposal_of,
    propose,
    remaining_hours_of,
)
from gyrobench.bench.investigation.stages import (
    CALIBRATE,
    CONFIRM,
    DISTINGUISH,
    TEST_LAW,
    Ending,
    Investigation,
    Stage,
)
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import Journal, read_journal
from gyrobench.bench.runs.locks import RunLock

#: Files of a block: its plan after approval, and its dwells after they were checked.
_PLAN, _DWELLS = "plan.json", "dwells.csv"
#: A kind of block is not proposed again after this number of blocks with only flagged dwells in sequence.
_MAX_FLAGGED = 2
#: Maximum number of blocks to confirm one hypothesis, if their outcomes are not clear.
MAX_TESTS = 4
#: After this number of distinguishing blocks, weak rivals no longer keep a hypothesis open.
PATIENCE = 3
#: Ends where no block of the bench can distinguish what is left, and those after which an adaptive campaign
#: still determines biases.
_NO_BLOCK_LEFT = "no_block", "not_on_list"
_CONCLUSIVE = "settled", "nothing_found", "not_on_list", "refuted"
_ONE_SLOW_LAW = "ageing and a drift together imitate one slow law of time"


class Bench(BlockPlanner, Protocol):
    """The bench that measured the first dwells and measures the blocks."""

    @property
    def rows(self) -> Sequence[DwellRow]:
        """Dwells before the first block."""

    @property
    def campaign_h(self) -> float:
        """Duration of their measurement."""

    def campaign(self, rows: Sequence[DwellRow]) -> Campaign:
        """Campaign of dwells for a search."""

    def measure(self, plan: BlockPlan, folder: Path) -> list[DwellRow]:
        """Measure a block, or the rest of an interrupted one; ``folder`` gets the files of the bench.

        Raises BlockRefusedError if the bench can't do it, and GyrobenchError if it fails.
        """


class Investigator:
    """An investigation of the dwells of a bench.

    ``folder`` gets the journal and all results; an investigation in it is continued. ``approve`` decides
    whether a proposed block is measured. With a ``profile``, blocks are also measured until its biases are as
    certain as after a measurement of the whole profile; the first dwells then count as time on the bench, and
    the budget is at most the duration of the profile.

    Raises RunFolderError if the folder belongs to another table.
    """

    def __init__(
        self,
        bench: Bench,
        folder: Path,
        budget_h: float,
        approve: Callable[[Proposal, Sequence[Rival]], bool],
        profile: Profile | None = None,
    ) -> None:
        make_folder(folder)
        self._rows = sorted(bench.rows, key=lambda row: (row.start_s, row.dwell))
        self._held_out = [bench.campaign(self._rows).last_cycle]
        self._profile = profile
        self._folder, self._bench = folder, bench
        self._budget_h = min(budget_h, profile.duration_h) if profile else budget_h
        self._approve = approve
        self._refused: dict[tuple[str, ...], str] = {}
        self._spent_h, self._blocks = bench.campaign_h if profile else 0.0, 0
        self._flagged: list[tuple[str, ...]] = []
        self._earlier: list[dict[str, Any]] = []
        self._stages: list[Stage] = []
        table = RunFolder(folder).first_dwells
        if not table.exists():
            write_dwells(table, self._rows)
        elif table.read_text(encoding="utf-8") != format_dwells(self._rows):
            raise RunFolderError(f"{folder}: is the investigation of another table. Choose another --out")

    def run(self, clock: Clock) -> Investigation:
        """Measure blocks until a hypothesis is settled, no block can help, or the time is spent.

        A settled hypothesis, and a law composed for an unlisted effect, are tested by one more block, which
        is predicted before it is measured. A failure of the bench ends the investigation; a later call
        continues it. Earlier measurements are read from the folder.
        """
        path = self._folder / "journal.jsonl"
        self._earlier = list(read_journal(path)) if path.exists() else []
        self._stages = []
        with RunLock(self._folder, clock), Journal(path, clock) as journal:
            event = "investigation_resumed" if self._earlier else "investigation_started"
            first_table = {"unit": self._rows[0].unit, "dwells": len(self._rows)}
            journal.record(event, procedure="investigation", budget_h=self._budget_h, **first_table)
            self._refused = {
                tuple(entry["kinds"]): entry["reason"]
                for entry in self._earlier
                if entry["event"] == "refused"
            }
            ending = None
            while ending is None:
                stage = self._search()
                ratio = stage.calibration and stage.calibration.ratio
                journal.record(
                    "searched",
                    spent_h=stage.spent_h,
                    uncertainty_ratio=ratio,
                    **_verdict_entry(stage.closure),
                )
                stage, ending = self._continue_stage(stage, journal)
                self._stages.append(stage)
            journal.record("investigation_ended", **ending._asdict())
            write_dwells(self._folder / "dwells.csv", self._rows)
        whole_h = self._profile.duration_h if self._profile else self._bench.campaign_h
        rows, refused = tuple(self._rows), dict(self._refused)
        return Investigation(tuple(self._stages), *ending, rows, refused, whole_h)

    def _continue_stage(self, stage: Stage, journal: Journal) -> tuple[Stage, Ending | None]:
        """The stage with the block that follows its search, or how the investigation ends."""
        ending = self._ending(stage)
        if ending is None:
            stage, ending = self._with_block(self._confirmation(stage) or stage, journal)
            is_idle = ending is not None and ending.ended in _NO_BLOCK_LEFT
            if is_idle and (confirm := self._confirmation(stage, is_last=True)):
                stage, ending = self._with_block(confirm, journal)
        if ending and ending.ended in (*_NO_BLOCK_LEFT, "budget"):
            ending = self._ending(stage, is_last=True) or ending
        if ending and (test := self._test(stage, ending.ended)):
            test, failure = self._with_block(test, journal)
            if failure is None:
                return test, None
            if failure.ended != "bench_failed":
                reason = f"{ending.reason} No further block tested it. {failure.reason}"
                return stage, ending._replace(reason=reason)
            return stage, failure
        if ending and ending.ended in _CONCLUSIVE and stage.is_uncertain and stage.calibration:
            stage = replace(stage, purpose=CALIBRATE, rivals=stage.calibration.rivals)
            stage, failure = self._with_block(stage, journal)
            ending = failure and (failure if failure.ended in ("bench_failed", "declined") else ending)
        return stage, ending

    def _with_block(self, stage: Stage, journal: Journal) -> tuple[Stage, Ending | None]:
        """The stage with the best block that the bench can do, or how the investigation ends without one."""
        folder = self._block_folder
        dwells_file = folder / _DWELLS
        best = self._approved_block(stage)
        if best is not None and dwells_file.exists():
            return self._with_outcome(stage, best, read_dwells(dwells_file), journal), None
        while True:
            if best is None:
                best = self._best_block(stage)
                if best is None:
                    return stage, self._no_block(stage)
                if not self._is_approved(best, stage, journal):
                    return stage, Ending("declined", "The proposed block was declined.")
            try:
                rows = self._bench.measure(best.block.plan, folder)
            except BlockRefusedError as error:
                kinds, best = best.block.kinds, None
                self._refused[kinds] = str(error)
                journal.record("refused", number=self._blocks + 1, kinds=kinds, reason=str(error))
                continue
            except GyrobenchError as error:
                problem = "; ".join(str(error).splitlines()).rstrip(".")
                return stage, Ending("bench_failed", f"The bench failed: {problem}.")
            write_dwells(dwells_file, rows)
            return self._with_outcome(stage, best, rows, journal), None

    def _best_block(self, stage: Stage) -> Proposal | None:
        """The best block for the purpose of a stage; None if none is useful."""
        only_flagged = [kinds for kinds in self._flagged if self._flagged.count(kinds) >= _MAX_FLAGGED]
        measured = [each.proposal.block.kinds for each in self._stages if each.proposal]
        is_settled = stage.is_uncertain and stage.purpose != DISTINGUISH
        proposals = propose(
            stage.forecast,
            stage.rivals,
            PossibleBlocks(self._bench, self._remaining_h, [*self._refused, *only_flagged], measured),
            self._profile,
            stage.calibration if stage.is_uncertain else None,
            is_settled=is_settled,
        )
        useful = [
            each
            for each in proposals
            if (each.can_help or each.replaced_h > MIN_GAIN)
            and (stage.purpose != TEST_LAW or stage.is_uncertain or each.block.name == NEW_CYCLE)
        ]
        if not useful:
            return None
        if is_settled:
            return proposal_of(stage.forecast, useful[0].block, stage.rivals)
        if stage.is_test:
            return max(useful, key=lambda each: each.tested_per_h)
        return min(useful, key=remaining_hours_of(useful)) if self._profile else useful[0]

    @property
    def _remaining_h(self) -> float:
        return self._budget_h - self._spent_h

    def _no_block(self, stage: Stage) -> Ending:
        if stage.is_uncertain:
            return Ending(
                "budget", f"No block is short enough for the {self._remaining_h:.1f} h that are left."
            )
        closure, best = stage.closure, stage.rivals[0]
        not_on_list = closure.posterior.unlisted_probability
        if closure.verdict == "unexplained" and not_on_list > 0.5:
            return _not_on_list(f"probability {not_on_list:.4f}")
        if set(best.names) >= SLOW:
            return _not_on_list(_ONE_SLOW_LAW)
        rejected = {
            each.effect.name: each.rejected for each in closure.evidence if each.effect.name in best.names
        }
        if closure.verdict == "unexplained" and any(rejected.values()) and best.probability >= SETTLED:
            reasons = "; ".join(f"{closure.label(name)}: {each}" for name, each in rejected.items() if each)
            label = listed(sorted(map(closure.label, best.names)))
            return _not_on_list(
                f"the most probable, {label} ({best.probability:.4f}), is not accepted ({reasons})"
            )
        names = sorted({name for each in stage.rivals for name in each.names})
        effects = {each.effect.name: each.effect for each in stage.closure.evidence}
        experiments = "; ".join(
            f"{stage.closure.label(name)}: {effects[name].experiment}" for name in names if name in effects
        )
        refused = "; ".join(f"{', then '.join(kinds)} ({reason})" for kinds, reason in self._refused.items())
        refused = refused and f"The bench refused {refused}. "
        return Ending(
            "no_block",
            f"{refused}No {'other ' * bool(refused)}block of this bench is expected to distinguish what is "
            "left. What would: "
            f"{experiments or 'a measurement of other quantities'}.",
        )

    def _confirmation(self, stage: Stage, *, is_last: bool = False) -> Stage | None:
        """Stage whose block confirms effects that lack only a confirmation; None if there are none.

        ``is_last``: whether no block distinguishes the rivals. In this case, or after :data:`PATIENCE`
        distinguishing blocks, rivals that rest on one dwell or are not significant do not count.
        """
        if only_unconfirmed(stage.closure, with_weak=not (is_last or self._ignores_weak_rivals)):
            return self._test_of_first(stage, confirming_rivals(stage.closure), again=True)
        rivals = inexact_law_rivals(stage.closure) if is_last else ()
        return self._test_of_first(stage, rivals) if rivals else None

    def _test_of_first(self, last: Stage, rivals: tuple[Rival, ...], *, again: bool = False) -> Stage | None:
        """Stage whose block tests the first of the rivals; None if a block did already.

        ``again``: test again if the earlier outcomes were not clear.
        """
        tested = self._confirmations(rivals[0].names)
        is_enough = tested and (not again or tested[-1].is_clear or len(tested) == MAX_TESTS)
        if not rivals[0].names or is_enough:
            return None
        return replace(last, rivals=rivals, purpose=CONFIRM)

    def _test(self, last: Stage, ended: str) -> Stage | None:
        """Stage whose block tests the result of the investigation: its hypothesis, or a composed law.

        With a profile, only a block that its biases need is used as the test.
        """
        if self._profile is not None and not last.is_uncertain:
            return None
        if ended == "settled":
            return self._test_of_first(last, confirming_rivals(last.closure))
        is_tested = any(each.purpose == TEST_LAW and each.outcome for each in self._stages)
        if ended == "not_on_list" and not is_tested:
            composed_laws = composed(last.closure).composed
            if composed_laws is not None and composed_laws.laws:
                found = tuple(each.candidate for each in last.closure.effects)[: MAX_EFFECTS - 1]
                names = tuple(each.effect.name for each in found)
                law = composed_laws.laws[0].candidate
                with_law = Rival((*names, law.effect.name), (*found, law), 0.5)
                without_law = Rival(names, found, 0.5, remainder_dph(last.closure))
                return replace(last, rivals=(with_law, without_law), purpose=TEST_LAW)
        return None

    @property
    def _ignores_weak_rivals(self) -> bool:
        """Whether :data:`PATIENCE` distinguishing blocks were measured."""
        blocks = (each for each in self._stages if each.purpose == DISTINGUISH and each.outcome)
        return sum(1 for _ in blocks) >= PATIENCE

    def _confirmations(self, names: tuple[str, ...]) -> list[Outcome]:
        """Outcomes of the blocks whose purpose was to confirm these effects."""
        blocks = [each for each in self._stages if each.purpose == CONFIRM and each.rivals[0].names == names]
        return [each.outcome for each in blocks if each.outcome]

    def _search(self) -> Stage:
        closure = search_campaign(self._bench.campaign(self._rows), self._held_out)
        rivals, noise = rivals_of(closure), closure.noise
        forecast = Forecast(noise.weighted(self._rows), noise.scales, noise.correlation_factor)
        stage = Stage(self._spent_h, closure, rivals, forecast)
        if self._profile is None:
            return stage
        return replace(stage, calibration=calibration_of(forecast, self._profile, rivals, self._bench))

    def _ending(self, stage: Stage, *, is_last: bool = False) -> Ending | None:
        """End and reason after a search, None to continue; ``is_last`` as in :meth:`_confirmation`."""
        posterior = stage.closure.posterior
        names = tuple(sorted(stage.closure.names))
        tested = next(reversed(self._confirmations(names)), None)
        is_confirmed = is_confirmed_by(
            each.confirmation
            for each in self._stages
            if each.confirmation and each.confirmed[0].names == names
        )
        if is_settled(stage.closure) or (
            is_confirmed
            and only_unconfirmed(stage.closure, with_weak=not (is_last or self._ignores_weak_rivals))
        ):
            if tested is not None and tested.contradicts:
                return Ending("refuted", f"A block contradicts what {' + '.join(names)} predicted for it.")
            if tested is not None and set(names) >= SLOW:
                return _not_on_list(_ONE_SLOW_LAW)
            return Ending("settled", _settled_reason(stage.closure))
        is_listed = posterior.unlisted_probability <= 1.0 - SETTLED
        if stage.closure.verdict == "clean" and is_listed and not posterior.rivals(()):
            return Ending(
                "nothing_found",
                f"Nothing found: the declared model alone has the probability "
                f"{posterior.no_effect_probability:.4f}, above {CLEAN:g} but below {SETTLED:g}, and "
                f"no effect one of {RIVAL:g}.",
            )
        if posterior.unlisted_probability >= SETTLED and self._confirmation(stage) is None:
            return _not_on_list(f"probability {posterior.unlisted_probability:.4f}")
        if self._spent_h >= self._budget_h and not (self._block_folder / _DWELLS).exists():
            return Ending("budget", f"{self._spent_h:.1f} h of {self._budget_h:g} h on the bench are spent.")
        return None

    @property
    def _block_folder(self) -> Path:
        return self._folder / f"block-{self._blocks + 1}"

    def _is_approved(self, proposal: Proposal, stage: Stage, journal: Journal) -> bool:
        """Whether a block may be measured; if so, writes its plan to its folder."""
        journal.record(
            "proposed",
            number=self._blocks + 1,
            purpose=stage.purpose,
            **proposal_entry(proposal, stage.rivals),
        )
        answer = self._approve(proposal, stage.rivals)
        if answer:
            make_folder(self._block_folder)
            write_whole(self._block_folder / _PLAN, proposal.block.plan.text().encode())
        event = "approved" if answer else "declined"
        journal.record(event, number=self._blocks + 1, operator=operator_name())
        return answer

    def _approved_block(self, stage: Stage) -> Proposal | None:
        """The next block if it was approved by an earlier call and not refused since."""
        entries = [entry for entry in self._earlier if entry.get("number") == self._blocks + 1]
        events = [entry["event"] for entry in entries]
        if not {"approved", "measured"} & set(events[-1:]):
            return None
        entry = next(entry for entry in reversed(entries) if entry["event"] == "proposed")
        plan = BlockPlan.model_validate_json((self._block_folder / _PLAN).read_text(encoding="utf-8"))
        block = Block(tuple(entry["block"].split(", then ")), entry.get("what", entry["block"]), plan)
        return proposal_of(stage.forecast, block, stage.rivals)

    def _with_outcome(
        self, stage: Stage, proposal: Proposal, rows: Sequence[DwellRow], journal: Journal
    ) -> Stage:
        """The stage with its block and outcome; adds the dwells to the table."""
        confirmed, forecast = stage.confirmed, stage.forecast
        outcome = outcome_of(forecast, proposal, rows, stage.rivals)
        confirmation = outcome_of(forecast, proposal, rows, confirmed) if confirmed[0].names else None
        hours = (max(row.end_s for row in rows) - proposal.block.plan.start_s) / S_PER_H
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
            off_forecast_k=outcome.off_forecast_k if outcome else None,
            hypotheses=outcome
            and [
                {"hypothesis": rival.title, "probability": probability, "error_dph": error_dph}
                for rival, probability, error_dph in zip(
                    stage.rivals, outcome.probabilities, outcome.error_dph, strict=True
                )
            ],
        )
        return replace(stage, proposal=proposal, outcome=outcome, confirmation=confirmation)


def _not_on_list(detail: str) -> Ending:
    return Ending("not_on_list", f"Not on the list of effects: {detail}.")


def _settled_reason(closure: Closure) -> str:
    """Text of the effects found with their probability, and of others that are not excluded."""
    posterior, names = closure.posterior, sorted(closure.names)
    found_text = listed(sorted(map(closure.label, names))) or "nothing beyond the declared model"
    reason = f"{found_text.capitalize()}: probability {probability_of_found(closure):.4f}."
    if posterior.unlisted_probability > 1.0 - SETTLED:
        reason += (
            f" Not excluded in addition: an unlisted effect, probability "
            f"{posterior.unlisted_probability:.4f}, {100.0 * remainder_share(closure):.0f} % of its size."
        )
    general = {other for name in names for other in posterior.more_general.get(name, ())}
    for each in sorted(general & posterior.effect_probabilities.keys()):
        label = closure.label(each)
        reason += f" Of a more general law, {label}: probability {posterior.effect_probabilities[each]:.4f}."
    if rivals := posterior.rivals(names):
        others = (f"{closure.label(each)} ({value:.2f})" for each, value in rivals.items())
        reason += f" Not excluded in addition, but not shown: {', '.join(others)}."
    return reason


def _verdict_entry(closure: Closure) -> dict[str, Any]:
    """Verdict and probabilities of a search, for the journal."""
    return {
        "verdict": closure.verdict,
        "effects": closure.posterior.effect_probabilities,
        "nothing": closure.posterior.no_effect_probability,
        "not_on_the_list": closure.posterior.unlisted_probability,
    }
