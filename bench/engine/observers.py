"""Interface of the observers of a run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from gyrobench.bench.bias.bias_filter import StateSpaceEstimate
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.operator import Operator, RunCommand
from gyrobench.bench.engine.run_outcome import RunOutcome
from gyrobench.bench.procedure.plan import PlannedStep
from gyrobench.bench.runs.folder import RunFolder


class RunObserver:
    """Watches a run; a subclass overrides the methods that it needs.

    No method may raise or take long: the run waits for it.
    """

    def begun(self, folder: RunFolder, bench: LiveBench, outcome: RunOutcome) -> None:
        """The instruments are open and the run folder exists.

        ``outcome`` holds what was measured before the run was resumed; the run adds to it.
        """

    def noted(self, text: str) -> None:
        """A note for the operator."""

    def identified(self, unit: str) -> None:
        """The serial number of the INS is known."""

    def dropped(self, unit: str, reason: str) -> None:
        """A unit, one of several, is left out of the rest of the run."""

    def step_started(self, planned: PlannedStep, bench: LiveBench) -> None:
        """A step begins."""

    def beat(self, bench: LiveBench) -> None:
        """A tick has passed, in a step or in a hold."""

    def ticked(self, bench: LiveBench, left_s: float) -> None:
        """A tick has passed in a step; ``left_s`` remain by the plan."""

    def estimable(self, estimate: Callable[[], StateSpaceEstimate | None]) -> None:
        """The biases of the dwell in progress can be estimated, until its step is over.

        ``estimate`` computes the estimate at its first call, and returns None while the biases are not
        observable. It takes milliseconds, which is long on virtual time: call it only to show the result.
        """

    def dwell_measured(self, row: DwellRow) -> None:
        """A dwell is over and its biases are estimated."""

    def held(self, reason: str, needs_person: bool, command: RunCommand | None) -> None:
        """The run holds; ``command`` is None if an interlock is the cause."""

    def continued(self) -> None:
        """A hold is over."""

    def asked(self, question: str, answers: Sequence[str]) -> None:
        """The operator is asked."""

    def answered(self) -> None:
        """No question is open."""

    def ended(self, outcome: RunOutcome) -> None:
        """The bench is safe and the run is over."""


_EVENT_NAMES = [name for name in vars(RunObserver) if not name.startswith("_")]


class ObserverGroup(RunObserver):
    """Notifies each of its members that needs an event, in their order."""

    def __init__(self, *members: RunObserver) -> None:
        for name in _EVENT_NAMES:
            base_method = getattr(RunObserver, name)
            handlers: list[Callable[..., None]] = []
            for method in (getattr(member, name) for member in members):
                if isinstance(method, partial):  # of a nested group
                    handlers += method.args[0]
                elif getattr(method, "__func__", None) is not base_method:
                    handlers.append(method)
            setattr(self, name, handlers[0] if len(handlers) == 1 else partial(_notify, handlers))


def _notify(methods: Sequence[Callable[..., None]], *arguments: object) -> None:
    for method in methods:
        method(*arguments)


class ObservedOperator:
    """An operator whose open question the observers see."""

    def __init__(self, operator: Operator, observer: RunObserver) -> None:
        self._operator = operator
        self._observer = observer

    def ask(self, question: str, answers: Sequence[str]) -> None:
        """Ask a question."""
        self._observer.asked(question, answers)
        self._operator.ask(question, answers)

    def answer(self) -> str | None:
        """Return the answer, or None while there is none."""
        answer = self._operator.answer()
        if answer is not None:
            self._observer.answered()
        return answer

    def withdraw(self) -> None:
        """Withdraw the open question."""
        self._observer.answered()
        self._operator.withdraw()

    def command(self) -> RunCommand | None:
        """Return a typed command, or None."""
        return self._operator.command()
