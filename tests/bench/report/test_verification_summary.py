"""A verification in a terminal of 80 columns."""

import io

import pytest
from rich.console import Console

from gyrobench.bench.report.terminal.tables import section_view
from gyrobench.bench.report.verification_page import verification_findings, verification_plan
from tests.bench.report.made_up_verification import (
    alone,
    confirmed,
    degraded,
    improved,
    inconclusive,
    not_confirmed,
    without_a_plateau,
)

ALL = [confirmed, improved, not_confirmed, inconclusive, alone, degraded, without_a_plateau]


def printed(content):
    stream = io.StringIO()
    Console(file=stream, width=80).print(section_view(content))
    return stream.getvalue()


@pytest.mark.parametrize("comparison", ALL)
def test_it_fits_a_terminal_without_colour_and_nothing_is_cut_off(comparison):
    text = printed(verification_findings(comparison()).chapter)
    assert max(map(len, text.splitlines())) <= 80
    assert "…" not in text
    assert "\x1b" not in text


def test_it_begins_with_the_judgement_and_has_the_numbers_with_their_noise():
    text = printed(verification_findings(confirmed()).chapter)
    assert text.splitlines()[1].startswith("Confirmed. Varying bias:")
    rows = [line.split() for line in text.splitlines()]
    first = [row[0] for row in rows if row].index("none")
    totals = [row for row in rows if row][first : first + 4]
    assert [row[0] for row in totals] == ["none", "declared", "with", "noise"]
    assert float(totals[0][2]) > 10.0 > float(totals[3][2])


def test_each_plateau_is_named_once():
    lines = [line.split() for line in printed(verification_findings(confirmed()).chapter).splitlines()]
    assert sum(line[:2] == ["62", "1"] for line in lines) == 1


def test_the_duration_of_the_runs_is_stated_before_they_begin():
    comparison = confirmed()
    text = printed(verification_plan(comparison.closure, comparison.models, ["none", "effect"], 68_400.0))
    assert (
        "2 runs of 19:00 h remain, 38:00 h in total: without compensation and with the effects."
        in " ".join(text.split())
    )
    one = printed(verification_plan(comparison.closure, comparison.models, ["declared"], 68_400.0))
    assert "1 run of 19:00 h remains: with the declared model." in one
    assert "All runs are complete" in printed(
        verification_plan(comparison.closure, comparison.models, [], 68_400.0)
    )
