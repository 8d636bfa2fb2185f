"""The people of a run: who watches, who can be asked, and what they order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gyrobench.bench.bias.bias_filter import StateSpaceEstimate
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.operator import Operator
from gyrobench.bench.engine.orders import Order, Orders
from gyrobench.bench.engine.outcome import RunOutcome
from gyrobench.bench.procedure.plan import PlannedStep
from gyrobench.bench.runs.folder import RunFolder


class Progress:
    """Somebody who watches a run; each kind overrides what it wants to know of.

    Nothing that is told here may raise, nor take long: the run waits for it.
    """

    def begun(self, folder: RunFolder, bench: LiveBench, outcome: RunOutcome) -> None:
        """The instruments are open and the run folder is there.

        ``outcome`` holds what was measured before the run was resumed, and grows from here on.
        """

    def told(self, text: str) -> None:
        """Something that a person should know."""

    def identified(self, unit: str) -> None:
        """The serial number of the INS is known."""

    def step_started(self, planned: PlannedStep, bench: LiveBench) -> None:
        """A step begins."""

    def beat(self, bench: LiveBench) -> None:
        """A tick has passed, in a step or in a hold."""

    def ticked(self, bench: LiveBench, left_s: float) -> None:
        """A tick has passed in a step; so much is left by the plan."""

    def estimated(self, estimate: StateSpaceEstimate) -> None:
        """The biases of the dwell under way, as far as they are known by now."""

    def dwell_measured(self, row: DwellRow) -> None:
        """A dwell is over and its biases are known."""

    def held(self, why: str, needs_person: bool, ordered: Order | None) -> None:
        """The run holds; ``ordered`` is the order that led to it, None where something tripped."""

    def continued(self) -> None:
        """A hold is over."""

    def asked(self, question: str, answers: Sequence[str]) -> None:
        """A person is asked."""

    def answered(self) -> None:
        """No question is open any more."""

    def ended(self, outcome: RunOutcome) -> None:
        """The bench is safe and the run is over."""


class AnnouncedOperator:
    """An operator whose open question is known to those who watch.

    Parameters
    ----------
    operator : Operator
        Who answers.
    progress : Progress
        Who watches.
    """

    def __init__(self, operator: Operator, progress: Progress) -> None:
        self._operator = operator
        self._progress = progress

    def ask(self, question: str, answers: Sequence[str]) -> None:
        """Put a question."""
        self._progress.asked(question, answers)
        self._operator.ask(question, answers)

    def answer(self) -> str | None:
        """The answer, or None while there is none."""
        answer = self._operator.answer()
        if answer is not None:
            self._progress.answered()
        return answer

    def withdraw(self) -> None:
        """Withdraw the question."""
        self._progress.answered()
        self._operator.withdraw()

    def order(self) -> Order | None:
        """An order given without being asked."""
        return self._operator.order()


@dataclass(frozen=True)
class People:
    """Who can be asked, who watches, and what they order."""

    operator: Operator
    progress: Progress
    orders: Orders
