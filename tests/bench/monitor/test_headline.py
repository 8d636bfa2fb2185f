import math
from dataclasses import replace

import pytest

from gyrobench.bench.live.picture import RunState
from gyrobench.bench.monitor.headline import SIGNS, headline
from tests.bench.live.made_up_picture import made_up_picture, waiting_picture


def tiles(picture):
    return {tile.name: (tile.value, tile.below) for tile in headline(picture).tiles}


def test_a_run_in_its_middle():
    shown = tiles(made_up_picture())
    assert shown["Time left"] == ("6:00 h", "of 15:00 h planned, 0:12 h behind")
    assert shown["Chamber"] == ("−9.8 °C", "set −10.0 °C, gyros 4.2 °C")
    assert shown["Dwell"] == ("14 of 24", "Z-Down, cycle 1; 13 measured, 1 flagged")
    assert headline(made_up_picture()).share_done == pytest.approx(0.6)


def test_a_run_that_is_over_took_what_it_took():
    shown = tiles(replace(made_up_picture(), state=RunState.FINISHED, left_s=0.0))
    assert shown["Took"][0] == "9:12 h"
    assert shown["Dwells"][0] == "13 of 24"


def test_a_run_of_which_nothing_is_known_yet():
    picture = replace(
        made_up_picture(),
        state=RunState.STARTING,
        bench=None,
        dwell=None,
        dwells=(),
        left_s=0.0,
        planned_s=0.0,
    )
    assert tiles(picture)["Chamber"] == ("not known", "")
    assert headline(picture).share_done == 0.0


def test_instruments_that_say_nothing_are_told():
    bench = replace(made_up_picture().bench, chamber_set_c=math.nan, gyro_c=(math.nan,) * 3)
    assert tiles(replace(made_up_picture(), bench=bench))["Chamber"][1] == "no set point, INS silent"


def test_every_state_has_a_sign_and_an_alarm_makes_any_that_goes_on_bad():
    assert set(SIGNS) == set(RunState)
    looks = {state: headline(replace(made_up_picture(), state=state)).look for state in RunState}
    assert {state for state, look in looks.items() if look == "bad"} == {RunState.FAILED}
    assert looks[RunState.HOLDING] == "notable"
    assert headline(waiting_picture()).look == "bad"
    assert headline(replace(waiting_picture(), state=RunState.FINISHED)).look == "good"


def test_the_end_is_expected_on_the_calendar_only_where_the_run_keeps_to_it():
    real = headline(made_up_picture())
    assert real.end.isoformat() == "2026-03-02T22:42:00+00:00"
    assert headline(replace(made_up_picture(), started_utc="2000-01-01T00:00:00+00:00")).end is None
    assert headline(replace(made_up_picture(), started_utc="")).end is None
    assert headline(replace(made_up_picture(), state=RunState.STOPPED)).end is None
    assert headline(replace(made_up_picture(), state=RunState.HOLDING)).end is None
