"""Hours on the bench until a tie is settled, by several ways of choosing the next block.

Units whose first campaign ends with several hypotheses, of other physics than the search
(:mod:`tests.benchmarks.investigation_units`). As a script it prints the tables of
docs/decisions/14-next-measurement.md; ``--criteria`` compares the first block that other criteria choose::

    python -m tests.benchmarks.bench_investigation --units 843 913
    python -m tests.benchmarks.bench_investigation --criteria
"""

import argparse
import copy
import functools
import itertools
import statistics
import time
from dataclasses import dataclass

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.investigation.forecast import Forecast
from gyrobench.bench.investigation.investigation import MAX_TESTS, PATIENCE
from gyrobench.bench.investigation.open_hypotheses import (
    SLOW,
    confirming_rivals,
    inexact_law_rivals,
    is_settled,
    only_unconfirmed,
    rivals_of,
    search_campaign,
)
from gyrobench.bench.investigation.proposal import (
    PossibleBlocks,
    is_confirmed_by,
    outcome_of,
    propose,
    remaining_hours_of,
)
from tests.benchmarks.closure_laws import ON_THE_LIST
from tests.benchmarks.investigation_units import SimulatedUnit

#: Units that no rule was found on. About half of their first campaigns end tied.
UNITS = range(843, 914)
_MAX_BLOCKS = 8
TO_CONFIRM = "to confirm: "


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
    """Whether there is an effect, on the list, and no hypothesis is settled."""
    posterior = closure.posterior
    return (
        closure.verdict == "ambiguous"
        and posterior.no_effect_probability < 0.05
        and posterior.unlisted_probability < 0.5
    )


def ties(seeds):
    """The units whose first campaign ends tied."""
    return [tie for tie in map(Tie, seeds) if is_tied(tie.closure)]


class Tie:
    """A unit with a tie; what follows a sequence of blocks is measured and searched once."""

    def __init__(self, seed):
        self.seed, unit = seed, unit_of(seed)
        self._held_out = [max(row.cycle for row in unit.rows)]
        self.campaign_h = (unit.rows[-1].end_s - unit.rows[0].start_s) / 3600.0
        self.truth = frozenset(unit.kinds)
        self._known = {(): State(unit, unit.rows, self._held_out, ())}

    @property
    def first(self):
        """The state after the first campaign."""
        return self._known[()]

    @property
    def closure(self):
        """Search of the first campaign."""
        return self.first.closure

    def settle(self, value):
        """Measure blocks of largest ``value`` until a settled hypothesis is tested, within one campaign."""
        blocks, hours, choice_s = (), 0.0, 0.0
        while True:
            state = self._known[blocks]
            is_stated, chosen, tested = self._next(state, value, self.campaign_h - hours)
            choice_s = max(choice_s, state.choice_s)
            if chosen is None or len(blocks) == _MAX_BLOCKS:
                is_stated &= not state.names >= SLOW and not any(
                    each.contradicts for each in state.tests()[-1:]
                )
                hours = hours if is_stated else self.campaign_h
                return Settled(hours, is_stated, is_stated and state.names == self.truth, blocks, choice_s)
            hours += chosen.block.plan.duration_h
            blocks = (*blocks, f"{TO_CONFIRM}{chosen.block.name}" if tested else chosen.block.name)
            if blocks not in self._known:
                unit = copy.deepcopy(state.unit)
                new = unit.measure(chosen.block.plan)
                rivals = tested or confirming_rivals(state.closure)
                hypothesis = frozenset(rivals[0].names)
                outcome = hypothesis and outcome_of(state.forecast, chosen, new, rivals)
                outcomes = [*state.outcomes, *([(hypothesis, outcome, bool(tested))] if outcome else [])]
                self._known[blocks] = State(unit, [*state.rows, *new], self._held_out, blocks, outcomes)

    def _next(self, state, value, left_h):
        """Whether a hypothesis is stated, the next block, and rivals that it tests by the command."""
        closure, rivals = state.closure, confirming_rivals(state.closure)
        test_value = by_test if value in (by_entropy, by_hours_left) else value

        def best(found, by):
            useful = [each for each in found if each.can_help and each.block.plan.duration_h <= left_h]
            return max(useful, key=lambda each: by(each, state), default=None)

        def is_stated(*, with_weak):
            is_confirmed = is_confirmed_by(each for names, each, _ in state.outcomes if names == state.names)
            return is_settled(closure) or (is_confirmed and only_unconfirmed(closure, with_weak=with_weak))

        def test():
            needs_test = state.names and not state.tests()
            return best(state.confirming, test_value) if needs_test else None

        is_late = len(state.blocks) - sum(is_test for *_, is_test in state.outcomes) >= PATIENCE
        for with_weak in (False,) if is_late else (True, False):
            if is_stated(with_weak=with_weak):
                return True, test(), rivals
            tests = state.tests()
            is_enough = tests and (tests[-1].is_clear or len(tests) == MAX_TESTS)
            if only_unconfirmed(closure, with_weak=with_weak) and not is_enough:
                if chosen := best(state.confirming, test_value):
                    return False, chosen, rivals
            elif chosen := best(state.proposals, value):
                return False, chosen, ()
        rivals = inexact_law_rivals(closure)
        if rivals and not state.tests(rivals[0].names):
            return False, best(state.proposed(rivals), test_value), rivals
        return False, None, ()


