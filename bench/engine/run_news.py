"""What of a run is told off the bench."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.orders import Order
from gyrobench.bench.engine.outcome import RunOutcome
from gyrobench.bench.engine.people import Progress
from gyrobench.bench.engine.progress import RunProgress
from gyrobench.bench.messages.message import Event, Message, Remaining
from gyrobench.bench.messages.messenger import Messenger
from gyrobench.bench.procedure.plan import Plan, PlannedStep
from gyrobench.bench.runs.folder import RunFolder

#: A question that is answered sooner was put to somebody who is there.
UNANSWERED_S = 30.0


class RunNews(Progress):
    """Watches a run and has its end, its holds and its open questions told.

    Parameters
    ----------
    messenger : Messenger
        Who tells them.
    plan : Plan
        What is being run.
    done : RunProgress
        What was done before, and grows.
    """

    def __init__(self, messenger: Messenger, plan: Plan, done: RunProgress) -> None:
        self._messenger = messenger
        self._plan = plan
        self._done = done
        self._unit = done.unit
        self._left_s = (
            plan.duration_s - plan.steps[done.next_index].start_s if not done.is_over(plan) else 0.0
        )
        self._why = ""
        self._is_hold_told = False
        self._question: tuple[str, tuple[str, ...]] = ("", ())
        self._tell_after_s = math.inf
        self._goes_on_from = ""
        self._bench: LiveBench
        self._folder: RunFolder

    def begun(self, folder: RunFolder, bench: LiveBench, outcome: RunOutcome) -> None:  # noqa: ARG002
        """Keep where the run is."""
        self._folder, self._bench = folder, bench

    def identified(self, unit: str) -> None:
        """Keep which unit it is."""
        self._unit = unit

    def step_started(self, planned: PlannedStep, bench: LiveBench) -> None:  # noqa: ARG002
        """Tell that a hold is over, once the run does go on."""
        self._left_s = self._plan.duration_s - planned.start_s
        if self._goes_on_from:
            self._tell("resumes", f"The hold is over: {self._goes_on_from}", about=self._goes_on_from)
            self._goes_on_from, self._is_hold_told = "", False

    def ticked(self, bench: LiveBench, left_s: float) -> None:  # noqa: ARG002
        """Keep what is left."""
        self._left_s = max(0.0, left_s)

    def beat(self, bench: LiveBench) -> None:
        """Tell of a question that nobody answers."""
        if bench.clock.now() < self._tell_after_s:
            return
        self._tell_after_s = math.inf
        question, answers = self._question
        self._is_hold_told = self._is_hold_told or bool(self._why)
        self._tell("needs_person", self._why, about=question, question=question, answers=answers)

    def held(self, why: str, needs_person: bool, ordered: Order | None) -> None:  # noqa: ARG002
        """Tell of a hold that ends by itself; for others somebody is asked."""
        self._why, self._goes_on_from = why, ""
        if not needs_person:
            self._is_hold_told = True
            self._tell("holds", f"It goes on by itself when all is good again: {why}", about=why)

    def continued(self) -> None:
        """Another hold may yet come before the next step."""
        if self._is_hold_told:
            self._goes_on_from = self._why
        self._why = ""

    def asked(self, question: str, answers: Sequence[str]) -> None:
        """Wait whether somebody answers."""
        self._question = question, tuple(answers)
        self._tell_after_s = self._bench.clock.now() + UNANSWERED_S

    def answered(self) -> None:
        """Nothing is open."""
        self._tell_after_s = math.inf

    def ended(self, outcome: RunOutcome) -> None:
        """Tell how it ended, and whether the bench is safe."""
        unsafe = [f"{each.what}: {each.problem}" for each in outcome.safe_state if each.problem]
        why = [outcome.reason] if outcome.reason else []
        why += [f"The bench is NOT in its safe state: {text}" for text in unsafe]
        why.append(f"{len(self._done.finished)} of {self._plan.dwell_count} dwells measured.")
        self._tell("ends", "\n".join(why), about=outcome.ended, ended=outcome.ended)

    def _tell(self, event: Event, why: str, about: str, **details: Any) -> None:
        dwells = self._plan.dwell_count - len(self._done.finished) - len(self._done.skipped)
        message = Message(
            event=event,
            why=why,
            station=self._bench.station.file.station,
            time=self._bench.clock.utc(),
            folder=self._folder.path.absolute(),
            procedure=self._plan.procedure.procedure,
            unit=self._unit,
            remaining=Remaining(self._left_s / 3600.0, dwells),
            **details,
        )
        self._messenger.send(message, about)
