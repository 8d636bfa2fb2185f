"""The figure of Allan deviations: what is in it."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from gyrobench.bench.bias.dwell import NavigationWindow
from gyrobench.bench.bias.noise_estimate import NoiseEstimate, estimate_noise
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.foundations.arrays import DEG_PER_SQRT_H_TO_SI, RADPS_TO_DPH, UG_PER_SQRT_HZ_TO_SI
from gyrobench.bench.report.figures.estimators import noise_figure
from gyrobench.bench.report.figures.style import png_bytes

ARW, VRW = 0.001 * DEG_PER_SQRT_H_TO_SI, 20.0 * UG_PER_SQRT_HZ_TO_SI
DECLARED = NoiseModel.from_datasheet(0.0006, 5.0)
GRAVITY = 9.8


def made_up(
    attitude_step: float = 1e-9, velocity_step: float = 1e-7, dead: tuple[int, ...] = ()
) -> NoiseEstimate:
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
def estimate() -> NoiseEstimate:
    return made_up()


def panels(figure: Figure) -> tuple[Axes, Axes]:
    gyros, accelerometers = figure.axes
    return gyros, accelerometers


def labels(axes: Axes) -> list[str]:
    legend = axes.get_legend()
    return [] if legend is None else [text.get_text() for text in legend.get_texts()]


def line(axes: Axes, beginning: str) -> tuple[np.ndarray, np.ndarray]:
    (found,) = [one for one in axes.get_lines() if str(one.get_label()).startswith(beginning)]
    return np.asarray(found.get_xdata()), np.asarray(found.get_ydata())


def test_deviations_of_each_gyro_are_drawn_in_degrees_per_hour_with_error_bars(
    estimate: NoiseEstimate,
) -> None:
    axes, _ = panels(noise_figure(estimate, DECLARED))
    assert axes.get_xscale() == axes.get_yscale() == "log"
    assert [one.get_label() for one in axes.containers] == ["X gyro", "Y gyro", "Z gyro"]
    for container, channel in zip(axes.containers, estimate.gyros, strict=True):
        drawn, _, bars = container.lines
        np.testing.assert_allclose(drawn.get_xdata(), channel.allan.tau_s)
        np.testing.assert_allclose(drawn.get_ydata(), channel.allan.deviation * RADPS_TO_DPH)
        heights = [np.ptp(segment[:, 1]) for segment in bars[0].get_segments()]
        assert heights[-1] / drawn.get_ydata()[-1] > 5.0 * heights[0] / drawn.get_ydata()[0] > 0.0


def test_random_walks_are_lines_of_their_size_at_one_second(estimate: NoiseEstimate) -> None:
    for axes, size, declared in zip(
        panels(noise_figure(estimate, DECLARED)), (0.06, 20.0), (0.036, 5.0), strict=True
    ):
        for beginning, expected, tolerance in (("random walk", size, 0.1), ("declared", declared, 1e-6)):
            tau, level = line(axes, beginning)
            np.testing.assert_allclose(level * np.sqrt(tau), expected, rtol=tolerance)


def test_legend_states_the_values(estimate: NoiseEstimate) -> None:
    gyros, accelerometers = panels(noise_figure(estimate, DECLARED))
    assert labels(gyros)[0].startswith("random walk\n0.00")
    assert "±" in labels(gyros)[0]
    assert labels(gyros)[1] == "declared\n0.0006 deg/√h"
    assert labels(accelerometers)[1] == "declared\n5 µg/√Hz"
    assert labels(gyros)[2] == labels(accelerometers)[2] == "complete fit"


def test_without_a_declared_noise_there_is_no_line_of_it(estimate: NoiseEstimate) -> None:
    for axes in panels(noise_figure(estimate, None)):
        assert not any("declared" in label for label in labels(axes))


def test_legend_stands_beside_the_data(estimate: NoiseEstimate) -> None:
    figure = noise_figure(estimate, DECLARED)
    png_bytes(figure)  # places everything
    for axes in figure.axes:
        legend = axes.get_legend()
        assert legend is not None
        assert legend.get_window_extent().x0 > axes.get_window_extent().x1
        assert legend.get_window_extent().x1 < figure.bbox.x1


def test_noise_that_the_resolution_hides_is_faint_and_has_a_limit() -> None:
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


def test_a_gyro_that_never_moves_is_left_out() -> None:
    figure = noise_figure(made_up(dead=(1,)), DECLARED)
    assert [one.get_label() for one in panels(figure)[0].containers] == ["X gyro", "Z gyro"]
    png_bytes(figure)


def test_output_that_never_changes_is_said_so() -> None:
    figure = noise_figure(made_up(attitude_step=1.0, velocity_step=10.0), DECLARED)
    for axes in panels(figure):
        assert [text.get_text() for text in axes.texts] == ["constant output: noise below resolution"]
    png_bytes(figure)


def test_equal_estimates_give_equal_files(estimate: NoiseEstimate) -> None:
    assert png_bytes(noise_figure(estimate, DECLARED)) == png_bytes(noise_figure(made_up(), DECLARED))