class State:
    """A unit and its dwells after some blocks, with their search."""

    def __init__(self, unit, rows, held_out, blocks, outcomes=()):
        self.unit, self.rows, self.blocks = unit, rows, blocks
        #: Hypothesis that a block was compared with, the outcome, and whether it was measured for that.
        self.outcomes = outcomes
        self._measured = [each.removeprefix(TO_CONFIRM).split(", then ") for each in blocks]
        self.closure = search_campaign(campaign_of(rows), held_out)
        self.names = frozenset(self.closure.names)
        self.choice_s = 0.0

    def tests(self, names=None):
        """Outcomes of the blocks that tested a hypothesis; by default that found."""
        hypothesis = frozenset(names or self.names)
        return [each for of, each, is_test in self.outcomes if is_test and of == hypothesis]

    @functools.cached_property
    def proposals(self):
        """All blocks with what the hypotheses predict."""
        return self.proposed(rivals_of(self.closure))

    @functools.cached_property
    def confirming(self):
        """All blocks with what the hypothesis found predicts, and what is predicted without it."""
        return self.proposed(confirming_rivals(self.closure))

    @functools.cached_property
    def forecast(self):
        return Forecast(self.closure.noise.weighted(self.rows), self.closure.noise.scales)

    def proposed(self, rivals):
        begin_s = time.process_time()
        found = propose(self.forecast, rivals, PossibleBlocks(measured=self._measured))
        self.choice_s = time.process_time() - begin_s
        return found


def by_hours_left(proposal, state):
    """Fewest expected hours left, the choice of an adaptive campaign."""
    return -remaining_hours_of(state.proposals)(proposal)


def by_entropy(proposal, state):
    """Expected fall of the entropy per hour, the choice of `gyrobench investigate`."""
    return proposal.gain_per_h


def by_test(proposal, state):
    """How far the block tests the hypothesis, per hour: how `gyrobench investigate` confirms one."""
    return proposal.tested_per_h


def by_d_optimality(proposal, state):
    """Fall of the log determinant of the parameters' covariance of the best hypothesis, per hour."""
    sigma_dph = state.closure.noise.scales * np.array([row.sigma_dph for row in proposal.rows])
    determinant = np.linalg.slogdet(proposal.predictions[0].covariance)[1]
    return (determinant - 2.0 * np.sum(np.log(sigma_dph))) / proposal.block.plan.duration_h


def by_chance(proposal, state):
    """Blocks of one kind in random order, another one for each unit."""
    name, seed = proposal.block.name.encode(), int(state.rows[0].unit[1:])
    draw = np.random.default_rng([seed, 31, len(state.rows), *name])
    return draw.random() - 2.0 * (len(proposal.block.kinds) > 1)


