"""Covariances of calibrated coefficients by source of error, with the gains of the estimator fixed.

At the gains of least covariance a small change of a source's variance changes the covariance as it does at
fixed gains, for the gains are at a minimum. So what a source contributes is the derivative of the covariance
with respect to the logarithm of its variance; the contributions add up to the covariance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gyrobench.bench.calibration.coefficients import COUNT
from gyrobench.bench.calibration.estimator import MIN_P_VALUE, Calibration, CalibrationOptions, Information
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.navigation.error_model import Site

#: Relative step of the variances.
_STEP = 1e-3
_NOISE = ("angle_random_walk", "velocity_random_walk", "white_angle", "white_velocity")


def rotation_parts(
    calibration: Calibration, site: Site, options: CalibrationOptions
) -> Mapping[str, FloatArray]:
    """Covariances (21, 21) of the coefficients by source; their sum is the calibration's.

    ``options`` are those of the calibration.
    """
    larger = float(np.sqrt(1.0 + _STEP))

    def covariance(
        noise: str = "", whole_turns: float | None = options.whole_turns, size: float = 1.0
    ) -> FloatArray:
        changed = {noise: getattr(calibration.noise, noise) * larger} if noise else {}
        found = Information.of(
            calibration.sections,
            calibration.starts,
            calibration.unknowns,
            replace(calibration.noise, **changed),
            site,
            replace(options, whole_turns=whole_turns),
        )
        found = replace(found, sizes=found.sizes * size)
        return np.asarray(found.solve()[1][:COUNT, :COUNT])

    base = covariance()
    parts = {name: (covariance(name) - base) / _STEP for name in _NOISE}
    if options.whole_turns is not None:
        parts["table_return"] = (covariance(whole_turns=options.whole_turns * larger) - base) / _STEP
    parts["assumed_size"] = (covariance(size=larger) - base) / _STEP
    # The step leaves a thousandth.
    factors = np.sqrt(np.diag(base) / np.sum([np.diag(part) for part in parts.values()], axis=0))
    parts = {name: part * np.outer(factors, factors) for name, part in parts.items()}
    by_site = {name: part[:COUNT, :COUNT] for name, part in calibration.by_site.items()}
    beyond = calibration.covariance[:COUNT, :COUNT] - base - sum(by_site.values())
    # Without a misfit what is left is rounding.
    return parts | by_site | {"misfit": beyond * (calibration.fit.p_value < MIN_P_VALUE)}
