import math
from dataclasses import replace

import pytest

from gyrobench.bench.live.picture_parts import DwellNow, LiveBias
from gyrobench.bench.monitor.dwell_charts import bias_charts, window_charts
from tests.bench.live.made_up_picture import made_up_picture
from tests.bench.monitor.test_chart import places


@pytest.fixture
def dwell():
    return made_up_picture().dwell


def test_windows_share_their_scales_and_show_how_far_they_are(dwell):
    first, second = window_charts(dwell)
    assert (first.number, second.number) == (1, 2)
    assert first.velocity.y == second.velocity.y
    assert first.heading.x == second.heading.x
    assert places(first.velocity.curves[0].path)[-1][0] == pytest.approx(1000.0, abs=10.0)
    assert places(second.velocity.curves[0].path)[-1][0] == pytest.approx(500.0, abs=10.0)


def test_velocities_are_in_mm_per_s_and_headings_in_arcsec(dwell):
    first, _ = window_charts(dwell)
    velocity, heading = first.velocity, first.heading
    east_y = places(velocity.curves[0].path)[-1][1] / 10.0
    heading_y = places(heading.curves[0].path)[-1][1] / 10.0
    assert east_y == pytest.approx(velocity.y.percent(1e3 * dwell.windows[0].velocity_east_mps[-1]), abs=0.1)
    assert heading_y == pytest.approx(
        heading.y.percent(3600.0 * dwell.windows[0].heading_change_deg[-1]), abs=0.1
    )


def test_an_aligning_ins_has_no_charts():
    dwell = DwellNow(1, 24, 1, "z_up")
    assert window_charts(dwell) == []
    assert bias_charts(dwell) == []


def test_each_gyros_live_bias_is_told_with_its_uncertainty(dwell):
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
