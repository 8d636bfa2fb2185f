import math
from dataclasses import replace

import pytest

from gyrobench.bench.monitor.snapshot import (
    Alarm,
    MeasuredProfile,
    PlannedProfile,
    Question,
    RunState,
    UnitStatus,
    WindowTrace,
)
from gyrobench.bench.monitor.terminal_screen import screen
from tests.bench.monitor.sample_snapshots import made_up_snapshot, new_snapshot, waiting_snapshot

SNAPSHOTS = {
    "running": made_up_snapshot(),
    "waiting": waiting_snapshot(),
    "new": new_snapshot(),
    "over": replace(made_up_snapshot(), state=RunState.FINISHED, left_s=0.0, step=None, dwell=None),
    "nothing measured": replace(
        made_up_snapshot(), measured=MeasuredProfile(), planned=PlannedProfile(), dwells=(), bins=()
    ),
    "window just begun": replace(
        made_up_snapshot(),
        dwell=replace(made_up_snapshot().dwell, windows=(WindowTrace(600.0),), estimates=()),
    ),
}


def shown(snapshot, width=80, height=20, is_ascii=False):
    return [line.plain for line in screen(snapshot, width, height, is_ascii)]


@pytest.mark.parametrize("snapshot", SNAPSHOTS.values(), ids=SNAPSHOTS)
@pytest.mark.parametrize("size", [(80, 20), (80, 36), (60, 14), (40, 8), (80, 4), (20, 1), (15, 36)])
@pytest.mark.parametrize("is_ascii", [False, True])
def test_no_line_is_too_long_and_no_line_too_many(snapshot, size, is_ascii):
    lines = shown(snapshot, *size, is_ascii)
    assert lines
    assert len(lines) <= size[1]
    assert max(map(len, lines)) <= size[0]


@pytest.mark.parametrize("snapshot", SNAPSHOTS.values(), ids=SNAPSHOTS)
def test_plain_ascii_where_nothing_else_can_be_shown(snapshot):
    assert all(line.isascii() for line in shown(snapshot, is_ascii=True))


@pytest.mark.parametrize("height", [5, 8, 12, 20, 36])
def test_state_time_left_question_and_answers_stay_at_any_height(height):
    text = "\n".join(shown(waiting_snapshot(), 80, height))
    assert "WAITING FOR THE OPERATOR" in text
    assert "h left" in text
    assert "13.2 K from its set point" in text
    assert "Type one of: continue, abort" in text
    assert "ALARM rate table: no reply" in text


def test_at_24_rows_there_is_everything():
    text = "\n".join(shown(made_up_snapshot(), 80, 20))
    assert "RUNNING" in text
    assert "6:00 h left" in text
    assert "navigate 10 min  5:00 of 10:00" in text
    assert "chamber -9.8, set -10.0" in text
    assert "from now on: plan" in text
    assert "z_down at 180 deg" in text
    assert "mm/s  E East  N North" in text
    assert "change of heading, arcsec" in text
    assert "x +5.20±2.00  y -1.10±2.40  z +1.60±4.00" in text
    assert "sigma 40.0" in text
    for row in ("x 0..5         3.0±1.1", "y 0..5         0.0±1.1", "z 0..5         1.5±1.1"):
        assert row in text


def test_each_of_several_units_has_its_bins():
    one = made_up_snapshot()
    bins = [one.bins, tuple(replace(each, bias_dph=each.bias_dph + 0.1) for each in one.bins)]
    units = [
        UnitStatus(number, "navigate", (4.1, 4.9, 3.6), 13, (0.0,) * 3, (1.0,) * 3, "", bins=of_unit)
        for number, of_unit in zip(("1101", "1102"), bins, strict=True)
    ]
    dropped = replace(units[0], number="1103", dropped="no frames")
    lines = shown(replace(one, units=(*units, dropped)), 80, 40)
    assert ", 3 units " in lines[0]
    text = "\n".join(lines)
    first, second = text.index("1101, C"), text.index("1102, C")
    assert "x 0..5         3.0±1.1" in text[first:second]
    assert "x 0..5       103.0±1.1" in text[second:]
    assert "1103, C" not in text
    least = "\n".join(shown(replace(one, units=tuple(units)), 80, 22))
    assert ("1101, C" in least, "1102, C" in least) == (True, False)


def test_four_units_have_their_bins_beside_graphs_in_60_rows():
    one = made_up_snapshot()
    units = tuple(
        UnitStatus(number, "navigate", (4.1, 4.9, 3.6), 13, (0.0,) * 3, (1.0,) * 3, "", bins=one.bins)
        for number in ("1101", "1102", "1103", "1104")
    )
    text = "\n".join(shown(replace(one, units=units), 100, 60))
    assert all(f"{unit.number}, C" in text for unit in units)
    assert "from now on: plan" in text
    assert "mm/s" in text


def test_the_profile_has_room_before_all_else_that_is_drawn():
    text = "\n".join(shown(made_up_snapshot(), 80, 12))
    assert "from now on: plan" in text
    assert "mm/s" not in text


def test_what_is_asked_is_not_said_twice():
    text = " ".join(shown(waiting_snapshot(), 80, 36))
    assert text.count("Look at door") + text.count("at door and compressor") <= 2
    assert text.count("degC, 13.2 K") == 1


def test_the_reason_of_a_pause_is_shown_beside_an_alarm():
    snapshot = replace(
        made_up_snapshot(),
        state=RunState.PAUSED,
        reason="paused by the operator (terminal)",
        question=None,
        alarms=(Alarm("table_fault", "rate trip. Look at the table."),),
    )
    text = "\n".join(shown(snapshot))
    assert "PAUSED" in text
    assert "paused by the operator (terminal)" in text
    assert "ALARM table fault: rate trip." in text


def test_a_long_question_is_cut_and_its_answers_are_not():
    snapshot = replace(waiting_snapshot(), alarms=(), question=Question("Why? " * 200, ("yes", "no")))
    lines = shown(snapshot, 80, 12)
    assert "Type one of: yes, no" in lines
    assert sum("Why?" in line for line in lines) <= 3


def test_answers_that_are_old_say_so():
    bench = replace(made_up_snapshot().bench, chamber_age_s=95.0, ins_age_s=math.nan, table_age_s=40.0)
    text = "\n".join(shown(replace(made_up_snapshot(), bench=bench)))
    assert "(95 s old)" in text
    assert "INS navigate (no data)" in text
    assert "table (40 s old)" in text


@pytest.mark.parametrize("known", [0, 12])
def test_an_estimate_without_uncertainty_is_left_out_of_the_history(known):
    dwell = made_up_snapshot().dwell
    unknown = replace(dwell.estimates[0], bias_dph=(math.nan,) * 3, sigma_dph=(math.nan,) * 3)
    estimates = (unknown, *dwell.estimates[:known], unknown)
    text = "\n".join(shown(replace(made_up_snapshot(), dwell=replace(dwell, estimates=estimates)), 80, 36))
    assert ("sigma unknown" in text) == (known == 0)
    assert "sigma nan" not in text


def test_skipped_dwells_are_counted():
    text = "\n".join(shown(replace(SNAPSHOTS["over"], skipped=(3,))))
    assert "dwells measured: 13 of 24 (1 skipped)" in text


def test_a_run_that_is_over_has_no_time_left_and_no_step():
    text = "\n".join(shown(SNAPSHOTS["over"]))
    assert "FINISHED  9:12 h" in text
    assert "left" not in text.splitlines()[0]
