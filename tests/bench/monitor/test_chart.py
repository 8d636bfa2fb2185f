import itertools
import math
import re

import pytest

from gyrobench.bench.monitor.chart import HOUR_S, MINUTE_S, band, line, time_axis, value_axis

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
        (45.75 * HOUR_S, HOUR_S, ["0", "6", "12", "18", "24", "30", "36", "42"]),
        (600.0, MINUTE_S, ["0", "2", "4", "6", "8", "10"]),
        (0.0, MINUTE_S, ["0", "1"]),
        (1000 * HOUR_S, HOUR_S, ["0", "144", "288", "432", "576", "720", "864"]),
    ],
)
def test_time_has_ticks_at_usual_hours_and_minutes(high_s, unit_s, texts):
    assert [tick.text for tick in time_axis("Time", 0.0, high_s, unit_s).ticks] == texts


def test_a_line_leads_through_its_points_and_is_broken_where_nothing_is_known():
    x, y = time_axis("Time", 0.0, 100.0, 1.0), value_axis("Value", [0.0, 1.0], 1.0)
    path = line(x, y, [0.0, 50.0, 60.0, 100.0], [0.0, 1.0, NAN, 0.0])
    assert path.count("M") == 2
    assert [place[0] for place in places(path)] == pytest.approx([0.0, 500.0, 1000.0])
    assert places(path)[0][1] == places(path)[2][1] > places(path)[1][1]


def test_nothing_gives_no_path():
    x, y = time_axis("Time", 0.0, 100.0, 1.0), value_axis("Value", [], 1.0)
    assert line(x, y, [1.0], [NAN]) == line(x, y, [], []) == band(x, y, [], [], []) == ""


def test_a_band_goes_there_above_and_back_below():
    x, y = time_axis("Time", 0.0, 100.0, 1.0), value_axis("Value", [0.0, 2.0], 1.0)
    path = band(x, y, [0.0, 100.0], [0.0, 0.5], [2.0, 1.5])
    assert [place[0] for place in places(path)] == [0.0, 1000.0, 1000.0, 0.0]
    heights = [place[1] for place in places(path)]
    assert heights == sorted(heights)
    assert path.endswith("Z")
