"""Figures of biases: what stands at the bars."""

from itertools import combinations

from gyrobench.bench.bias.bins import BiasBin
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.report.figures.bias import bias_figure


def test_numbers_at_bars_of_positions_that_coincide_do_not_overlap():
    bins = [
        BiasBin("x", each, 20.0, 30.0, 25.0, 0.002, 0.001, 12, chi2_reduced=1.0, spread_p_value=0.5)
        for each in POSITIONS
    ]
    figure = bias_figure("x", [], bins)
    figure.canvas.draw()
    numbers = [text for axes in figure.axes for text in axes.texts if text.get_text() == "12"]
    assert len(numbers) == 6
    boxes = [each.get_window_extent() for each in numbers]
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
