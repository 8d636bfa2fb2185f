"""Missions that are navigated once for each set of coefficients: many tests compare the same ones."""

from contextlib import contextmanager

import pytest

from gyrobench.bench.calibration.mission import mission_error
from gyrobench.bench.verification import coefficient_verification


@contextmanager
def missions_once():
    """Comparisons of coefficients share their missions."""
    done = {}

    def once(values, covariance, site):
        key = (values.tobytes(), covariance.tobytes(), site)
        if key not in done:
            done[key] = mission_error(values, covariance, site)
        return done[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(coefficient_verification, "mission_error", once)
        yield
