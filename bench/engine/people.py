"""The people of a run: who watches, who can be asked, and what they order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from bench.bias.state_space.bias_filter import StateSpaceEstimate
from bench.bias.tables.dwell_table import DwellRow
from bench.engine.live_bench import LiveBench
from bench.engine.operator import Operator
from bench.engine.orders import Orders
from bench.procedure.plan import PlannedStep


class Progress(Protocol):
    """Somebody who watches a run."""

    def told(self, text: str) -> None:
        """Something that a person should know."""
        ...

    def step_started(self, planned: PlannedStep, bench: LiveBench) -> None:
        """A step begins."""
        ...

    def ticked(self, bench: LiveBench, left_s: float) -> None:
        """Time went on; so much is left by the plan."""
        ...

    def estimated(self, estimate: StateSpaceEstimate) -> None:
        """The biases of the dwell under way, as far as they are known by now."""
        ...

    def dwell_measured(self, row: DwellRow) -> None:
        """A dwell is over and its biases are known."""
        ...


@dataclass(frozen=True)
class People:
    """Who can be asked, who watches, and what they order."""

    operator: Operator
    progress: Progress
    orders: Orders
