"""Planned against real duration."""

from __future__ import annotations

from gyrobench.bench.report.journal_sections import durations_by_kind, took_in_journal


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


def test_journal_states_the_kind_of_every_step() -> None:
    journal = [
        {"event": "step_started", "step": 1, "kind": "soak", "what": "soak 1 min"},
        {"event": "step_finished", "step": 1, "kind": "soak", "planned_s": 1.0, "took_s": 2.0},
        {"event": "step_finished", "step": 2, "kind": "soak", "planned_s": 3.0, "took_s": 4.0},
    ]
    assert took_in_journal(journal) == {"soak": [(1.0, 2.0), (3.0, 4.0)]}


def test_damaged_entries_of_a_journal_are_passed_over() -> None:
    journal = [
        {"event": "step_finished", "step": 2, "kind": "soak", "took_s": 2.0},
        {"event": "step_finished", "planned_s": 3.0, "took_s": 4.0},
        {},
    ]
    assert took_in_journal(journal) == {}
