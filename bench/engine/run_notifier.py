"""Messages about a run to people elsewhere: holds, questions that stay unanswered, its end."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.observers import RunObserver
from gyrobench.bench.engine.operator import RunCommand
from gyrobench.bench.engine.resume import ResumeState
from gyrobench.bench.engine.run_outcome import RunOutcome
from gyrobench.bench.foundations.text import flag_text
from gyrobench.bench.messages.delivery import Event, Message, Remaining
from gyrobench.bench.messages.messenger import Messenger
from gyrobench.bench.procedure.plan import Plan, PlannedStep
from gyrobench.bench.runs.folder import RunFolder

#: A question that is answered within this time needs no message: the operator is at the bench.
UNANSWERED_S = 30.0
#: So many flagged dwells of a unit in a row are no disturbance: the run may measure nothing.
_FLAGGED_IN_A_ROW = 3


class RunNotifier(RunObserver):
    """Sends messages about a run."""

    def __init__(self, messenger: Messenger, plan: Plan, state: ResumeState) -> None:
        self._messenger = messenger
        self._plan = plan
        self._state = state
        self._unit = state.unit
        self._left_s = (
            plan.duration_s - plan.steps[state.resume_index(plan)].start_s if not state.is_over(plan) else 0.0
        )
        self._why = ""
        self._is_hold_sent = False
        self._question: tuple[str, tuple[str, ...]] = ("", ())
        self._send_after_s = math.inf
        self._continued_after = ""
        self._flagged: Counter[str] = Counter()  # dwells in a row, by unit
        self._bench: LiveBench
        self._folder: RunFolder

    def begun(self, folder: RunFolder, bench: LiveBench, outcome: RunOutcome) -> None:  # noqa: ARG002
        """Keep where the run is."""
        self._folder, self._bench = folder, bench

    def identified(self, unit: str) -> None:
        """Keep the serial number."""
        self._unit = unit

    def step_started(self, planned: PlannedStep, bench: LiveBench) -> None:  # noqa: ARG002
        """Send that a hold is over, once a step begins."""
        self._left_s = self._plan.duration_s - planned.start_s
        if why := self._continued_after:
            self._send("resumes", f"The hold is over: {why}", about=why)
            self._continued_after, self._is_hold_sent = "", False

    def ticked(self, bench: LiveBench, left_s: float) -> None:  # noqa: ARG002
        """Keep what is left."""
        self._left_s = max(0.0, left_s)

    def beat(self, bench: LiveBench) -> None:
        """Send a question that stays unanswered."""
        if bench.clock.now() < self._send_after_s:
            return
        self._send_after_s = math.inf
        question, answers = self._question
        self._is_hold_sent = self._is_hold_sent or bool(self._why)
        self._send("needs_person", self._why, about=question, question=question, answers=answers)

    def dwell_measured(self, row: DwellRow) -> None:
        """Send that several dwells in a row are flagged, once until one is not."""
        self._flagged[row.unit] = self._flagged[row.unit] + 1 if row.flags else 0
        if self._flagged[row.unit] == _FLAGGED_IN_A_ROW:
            why = (
                f"The last {_FLAGGED_IN_A_ROW} dwells are flagged, number {row.dwell}: {flag_text(row.flags)}"
            )
            self._send("dwells_flagged", why, about=row.unit)

    def dropped(self, unit: str, why: str) -> None:
        """Send that a unit is left out."""
        self._send("unit_dropped", f"Unit {unit}: {why}", about=unit)

    def held(self, why: str, needs_person: bool, command: RunCommand | None) -> None:  # noqa: ARG002
        """Send a hold that ends without the operator; for others the operator is asked."""
        self._why, self._continued_after = why, ""
        if not needs_person:
            self._is_hold_sent = True
            self._send("holds", f"It continues without an operator once nothing is tripped: {why}", about=why)

    def continued(self) -> None:
        """Wait for the next step: another hold may come before it."""
        if self._is_hold_sent:
            self._continued_after = self._why
        self._why = ""

    def asked(self, question: str, answers: Sequence[str]) -> None:
        """Wait for an answer."""
        self._question = question, tuple(answers)
        self._send_after_s = self._bench.clock.now() + UNANSWERED_S

    def answered(self) -> None:
        """Forget the question."""
        self._send_after_s = math.inf

    def ended(self, outcome: RunOutcome) -> None:
        """Send how the run ended, and whether the bench is safe."""
        unsafe = [f"{each.what}: {each.problem}" for each in outcome.safe_state if each.problem]
        why = [outcome.reason] if outcome.reason else []
        why += [f"The bench is NOT in its safe state: {text}" for text in unsafe]
        why.append(f"{len(self._state.finished)} of {self._plan.dwell_count} dwells measured.")
        self._send("ends", "\n".join(why), about=outcome.ended, ended=outcome.ended)

    def _send(self, event: Event, why: str, about: str, **details: Any) -> None:
        dwells = self._plan.dwell_count - len(self._state.finished) - len(self._state.skipped)
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
