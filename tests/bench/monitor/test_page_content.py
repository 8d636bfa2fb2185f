import math
from dataclasses import replace

import pytest

from gyrobench.bench.monitor.page_content import (
    STATE_SYMBOLS,
    Freshness,
    age_text,
    bin_tables,
    dwell_table,
    freshness_of,
    headline,
    list_row,
    reading_rows,
    unreadable_row,
)
from gyrobench.bench.monitor.run_list import RunSummary
from gyrobench.bench.monitor.snapshot import RunState
from tests.bench.monitor.sample_snapshots import bins_of, made_up_snapshot, measured_dwells, waiting_snapshot
from tests.bench.monitor.served_run import NOW


@pytest.mark.parametrize(
    ("state", "updated", "age_s", "is_over", "is_silent"),
    [
        (RunState.RUNNING, "2026-03-02T16:41:59+00:00", 2.0, False, False),
        (RunState.RUNNING, "2026-03-02T16:41:21+00:00", 40.0, False, True),
        (RunState.HOLDING, "2026-03-02T10:42:01+00:00", 21600.0, False, True),
        (RunState.FINISHED, "2026-03-01T16:42:01+00:00", 86400.0, True, False),
        (RunState.RUNNING, "2026-03-02T16:43:00+00:00", 0.0, False, False),
        (RunState.RUNNING, "", 0.0, False, False),
    ],
)
def test_a_run_that_should_write_and_does_not_is_silent(state, updated, age_s, is_over, is_silent):
    freshness = freshness_of(state, updated, NOW)
    assert (freshness.age_s, freshness.is_over, bool(freshness.warning)) == (age_s, is_over, is_silent)


def test_ages_are_reported_in_the_unit_that_fits():
    ages = (0.4, 40.0, 720.0, 5 * 3600.0, 3 * 86400.0)
    assert [age_text(age_s) for age_s in ages] == ["0 s", "40 s", "12 min", "5 h", "3 days"]


def tiles(snapshot):
    return {tile.name: (tile.value, tile.detail) for tile in headline(snapshot).tiles}


def test_a_run_in_its_middle():
    shown = tiles(made_up_snapshot())
    assert shown["Time left"] == ("6:00 h", "of 15:00 h planned, 0:12 h behind")
    assert shown["Chamber"] == ("−9.8 °C", "set −10.0 °C, gyros 4.2 °C")
    assert shown["Dwell"] == ("14 of 24", "Z-Down, cycle 1; 13 measured, 1 flagged")
    assert headline(made_up_snapshot()).share_done == pytest.approx(0.6)


def test_a_run_that_waits_or_broke_off_shows_the_command_that_continues_it():
    running = replace(made_up_snapshot(), folder="/runs/my run")
    broken = replace(running, state=RunState.STOPPED)
    waits = replace(waiting_snapshot(), folder="/runs/hot")
    asked = replace(waits, question=replace(waits.question, answers=("yes", "no")))
    assert headline(broken).next_step.startswith("gyrobench resume '/runs/my run' --look shows what is left")
    assert headline(waits).next_step.startswith("gyrobench control /runs/hot continue resumes it, abort")
    assert [headline(each).next_step for each in (running, asked)] == ["", ""]


def test_a_run_that_is_over_took_what_it_took():
    shown = tiles(replace(made_up_snapshot(), state=RunState.FINISHED, left_s=0.0))
    assert shown["Took"][0] == "9:12 h"
    assert shown["Dwells"][0] == "13 of 24"


def test_skipped_dwells_are_counted():
    snapshot = replace(made_up_snapshot(), state=RunState.FINISHED, skipped=(3, 9))
    assert tiles(snapshot)["Dwells"] == ("13 of 24", "13 measured, 1 flagged, 2 skipped")


def test_a_run_of_which_nothing_is_known_yet():
    snapshot = replace(
        made_up_snapshot(),
        state=RunState.STARTING,
        bench=None,
        dwell=None,
        dwells=(),
        left_s=0.0,
        planned_s=0.0,
    )
    assert tiles(snapshot)["Chamber"] == ("unknown", "")
    assert headline(snapshot).share_done == 0.0


def test_instruments_that_say_nothing_are_reported():
    bench = replace(made_up_snapshot().bench, chamber_set_c=math.nan, gyro_c=(math.nan,) * 3)
    assert tiles(replace(made_up_snapshot(), bench=bench))["Chamber"][1] == "no set point, INS silent"


def test_every_state_has_a_sign_and_an_alarm_makes_any_that_still_running_bad():
    assert set(STATE_SYMBOLS) == set(RunState)
    looks = {state: headline(replace(made_up_snapshot(), state=state)).css_class for state in RunState}
    assert {state for state, look in looks.items() if look == "bad"} == {RunState.FAILED}
    assert looks[RunState.HOLDING] == "notable"
    assert headline(waiting_snapshot()).css_class == "bad"
    assert headline(replace(waiting_snapshot(), state=RunState.FINISHED)).css_class == "good"


def test_the_end_is_expected_on_the_calendar_only_where_the_run_keeps_to_it():
    real = headline(made_up_snapshot())
    assert real.end.isoformat() == "2026-03-02T22:42:00+00:00"
    assert headline(replace(made_up_snapshot(), started_utc="2000-01-01T00:00:00+00:00")).end is None
    tenfold = replace(made_up_snapshot(), started_utc="2026-03-02T16:36:00+00:00", now_s=3600.0)
    assert headline(replace(tenfold, updated_utc="2026-03-02T16:42:00+00:00")).end is None
    assert headline(replace(made_up_snapshot(), started_utc="")).end is None
    assert headline(replace(made_up_snapshot(), state=RunState.STOPPED)).end is None
    assert headline(replace(made_up_snapshot(), state=RunState.HOLDING)).end is None


