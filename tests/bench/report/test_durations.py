"""Planned against real duration."""

from __future__ import annotations

import pytest

from bench.procedure.steps import (
    STEP_KINDS,
    Align,
    AskOperator,
    Chamber,
    GoTo,
    Navigate,
    PowerOn,
    Soak,
    Turn,
    Wait,
)
from bench.report.durations import clock_time, durations_by_kind, took_in_journal

STEPS = [
    PowerOn(),
    *(STEP_KINDS[name]() for name in ("power_off", "chamber_off")),
    Chamber(temperature_c=60.0, ramp_c_per_min=1.0),
    Soak(for_s=60.0),
    GoTo(position="z_up"),
    Align(duration_s=300.0),
    Navigate(duration_s=600.0),
    Turn(angle_deg=180.0),
    Wait(duration_s=5.0),
    AskOperator(question="ready?"),
]


def test_longest_comes_first_and_all_of_them_last() -> None:
    kinds = durations_by_kind({"go_to": [(20.0, 25.0), (20.0, 21.0)], "soak": [(3600.0, 3000.0)], "wait": []})
    assert [(kind.kind, kind.count, kind.planned_s, kind.took_s) for kind in kinds] == [
        ("soak", 1, 3600.0, 3000.0),
        ("go to", 2, 40.0, 46.0),
        ("all", 3, 3640.0, 3046.0),
    ]
    assert [kind.difference for kind in kinds[:2]] == ["-0:10:00 (-16.7 %)", "+0:00:06 (+15.0 %)"]


def test_nothing_done_gives_no_rows() -> None:
    assert durations_by_kind({}) == []


def test_step_planned_for_no_time_has_no_percentage() -> None:
    assert durations_by_kind({"power_off": [(0.0, 1.0)]})[0].difference == "+0:00:01"


@pytest.mark.parametrize("step", STEPS, ids=lambda step: step.name)
def test_journal_tells_the_kind_of_every_step(step: object) -> None:
    journal = [
        {"event": "step_started", "step": 1, "what": step.describe()},
        {"event": "step_finished", "step": 1, "planned_s": 1.0, "took_s": 2.0},
    ]
    assert took_in_journal(journal) == {step.name: [(1.0, 2.0)]}


def test_every_kind_of_step_is_tried_above() -> None:
    assert {step.name for step in STEPS} == set(STEP_KINDS)


def test_damaged_entries_of_a_journal_are_passed_over_or_called_other() -> None:
    journal = [
        {"event": "step_started", "step": 1},
        {"event": "step_finished", "step": 1, "planned_s": 1.0, "took_s": 2.0},
        {"event": "step_finished", "step": 2, "took_s": 2.0},
        {"event": "step_finished", "planned_s": 3.0, "took_s": 4.0},
        {},
    ]
    assert took_in_journal(journal) == {"other": [(1.0, 2.0), (3.0, 4.0)]}


def test_times_are_written_to_the_second() -> None:
    assert [clock_time(value) for value in (0.0, 59.6, 3723.0, 162_000.0)] == [
        "0:00:00",
        "0:01:00",
        "1:02:03",
        "45:00:00",
    ]
