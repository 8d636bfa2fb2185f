"""The figure of a unit's drift."""

from datetime import datetime, timedelta
from itertools import pairwise

import pytest

from gyrobench.bench.report.figures.drift import trend_figure
from gyrobench.bench.report.terminal.runs import trend_summary
from gyrobench.bench.runs.index.run_biases import LEVEL, BiasQuantity, RunBias, trends
from tests.bench.report.plain_terminal import printed_lines


def trends_of(bins, runs):
    start = datetime(2026, 1, 1)
    biases = [RunBias("1", start + timedelta(days=30 * run), 0.001 * run**2, 0.001) for run in range(runs)]
    quantities = [
        BiasQuantity(gyro, 5.0 * number, 5.0 * number + 5.0, LEVEL, ("z_up",))
        for gyro in "xyz"
        for number in range(bins)
    ]
    return trends(dict.fromkeys(quantities, biases))


@pytest.mark.parametrize(("runs", "scatter"), [(1, []), (2, ["0.0"])])
def test_the_scatter_between_runs_is_empty_for_a_single_run(runs, scatter):
    lines = printed_lines(trend_summary("1001", trends_of(1, runs), [], []))
    row = next(line for line in lines if line.startswith("x "))
    assert row.split()[4:] == scatter


@pytest.mark.draws
@pytest.mark.parametrize(("bins", "runs"), [(1, 2), (14, 6)])
def test_legends_of_the_gyros_neither_overlap_nor_leave_the_figure(bins, runs):
    figure = trend_figure("1001", trends_of(bins, runs))
    figure.canvas.draw()
    boxes = [panel.get_legend().get_window_extent() for panel in figure.axes]
    assert all(above.y0 >= below.y1 for above, below in pairwise(boxes))
    assert boxes[-1].y0 >= 0.0
    assert boxes[0].y1 <= figure.bbox.height


@pytest.mark.draws
def test_the_legend_names_slopes_only_where_there_are_some():
    titles = [
        trend_figure("1001", trends_of(2, runs)).axes[0].get_legend().get_title().get_text()
        for runs in (2, 6)
    ]
    assert ["slope" in title for title in titles] == [False, True]
