"""Planned against real duration, and the events of a run."""

from gyrobench.bench.report.journal_sections import (
    MAX_ROWS,
    durations_by_kind,
    durations_section,
    events_section,
    run_events,
    step_durations,
)


def finished(step, kind, planned_s, took_s):
    return {"event": "step_finished", "step": step, "kind": kind, "planned_s": planned_s, "took_s": took_s}


def kinds_of(*journal):
    return durations_by_kind(step_durations(journal))


def test_longest_comes_first_and_all_of_them_last():
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


def test_step_that_is_done_again_is_planned_once():
    journal = [finished(number, "navigate", 600.0, 610.0) for number in (1, 2, 1, 2, 3)]
    *_, total = kinds_of(*journal)
    assert (total.count, total.planned_s, total.actual_s, total.repeats) == (3, 1800.0, 3050.0, 2)
    [table] = durations_section(step_durations(journal)).tables
    assert table.caption == "The actual duration includes 2 steps done again"
    [table] = durations_section(step_durations(journal[:2])).tables
    assert table.caption == ""


def test_step_planned_for_no_time_has_no_percentage():
    assert kinds_of(finished(1, "power_off", 0.0, 1.0))[0].difference == "+0:00:01"


def test_other_and_damaged_entries_of_a_journal_are_passed_over():
    unfinished = {"event": "step_started", "step": 1, "kind": "soak", "what": "soak 1 min"}
    damaged = {"event": "step_finished", "step": 2, "kind": "soak", "took_s": 2.0}
    without_kind = {"event": "step_finished", "planned_s": 3.0, "took_s": 4.0}
    of_text = finished(2, "soak", "align", 2.0)
    of_list = finished([2], "soak", 1.0, 2.0)
    assert kinds_of(unfinished, damaged, without_kind, of_text, of_list, {}) == []


def entry(time_s, event, **details):
    return {"time_s": time_s, "utc": "2000-01-01T00:00:00+00:00", "event": event, **details}


def test_a_hold_states_what_it_waited_for_and_who_continued():
    journal = [
        entry(60.0, "held", why="door open", after=["door"], waits_for="a person"),
        entry(180.0, "continued", by="the operator", after=["door"], held_s=120.0),
    ]
    (event,) = run_events(journal)
    assert (event.time, event.kind, event.description) == ("0:01:00", "held", "door open")
    assert event.outcome == "continued by the operator after 0:02:00"


def test_a_hold_without_end_still_waits():
    (event,) = run_events([entry(60.0, "held", why="door open", waits_for="a person")])
    assert event.outcome == "waits for a person"


def test_a_trip_states_whether_the_bench_was_made_safe():
    for problem, outcome in (("", "made safe"), ("no reply", "safe state NOT reached: table stopped")):
        journal = [
            entry(5.0, "tripped", interlocks=["gyro"], why="too hot"),
            entry(6.0, "made_safe", actions=[{"what": "table stopped", "problem": problem}]),
        ]
        assert run_events(journal)[0].outcome == outcome


def test_a_dwell_given_up_states_what_became_of_it():
    given_up = entry(10.0, "dwell_given_up", dwell=7, why="a gap in the CAN frames", counts=True)
    assert run_events([given_up])[0].outcome == "not measured again"
    good = entry(20.0, "dwell_finished", marks={"dwell": 7}, flags="")
    (event,) = run_events([given_up, good])
    assert event.outcome == "measured again, good"
    flagged = run_events([given_up, entry(20.0, "dwell_finished", marks={"dwell": 7}, flags="gap")])
    assert [each.outcome for each in flagged] == ["measured again, flagged", "excluded from the bins"]


def test_equal_retries_are_stated_once_with_how_often():
    journal = [entry(float(n), "retry", instrument="chamber", error="chamber: no reply") for n in range(5)]
    journal.append(entry(9.0, "answers_again", instrument="chamber"))
    (event,) = run_events(journal)
    assert (event.count, event.time, event.outcome) == (5, "0:00:00 to 0:00:04", "answers again")


def test_thousands_of_events_stay_readable_and_none_is_lost():
    journal = []
    for n in range(5000):
        journal.append(entry(10.0 * n, "retry", instrument="INS", error=f"{n} frames {'x' * (n % 90)}"))
        if n % 50 == 0:
            journal.append(entry(10.0 * n + 1.0, "tripped", interlocks=["a"], why=f"trip {'y' * (n // 50)}"))
    journal.append(entry(1e6, "held", why="the last one", waits_for="a person"))
    events = run_events(journal)
    assert len(events) <= MAX_ROWS
    assert sum(each.count for each in events) == 5000 + 100 + 1
    assert "the last one" in [each.description for each in events]


def test_how_the_run_was_cut_short_and_continued_is_there():
    journal = [
        entry(1.0, "journal_repaired", cut_off="{"),
        entry(2.0, "run_resumed", next_step=12),
        entry(3.0, "ordered", order="pause", by="SIGTSTP"),
        entry(4.0, "note", text="the clock of the INS was set"),
        entry(5.0, "dwell_skipped", dwell=3),
        entry(6.0, "run_ended", ended="stopped", reason="by an order"),
    ]
    events = run_events(journal)
    kinds = [each.kind for each in events]
    assert kinds == ["note", "resumed", "command", "note", "dwell skipped", "ended"]
    assert events[2].outcome == "by the operator (Ctrl-Z)"


def test_a_quiet_run_says_so():
    section = events_section([entry(1.0, "run_ended", ended="finished", reason="")])
    assert section.paragraphs == ["The journal has no fault, hold, repeat, command or note."]
    assert not section.tables


def test_entries_of_any_shape_are_read():
    journal = [
        entry("now", "retry", instrument=["a"], error=None),
        entry(1e400, "held", why=3, waits_for={}),
        entry(None, "continued", by=None, held_s="long"),
        entry(True, "made_safe", actions=7),
        entry(0.0, "dwell_finished", marks=[1], flags=["x"]),
        {"event": ["tripped"]},
    ]
    assert len(run_events(journal)) == 3


def test_soaks_that_did_not_settle_are_counted_with_the_largest_rate():
    text = "soak not settled after at_most_s (90 min): a gyro still changes by {} degC/h, limit 2 degC/h"
    journal = [
        entry(60.0 * number, "soak_not_settled", text=text.format(rate), rate_c_per_h=rate, limit_c_per_h=2.0)
        for number, rate in enumerate((5.83, 7.21, None))
    ]
    section = events_section(journal)
    assert section.paragraphs == [
        "Events: soak not settled (3).",
        "3 soaks ended by at_most_s before the gyros had settled; the largest rate of a gyro was 7.21 °C/h.",
    ]
    assert [(each.kind, each.description) for each in run_events(journal)][1] == (
        "soak not settled",
        text.format(7.21),
    )


def test_a_dwell_repeated_on_command_states_reason_operator_and_what_it_replaces():
    commanded = entry(10.0, "repeat_commanded", dwells=[7], why=["flagged: a gap"], operator="A. Smith")
    (event,) = run_events([commanded])
    assert (event.kind, event.description, event.outcome) == (
        "dwell repeated",
        "dwell 7 (flagged: a gap), commanded by A. Smith",
        "not measured again",
    )
    measured = entry(20.0, "dwell_finished", marks={"dwell": 7}, flags="", replaces_earlier=True)
    (event,) = run_events([commanded, measured])
    assert event.outcome == "measured again, good; replaces the earlier measurement"
