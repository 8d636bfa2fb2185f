"""What is read of the probabilities of sets of effects."""

from dataclasses import replace

import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects.laws import THERMAL_HYSTERESIS, WARM_UP
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.closure.posterior import HypothesisProbability, Posterior
from tests.bench.closure.test_candidates import whole
from tests.benchmarks.closure_calibration import drawn
from tests.benchmarks.closure_units import make_unit


def test_probabilities_are_summed_over_sets():
    one, two = frozenset({"a"}), frozenset({"a", "b"})
    weights = ((one, False, 0.6), (two, False, 0.3), (one, True, 0.1))
    posterior = Posterior(tuple(HypothesisProbability(*each, ()) for each in weights), {})
    assert posterior.effect_probabilities == {"a": pytest.approx(1.0), "b": pytest.approx(0.3)}
    assert posterior.unlisted_probability == pytest.approx(0.1)
    assert posterior.no_effect_probability == 0.0
    assert posterior.sets == [one, two]
    assert posterior.odds(one, two) == pytest.approx(2.0)


def test_an_effect_is_there_as_such_or_as_a_special_case():
    one, general, other = (frozenset({name}) for name in "agb")
    weights = ((one, False, 0.9), (general, False, 0.06), (one | other, False, 0.03), (one, True, 0.01))
    posterior = Posterior(tuple(HypothesisProbability(*each, ()) for each in weights), {})
    assert posterior.joint_probability(one) == pytest.approx(0.93)
    assert posterior.similar(one) == [general]
    posterior = replace(posterior, more_general={"a": general})
    assert posterior.joint_probability(one) == pytest.approx(0.99)
    assert posterior.joint_probability(one, has_remainder=None) == pytest.approx(1.0)
    assert posterior.similar(one) == []
    assert posterior.rivals(one) == {}


def test_an_effect_that_is_not_improbable_is_a_rival():
    one, both = frozenset({"a"}), frozenset({"a", "b"})
    posterior = Posterior(
        (HypothesisProbability(one, False, 0.8, ()), HypothesisProbability(both, False, 0.2, ())), {}
    )
    assert posterior.joint_probability(one) == pytest.approx(1.0)
    assert posterior.rivals(one) == {"b": pytest.approx(0.2)}


def test_the_forms_of_an_effect_are_those_of_the_most_probable_set_that_includes_it():
    one, both = frozenset({"thermal_hysteresis"}), frozenset({"thermal_hysteresis", "warm_up"})
    width, many = (replace(whole(THERMAL_HYSTERESIS, 4.5), form=form) for form in THERMAL_HYSTERESIS.forms)
    warm_up = whole(WARM_UP, 900.0)
    posterior = Posterior(
        (
            HypothesisProbability(both, False, 0.9, (), ((0.7, (width, warm_up)), (0.3, (warm_up, many)))),
            HypothesisProbability(one, False, 0.1, (), ((0.1, (width,)), (0.9, (many,)))),
        ),
        {},
    )
    assert posterior.other_forms(one, width) == [(0.3, (warm_up, many))]
    assert posterior.other_forms(one, many) == [(0.7, (width, warm_up))]
    alone = replace(posterior, hypotheses=posterior.hypotheses[1:])
    assert alone.other_forms(one, width) == [(0.9, (many,))]


@pytest.mark.long
def test_a_simpler_set_in_place_of_the_most_probable_has_its_own_ties():
    """The most probable set has other neighbours than the simpler one that is found."""
    _, options = drawn(55)
    closure = close_loop(campaign_of(make_unit(55, **options)[0]))
    found = {each.effect.name for each in closure.effects}
    for names in closure.posterior.similar(frozenset(found)):
        assert len(names & found) == len(found) - 1
