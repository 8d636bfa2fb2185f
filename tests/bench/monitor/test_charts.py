import itertools
import math
import re
from dataclasses import replace

import pytest

from gyrobench.bench.foundations.arrays import S_PER_H
from gyrobench.bench.monitor.charts import (
    band_path,
    bias_charts,
    line_path,
    profile_chart,
    temperature_charts,
    time_axis,
    value_axis,
    window_charts,
)
from gyrobench.bench.monitor.snapshot import CurrentDwell, LiveBias, MeasuredProfile, PlannedProfile, RunState
from tests.bench.monitor.sample_snapshots import made_up_snapshot

NAN = math.nan


def places(path):
    return [tuple(map(float, place)) for place in re.findall(r"[ML]([-\d.]+) ([-\d.]+)", path)]


@pytest.mark.parametrize("low", [-40.0, 0.0, 1e-4, 333.0])
@pytest.mark.parametrize("span", [1e-3, 0.07, 1.0, 9.9, 130.0, 4e4])
def test_ticks_are_few_equally_far_apart_and_say_where_they_are(low, span):
    axis = value_axis("Temperature", [low, low + span], 1e-9)
    values = [float(tick.text.replace("−", "-")) for tick in axis.ticks]
    steps = [b - a for a, b in itertools.pairwise(values)]
    assert 2 <= len(values) <= 9
    assert steps == pytest.approx([steps[0]] * len(steps), rel=1e-6)
    assert [axis.percent(value) for value in values] == pytest.approx(
        [tick.percent for tick in axis.ticks], abs=0.01 * 100.0
    )
    assert all(0.0 <= tick.percent <= 100.0 for tick in axis.ticks)


def test_an_upright_axis_has_its_high_end_at_the_top():
    axis = value_axis("Temperature", [10.0, 20.0], 1.0)
    assert axis.percent(20.0) < axis.percent(10.0)
    assert axis.low < 10.0
    assert axis.high > 20.0


def test_values_that_hardly_differ_do_not_fill_the_plot():
    axis = value_axis("Temperature", [20.0, 20.001, NAN], 10.0)
    assert axis.high - axis.low > 10.0


def test_an_axis_of_nothing_still_is_one():
    assert value_axis("Temperature", [NAN], 10.0).ticks


@pytest.mark.parametrize(
    ("high_s", "unit_s", "texts"),
    [
        (45.75 * S_PER_H, S_PER_H, ["0", "6", "12", "18", "24", "30", "36", "42"]),
        (2.4 * S_PER_H, S_PER_H, ["0:00", "0:20", "0:40", "1:00", "1:20", "1:40", "2:00", "2:20"]),
        (600.0, 60.0, ["0", "2", "4", "6", "8", "10"]),
        (0.0, 60.0, ["0", "1"]),
        (1000 * S_PER_H, S_PER_H, ["0", "144", "288", "432", "576", "720", "864"]),
    ],
)
def test_time_has_ticks_at_usual_hours_and_minutes(high_s, unit_s, texts):
    assert [tick.text for tick in time_axis("Time", high_s, unit_s).ticks] == texts


def test_a_line_leads_through_its_points_and_is_broken_where_nothing_is_known():
    x, y = time_axis("Time", 100.0, 1.0), value_axis("Value", [0.0, 1.0], 1.0)
    path = line_path(x, y, [0.0, 50.0, 60.0, 100.0], [0.0, 1.0, NAN, 0.0])
    assert path.count("M") == 2
    assert [place[0] for place in places(path)] == pytest.approx([0.0, 500.0, 1000.0])
    assert places(path)[0][1] == places(path)[2][1] > places(path)[1][1]


def test_nothing_gives_no_path():
    x, y = time_axis("Time", 100.0, 1.0), value_axis("Value", [], 1.0)
    assert line_path(x, y, [1.0], [NAN]) == line_path(x, y, [], []) == band_path(x, y, [], [], []) == ""


def test_a_band_goes_there_above_and_back_below():
    x, y = time_axis("Time", 100.0, 1.0), value_axis("Value", [0.0, 2.0], 1.0)
    path = band_path(x, y, [0.0, 100.0], [0.0, 0.5], [2.0, 1.5])
    assert [place[0] for place in places(path)] == [0.0, 1000.0, 1000.0, 0.0]
    heights = [place[1] for place in places(path)]
    assert heights == sorted(heights)
    assert path.endswith("Z")


