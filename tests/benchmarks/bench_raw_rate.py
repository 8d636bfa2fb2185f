"""Bias and Earth rate from raw angular rates of a real ring laser INS, X axis up and down."""

from pathlib import Path

import numpy as np
import pytest

from gyrobench.bench.bias.raw_rate import RateRecording, up_down_pair
from gyrobench.bench.foundations.arrays import RADPS_TO_DPH
from gyrobench.bench.navigation.earth import EARTH_RATE

LN100 = Path(__file__).parents[3] / "shared" / "data" / "ln100"
LATITUDE = np.deg2rad(51.0784)


def recording(name: str, with_force: bool) -> RateRecording:
    columns = np.fromfile(LN100 / f"x_LN100_{name}.ins", "<f8").reshape(-1, 7)
    return RateRecording(columns[:, 0], np.deg2rad(columns[:, 1:4]), columns[:, 4:] if with_force else None)


@pytest.mark.skipif(not LN100.exists(), reason="the measured LN100 records are not beside the checkout")
def test_bias_and_earth_rate_of_a_measured_pair():
    print("\nMeasured ring laser INS, X up and X down, 300 s each, deg/h")
    print(f"{'':38s} {'bias':>18s} {'Earth rate, vertical':>22s}   from latitude")
    expected_dph = EARTH_RATE * np.sin(LATITUDE) * RADPS_TO_DPH
    for name, with_force in (("along the axis", False), ("along the measured vertical", True)):
        pair = up_down_pair(recording("up", with_force), recording("down", with_force), "x")
        bias, rate = (
            f"{value * RADPS_TO_DPH:8.4f} ± {sigma * RADPS_TO_DPH:.4f}"
            for value, sigma in (
                (pair.bias_radps, pair.bias_sigma_radps),
                (pair.earth_radps, pair.earth_sigma_radps),
            )
        )
        print(f"{name:38s} {bias:>18s} {rate:>22s}   {expected_dph:.4f}")
        assert abs(pair.sigmas_from(LATITUDE)) < 3.0
