"""The difference of the two estimators as a picture."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrobench.bench.bias.dwell import NavigationWindow
from gyrobench.bench.bias.noise_estimate import estimate_noise
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.statistics import uniformity_p_value
from gyrobench.bench.foundations.arrays import DEG_PER_SQRT_H_TO_SI, RADPS_TO_DPH, UG_PER_SQRT_HZ_TO_SI
from gyrobench.bench.report.figures.estimators import (
    differences_dph,
    estimators_figure,
    fit_figure,
    has_both_estimates,
    has_distribution,
    noise_figure,
)
from gyrobench.bench.report.figures.style import png_bytes
from gyrobench.bench.report.run_text import POSITION_SIGNIFICANCE


def test_every_good_dwell_shows_the_paper_minus_the_state_space_estimate(dwells):
    figure = estimators_figure(dwells)
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["X gyro", "Y gyro", "Z gyro"]
    for axis, axes in enumerate(figure.axes):
        markers = [line for line in axes.lines if line.get_marker() != "None"]
        drawn = [value for line in markers for value in np.asarray(line.get_ydata()).tolist()]
        expected = [1e3 * (row.paper_bias_dph[axis] - row.bias_dph[axis]) for row in dwells if not row.flags]
        assert sorted(drawn) == pytest.approx(sorted(expected))


def test_bars_are_both_uncertainties_combined(dwells):
    row = dwells[0]
    assert differences_dph(row)[1] == pytest.approx(
        (row.paper_bias_dph[1] - row.bias_dph[1], math.hypot(row.sigma_dph[1], row.paper_sigma_dph[1]))
    )


def test_dwells_with_flags_or_one_estimate_are_left_out(dwells, old_dwells):
    both = [row.dwell for row in (*dwells[:8], *old_dwells[:8]) if has_both_estimates(row)]
    assert both == [1, 2, 3, 4, 5, 6, 8]


def test_run_without_the_papers_method_says_so(old_dwells):
    texts = [text.get_text() for axes in estimators_figure(old_dwells).axes for text in axes.texts]
    assert texts == ["the paper's method gave no bias"]


def ratios_by_label(axes):
    return {
        str(line.get_label()): dict(zip(line.get_xdata(), line.get_ydata(), strict=True))
        for line in axes.lines
        if not str(line.get_label()).startswith("_")
    }


def test_ratio_of_every_tested_dwell_is_drawn_in_the_style_of_its_position(dwells):
    shown = ratios_by_label(fit_figure(dwells).axes[0])
    assert list(shown) == ["Z-Up", "Z-Down", "Y-Up", "Y-Down", "X-Up", "X-Down"]
    assert shown["X-Up"] == {row.dwell: row.fit_ratio for row in dwells if row.position == "x_up"}
    assert 7 not in shown["Z-Up"]  # flagged, and not tested


def test_tested_dwell_with_a_flag_is_crossed_out(dwells):
    bad = replace(dwells[3], flags=("the model does not fit",), fit_ratio=4.0)
    shown = ratios_by_label(fit_figure([*dwells[:3], bad]).axes[0])
    assert shown["flagged"] == {4: 4.0}
    assert shown["Y-Down"] == {4: 4.0}


def test_distribution_rises_by_equal_steps_at_the_p_values(dwells):
    tested = dwells[:6]
    curve = fit_figure(tested).axes[1].lines[-1]
    assert list(curve.get_xdata()) == [0.0, *sorted(row.fit_p_value for row in tested), 1.0]
    assert np.asarray(curve.get_ydata()) == pytest.approx([*np.arange(7) / 6, 1.0])


def test_band_ends_where_the_test_of_the_text_rejects(dwells):
    axes = fit_figure(dwells[:6]).axes[1]
    band = float(axes.collections[0].get_paths()[0].vertices[:, 1].max()) - 1.0
    # Six p-values whose distribution is nowhere below uniform, and above it by the band at most.
    at_the_edge = [max((number + 1) / 6 - band, 0.0) for number in range(6)]
    assert uniformity_p_value(at_the_edge) == pytest.approx(POSITION_SIGNIFICANCE, rel=1e-6)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_few_dwells_have_whole_numbers_a_wide_range_and_no_distribution(dwells, count):
    figure = fit_figure(dwells[:count])
    png_bytes(figure)
    (axes,) = figure.axes
    low, high = axes.get_ylim()
    assert low <= 0.8
    assert high >= 1.2
    assert all(float(tick).is_integer() for tick in axes.get_xticks())
    assert not has_distribution(dwells[:count])
    assert has_distribution(dwells[:5])


def test_ratios_far_from_one_are_all_in_the_picture(dwells):
    low, high = fit_figure([*dwells[:3], replace(dwells[3], fit_ratio=4.0)]).axes[0].get_ylim()
    assert low < 0.8
    assert high > 4.0


def test_run_without_tests_says_so(old_dwells):
    figure = fit_figure(old_dwells)
    assert [text.get_text() for text in figure.axes[0].texts] == ["no dwell tested"]
    assert figure.legends == []


ARW, VRW = 0.001 * DEG_PER_SQRT_H_TO_SI, 20.0 * UG_PER_SQRT_HZ_TO_SI
DECLARED = NoiseModel.from_datasheet(0.0006, 5.0)
GRAVITY = 9.8


def made_up(attitude_step=1e-9, velocity_step=1e-7, dead=()):
    """Random walks of 300 s at 10 Hz; the dead axes do not move."""
    random = np.random.default_rng(1)
    angles, velocities = (
        walk * np.sqrt(0.1) * random.normal(size=(3000, 3)).cumsum(axis=0) for walk in (ARW, VRW)
    )
    angles[:, dead] = 0.0
    angles = np.rint(angles / attitude_step) * attitude_step
    velocities = np.rint(velocities / velocity_step) * velocity_step
    attitudes = Rotation.from_rotvec(angles).as_matrix()
    return estimate_noise([NavigationWindow(0.1 * np.arange(3000), velocities, attitudes)], GRAVITY)


@pytest.fixture(scope="module")
def estimate():
    return made_up()


def panels(figure):
    gyros, accelerometers = figure.axes
    return gyros, accelerometers


def labels(axes):
    legend = axes.get_legend()
    return [] if legend is None else [text.get_text() for text in legend.get_texts()]


def line(axes, beginning):
    (found,) = [one for one in axes.get_lines() if str(one.get_label()).startswith(beginning)]
    return np.asarray(found.get_xdata()), np.asarray(found.get_ydata())


def test_deviations_of_each_gyro_are_drawn_in_degrees_per_hour_with_error_bars(estimate):
    axes, _ = panels(noise_figure(estimate, DECLARED))
    assert axes.get_xscale() == axes.get_yscale() == "log"
    assert [one.get_label() for one in axes.containers] == ["X gyro", "Y gyro", "Z gyro"]
    for container, channel in zip(axes.containers, estimate.gyros, strict=True):
        drawn, _, bars = container.lines
        np.testing.assert_allclose(drawn.get_xdata(), channel.allan.tau_s)
        np.testing.assert_allclose(drawn.get_ydata(), channel.allan.deviation * RADPS_TO_DPH)
        heights = [np.ptp(segment[:, 1]) for segment in bars[0].get_segments()]
        assert heights[-1] / drawn.get_ydata()[-1] > 5.0 * heights[0] / drawn.get_ydata()[0] > 0.0


def test_random_walks_are_lines_of_their_size_at_one_second(estimate):
    for axes, size, declared in zip(
        panels(noise_figure(estimate, DECLARED)), (0.06, 20.0), (0.036, 5.0), strict=True
    ):
        for beginning, expected, tolerance in (("random walk", size, 0.1), ("declared", declared, 1e-6)):
            tau, level = line(axes, beginning)
            np.testing.assert_allclose(level * np.sqrt(tau), expected, rtol=tolerance)


def test_legend_states_the_values(estimate):
    gyros, accelerometers = panels(noise_figure(estimate, DECLARED))
    assert labels(gyros)[0].startswith("random walk\n0.00")
    assert "±" in labels(gyros)[0]
    assert labels(gyros)[1] == "declared\n0.0006 deg/√h"
    assert labels(accelerometers)[1] == "declared\n5 µg/√Hz"
    assert labels(gyros)[2] == labels(accelerometers)[2] == "complete fit"


def test_without_a_declared_noise_there_is_no_line_of_it(estimate):
    for axes in panels(noise_figure(estimate, None)):
        assert not any("declared" in label for label in labels(axes))


def test_legend_stands_beside_the_data(estimate):
    figure = noise_figure(estimate, DECLARED)
    png_bytes(figure)  # places everything
    for axes in figure.axes:
        legend = axes.get_legend()
        assert legend is not None
        assert legend.get_window_extent().x0 > axes.get_window_extent().x1
        assert legend.get_window_extent().x1 < figure.bbox.x1


def test_noise_that_the_resolution_hides_is_faint_and_has_a_limit():
    gyros, accelerometers = panels(noise_figure(made_up(attitude_step=5e-6, velocity_step=0.01), DECLARED))
    assert [one.get_label() for one in gyros.containers] == [
        "X gyro (below resolution)",
        "Y gyro (below resolution)",
        "Z gyro (below resolution)",
    ]
    assert all(one.lines[0].get_alpha() < 0.5 and not one.has_yerr for one in gyros.containers)
    for axes in (gyros, accelerometers):
        assert "complete fit" not in labels(axes)
        assert any(
            label.startswith("random walk\nhidden by the resolution\nbelow ") for label in labels(axes)
        )


def test_a_gyro_that_never_moves_is_left_out():
    figure = noise_figure(made_up(dead=(1,)), DECLARED)
    assert [one.get_label() for one in panels(figure)[0].containers] == ["X gyro", "Z gyro"]
    png_bytes(figure)


def test_output_that_never_changes_is_said_so():
    figure = noise_figure(made_up(attitude_step=1.0, velocity_step=10.0), DECLARED)
    for axes in panels(figure):
        assert [text.get_text() for text in axes.texts] == ["constant output: noise below resolution"]
    png_bytes(figure)


def test_equal_estimates_give_equal_files(estimate):
    assert png_bytes(noise_figure(estimate, DECLARED)) == png_bytes(noise_figure(made_up(), DECLARED))
