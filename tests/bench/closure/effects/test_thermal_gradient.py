import numpy as np

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects.laws import THERMAL_GRADIENT as EFFECT
from tests.bench.closure.thermal_bench import measure

[FORM] = EFFECT.forms


def test_it_is_the_electronics_above_the_optics_in_every_position(clean):
    np.testing.assert_allclose(FORM.columns(clean, ())[:, :, 0], clean.board_c - clean.gyro_c)


def test_unknown_electronics_temperatures_are_a_missing_input():
    assert "temperature sensors" in FORM.missing_input(campaign_of(measure(cycles=2, sensors=()).rows))
