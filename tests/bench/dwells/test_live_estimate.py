"""The estimate while a dwell goes on, fed with a recorded dwell bit by bit."""

from dataclasses import replace
from itertools import cycle

import numpy as np
import pytest

from gyrobench.bench.bias import parameters
from gyrobench.bench.bias.window_filter import whiten
from gyrobench.bench.dwells.dwell_output import decode_dwell, dwell_at_rest
from gyrobench.bench.dwells.live_estimate import LiveEstimate, compile_estimator
from gyrobench.bench.dwells.measure_dwell import estimate_dwell, measure_dwell

INS_STATUS = 0x010


class Replayed:
    """A recorded dwell whose frames come as far as ``now``."""

    def __init__(self, marks, frames, setup):
        self.windows, self.frames = marks.windows, frames
        self.now = 0
        self.asked_from = []
        self.live = LiveEstimate(setup, self.come)

    def come(self, first):
        self.asked_from.append(first)
        return self.frames.take(slice(first, self.now))

    def estimate_at(self, now):
        """What is estimated when that many frames have come."""
        self.now = now
        begun = [mark for mark in self.windows if mark.first_frame < now]
        return self.live.update([*begun[:-1], replace(begun[-1], end_frame=min(now, begun[-1].end_frame))])


def stops(first, end, steps):
    """Numbers from first to end, in steps of these sizes over and over."""
    sizes = cycle(steps)
    while first < end:
        first = min(end, first + next(sizes))
        yield first


@pytest.fixture
def replayed(recorded):
    return Replayed(*recorded)


def end_of(recorded):
    return recorded[0].windows[-1].end_frame


@pytest.mark.parametrize(
    "steps", [(10**6,), (1080,), (7, 1, 3333, 401, 90, 1200), (137,)], ids=["whole", "30 s", "odd", "4 s"]
)
def test_at_the_end_it_is_the_estimate_of_the_whole_dwell(recorded, replayed, steps):
    whole = measure_dwell(*recorded).estimate
    begin = recorded[0].windows[1].first_frame
    *_, last = [replayed.estimate_at(now) for now in stops(begin, end_of(recorded), steps)]
    # What can differ are temperatures between the last one that has come and the next.
    np.testing.assert_allclose(last.bias_dph, whole.bias_dph, rtol=0.0, atol=0.005 * whole.sigma_dph.min())
    np.testing.assert_allclose(last.sigma_dph, whole.sigma_dph, rtol=1e-3)
    assert last.fit.chi2 == pytest.approx(whole.fit.chi2, rel=0.01)
    assert last.fit.dof == whole.fit.dof


def test_the_biases_are_those_at_the_mean_temperature_so_far(recorded, replayed):
    marks, frames, setup = recorded
    dwell = dwell_at_rest(marks, decode_dwell(marks, frames, setup)[0], setup)
    whole = estimate_dwell(dwell, setup, setup.noise).estimate.information.bias_at_mean
    begin = recorded[0].windows[1].first_frame
    *_, last = [replayed.estimate_at(now) for now in stops(begin, end_of(recorded), (777,))]
    mean_k = np.diag(whole[:, parameters.GYRO_SLOPE])
    assert (np.abs(mean_k) > 0.1).all()
    np.testing.assert_allclose(
        np.diag(last.information.bias_at_mean[:, parameters.GYRO_SLOPE]), mean_k, atol=0.01
    )


def test_uncertainties_fall_as_the_second_window_goes_on(recorded, replayed):
    begin = recorded[0].windows[1].first_frame + 37 * 10
    estimates = [replayed.estimate_at(now) for now in range(begin, end_of(recorded), 37 * 10)]
    assert (np.diff([each.sigma_dph for each in estimates], axis=0) < 0.0).all()
    assert (estimates[0].sigma_dph > 5.0 * estimates[-1].sigma_dph).any()