def by_hunter_reiner(proposal, state):
    """Sum of the squared differences of the means (1965)."""
    return sum(float(apart @ apart) for apart, *_ in _pairs(proposal)) / proposal.block.plan.duration_h


def by_box_hill(proposal, state):
    """Upper bound of the expected information (1967)."""
    total = 0.0
    for apart, first, second, weight in _pairs(proposal, state):
        one, other = np.linalg.inv(first), np.linalg.inv(second)
        total += weight * np.trace(first @ other + second @ one - 2.0 * np.eye(len(apart)))
        total += weight * apart @ (one + other) @ apart
    return 0.5 * total / proposal.block.plan.duration_h


def by_buzzi_ferraris(proposal, state):
    """Differences in units of their uncertainty (1990)."""
    noise = np.diag(
        (state.closure.noise.scales * np.array([row.sigma_dph for row in proposal.rows])).T.ravel() ** 2
    )
    total = 0.0
    for apart, first, second, _ in _pairs(proposal):
        inverse = np.linalg.inv(first + second)
        total += np.trace(noise @ inverse) + apart @ inverse @ apart
    return total / proposal.block.plan.duration_h


def by_akaike_weights(proposal, state):
    """Expected Akaike weight of the true hypothesis, above that without a measurement (Michalik 2010)."""
    predictions, probabilities = proposal.predictions, _probabilities(state)
    expected = -1.0 / len(predictions)
    for truth, probability in zip(predictions, probabilities, strict=True):
        inverse = np.linalg.inv(truth.covariance)
        apart = [truth.mean_dph - each.mean_dph for each in predictions]
        expected += probability / sum(np.exp(-0.5 * each @ inverse @ each) for each in apart)
    return expected / proposal.block.plan.duration_h


def by_jensen_renyi(proposal, state):
    """Quadratic Jensen-Renyi divergence (Olofsson 2019)."""
    predictions, probabilities = proposal.predictions, _probabilities(state)

    def overlap(one, other):
        covariance = one.covariance + other.covariance
        apart = one.mean_dph - other.mean_dph
        return -0.5 * (apart @ np.linalg.solve(covariance, apart) + np.linalg.slogdet(covariance)[1])

    mixed = [
        np.log(first * second) + overlap(one, other)
        for one, first in zip(predictions, probabilities, strict=True)
        for other, second in zip(predictions, probabilities, strict=True)
    ]
    alone = sum(p * overlap(each, each) for each, p in zip(predictions, probabilities, strict=True))
    return (alone - np.logaddexp.reduce(mixed)) / proposal.block.plan.duration_h


def _probabilities(state):
    return [each.probability for each in rivals_of(state.closure)]


def _pairs(proposal, state=None):
    """Difference of the means, both covariances, and the product of the probabilities of all pairs."""
    weights = _probabilities(state) if state else [1.0] * len(proposal.predictions)
    for one, other in itertools.combinations(range(len(weights)), 2):
        first, second = proposal.predictions[one], proposal.predictions[other]
        apart = first.mean_dph - second.mean_dph
        yield apart, first.covariance, second.covariance, weights[one] * weights[other]


WAYS = {
    "entropy per hour": by_entropy, "hours left": by_hours_left, "D-optimal": by_d_optimality,
    "random": by_chance,
}  # fmt: skip
CRITERIA = {
    "Hunter-Reiner": by_hunter_reiner, "Box-Hill": by_box_hill, "Buzzi-Ferraris": by_buzzi_ferraris,
    "Akaike weights": by_akaike_weights, "Jensen-Renyi": by_jensen_renyi, "D-optimal": by_d_optimality,
}  # fmt: skip


def settled(seeds):
    """Outcome of each way for each tie, and the hours of the ties' first campaigns."""
    found = ties(seeds)
    ends = {name: [tie.settle(value) for tie in found] for name, value in WAYS.items()}
    return ends, [tie.campaign_h for tie in found]


