"""Dwells for the tests of the estimators."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import pytest

from gyrobench.bench.bias.dwell import Dwell
from tests.bench.bias.pyins_dwells import RestingIns, simulate


@pytest.fixture(scope="session")
def dwell_of() -> Callable[..., Dwell]:
    """``dwell_of(position="y_up", gyro_bias_dph=(...))``: fields of :class:`RestingIns`."""
    return lru_cache(lambda **fields: simulate(RestingIns(**fields)))
