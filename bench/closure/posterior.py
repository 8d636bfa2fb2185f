"""Probabilities of hypotheses: sets of effects, with or without a remainder from an unlisted effect.

:mod:`gyrobench.bench.closure.evidence` computes them; search, verdict and reports read them here. The
constants are the probabilities that verdicts and statements require.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from gyrobench.bench.closure.candidates import Candidate

#: Effects are tied if the posterior odds of one to the other are below this.
TIE_ODDS = 100.0
#: Other forms of an effect found are reported from this share of the probability on.
_FORM_SHARE = 0.05
#: Verdict "explained": smallest probability that all effects found are present, without a remainder.
EXPLAINED = 0.99
#: Another effect that is at least this probable is a rival: the verdict is then not "explained".
RIVAL = 0.1
#: Verdict "clean": smallest probability of the declared model alone.
CLEAN = 0.5


@dataclass(frozen=True)
class HypothesisProbability:
    """A hypothesis and its probability."""

    names: frozenset[str]  #: Effects.
    has_remainder: bool  #: Whether it includes an unlisted effect.
    probability: float  #: Posterior.
    #: The effects as fitted; in place of one that can't be fitted, the effect that it imitates.
    candidates: tuple[Candidate, ...]
    #: Share of the probability and fit of each combination of forms of the effects.
    forms: tuple[tuple[float, tuple[Candidate, ...]], ...] = ()


@dataclass(frozen=True)
class Posterior:
    """Probabilities after a search."""

    hypotheses: tuple[HypothesisProbability, ...]  #: Most probable first.
    process_probabilities: dict[str, float]  #: Of each process that a remainder may follow, if there is one.
    #: For each effect found, the effects of which it is a special case: more general laws of the same effect.
    more_general: Mapping[str, frozenset[str]] = field(default_factory=dict)

    @property
    def effect_probabilities(self) -> dict[str, float]:
        """Probability of each effect, in any set."""
        names = sorted(set().union(*(each.names for each in self.hypotheses)))
        return {
            name: sum(each.probability for each in self.hypotheses if name in each.names) for name in names
        }

    @property
    def sets(self) -> list[frozenset[str]]:
        """Sets of effects, ordered by their probability with or without a remainder, most probable first."""
        probabilities: dict[frozenset[str], float] = {}
        for each in self.hypotheses:
            probabilities[each.names] = probabilities.get(each.names, 0.0) + each.probability
        return sorted(probabilities, key=lambda names: -probabilities[names])

    @property
    def no_effect_probability(self) -> float:
        """Probability of the declared model alone."""
        return self.set_probability(())

    @property
    def unlisted_probability(self) -> float:
        """Probability of an unlisted effect, with or without listed ones."""
        return sum(each.probability for each in self.hypotheses if each.has_remainder)

    def set_probability(self, names: Collection[str]) -> float:
        """Probability of exactly these effects, without an unlisted one."""
        return sum(
            each.probability
            for each in self.hypotheses
            if each.names == frozenset(names) and not each.has_remainder
        )

    def joint_probability(self, names: Collection[str], *, has_remainder: bool | None = False) -> float:
        """Probability that all these effects are present, in any set, each as such or by a more general law.

        ``has_remainder``: whether an unlisted effect is present; None for either.
        """
        return sum(
            each.probability
            for each in self.hypotheses
            if self.contains(each, names) and has_remainder in (None, each.has_remainder)
        )

    def contains(self, hypothesis: HypothesisProbability, names: Collection[str]) -> bool:
        """Whether a hypothesis includes all these effects, each as such or by a more general law."""
        return all(hypothesis.names & {name, *self.more_general.get(name, ())} for name in names)

    def any_probability(self, names: Collection[str]) -> float:
        """Probability that at least one of these effects is present, alone or with others."""
        return sum(each.probability for each in self.hypotheses if each.names.intersection(names))

    def rivals(self, names: Collection[str]) -> dict[str, float]:
        """Other effects with a probability of at least ``RIVAL``, by name.

        A more general law in place of an effect that it contains is no rival.
        """
        probabilities: dict[str, float] = {}
        for each in self.hypotheses:
            general = (self.more_general.get(name, ()) for name in {*names} - each.names)
            for name in each.names.difference(names, *general):
                probabilities[name] = probabilities.get(name, 0.0) + each.probability
        return {name: probabilities[name] for name in sorted(probabilities) if probabilities[name] >= RIVAL}

    def odds(self, names: frozenset[str], other: frozenset[str]) -> float:
        """Odds of one set to another, both without a remainder."""
        probability, other_probability = (self.set_probability(each) for each in (names, other))
        return probability / other_probability if other_probability > 0.0 else math.inf

    def similar(self, names: frozenset[str]) -> list[frozenset[str]]:
        """Sets with one effect exchanged and odds against them below ``TIE_ODDS``, most probable first.

        Without sets that have a more general law in place of an effect.
        """
        min_probability = self.set_probability(names) / TIE_ODDS
        general = frozenset().union(*(self.more_general.get(name, ()) for name in names))
        return [
            each.names
            for each in self.hypotheses
            if not each.has_remainder
            and len(each.names) == len(names) == len(each.names & names) + 1
            and each.probability > min_probability
            and not each.names & general - names
        ]

    def other_forms(
        self, names: frozenset[str], candidate: Candidate
    ) -> list[tuple[float, tuple[Candidate, ...]]]:
        """Probability share and fit of a set of effects with one of them in other forms, most probable first.

        Of the most probable set that includes the effects ``names``, since their forms say nothing in a set
        that the data exclude. Only forms with more than ``_FORM_SHARE`` of its probability.
        """
        sets = (each for each in self.hypotheses if each.names >= names and not each.has_remainder)
        by_form: dict[str, tuple[float, tuple[Candidate, ...]]] = {}
        for share, candidates in next(sets).forms:
            [form] = [other.form.name for other in candidates if other.effect.name == candidate.effect.name]
            previous_share, best_fit = by_form.get(form, (0.0, candidates))
            by_form[form] = previous_share + share, best_fit
        by_form.pop(candidate.form.name, None)
        return sorted((each for each in by_form.values() if each[0] > _FORM_SHARE), key=lambda each: -each[0])

    def tied_with(self, names: frozenset[str], name: str) -> tuple[str, ...]:
        """Effects that may replace one of a set, most probable first."""
        tied = (next(iter(each - names)) for each in self.similar(names) if name not in each)
        return tuple(dict.fromkeys(tied))
