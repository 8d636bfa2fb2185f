import numpy as np

from gyrobench.bench.closure.effects.laws import G_SENSITIVITY as EFFECT
from tests.bench.closure.thermal_bench import UP

[FORM] = EFFECT.forms


def test_each_gyro_has_up_along_the_three_axes_at_every_temperature(clean):
    expected = np.array([UP[name] for name in clean.position], dtype=float)
    columns = FORM.columns(clean, ())
    for gyro in range(3):
        np.testing.assert_allclose(columns[:, gyro], expected, atol=1e-15)
