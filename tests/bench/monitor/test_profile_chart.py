from dataclasses import replace

import pytest

from gyrobench.bench.live.picture_parts import MeasuredProfile, PlannedProfile
from gyrobench.bench.monitor.profile_chart import profile_chart
from tests.bench.live.made_up_picture import HOUR_S, made_up_picture
from tests.bench.monitor.test_chart import places


@pytest.fixture
def picture():
    return made_up_picture()


def curve(chart, look):
    return next(each for each in chart.curves if each.look == look)


def test_what_is_to_come_is_as_late_as_the_run(picture):
    profile = profile_chart(picture)
    chart = profile.chart
    now, late_s = round(10.0 * chart.now_percent, 1), picture.now_s - picture.plan_now_s
    planned = [place[0] for place in places(curve(chart, "chamber planned").path)]
    assert late_s == pytest.approx(0.2 * HOUR_S)
    assert max(planned) == pytest.approx(1000.0)
    assert chart.x.high == picture.planned.time_s[-1] + late_s
    assert 10.0 * chart.x.percent(picture.plan_now_s) == pytest.approx(
        planned[planned.index(now) - 1], abs=0.2
    )


def test_the_plan_reaches_now_from_both_sides(picture):
    path = curve(profile_chart(picture).chart, "gyro planned").path
    past, future = (places(part) for part in path.replace("M", "|M").split("|")[1:])
    assert past[-1][1] == future[0][1]


def test_what_was_measured_ends_now_and_is_broken_in_its_gap(picture):
    chart = profile_chart(picture).chart
    for look in ("set-point", "chamber", "gyro-x", "gyro-y", "gyro-z"):
        path = curve(chart, look).path
        assert path.count("M") == 2
        assert places(path)[-1][0] <= 10.0 * chart.now_percent + 0.1


def test_each_position_has_its_lane_with_the_stays_that_are_over_marked(picture):
    profile = profile_chart(picture)
    lanes = profile.lanes
    assert list(lanes) == ["z_up", "z_down", "y_up", "y_down", "x_up", "x_down"]
    assert [stay.is_over for stay in lanes["z_up"]] == [True, True, True, False]
    for stay in (stay for stays in lanes.values() for stay in stays):
        assert 0.0 <= stay.start_percent < stay.start_percent + stay.width_percent <= 100.001
        assert stay.is_over == (stay.start_percent + stay.width_percent < profile.chart.now_percent)


def test_a_short_run_is_told_in_minutes(picture):
    short = replace(
        picture, planned=PlannedProfile((0.0, 600.0), (20.0, 20.0), (30.0, 30.0)), now_s=60.0, left_s=540.0,
        planned_s=600.0, measured=MeasuredProfile(),
    )  # fmt: skip
    assert profile_chart(short).chart.x.title.endswith("min")


def test_there_is_no_chart_of_nothing(picture):
    assert profile_chart(replace(picture, planned=PlannedProfile(), measured=MeasuredProfile())) is None
    assert profile_chart(replace(picture, planned=PlannedProfile())) is not None