def test_bins_are_shown_by_gyro_with_the_warmest_first_and_empty_ranges_as_one():
    x, y, z = bin_tables(made_up_snapshot().bins)
    assert (x.gyro, y.gyro, z.gyro) == ("X gyro", "Y gyro", "Z gyro")
    assert x.unit == "0.001 deg/h"
    assert x.positions == ("Z-Up", "Z-Down", "Y-Up", "Y-Down", "X-Up", "X-Down")
    assert [label for label, _ in x.rows] == ["70…75", "35…70", "30…35", "5…30", "0…5"]
    assert [len(cells) for _, cells in x.rows] == [6, 0, 6, 0, 6]
    assert (x.rows[0][1][0].bias, x.rows[0][1][0].sigma) == ("3.0", "1.1")


def test_a_flagged_dwell_is_in_no_bin():
    warmest = bin_tables(made_up_snapshot().bins)[0].rows[0][1]
    assert [cell.count for cell in warmest] == [1, 1, 1, 1, 0, 1]


def test_bins_below_zero_have_true_minus_signs():
    labels = [label for label, _ in bin_tables(bins_of(measured_dwells(24)))[0].rows]
    assert labels[-1] == "−30…−25"


def test_no_bins_where_no_dwell_counts():
    assert bin_tables(()) == []
    assert bin_tables(bins_of(())) == []


def test_dwells_come_with_the_newest_first():
    _, rows = dwell_table(measured_dwells(13))
    assert [dwell.number for dwell, _, _ in rows] == list(range(13, 0, -1))
    (newest, temperature, cells), (flagged, _, flagged_cells) = rows[0], rows[13 - 5]
    assert (newest.position, temperature) == ("z_up", "3.1")
    assert [cell.bias for cell in cells] == ["3.0", "0.0", "1.5"]
    assert flagged.flags == "the INS left navigation in the turn"
    assert [cell.count for cell in flagged_cells] == [0, 0, 0]


def test_readings_are_shown_with_their_age():
    rows = {what: (value, age) for what, value, age in reading_rows(made_up_snapshot().bench)}
    assert rows["chamber air"] == ("−9.80 °C", "0.6 s")
    assert rows["gyro optics x, y, z"] == ("4.10, 4.90, 3.60 °C", "0.0 s")
    assert rows["table inner axis"] == ("180.000°, 0.00 deg/s", "0.4 s")


def test_readings_that_are_not_known_say_so():
    nan = math.nan
    silent = replace(
        made_up_snapshot().bench, gyro_c=(nan,) * 3, electronics_c=(nan, 12.0, nan), case_c=nan,
        outer_deg=nan, outer_rate_dps=nan, chamber_set_c=nan, ins_age_s=nan,
    )  # fmt: skip
    rows = {what: (value, age) for what, value, age in reading_rows(silent)}
    assert rows["gyro optics x, y, z"] == ("unknown", "never")
    assert rows["electronics x, y, z"] == ("–, 12.00, – °C", "never")
    assert rows["table outer axis"] == ("unknown", "0.4 s")
    assert rows["chamber set"] == ("not controlled", "0.6 s")
    assert not any("nan" in value for value, _ in rows.values())


def test_temperatures_that_the_ins_does_not_send_are_left_out():
    without = replace(made_up_snapshot().bench, electronics_c=(math.nan,) * 3, case_c=math.nan)
    assert {"electronics x, y, z", "INS case"}.isdisjoint(what for what, _, _ in reading_rows(without))


RUN = RunSummary(
    "six position #1", "six_position", ["1001"], RunState.HOLDING, "the door is open",
    "2026-03-02T07:30:00+00:00", "2026-03-02T16:42:00+00:00", 13, 24, 21600.0,
)  # fmt: skip


def test_a_run_under_way_in_one_line():
    row = list_row(RUN, Freshness(1.0, False, ""))
    assert row.address == "runs/six%20position%20%231/"
    assert (row.state, row.css_class, row.reason) == ("holding", "notable", "the door is open")
    assert row.facts == "six_position, unit 1001, 13 of 24 dwells, 6:00 h left, started 2026-03-02 07:30 UTC"


def test_a_run_of_several_units_names_each():
    row = list_row(replace(RUN, units=["1001", "1002"]), Freshness(1.0, False, ""))
    assert row.facts.startswith("six_position, units 1001, 1002, 13 of 24")


def test_a_run_that_is_over_has_nothing_left():
    row = list_row(replace(RUN, state=RunState.STOPPED), Freshness(1.0, True, ""))
    assert "left" not in row.facts


def test_a_silent_run_and_one_that_can_not_be_read_are_reported_as_such():
    silent = list_row(RUN, Freshness(40.0, False, "No update for 40 s."))
    assert (silent.state, silent.css_class, silent.reason) == ("silent", "bad", "No update for 40 s.")
    assert unreadable_row("mine", "damaged").reason == "damaged"


def test_alarms_come_first():
    row = list_row(replace(RUN, alarms=2), Freshness(1.0, False, ""))
    assert row.css_class == "bad"
    assert row.facts.startswith("▲ 2 ALARMS, ")


@pytest.mark.parametrize(
    ("verdict", "look", "text"),
    [
        ("", "good", "finished"),
        ("accepted", "good", "finished, unit accepted"),
        ("marginal", "notable", "finished, unit marginal"),
        ("rejected", "bad", "finished, unit rejected"),
    ],
)
def test_the_verdict_is_as_prominent_as_the_end_of_the_run(verdict, look, text):
    top = headline(replace(made_up_snapshot(), state=RunState.FINISHED, alarms=()), verdict)
    assert (top.css_class, top.state) == (look, text)
    assert top.symbol == ("✕" if verdict == "rejected" else "✓")
