from dataclasses import replace

from gyrobench.bench.live.picture import RunState
from gyrobench.bench.monitor.list_rows import list_row, unreadable_row
from gyrobench.bench.monitor.news import News
from gyrobench.bench.monitor.runs import RunSummary

RUN = RunSummary(
    "six position #1", "six_position", "1001", RunState.HOLDING, "the door is open",
    "2026-03-02T07:30:00+00:00", "2026-03-02T16:42:00+00:00", 13, 24, 21600.0,
)  # fmt: skip


def test_a_run_under_way_in_one_line():
    row = list_row(RUN, News(1.0, False, ""))
    assert row.address == "runs/six%20position%20%231/"
    assert (row.state, row.look, row.reason) == ("holding", "notable", "the door is open")
    assert row.facts == "six_position, unit 1001, 13 of 24 dwells, 6:00 h left, started 2026-03-02 07:30 UTC"


def test_a_run_that_is_over_has_nothing_left():
    row = list_row(replace(RUN, state=RunState.STOPPED), News(1.0, True, ""))
    assert "left" not in row.facts


def test_a_silent_run_and_one_that_can_not_be_read_are_told_as_such():
    silent = list_row(RUN, News(40.0, False, "No news for 40 s."))
    assert (silent.state, silent.look, silent.reason) == ("silent", "bad", "No news for 40 s.")
    assert unreadable_row("mine", "damaged").reason == "damaged"


def test_alarms_are_told_first():
    row = list_row(replace(RUN, alarms=2), News(1.0, False, ""))
    assert row.look == "bad"
    assert row.facts.startswith("▲ 2 ALARMS, ")
