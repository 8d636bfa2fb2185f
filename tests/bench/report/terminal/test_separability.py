"""What a planned campaign could distinguish, in a terminal of 80 columns without colour."""

import re
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.closure.effects import all_effects
from gyrobench.bench.closure.planned_campaign import UnitProperties, planned_campaign
from gyrobench.bench.closure.procedure_changes import Advice
from gyrobench.bench.closure.separability import searched_dwells, separability
from gyrobench.bench.report.terminal.separability import pairs_text, separability_summary
from tests.bench.closure.plans import shipped
from tests.bench.report.plain_terminal import printed

UNIT = UnitProperties(0.0006, "declared by the station")
TARGET_DPH = 0.002


@pytest.fixture(scope="module")
def result():
    _, plan = shipped("six_position_fig7")
    return separability(searched_dwells(planned_campaign(plan, UNIT)), all_effects())


def one_line(view):
    """Text as a plain terminal of 80 columns shows it, in one line."""
    return " ".join(printed(view).split())


def test_every_effect_has_its_sizes_and_nearest_alternative(result):
    text = one_line(separability_summary(result, 60, UNIT, TARGET_DPH, []))
    shown = [each for each in result.detections if each.missing_input is None]
    assert len(shown) > 8
    for each in shown:
        nearest, size_dph = result.nearest_alternative(each.effect.name) or ("", 0.0)
        size = f"{1e3 * size_dph:.2f}" if np.isfinite(size_dph) else "never"
        sizes = f"{1e3 * each.typical_dph:.2f} {1e3 * each.largest_dph:.2f} x"
        # A long label is folded.
        label, alternative = (text.split()[0] for text in (each.effect.display_name, result.label(nearest)))
        row = rf" {label}[a-z -]* {re.escape(sizes)}\S* {alternative}[a-z -]* {re.escape(size)} "
        assert re.search(row, text), row


def test_it_states_dwells_and_uncertainty(result):
    text = one_line(separability_summary(result, 60, UNIT, TARGET_DPH, []))
    assert "The search uses 30 of 60 dwells; the last cycle is held out." in text
    assert (
        "Standard uncertainty of a bias: ±1.04, from an angle random walk of 0.0006 deg/sqrt(h), declared by "
        "the station" in text
    )
    undeclared = replace(UNIT, noise_source=UnitProperties().noise_source)
    assert "a typical value, none is declared" in one_line(
        separability_summary(result, 30, undeclared, TARGET_DPH, [])
    )
    assert "There is one cycle of 30 dwells" in one_line(
        separability_summary(result, 30, undeclared, TARGET_DPH, [])
    )


def test_it_states_where_there_are_too_few_dwells_to_search(result):
    campaign = result.campaign
    few = replace(result, campaign=campaign.part(np.arange(len(campaign)) < 6))
    text = one_line(separability_summary(few, 12, UNIT, TARGET_DPH, []))
    assert "Too few for gyrobench close: a cubic in temperature leaves" in text
    assert "Too few" not in one_line(separability_summary(result, 60, UNIT, TARGET_DPH, []))


def test_it_lists_effects_not_found_and_not_distinguished(result):
    text = one_line(separability_summary(result, 60, UNIT, TARGET_DPH, []))
    assert "Not found at 2.00: chamber state." in text
    assert "Not distinguished at 2.00: " in text
    large = one_line(separability_summary(result, 60, UNIT, 0.9, []))
    assert "Not found" not in large
    # At any size, an effect that can't be fitted may take the place of one that it imitates.
    assert (
        "Not distinguished at 900.00: daily course of the room from time drift; g-sensitivity from" in large
    )
    seen = replace(result, distinguished_dph=dict.fromkeys(result.distinguished_dph, 0.5))
    assert "At 900.00 all effects are found and distinguished." in one_line(
        separability_summary(seen, 60, UNIT, 0.9, [])
    )


def test_effects_not_observable_are_grouped_by_missing_input(result):
    blind = replace(result.campaign, set_c=np.full(len(result.campaign), np.nan))
    text = one_line(separability_summary(separability(blind, all_effects()), 60, UNIT, TARGET_DPH, []))
    assert "Not observable: chamber state. Missing input: the chamber's set point." in text
    assert "Not found" not in text


@pytest.mark.parametrize(
    ("advice", "sentence"),
    [
        (
            Advice(("add a cycle", "wait"), 2.36, ("warm_up",), (("a", "b"), ("b", "c"))),
            "With 2.4 h more: add a cycle and wait. This finds warm-up and distinguishes it from all others, "
            "and distinguishes b from a and c.",
        ),
        (
            Advice(("add a cycle",), -0.5, (), (("a", "b"),)),
            "With 0.5 h less: add a cycle. This distinguishes a from b.",
        ),
        (
            Advice(("wait",), 12.0, (), (("a", "b"),), (("c", "d"),)),
            "With 12.0 h more: wait. This distinguishes a from b, but does not distinguish c from d.",
        ),
        (
            Advice((), 0.0, ("x", "y"), ()),
            "No known change finds x and y and distinguishes them from all others.",
        ),
    ],
)
def test_advice_is_a_sentence(result, advice, sentence):
    assert sentence in one_line(separability_summary(result, 60, UNIT, TARGET_DPH, [advice]))


def test_pairs_are_gathered_by_the_effect_that_most_of_them_have():
    assert pairs_text([("a", "c"), ("b", "c"), ("c", "d"), ("e", "f")], str) == "c from a, b and d; e from f"
    assert pairs_text([], str) == ""