def test_nothing_is_reported_or_decoded_before_the_first_turn(recorded, replayed):
    first = recorded[0].windows[0]
    estimates = {replayed.estimate_at(now) for now in range(first.first_frame + 1, first.end_frame, 1000)}
    assert estimates == {None}
    assert replayed.asked_from == []


def test_only_new_frames_are_decoded_again(recorded, replayed):
    begin = recorded[0].windows[1].first_frame
    for now in (begin + 1000, begin + 2000, begin + 3000):
        replayed.estimate_at(now)
    assert replayed.asked_from == [0, begin + 600, begin + 1600]


def test_windows_beyond_two_are_taken_as_they_come(recorded):
    marks, frames, setup = recorded
    second = marks.windows[1]
    middle = (second.first_frame + second.end_frame) // 2
    third = replace(second, first_frame=middle + 180)
    three = replace(marks, windows=(marks.windows[0], replace(second, end_frame=middle), third))
    whole = measure_dwell(three, frames, setup).estimate
    replayed = Replayed(three, frames, setup)
    *_, last = [replayed.estimate_at(now) for now in stops(second.first_frame, second.end_frame, (777,))]
    np.testing.assert_allclose(last.bias_dph, whole.bias_dph, rtol=0.0, atol=0.005 * whole.sigma_dph.min())
    np.testing.assert_allclose(last.sigma_dph, whole.sigma_dph, rtol=1e-3)


def test_an_ins_that_left_navigation_determines_nothing_more(recorded):
    marks, frames, setup = recorded
    left_at = marks.windows[1].first_frame + 2000
    data = frames.data.copy()
    aligning = (frames.arbitration_id == INS_STATUS) & (np.arange(len(frames)) >= left_at)
    aligning[left_at + 1000 :] = False  # and comes back
    data[aligning, 0] = 2
    replayed = Replayed(marks, frames.with_fields(data=data), setup)
    assert replayed.estimate_at(left_at) is not None
    assert [replayed.estimate_at(left_at + more) for more in (500, 1500, 2500)] == [None] * 3


def test_noise_that_is_not_declared_is_that_of_all_windows_so_far(recorded):
    marks, frames, setup = recorded
    own = replace(setup, noise=None)
    whole = measure_dwell(marks, frames, own).estimate
    begin = marks.windows[1].first_frame
    replayed = Replayed(marks, frames, own)
    *_, last = [replayed.estimate_at(now) for now in stops(begin, end_of(recorded), (5000,))]
    # What can differ are temperatures between the last one that has come and the next.
    np.testing.assert_allclose(last.bias_dph, whole.bias_dph, rtol=0.0, atol=0.005 * whole.sigma_dph.min())
    np.testing.assert_allclose(last.sigma_dph, whole.sigma_dph, rtol=1e-3)


def test_a_window_that_has_just_begun_shows_no_noise_and_disturbs_none(recorded):
    marks, frames, setup = recorded
    replayed = Replayed(marks, frames, replace(setup, noise=None))
    assert replayed.estimate_at(marks.windows[1].first_frame + 37 * 10) is not None


def test_noise_that_the_first_window_does_not_show_leaves_the_biases_unknown(recorded):
    marks, frames, setup = recorded
    first, second = marks.windows
    short = replace(marks, windows=(replace(first, end_frame=first.first_frame + 37 * 20), second))
    assert Replayed(short, frames, replace(setup, noise=None)).estimate_at(second.end_frame) is None
    assert Replayed(marks, frames, replace(setup, noise=None)).estimate_at(second.end_frame) is not None


@pytest.mark.parametrize("has_noise", [True, False])
def test_after_warming_up_no_estimate_compiles_anything(recorded, has_noise):
    marks, frames, setup = recorded
    compile_estimator(setup if has_noise else replace(setup, noise=None))
    compiled = list(whiten.dispatcher.signatures)
    assert compiled
    measure_dwell(marks, frames, setup)
    assert Replayed(marks, frames, setup).estimate_at(end_of(recorded)) is not None
    assert list(whiten.dispatcher.signatures) == compiled
