"""Probabilities of hypotheses: sets of effects, with or without a remainder that is on no list.

:mod:`gyrobench.bench.closure.evidence` computes them; here is what a search, a verdict and a report read
of them, with the limits of what is stated.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from gyrobench.bench.closure.candidates import Candidate

#: Effects are tied if the data and the prior prefer one by odds of less than this to 1.
TIE_ODDS = 100.0
#: Least probability of another form of an effect found that is stated.
_FORM_SHARE = 0.05
#: Probability that all effects found are there, without a remainder, where they explain a residual.
EXPLAINED = 0.99
#: Probability of any other effect from which it is not settled that those found are all.
RIVAL = 0.1
#: Least probability of the declared model alone where it is stated that there is nothing else.
CLEAN = 0.5


@dataclass(frozen=True)
class HypothesisProbability:
    """A hypothesis and its probability."""

    names: frozenset[str]  #: Effects.
    has_remainder: bool  #: Whether an unlisted effect is added.
    probability: float  #: Posterior.
    #: The effects as fitted; of one that can't be fitted, the one that imitates it.
    candidates: tuple[Candidate, ...]
    #: Their forms, each combination as fitted with its share of the probability.
    forms: tuple[tuple[float, tuple[Candidate, ...]], ...] = ()


@dataclass(frozen=True)
class Posterior:
    """Probabilities after a search."""

    hypotheses: tuple[HypothesisProbability, ...]  #: Most probable first.
    follows: dict[str, float]  #: Probability of each process, if there is a remainder.
    #: By effect found: those of which it is a special case. They are no other cause, only a more general law.
    more_general: Mapping[str, frozenset[str]] = field(default_factory=dict)

    @property
    def of_effect(self) -> dict[str, float]:
        """Probability of each effect, in any set."""
        names = sorted(set().union(*(each.names for each in self.hypotheses)))
        return {
            name: sum(each.probability for each in self.hypotheses if name in each.names) for name in names
        }

    @property
    def sets(self) -> list[frozenset[str]]:
        """Sets of effects, with or without a remainder, most probable first."""
        total: dict[frozenset[str], float] = {}
        for each in self.hypotheses:
            total[each.names] = total.get(each.names, 0.0) + each.probability
        return sorted(total, key=lambda names: -total[names])

    @property
    def nothing(self) -> float:
        """Probability of the declared model alone."""
        return self.of_set(())

    @property
    def not_on_list(self) -> float:
        """Probability of an unlisted effect, beside any effects."""
        return sum(each.probability for each in self.hypotheses if each.has_remainder)

    def of_set(self, names: Collection[str]) -> float:
        """Probability of exactly these effects, without an unlisted one."""
        wanted = frozenset(names), False
        return sum(each.probability for each in self.hypotheses if (each.names, each.has_remainder) == wanted)

    def of_all(self, names: Collection[str], *, has_remainder: bool | None = False) -> float:
        """Probability that all these effects are there, in any set, each as such or as a special case.

        ``has_remainder``: whether an unlisted effect is there; None for either.
        """
        return sum(
            each.probability
            for each in self.hypotheses
            if self.contains(each, names) and has_remainder in (None, each.has_remainder)
        )

    def contains(self, hypothesis: HypothesisProbability, names: Collection[str]) -> bool:
        """Whether a hypothesis has all these effects, each as such or as a special case."""
        return all(hypothesis.names & {name, *self.more_general.get(name, ())} for name in names)

    def of_any(self, names: Collection[str]) -> float:
        """Probability that at least one of these effects is there, alone or with others."""
        return sum(each.probability for each in self.hypotheses if each.names.intersection(names))

    def rivals(self, names: Collection[str]) -> dict[str, float]:
        """Effects beside these, or in place of them, that are not improbable.

        A more general law is one beside an effect that it contains, not in place of it.
        """
        found: dict[str, float] = {}
        for each in self.hypotheses:
            general = (self.more_general.get(name, ()) for name in {*names} - each.names)
            for name in each.names.difference(names, *general):
                found[name] = found.get(name, 0.0) + each.probability
        return {name: found[name] for name in sorted(found) if found[name] >= RIVAL}

    def odds(self, names: frozenset[str], other: frozenset[str]) -> float:
        """Odds of one set to another one, both without a remainder."""
        probability, less = (self.of_set(each) for each in (names, other))
        return probability / less if less > 0.0 else math.inf

    def similar(self, names: frozenset[str]) -> list[frozenset[str]]:
        """Sets with one effect exchanged that are not excluded by odds of TIE_ODDS, most probable first.

        One that has a more general law in place of an effect is none of them.
        """
        least = self.of_set(names) / TIE_ODDS
        general = frozenset().union(*(self.more_general.get(name, ()) for name in names))
        return [
            each.names
            for each in self.hypotheses
            if not each.has_remainder
            and len(each.names) == len(names) == len(each.names & names) + 1
            and each.probability > least
            and not each.names & general - names
        ]

    def other_forms(self, names: frozenset[str], one: Candidate) -> list[tuple[float, tuple[Candidate, ...]]]:
        """A set of effects with one of them in other forms, most probable first.

        Each form that has ``_FORM_SHARE`` of the probability of the set, with the set as fitted.
        """
        found: dict[str, tuple[float, tuple[Candidate, ...]]] = {}
        for each in self.hypotheses:
            for share, candidates in each.forms if each.names == names and not each.has_remainder else ():
                [form] = [other.form.name for other in candidates if other.effect.name == one.effect.name]
                before, best = found.get(form, (0.0, candidates))
                found[form] = before + share, best
        found.pop(one.form.name, None)
        return sorted((each for each in found.values() if each[0] > _FORM_SHARE), key=lambda each: -each[0])

    def tied_with(self, names: frozenset[str], one: str) -> tuple[str, ...]:
        """Effects that may take the place of one of a set, most probable first."""
        tied = (next(iter(each - names)) for each in self.similar(names) if one not in each)
        return tuple(dict.fromkeys(tied))
