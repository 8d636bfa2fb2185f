"""What a planned campaign could tell, in a terminal of 80 columns without colour."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console, RenderableType

from gyrobench.bench.closure.effects import all_effects
from gyrobench.bench.closure.planned_campaign import PlannedUnit, planned_campaign
from gyrobench.bench.closure.procedure_changes import Advice
from gyrobench.bench.closure.separability import Separability, searched_dwells, separability
from gyrobench.bench.report.terminal.separability import pairs_text, separability_summary
from tests.bench.closure.plans import shipped

UNIT = PlannedUnit(0.0006, is_noise_declared=True)
TARGET_DPH = 0.002


@pytest.fixture(scope="module")
def separable() -> Separability:
    _, plan = shipped("six_position_fig7")
    return separability(searched_dwells(planned_campaign(plan, UNIT)), all_effects())


def printed(renderable: RenderableType) -> str:
    """Text as a plain terminal of 80 columns shows it, in one line."""
    stream = io.StringIO()
    Console(width=80, file=stream, force_terminal=False, color_system=None).print(renderable)
    lines = [line.rstrip() for line in stream.getvalue().splitlines()]
    assert max(map(len, lines)) <= 80
    assert not any("…" in line or "\x1b" in line for line in lines)
    return " ".join(" ".join(lines).split())


def test_every_effect_has_its_sizes_and_hardest_rival(separable: Separability) -> None:
    text = printed(separability_summary(separable, 60, UNIT, TARGET_DPH, []))
    for each in separable.detections:
        name = each.effect.name
        rival, separable_dph = separable.hardest_rival(name) or ("", 0.0)
        sizes = f"{name} {1e3 * each.typical_dph:.2f} {1e3 * each.largest_dph:.2f} x"
        assert sizes in text
        assert f" {rival} {1e3 * separable_dph:.2f} " in text


def test_it_says_what_it_rests_on(separable: Separability) -> None:
    text = printed(separability_summary(separable, 60, UNIT, TARGET_DPH, []))
    assert "30 of 60 dwells are searched; the last cycle is held out." in text
    assert (
        "uncertainty of each bias ±1.04, from an angle random walk of 0.0006 deg/sqrt(h), declared by the "
        "station" in text
    )
    undeclared = replace(UNIT, is_noise_declared=False)
    assert "a typical value, none is declared" in printed(
        separability_summary(separable, 30, undeclared, TARGET_DPH, [])
    )
    assert "One cycle of 30 dwells" in printed(
        separability_summary(separable, 30, undeclared, TARGET_DPH, [])
    )


def test_it_lists_what_is_not_found_and_not_separable(separable: Separability) -> None:
    text = printed(separability_summary(separable, 60, UNIT, TARGET_DPH, []))
    assert "Not found at 2.00: chamber_state." in text
    assert "Not separable at 2.00: " in text
    assert "At 900.00 all of them are found and separable." in printed(
        separability_summary(separable, 60, UNIT, 0.9, [])
    )


def test_effects_that_can_not_be_seen_are_gathered_by_what_they_lack(separable: Separability) -> None:
    blind = replace(separable.campaign, set_c=np.full(len(separable.campaign), np.nan))
    text = printed(separability_summary(separability(blind, all_effects()), 60, UNIT, TARGET_DPH, []))
    assert "Not observable without the chamber's set point: chamber_state." in text
    assert "Not found" not in text


@pytest.mark.parametrize(
    ("advice", "sentence"),
    [
        (
            Advice(("add a cycle", "wait"), 2.36, ("warm_up",), (("a", "b"), ("b", "c"))),
            "With 2.4 h more, add a cycle and wait: finds warm_up and separates it from all others, "
            "and separates b from a and c.",
        ),
        (
            Advice(("add a cycle",), -0.5, (), (("a", "b"),)),
            "With 0.5 h less, add a cycle: separates a from b.",
        ),
        (
            Advice(("wait",), 12.0, (), (("a", "b"),), (("c", "d"),)),
            "With 12.0 h more, wait: separates a from b; but no longer c from d.",
        ),
        (
            Advice((), 0.0, ("x", "y"), ()),
            "No change known here finds x and y and separates them from all others.",
        ),
    ],
)
def test_advice_is_a_sentence(separable: Separability, advice: Advice, sentence: str) -> None:
    assert sentence in printed(separability_summary(separable, 60, UNIT, TARGET_DPH, [advice]))


def test_pairs_are_gathered_by_the_effect_that_most_of_them_have() -> None:
    assert pairs_text([("a", "c"), ("b", "c"), ("c", "d"), ("e", "f")]) == "c from a, b and d; e from f"
    assert pairs_text([]) == ""
