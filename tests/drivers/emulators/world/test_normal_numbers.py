import numpy as np
import pytest

from gyrobench.drivers.emulators.world.normal_numbers import NormalNumbers


@pytest.mark.parametrize("seed", [(0, 0, 0), (7, 1, 164_000), (3, 0, 0, 2)])
def test_the_numbers_are_those_of_numpy_however_they_are_drawn(seed):
    numbers, numpys = NormalNumbers(seed), np.random.default_rng(seed)
    for shape in (3, (1, 7), (10, 607), (60, 600), (2, 1), 0, 200_000):
        drawn = numbers.standard_normal(shape)
        assert drawn.shape == np.empty(shape).shape
        assert np.abs(drawn - numpys.standard_normal(shape)).max(initial=0.0) < 1e-13


def test_the_tails_are_drawn_too():
    drawn = NormalNumbers((1,)).standard_normal(2_000_000)
    beyond = np.abs(drawn) > 3.6541528853610088
    assert beyond.sum() == pytest.approx(2_000_000 * 2.58e-4, abs=4.0 * np.sqrt(516.0))
    assert drawn[beyond].min() < -4.5
    assert drawn[beyond].max() > 4.5
