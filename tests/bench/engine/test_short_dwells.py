"""Dwells in one position over bytes and frames: what ends a navigation, which turns, whose noise."""

from itertools import count

import numpy as np
import pytest

from gyrobench.bench.foundations.shipped import find_document

HEAD = """procedure: short
steps:
  - power_on: {{settle_s: 20}}
  - go_to: {{position: {position}}}
  - align: {{duration_s: 120}}
"""
FOUR_AZIMUTHS = ["navigate: {duration_s: 100}", *["turn: {angle_deg: 90}", "navigate: {duration_s: 100}"] * 3]


@pytest.fixture
def measured(run_watched, tmp_path):
    """``measured(steps, world, position="z_up", station="emulated")``: the only dwell, and its watcher."""
    numbers = count()

    def run(steps, world, position="z_up", station="emulated"):
        path = tmp_path / "short.yaml"
        path.write_text(HEAD.format(position=position) + "".join(f"  - {step}\n" for step in steps))
        out = tmp_path / f"run-{next(numbers)}"
        _, outcome, watcher, _ = run_watched(path, out, world, station=station)
        assert outcome.ended == "finished", outcome.reason
        (dwell,) = outcome.dwells
        return dwell, watcher

    return run


def half_turn(angle_deg=180, first_s=100, second="duration_s: 100"):
    return [
        f"navigate: {{duration_s: {first_s}}}",
        f"turn: {{angle_deg: {angle_deg}}}",
        f"navigate: {{{second}}}",
    ]


def until(sigma_dph, times):
    return half_turn(first_s=150, second=f"until: {{bias_sigma_below_dph: {sigma_dph}}}, {times}")


def largest_sigmas_dph(watcher):
    (estimates,) = watcher.estimates
    return [float(estimate.sigma_dph.max()) for estimate in estimates]


def errors_in_sigmas(dwell, watcher):
    assert dwell.row.flags == ()
    (true_bias_dph,) = watcher.true_bias_dph
    return (dwell.estimate.bias_dph - true_bias_dph) / dwell.estimate.sigma_dph


def test_a_navigation_ends_as_soon_as_the_biases_are_known_well_enough(measured):
    dwell, watcher = measured(until(0.004, "at_most_s: 600"), "gyro_a")
    *before, last = largest_sigmas_dph(watcher)
    assert last < 0.004 <= min(before)
    assert 60.0 <= np.ptp(dwell.windows[1].time_s) < 300.0
    assert max(dwell.row.sigma_dph) < 0.004
    assert np.abs(errors_in_sigmas(dwell, watcher)).max() < 4.0


def test_a_navigation_whose_biases_stay_unknown_ends_after_its_maximum_time(measured):
    dwell, watcher = measured(until(0.00001, "at_most_s: 95"), "gyro_a")
    assert np.ptp(dwell.windows[1].time_s) == pytest.approx(95.0, abs=1.5)
    assert min(largest_sigmas_dph(watcher)) > 0.00001
    assert max(dwell.row.sigma_dph) < 0.01


def test_a_navigation_lasts_its_minimum_time_however_well_the_biases_are_known(measured):
    dwell, watcher = measured(until(1, "at_least_s: 90, at_most_s: 400"), "gyro_a")
    assert np.ptp(dwell.windows[1].time_s) == pytest.approx(90.0, abs=1.5)
    assert max(largest_sigmas_dph(watcher)) < 1.0


def test_no_bias_is_estimated_before_the_turn_and_the_last_one_is_near_the_result(measured):
    dwell, watcher = measured(half_turn(first_s=200), "gyro_a")
    (estimates,) = watcher.estimates
    assert len(estimates) == 3  # every 30 s of the second 100 s
    assert sorted(largest_sigmas_dph(watcher), reverse=True) == largest_sigmas_dph(watcher)
    final, last = dwell.estimate, estimates[-1]
    # The result has 10 s more; of nested estimates the variance of the difference is that of the variances.
    scatter_dph = np.sqrt(last.sigma_dph**2 - final.sigma_dph**2)
    assert (np.abs(last.bias_dph - final.bias_dph) < 4.0 * scatter_dph).all()


@pytest.mark.parametrize("world", [pytest.param("ideal", marks=pytest.mark.long), "gyro_a"])
def test_four_azimuths_give_the_bias_better_than_two_but_not_by_the_papers_method(measured, world):
    two, _ = measured(half_turn(), world)
    four, watcher = measured(FOUR_AZIMUTHS, world)
    assert len(four.windows) == 4
    headings = [np.degrees(np.arctan2(*window.C_nb[:2, 1])) for window in four.windows]
    np.testing.assert_allclose(np.diff(headings) % 360.0, 270.0, atol=0.1)  # about Up, so against the compass
    assert (four.estimate.sigma_dph < 0.8 * two.estimate.sigma_dph).all()
    # Without noise, rounding is left.
    assert np.abs(errors_in_sigmas(four, watcher)).max() < (0.25 if world == "ideal" else 4.0)
    assert np.isnan([four.row.paper_bias_dph, four.row.paper_sigma_dph]).all()


@pytest.mark.parametrize("position", ["z_down", "y_down", "x_up"])
def test_a_turn_to_the_other_side_gives_the_same_bias(measured, position):
    dwell, watcher = measured(half_turn(-180), "ideal", position)
    assert np.abs(errors_in_sigmas(dwell, watcher)).max() < 0.25
    np.testing.assert_allclose(dwell.row.paper_bias_dph, watcher.true_bias_dph[0], atol=0.001)


def test_a_dwell_may_begin_where_the_last_one_ended(run_watched, tmp_path):
    path = tmp_path / "on.yaml"
    steps = [*half_turn(), "align: {duration_s: 120}", *half_turn()]
    path.write_text(HEAD.format(position="y_up") + "".join(f"  - {step}\n" for step in steps))
    _, outcome, watcher, _ = run_watched(path, tmp_path / "run", "ideal")
    assert [dwell.row.flags for dwell in outcome.dwells] == [(), ()]
    for dwell, true_bias_dph in zip(outcome.dwells, watcher.true_bias_dph, strict=True):
        np.testing.assert_array_less(np.abs(dwell.row.bias_dph - true_bias_dph), dwell.estimate.sigma_dph / 4)


@pytest.fixture
def undeclared_station(tmp_path):
    """The shipped station without its declared noise."""
    text = find_document("stations", "emulated").read_text()
    begin, end = text.index("  noise:\n"), text.index("unit:\n")
    path = tmp_path / "undeclared.yaml"
    path.write_text(f"{text[:begin]}  noise: estimated\n\n{text[end:]}")
    return path


def test_noise_estimated_from_the_dwell_gives_nearly_the_same_uncertainties(measured, undeclared_station):
    steps = half_turn(first_s=150, second="duration_s: 150")
    declared, _ = measured(steps, "gyro_a")
    estimated, watcher = measured(steps, "gyro_a", station=undeclared_station)
    # 300 s of three gyros give their random walk to about 5 %.
    np.testing.assert_allclose(estimated.estimate.sigma_dph, declared.estimate.sigma_dph, rtol=0.15)
    assert (estimated.estimate.sigma_dph != declared.estimate.sigma_dph).all()
    assert estimated.row.fit_p_value > 0.001
    assert len(watcher.estimates[0]) == 4


def test_noise_that_the_resolution_hides_has_to_be_declared(measured, undeclared_station):
    dwell, watcher = measured(half_turn(), "ideal", station=undeclared_station)
    assert "Declare the noise of the data sheet" in str(dwell.row.flags)
    assert np.isnan(dwell.row.bias_dph).all()
    assert watcher.estimates == [[]]
