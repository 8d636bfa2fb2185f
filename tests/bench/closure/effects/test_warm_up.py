from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects.laws import WARM_UP as EFFECT
from tests.bench.closure.thermal_bench import measure

[FORM] = EFFECT.forms
TAU_S = 3600.0


@pytest.mark.parametrize("each_cycle", [False, True], ids=["one power-on", "one in each cycle"])
def test_it_is_the_mean_of_the_decay_over_the_dwell(each_cycle):
    measured = measure(power_on_each_cycle=each_cycle)
    decay = np.exp(-measured.course.since_power_on_h * 3600.0 / TAU_S)
    expected = [decay[round(row.start_s / 60) : round(row.end_s / 60)].mean() for row in measured.rows]
    column = FORM.columns(campaign_of(measured.rows), (TAU_S,))[:, :, 0]
    np.testing.assert_allclose(column, np.repeat(np.array(expected)[:, None], 3, axis=1), atol=0.012)


def test_hours_after_power_on_it_vanishes(clean):
    column = FORM.columns(clean, (TAU_S,))[:, 0, 0]
    assert 0.7 < column[0] < 0.9
    assert column[-1] < 1e-12


def test_a_dwell_of_no_length_is_no_division_by_zero(clean):
    still = replace(clean, end_s=clean.start_s)
    assert np.isfinite(FORM.columns(still, (TAU_S,))).all()


@pytest.mark.parametrize(("cycles", "size"), [(4, 2.0), pytest.param(3, 4.0, marks=pytest.mark.long)])
def test_a_decay_longer_than_twelve_hours_is_no_drift(closed, cycles, size):
    closure = closed({_slow_decay: size}, cycles=cycles, seed=3)
    [found] = closure.effects
    assert closure.probability > 0.95
    assert found.tied_with == ()
    assert found.effect.name == "warm_up"
    assert found.candidate.values[0] == pytest.approx(30.0 * 3600.0, rel=0.15)
    assert found.candidate.form.parameters[0].high == pytest.approx(
        np.ptp([closure.campaign.start_s[0], closure.campaign.end_s[closure.searched][-1]])
    )


def _slow_decay(course):
    return np.exp(-course.since_power_on_h / 30.0)[:, None]
