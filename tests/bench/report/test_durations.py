"""Planned against real duration."""

from __future__ import annotations

from gyrobench.bench.report.journal_sections import (
    KindDuration,
    durations_by_kind,
    durations_section,
    step_durations,
)


def finished(step: int, kind: str, planned_s: float, took_s: float) -> dict[str, object]:
    return {"event": "step_finished", "step": step, "kind": kind, "planned_s": planned_s, "took_s": took_s}


def kinds_of(*journal: dict[str, object]) -> list[KindDuration]:
    return durations_by_kind(step_durations(journal))


def test_longest_comes_first_and_all_of_them_last() -> None:
    kinds = kinds_of(
        finished(1, "go_to", 20.0, 25.0),
        finished(2, "soak", 3600.0, 3000.0),
        finished(3, "go_to", 20.0, 21.0),
    )
    assert [(kind.kind, kind.count, kind.planned_s, kind.actual_s) for kind in kinds] == [
        ("soak", 1, 3600.0, 3000.0),
        ("go to", 2, 40.0, 46.0),
        ("all", 3, 3640.0, 3046.0),
    ]
    assert [kind.difference for kind in kinds[:2]] == ["-0:10:00 (-16.7 %)", "+0:00:06 (+15.0 %)"]


def test_step_that_is_done_again_is_planned_once() -> None:
    journal = [finished(number, "navigate", 600.0, 610.0) for number in (1, 2, 1, 2, 3)]
    *_, total = kinds_of(*journal)
    assert (total.count, total.planned_s, total.actual_s, total.repeats) == (3, 1800.0, 3050.0, 2)
    [table] = durations_section(step_durations(journal)).tables
    assert table.caption == "The actual duration includes 2 steps done again"
    [table] = durations_section(step_durations(journal[:2])).tables
    assert table.caption == ""


def test_step_planned_for_no_time_has_no_percentage() -> None:
    assert kinds_of(finished(1, "power_off", 0.0, 1.0))[0].difference == "+0:00:01"


def test_other_and_damaged_entries_of_a_journal_are_passed_over() -> None:
    unfinished = {"event": "step_started", "step": 1, "kind": "soak", "what": "soak 1 min"}
    damaged = {"event": "step_finished", "step": 2, "kind": "soak", "took_s": 2.0}
    without_kind = {"event": "step_finished", "planned_s": 3.0, "took_s": 4.0}
    assert kinds_of(unfinished, damaged, without_kind, {}) == []
