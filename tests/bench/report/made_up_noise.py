"""Noise of an INS that is made of random walks."""

import numpy as np
from scipy.spatial.transform import Rotation

from gyrobench.bench.bias.dwell import NavigationWindow
from gyrobench.bench.bias.noise_estimate import estimate_noise
from gyrobench.bench.foundations.arrays import DEG_PER_SQRT_H_TO_SI, UG_PER_SQRT_HZ_TO_SI

EPOCHS, INTERVAL_S = 1200, 0.25


def made_up_noise(arw_deg_per_sqrt_h=0.001, vrw_ug_per_sqrt_hz=20.0):
    """Estimate from five minutes at 4 Hz."""
    random = np.random.default_rng(1)
    angles, velocities = (
        walk * np.sqrt(INTERVAL_S) * random.normal(size=(EPOCHS, 3)).cumsum(axis=0)
        for walk in (arw_deg_per_sqrt_h * DEG_PER_SQRT_H_TO_SI, vrw_ug_per_sqrt_hz * UG_PER_SQRT_HZ_TO_SI)
    )
    attitudes = Rotation.from_rotvec(angles).as_matrix()
    return estimate_noise([NavigationWindow(INTERVAL_S * np.arange(EPOCHS), velocities, attitudes)], 9.8)