def of_each(seeds):
    """Line of each unit: how its first campaign ends, and what entropy per hour makes of a tie."""
    for seed in seeds:
        tie = Tie(seed)
        truth, names = (" and ".join(sorted(each)) for each in (tie.truth, tie.closure.names))
        if is_tied(tie.closure):
            end = tie.settle(by_entropy)
            state = "right" if end.is_right else "wrong" if end.is_settled else "open"
            yield f"{seed} {truth}: {state}, {end.hours:.1f} h, {'; '.join(end.blocks)}"
        else:
            yield f"{seed} {truth}: no tie, {tie.closure.verdict} {names}"


def table(found, campaigns_h):
    """Lines of a table of what was settled, and in which time."""
    yield "| blocks by | settled | right | hours, median | mean | share of the first campaign, median |"
    yield "|---|---|---|---|---|---|"
    for name, ends in found.items():
        done = [each for each in ends if each.is_settled]
        shares = [each.hours / whole_h for each, whole_h in zip(ends, campaigns_h, strict=True)]
        yield (
            f"| {name} | {len(done)} of {len(ends)} | {sum(each.is_right for each in done)} of {len(done)} | "
            f"{statistics.median(each.hours for each in ends):.1f} | "
            f"{statistics.mean(each.hours for each in ends):.1f} | {statistics.median(shares):.2f} |"
        )


def criteria_table(seeds):
    """Lines of a table: how often a criterion chooses the same first block, and what its choice is worth."""
    states = [tie.first for tie in ties(seeds)]
    yield "| criterion per hour | same first block | entropy per hour of its block over the largest, median |"
    yield "|---|---|---|"
    for name, value in CRITERIA.items():
        shares = []
        for state in states:
            chosen = max(state.proposals, key=lambda each, state=state: value(each, state))
            shares.append(chosen.gain_per_h / max(each.gain_per_h for each in state.proposals))
        same = sum(share == 1.0 for share in shares)
        yield f"| {name} | {same} of {len(shares)} | {statistics.median(shares):.2f} |"


@pytest.fixture(scope="module")
def ends():
    found, campaigns_h = settled(UNITS)
    print("\n" + "\n".join(table(found, campaigns_h)))
    return found, campaigns_h


@pytest.mark.timeout(7200)
def test_a_block_is_chosen_in_ten_seconds(ends):
    longest_s = max(each.choice_s for each in ends[0]["entropy per hour"])
    print(f"longest choice of a block: {longest_s:.1f} s of processor time")
    assert longest_s <= 10.0


def test_nine_of_ten_ties_are_settled(ends):
    own = ends[0]["entropy per hour"]
    assert sum(each.is_settled for each in own) >= 0.9 * len(own)


def test_ties_are_settled_in_a_quarter_of_a_campaign(ends):
    found, campaigns_h = ends
    own = found["entropy per hour"]
    shares = [each.hours / whole_h for each, whole_h in zip(own, campaigns_h, strict=True)]
    assert statistics.median(shares) <= 0.25


def test_every_settled_hypothesis_is_right(ends):
    own = ends[0]["entropy per hour"]
    assert all(each.is_right for each in own if each.is_settled)


def median_h(ends, way):
    return statistics.median(each.hours for each in ends[0][way])


def test_d_optimal_blocks_need_longer(ends):
    assert median_h(ends, "entropy per hour") <= median_h(ends, "D-optimal")


def test_random_blocks_need_twice_as_long(ends):
    assert median_h(ends, "entropy per hour") <= 0.5 * median_h(ends, "random")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--units", type=int, nargs=2, metavar=("FIRST", "LAST"))
    parser.add_argument("--criteria", action="store_true")
    parser.add_argument("--each", action="store_true", help="a line for each unit, by entropy per hour")
    options = parser.parse_args()
    units = range(options.units[0], options.units[1] + 1) if options.units else UNITS
    for line in (
        criteria_table(units)
        if options.criteria
        else of_each(units)
        if options.each
        else table(*settled(units))
    ):
        print(line, flush=True)
