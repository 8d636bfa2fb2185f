"""Hours on the bench until a tie is settled, by several ways of choosing the next block.

Units whose first campaign ends with several causes, of other physics than the search
(:mod:`tests.benchmarks.investigation_units`). As a script it prints the table of
docs/decisions/14-next-measurement.md; ``--criteria`` adds the criteria of GPdoemd::

    python -m tests.benchmarks.bench_investigation --criteria
"""

import copy
import functools
import time
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.investigation.forecast import Forecast
from gyrobench.bench.investigation.investigation import MIN_GAIN, is_settled, rivals_of, searched
from gyrobench.bench.investigation.proposal import propose
from tests.benchmarks.closure_laws import ON_THE_LIST
from tests.benchmarks.investigation_units import SimulatedUnit

#: Seeds of units of which the first campaign ends tied: all of a range, none left out.
SEEDS = range(80)
_MAX_BLOCKS = 8
_RANDOM_DRAWS = 2


@dataclass(frozen=True)
class Settled:
    """How one way of choosing ended for one unit."""

    hours: float  #: On the bench after the first campaign, or to the limit.
    is_settled: bool
    is_right: bool
    blocks: tuple[str, ...]
    choice_s: float  #: Longest choice of a block, CPU time.


def unit_of(seed):
    """A unit with one or two effects, and two or three cycles."""
    draw = np.random.default_rng([seed, 29])
    count = 1 if draw.random() < 0.75 else 2
    kinds = draw.choice([*ON_THE_LIST], count, replace=False).tolist()
    sizes = np.exp(draw.uniform(np.log(1.0), np.log(10.0), count)).tolist()
    cycles = int(np.random.default_rng([seed, 30]).integers(2, 4))
    return SimulatedUnit(seed, kinds, sizes, cycles)


def is_tied(closure):
    """Whether there is an effect, on the list, and no cause is settled."""
    posterior = closure.posterior
    return closure.verdict == "ambiguous" and posterior.nothing < 0.05 and posterior.not_on_list < 0.5


class Tie:
    """A unit with a tie; what follows a sequence of blocks is measured and searched once."""

    def __init__(self, seed):
        unit = unit_of(seed)
        self._held_out = [max(row.cycle for row in unit.rows)]
        self.campaign_h = (unit.rows[-1].end_s - unit.rows[0].start_s) / 3600.0
        self.truth = frozenset(unit.kinds)
        self._known = {(): State(unit, unit.rows, self._held_out, ())}

    @property
    def closure(self):
        """Search of the first campaign."""
        return self._known[()].closure

    def settle(self, value):
        """Measure blocks of largest ``value`` until a cause is settled, for at most one campaign."""
        blocks, hours, choice_s = (), 0.0, 0.0
        while True:
            state = self._known[blocks]
            if is_settled(state.closure):
                is_right = {each.effect.name for each in state.closure.effects} == self.truth
                return Settled(hours, True, is_right, blocks, choice_s)
            left_h = self.campaign_h - hours
            useful = [
                each
                for each in state.proposals
                if each.entropy - each.expected_entropy > MIN_GAIN and each.block.plan.duration_h <= left_h
            ]
            choice_s = max(choice_s, state.choice_s)
            if not useful or len(blocks) == _MAX_BLOCKS:
                return Settled(self.campaign_h, False, False, blocks, choice_s)
            chosen = max(useful, key=lambda each: value(each, state))
            hours += chosen.block.plan.duration_h
            blocks = (*blocks, chosen.block.name)
            if blocks not in self._known:
                unit = copy.deepcopy(state.unit)
                new = unit.measure(chosen.block.plan)
                self._known[blocks] = State(unit, [*state.rows, *new], self._held_out, blocks)


class State:
    """A unit and its dwells after some blocks, with their search."""

    def __init__(self, unit, rows, held_out, blocks):
        self.unit, self.rows = unit, rows
        self._measured = [each.split(", then ") for each in blocks]
        self.closure = searched(campaign_of(rows), held_out)
        self.choice_s = 0.0

    @functools.cached_property
    def proposals(self):
        """All blocks with what the causes predict."""
        begin_s = time.process_time()
        rivals, scale = rivals_of(self.closure), self.closure.noise_scale
        found = propose(Forecast(self.rows), rivals, scale, measured=self._measured)
        self.choice_s = time.process_time() - begin_s
        return found


def by_entropy(proposal, state):
    """The choice of `gyrobench investigate`."""
    return proposal.gain_per_h


def by_d_optimality(proposal, state):
    """Fall of the logarithm of the determinant of the parameters' covariance of the best cause, per hour."""
    sigma_dph = state.closure.noise_scale * np.array([row.sigma_dph for row in proposal.rows])
    determinant = np.linalg.slogdet(proposal.predictions[0].covariance)[1]
    return (determinant - 2.0 * np.sum(np.log(sigma_dph))) / proposal.block.plan.duration_h


def by_chance(seed):
    """Blocks of one kind in random order."""
    draw = np.random.default_rng([seed, 31])
    return lambda proposal, state: draw.random() - 2.0 * (len(proposal.block.kinds) > 1)
