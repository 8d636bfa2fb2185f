"""Sends messages about a run: its holds, unanswered questions, and its end."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.observers import RunObserver
from gyrobench.bench.engine.operator import RunCommand
from gyrobench.bench.engine.resume_state import ResumeState
from gyrobench.bench.engine.run_outcome import RunOutcome
from gyrobench.bench.foundations.text import flag_text
from gyrobench.bench.messages.delivery import Event, Message, Remaining
from gyrobench.bench.messages.messenger import Messenger
from gyrobench.bench.procedure.plan import Plan, PlannedStep
from gyrobench.bench.runs.folder import RunFolder

#: A question answered within this time causes no message: the operator is at the bench.
UNANSWERED_S = 30.0
#: This number of successive flagged dwells of a unit is reported: the run may measure nothing.
_MAX_FLAGGED_IN_A_ROW = 3


class RunNotifier(RunObserver):
    """Sends messages about a run."""

    def __init__(self, messenger: Messenger, plan: Plan, progress: ResumeState) -> None:
        self._messenger = messenger
        self._plan = plan
        self._progress = progress
        self._unit = progress.unit
        self._remaining_s = 0.0
        if not progress.is_over(plan):
            self._remaining_s = plan.duration_s - plan.steps[progress.resume_index(plan)].start_s
        self._hold_reason = ""
        self._is_hold_sent = False
        self._question: tuple[str, tuple[str, ...]] = ("", ())
        self._send_after_s = math.inf
        self._ended_hold = ""
        self._flagged: Counter[str] = Counter()  # dwells in a row, by unit
        self._bench: LiveBench
        self._folder: RunFolder

    def begun(self, folder: RunFolder, bench: LiveBench, outcome: RunOutcome) -> None:  # noqa: ARG002
        """Store folder and bench."""
        self._folder, self._bench = folder, bench

    def identified(self, unit: str) -> None:
        """Store the serial number."""
        self._unit = unit

    def step_started(self, planned: PlannedStep, bench: LiveBench) -> None:  # noqa: ARG002
        """Send that a hold is over when the next step begins."""
        self._remaining_s = self._plan.duration_s - planned.start_s
        if reason := self._ended_hold:
            self._send("resumes", f"The hold is over: {reason}", about=reason)
            self._ended_hold, self._is_hold_sent = "", False

    def ticked(self, bench: LiveBench, left_s: float) -> None:  # noqa: ARG002
        """Store the remaining time."""
        self._remaining_s = max(0.0, left_s)

    def beat(self, bench: LiveBench) -> None:
        """Send a question that is still unanswered."""
        if bench.clock.now() < self._send_after_s:
            return
        self._send_after_s = math.inf
        question, answers = self._question
        self._is_hold_sent = self._is_hold_sent or bool(self._hold_reason)
        self._send("needs_person", self._hold_reason, about=question, question=question, answers=answers)

    def dwell_measured(self, row: DwellRow) -> None:
        """Send once that several successive dwells are flagged, until a dwell is not."""
        self._flagged[row.unit] = self._flagged[row.unit] + 1 if row.flags else 0
        if self._flagged[row.unit] == _MAX_FLAGGED_IN_A_ROW:
            flags = f"number {row.dwell}: {flag_text(row.flags)}"
            reason = f"The last {_MAX_FLAGGED_IN_A_ROW} dwells are flagged, {flags}"
            self._send("dwells_flagged", reason, about=row.unit)

    def dropped(self, unit: str, reason: str) -> None:
        """Send that a unit is dropped."""
        self._send("unit_dropped", f"Unit {unit}: {reason}", about=unit)

    def held(self, reason: str, needs_person: bool, command: RunCommand | None) -> None:  # noqa: ARG002
        """Send a hold that ends without the operator; the others are sent with their question."""
        self._hold_reason, self._ended_hold = reason, ""
        if not needs_person:
            self._is_hold_sent = True
            self._send(
                "holds", f"It continues without an operator once nothing is tripped: {reason}", about=reason
            )

    def continued(self) -> None:
        """Wait for the next step: another hold may come before it."""
        if self._is_hold_sent:
            self._ended_hold = self._hold_reason
        self._hold_reason = ""

    def asked(self, question: str, answers: Sequence[str]) -> None:
        """Wait for an answer."""
        self._question = question, tuple(answers)
        self._send_after_s = self._bench.clock.now() + UNANSWERED_S

    def answered(self) -> None:
        """Cancel the message about the question."""
        self._send_after_s = math.inf

    def ended(self, outcome: RunOutcome) -> None:
        """Send how the run ended, and whether the bench is safe."""
        unsafe = [f"{each.what}: {each.problem}" for each in outcome.safe_state if each.problem]
        lines = [outcome.reason] if outcome.reason else []
        lines += [f"The bench is NOT in its safe state: {text}" for text in unsafe]
        lines.append(f"{len(self._progress.finished)} of {self._plan.dwell_count} dwells measured.")
        lines += [outcome.skipped_text] if outcome.skipped_text else []
        self._send("ends", "\n".join(lines), about=outcome.ended, ended=outcome.ended)

    def _send(self, event: Event, reason: str, about: str, **details: Any) -> None:
        dwells = self._plan.dwell_count - len(self._progress.finished) - len(self._progress.skipped)
        message = Message(
            event=event,
            why=reason,
            station=self._bench.station.file.station,
            time=self._bench.clock.utc(),
            folder=self._folder.path.absolute(),
            procedure=self._plan.procedure.procedure,
            unit=self._unit,
            remaining=Remaining(self._remaining_s / 3600.0, dwells),
            **details,
        )
        self._messenger.send(message, about)
