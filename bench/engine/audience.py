"""Several who watch one run."""

from __future__ import annotations

from collections.abc import Sequence

from gyrobench.bench.bias.bias_filter import StateSpaceEstimate
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.orders import Order
from gyrobench.bench.engine.outcome import RunOutcome
from gyrobench.bench.engine.people import Progress
from gyrobench.bench.procedure.plan import PlannedStep
from gyrobench.bench.runs.folder import RunFolder


class Audience(Progress):
    """Tells each of its members everything, in their order."""

    def __init__(self, *members: Progress) -> None:
        self._members = members

    def begun(self, folder: RunFolder, bench: LiveBench, outcome: RunOutcome) -> None:  # noqa: D102
        for member in self._members:
            member.begun(folder, bench, outcome)

    def told(self, text: str) -> None:  # noqa: D102
        for member in self._members:
            member.told(text)

    def identified(self, unit: str) -> None:  # noqa: D102
        for member in self._members:
            member.identified(unit)

    def step_started(self, planned: PlannedStep, bench: LiveBench) -> None:  # noqa: D102
        for member in self._members:
            member.step_started(planned, bench)

    def beat(self, bench: LiveBench) -> None:  # noqa: D102
        for member in self._members:
            member.beat(bench)

    def ticked(self, bench: LiveBench, left_s: float) -> None:  # noqa: D102
        for member in self._members:
            member.ticked(bench, left_s)

    def estimated(self, estimate: StateSpaceEstimate) -> None:  # noqa: D102
        for member in self._members:
            member.estimated(estimate)

    def dwell_measured(self, row: DwellRow) -> None:  # noqa: D102
        for member in self._members:
            member.dwell_measured(row)

    def held(self, why: str, needs_person: bool, ordered: Order | None) -> None:  # noqa: D102
        for member in self._members:
            member.held(why, needs_person, ordered)

    def continued(self) -> None:  # noqa: D102
        for member in self._members:
            member.continued()

    def asked(self, question: str, answers: Sequence[str]) -> None:  # noqa: D102
        for member in self._members:
            member.asked(question, answers)

    def answered(self) -> None:  # noqa: D102
        for member in self._members:
            member.answered()

    def ended(self, outcome: RunOutcome) -> None:  # noqa: D102
        for member in self._members:
            member.ended(outcome)
