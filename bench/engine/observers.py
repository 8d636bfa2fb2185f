"""Observers of a run: what they are notified of."""

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
        """Something that the operator should know."""

    def identified(self, unit: str) -> None:
        """The serial number of the INS is known."""

    def dropped(self, unit: str, why: str) -> None:
        """A unit, one of several, is left out of the rest of the run."""

    def step_started(self, planned: PlannedStep, bench: LiveBench) -> None:
        """A step begins."""

    def beat(self, bench: LiveBench) -> None:
        """A tick has passed, in a step or in a hold."""

    def ticked(self, bench: LiveBench, left_s: float) -> None:
        """A tick has passed in a step; ``left_s`` remain by the plan."""

    def estimable(self, estimate: Callable[[], StateSpaceEstimate | None]) -> None:
        """The biases of the dwell in progress can be estimated again, until its step is over.

        ``estimate`` does so at its first call, and returns None as long as they are not observable. It takes
        milliseconds, and on virtual time a dwell takes a fraction of a second: an observer calls it only for
        what it shows.
        """

    def dwell_measured(self, row: DwellRow) -> None:
        """A dwell is over and its biases are known."""

    def held(self, why: str, needs_person: bool, command: RunCommand | None) -> None:
        """The run holds: by a command, or (None) because of an interlock."""

    def continued(self) -> None:
        """A hold is over."""

    def asked(self, question: str, answers: Sequence[str]) -> None:
        """The operator is asked."""

    def answered(self) -> None:
        """No question is open."""

    def ended(self, outcome: RunOutcome) -> None:
        """The bench is safe and the run is over."""


_EVENTS = [name for name in vars(RunObserver) if not name.startswith("_")]


class ObserverGroup(RunObserver):
    """Notifies each of its members that needs an event, in their order."""

    def __init__(self, *members: RunObserver) -> None:
        for name in _EVENTS:
            ignores = getattr(RunObserver, name)
            needed: list[Callable[..., None]] = []
            for method in (getattr(member, name) for member in members):
                if isinstance(method, partial):  # of a group
                    needed += method.args[0]
                elif getattr(method, "__func__", None) is not ignores:
                    needed.append(method)
            setattr(self, name, needed[0] if len(needed) == 1 else partial(_notify, needed))


def _notify(methods: Sequence[Callable[..., None]], *details: object) -> None:
    for method in methods:
        method(*details)


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
