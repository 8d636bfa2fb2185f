"""The figures of a search for effects: what is drawn, with which values."""

from itertools import pairwise

import numpy as np
import pytest
from matplotlib.patches import Rectangle

from gyrobench.bench.closure.effects import all_effects
from gyrobench.bench.closure.planned_campaign import UnitProperties, planned_campaign
from gyrobench.bench.closure.separability import searched_dwells, separability
from gyrobench.bench.foundations.arrays import rms
from gyrobench.bench.report.figures.closure import (
    closure_effect_figure,
    closure_error_figure,
    closure_evidence_figure,
    closure_residual_figure,
    separability_figure,
    temperature_groups,
)
from tests.bench.closure.plans import dwell, planned, shipped
from tests.bench.report.made_up_closure import ambiguous, clean, explained, unexplained, without_boards


def points(axes, label):
    [line] = [line for line in axes.get_lines() if line.get_label() == label]
    return np.array(line.get_xdata()), np.array(line.get_ydata())


def texts(figure):
    return " ".join(text.get_text() for axes in figure.axes for text in axes.texts)


def test_residuals_are_drawn_before_and_after_against_four_things():
    closure = explained()
    figure = closure_residual_figure(closure, "x")
    assert len(figure.axes) == 8
    for axes, model in ((figure.axes[0], closure.declared), (figure.axes[4], closure.model)):
        expected = 1000.0 * closure.residuals_dph(model)[:, 0]
        for label, chosen in (("searched", closure.searched), ("held out", ~closure.searched)):
            along, values = points(axes, label)
            assert along == pytest.approx(closure.campaign.gyro_c[chosen, 0])
            assert values == pytest.approx(expected[chosen])


def test_the_noise_is_a_band_of_one_sigma():
    figure = closure_residual_figure(explained(), "y")
    [band] = figure.axes[0].patches
    assert (band.get_y(), band.get_height()) == pytest.approx((-2.0, 4.0))


def test_dwells_of_a_position_stand_together():
    figure = closure_residual_figure(explained(), "z")
    along, _ = points(figure.axes[3], "searched")
    names = np.array(explained().campaign.position)[explained().searched]
    ticks = [tick.get_text() for tick in figure.axes[-1].get_xticklabels()]
    assert ticks[0] == "Z-Up"
    assert np.abs(along[names == "z_up"]).max() < 0.5


def test_without_effects_the_declared_model_stands_alone():
    assert len(closure_residual_figure(clean(), "x").axes) == 4


def test_the_evidence_has_a_bar_for_each_effect_as_long_as_its_share():
    closure = ambiguous()
    [axes] = closure_evidence_figure(closure).axes
    lengths = [bar.get_width() for bar in axes.patches]
    assert lengths == pytest.approx([100.0 * min(max(each.share, 0.0), 1.0) for each in closure.evidence])
    assert len({bar.get_facecolor() for bar in axes.patches}) == 3


def test_an_effect_not_fitted_is_shown_with_the_reason():
    figure = closure_evidence_figure(without_boards())
    assert "not fitted; missing: temperature sensors" in texts(figure)
    low, high = sorted(figure.axes[0].get_ylim())
    assert low < 0
    assert high > len(without_boards().evidence) - 1


def test_without_excess_variance_the_bars_are_p_values():
    assert "p = 1.000" in texts(closure_evidence_figure(clean()))


def test_the_effect_is_drawn_as_partial_residuals_on_the_fit():
    closure = explained()
    [found] = closure.effects
    figure = closure_effect_figure(closure, found)
    along, line = points(figure.axes[0], "fit")
    assert along == pytest.approx(np.sort(closure.campaign.rate_c_per_h[:, 0]))
    assert np.diff(line) == pytest.approx(1000.0 * found.sizes_dph[0, 0] * np.diff(along))
    dwells, values = points(figure.axes[0], "searched")
    left = values - np.interp(dwells, along, line)
    assert left == pytest.approx(1000.0 * closure.residuals_dph(closure.model)[closure.searched, 0])


@pytest.mark.parametrize("end", [4.0, 5.0, 10.0, 100.0])
def test_numbers_below_neighbouring_panels_of_an_effect_stand_apart(end):
    [found] = explained().effects
    figure = closure_effect_figure(explained(), found)
    for axes in figure.axes:
        axes.set(xlim=(-end, end), xticks=np.linspace(-end, end, 5))
    figure.canvas.draw()
    ends = [[each.get_window_extent() for each in axes.get_xticklabels()] for axes in figure.axes]
    apart_in = [(after[0].x0 - before[-1].x1) / figure.dpi for before, after in pairwise(ends)]
    assert min(apart_in) > 0.03


def test_a_gyro_without_the_effect_is_marked():
    [found] = explained().effects
    assert "z" not in found.axes
    assert "not significant" in texts(closure_effect_figure(explained(), found))


def test_errors_are_pairs_of_bars_with_the_noise():
    closure = explained()
    upper, lower = closure_error_figure(closure).axes
    assert len(upper.patches) == 2 * (3 + 6)
    errors_dph = closure.residuals_dph(closure.declared)[~closure.searched]
    assert upper.patches[0].get_height() == pytest.approx(1000.0 * rms(errors_dph[:, 0]))
    assert len(lower.patches) == 2 * len(temperature_groups(closure))


def test_temperature_bins_hold_every_bias_held_out_once():
    groups = temperature_groups(unexplained())
    counts = sum(chosen.astype(int) for chosen in groups.values())
    assert np.array_equal(counts, np.repeat(~unexplained().searched[:, None], 3, axis=1).astype(int))
    assert len(groups) <= 12


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