@pytest.fixture
def dwell():
    return made_up_snapshot().dwell


def test_windows_share_their_scales_and_show_how_far_they_are(dwell):
    (first_velocity, first_heading), (second_velocity, second_heading) = window_charts(dwell)
    assert first_velocity.y == second_velocity.y
    assert first_heading.x == second_heading.x
    assert places(first_velocity.curves[0].path)[-1][0] == pytest.approx(1000.0, abs=10.0)
    assert places(second_velocity.curves[0].path)[-1][0] == pytest.approx(500.0, abs=10.0)


def test_velocities_are_in_mm_per_s_and_headings_in_arcsec(dwell):
    (velocity, heading), _ = window_charts(dwell)
    east_y = places(velocity.curves[0].path)[-1][1] / 10.0
    heading_y = places(heading.curves[0].path)[-1][1] / 10.0
    assert east_y == pytest.approx(velocity.y.percent(1e3 * dwell.windows[0].velocity_east_mps[-1]), abs=0.1)
    assert heading_y == pytest.approx(
        heading.y.percent(3600.0 * dwell.windows[0].heading_change_deg[-1]), abs=0.1
    )


def test_an_aligning_ins_has_no_charts():
    dwell = CurrentDwell(1, 24, 1, "z_up")
    assert window_charts(dwell) == []
    assert bias_charts(dwell) == []


def test_each_gyros_live_bias_is_shown_with_its_uncertainty(dwell):
    charts = bias_charts(dwell)
    assert [each.label for each in charts] == ["X gyro", "Y gyro", "Z gyro"]
    assert [each.text for each in charts] == ["5.2 ± 2.0", "−1.1 ± 2.4", "1.6 ± 4.0"]
    assert {each.unit for each in charts} == {"0.001 deg/h"}


def test_the_area_of_one_sigma_shrinks_onto_the_newest_bias(dwell):
    chart = bias_charts(dwell)[0].chart
    area = places(chart.curves[0].path)
    half = len(area) // 2
    widths = [below[1] - above[1] for above, below in zip(area[:half], area[: half - 1 : -1], strict=True)]
    assert widths == sorted(widths, reverse=True)
    assert widths[-1] > 0.0


def test_an_estimate_without_an_answer_is_left_out(dwell):
    nothing = LiveBias(0.0, (math.nan,) * 3, (math.nan,) * 3)
    for charts in (bias_charts(replace(dwell, estimates=(nothing, *dwell.estimates))),
                   bias_charts(replace(dwell, estimates=(nothing,)))):  # fmt: skip
        assert "nan" not in "".join(curve.path for each in charts for curve in each.chart.curves)


@pytest.fixture
def snapshot():
    return made_up_snapshot()


def curve(chart, look):
    return next(each for each in chart.curves if each.css_class == look)


def test_what_is_to_come_is_as_late_as_the_run(snapshot):
    profile = profile_chart(snapshot)
    chart = profile.chart
    now, late_s = round(10.0 * chart.now_percent, 1), snapshot.now_s - snapshot.plan_now_s
    planned = [place[0] for place in places(curve(chart, "chamber planned").path)]
    assert late_s == pytest.approx(0.2 * S_PER_H)
    assert max(planned) == pytest.approx(1000.0)
    assert chart.x.high == snapshot.planned.time_s[-1] + late_s
    assert 10.0 * chart.x.percent(snapshot.plan_now_s) == pytest.approx(
        planned[planned.index(now) - 1], abs=0.2
    )


def test_the_plan_reaches_now_from_both_sides(snapshot):
    path = curve(profile_chart(snapshot).chart, "gyro planned").path
    past, future = (places(part) for part in path.replace("M", "|M").split("|")[1:])
    assert past[-1][1] == future[0][1]


def test_what_was_measured_ends_now_and_is_broken_in_its_gap(snapshot):
    chart = profile_chart(snapshot).chart
    for look in ("set-point", "chamber", "gyro-x", "gyro-y", "gyro-z"):
        path = curve(chart, look).path
        assert path.count("M") == 2
        assert places(path)[-1][0] <= 10.0 * chart.now_percent + 0.1


