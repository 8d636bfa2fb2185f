"""The map of correlations of a planned campaign."""

from matplotlib.patches import Rectangle

from gyrobench.bench.closure.effects import all_effects
from gyrobench.bench.closure.planned_campaign import UnitProperties, planned_campaign
from gyrobench.bench.closure.separability import searched_dwells, separability
from gyrobench.bench.report.figures.separability import separability_figure
from tests.bench.closure.plans import dwell, planned, shipped


def separability_of(plan):
    return separability(searched_dwells(planned_campaign(plan, UnitProperties(0.0006))), all_effects())


def test_every_pair_shows_its_correlation_and_whether_it_is_distinguished():
    found = separability_of(shipped("six_position_fig7")[1])
    axes = separability_figure(found, 0.002, "six_position_fig7").axes[0]
    names = [each.effect.name for each in found.detections if each.missing_input is None]
    labels = [label.get_text() for label in axes.get_yticklabels()]
    assert labels == [label.get_text() for label in axes.get_xticklabels()] == [*map(found.label, names)]
    shown = {
        (names[round(text.get_position()[1])], names[round(text.get_position()[0])]): text.get_text()
        for text in axes.texts
    }
    # An effect that needs another input has no row.
    assert shown == {
        pair: f"{value:.2f}" for pair, value in found.correlation.items() if set(pair) <= set(names)
    }
    assert len(shown) == len(names) * (len(names) - 1)
    frames = [patch for patch in axes.patches if isinstance(patch, Rectangle)]
    centres = {(round(frame.get_y() + 0.44), round(frame.get_x() + 0.46)) for frame in frames}
    framed = {tuple(sorted((names[row], names[column]))) for row, column in centres}
    assert framed == {pair for pair in found.not_distinguished(0.002) if set(pair) <= set(names)}


def test_a_plan_that_shows_nothing_says_so():
    _, plan = planned(f"  - power_on\n{dwell('z_up')}")
    [axes] = separability_figure(separability_of(plan), 0.002, "test").axes
    assert "fewer than two observable effects" in axes.texts[0].get_text()
