from itertools import pairwise

import pytest

from gyrobench.bench.live.thinned import Thinned


def thinned(count, most=10):
    kept = Thinned(most)
    for number in range(count):
        kept.add((number,))
    return [number for (number,) in kept.rows()]


@pytest.mark.parametrize("count", [0, 1, 5, 9])
def test_few_rows_are_all_kept(count):
    assert thinned(count) == list(range(count))


@pytest.mark.parametrize("count", [10, 11, 57, 640, 641, 12_345])
@pytest.mark.parametrize("most", [9, 10])
def test_many_rows_are_thinned_evenly_with_the_first_and_the_newest(count, most):
    rows = thinned(count, most)
    assert most // 2 <= len(rows) <= most
    assert (rows[0], rows[-1]) == (0, count - 1)
    assert len({after - before for before, after in pairwise(rows[:-1])}) == 1