def test_each_position_has_its_lane_with_the_stays_that_are_over_marked(snapshot):
    profile = profile_chart(snapshot)
    lanes = profile.lanes
    assert list(lanes) == ["z_up", "z_down", "y_up", "y_down", "x_up", "x_down"]
    assert [bar.is_over for bar in lanes["z_up"]] == [True, True, True, False]
    for bar in (bar for bars in lanes.values() for bar in bars):
        assert 0.0 <= bar.start_percent < bar.start_percent + bar.width_percent <= 100.001
        assert bar.is_over == (bar.start_percent + bar.width_percent < profile.chart.now_percent)


def test_a_measured_dwell_stays_over_where_the_return_to_the_next_one_takes_the_plan_back(snapshot):
    planned = snapshot.planned
    visit = max(
        (each for each in planned.positions if each.end_s <= snapshot.plan_now_s), key=lambda each: each.end_s
    )
    for number, back_s, is_over in (
        (snapshot.dwells[-1].number, 60.0, True),
        (snapshot.dwells[-1].number, 7200.0, True),
        (99, 60.0, False),
    ):
        positions = (replace(visit, dwells=(number,)),)
        taken_back = replace(
            snapshot,
            left_s=snapshot.planned_s - visit.end_s + back_s,
            planned=replace(planned, positions=positions),
        )
        profile = profile_chart(taken_back)
        (bar,) = profile.lanes[visit.position]
        assert bar.is_over is is_over
        is_left_of_now = bar.start_percent + bar.width_percent <= profile.chart.now_percent + 0.001
        assert is_left_of_now is is_over


def test_a_run_that_was_faster_than_its_plan_shows_the_whole_plan(snapshot):
    profile = profile_chart(replace(snapshot, state=RunState.FINISHED, left_s=0.0, now_s=9.2 * S_PER_H))
    ends = [bar.start_percent + bar.width_percent for bars in profile.lanes.values() for bar in bars]
    assert max(ends) <= 100.001
    assert profile.chart.now_percent < 65.0


def test_a_short_run_is_shown_in_minutes(snapshot):
    short = replace(
        snapshot, planned=PlannedProfile((0.0, 600.0), (20.0, 20.0), (30.0, 30.0)), now_s=60.0, left_s=540.0,
        planned_s=600.0, measured=MeasuredProfile(),
    )  # fmt: skip
    assert profile_chart(short).chart.x.title.endswith("min")


def test_there_is_no_chart_of_nothing(snapshot):
    assert profile_chart(replace(snapshot, planned=PlannedProfile(), measured=MeasuredProfile())) is None
    assert profile_chart(replace(snapshot, planned=PlannedProfile())) is not None


def test_bins_are_drawn_over_temperature_with_a_line_for_each_position():
    charts = temperature_charts(made_up_snapshot().bins)
    assert [each.label for each in charts] == ["X gyro", "Y gyro", "Z gyro"]
    filled = {each.position for each in made_up_snapshot().bins if each.count and each.gyro == "x"}
    assert {curve.css_class for curve in charts[0].chart.curves} == {f"position {name}" for name in filled}
    ticks = [tick.percent for tick in charts[0].chart.x.ticks]
    assert ticks == sorted(ticks)
    assert temperature_charts([]) == []


def test_the_scale_of_bins_covers_their_uncertainties_and_each_mean_has_its_bar():
    only = next(each for each in made_up_snapshot().bins if each.count and each.gyro == "x")
    chart = temperature_charts([replace(only, bias_dph=2e-3, sigma_dph=1e-3)])[0].chart
    assert chart.y.low < 1.0 < 3.0 < chart.y.high < 4.0
    mean, left, right, low, high = (y for _, y in places(chart.curves[0].path))
    assert left == right == mean
    assert [low, mean, high] == pytest.approx(
        [10.0 * chart.y.percent(value) for value in (1.0, 2.0, 3.0)], abs=0.1
    )


def test_the_past_of_the_plan_ends_now_where_the_run_is_ahead_of_it(snapshot):
    chart = profile_chart(replace(snapshot, now_s=snapshot.plan_now_s - 1200.0)).chart
    past = curve(chart, "gyro planned").path.replace("M", "|M").split("|")[1]
    assert max(x for x, _ in places(past)) == pytest.approx(10.0 * chart.now_percent, abs=0.1)
