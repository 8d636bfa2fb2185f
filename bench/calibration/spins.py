"""Scale factor of each gyro from whole turns: per spin, and its dependence on rate and direction.

A spin of whole turns of the table measures the scale factor at its rate and in its direction: the residual
angle after correction of all known errors, over the angle travelled. Noise and the table's return are
independent from spin to spin. An error of the bias is common to all spins of a gyro, with opposite effect in
opposite directions, as an asymmetry.

References
----------
IEEE Std 647-2006: scale factor, its nonlinearity and asymmetry, of single-axis laser gyros.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.bias.statistics import chi2_p_value
from gyrobench.bench.calibration.coefficients import COEFFICIENTS
from gyrobench.bench.calibration.estimator import Calibration
from gyrobench.bench.calibration.section import SpinError
from gyrobench.bench.calibration.strapdown import ASYMMETRIES
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.navigation.positions import AXES

#: Largest relative difference of rates that count as equal.
_RATE_TOLERANCE = 0.02
#: Whole turns contradict gravity if the scale factors differ by more than this number of standard
#: uncertainties plus this, ppm, which allows for accelerometers that settle by 60 ug in one turn.
_MIN_SIGMAS, _MIN_PPM = 5.0, 10.0


@dataclass(frozen=True)
class SpinRow:
    """Scale factor from one spin."""

    start_s: float  #: On the log's clock.
    axis: str
    rate_dps: float  #: With its sign.
    turns: int  #: With their sign.
    scale_factor_ppm: float
    sigma_ppm: float
    residual_ppm: float  #: Scale factor minus that of all spins of the gyro.


@dataclass(frozen=True)
class RateRow:
    """Scale factor at one rate."""

    rate_dps: float
    deviation_ppm: float  #: Scale factor, mean of both directions, minus that of all rates.
    deviation_sigma_ppm: float
    #: asymmetry_ppm, asymmetry_sigma_ppm: Scale factor in positive direction minus that in negative
    #: direction; None if only one was measured.
    asymmetry_ppm: float | None
    asymmetry_sigma_ppm: float | None


@dataclass(frozen=True)
class SpinScaleFactor:
    """Scale factor of one gyro from all its spins."""

    axis: str
    scale_factor_ppm: float
    sigma_ppm: float
    spins: tuple[SpinRow, ...]
    rates: tuple[RateRow, ...]
    p_value: float  #: Probability of the spins' scatter if the scale factor is constant.


def spin_scale_factors(calibration: Calibration, whole_turns: float) -> list[SpinScaleFactor]:
    """Scale factors of the gyros that were spun.

    ``whole_turns``: standard uncertainty, rad, of the table's return.
    """
    spins_by_axis: dict[int, list[tuple[float, SpinError]]] = {}
    common = calibration.common.copy()
    common[ASYMMETRIES] = 0.0  # so that asymmetries remain in the scale factors of the spins
    for section, recording, start in zip(
        calibration.problem.sections, calibration.recordings, calibration.starts, strict=True
    ):
        begin_s = recording.start_s + recording.rests[0].begin * recording.interval_s
        edges_s = section.interval_s * np.concatenate([[0], section.epochs.ends])
        for spin in section.spin_errors(start, common, calibration.problem.site):
            spins_by_axis.setdefault(spin.axis, []).append((begin_s + float(edges_s[spin.epoch]), spin))
    return [
        _gyro_scale_factor(calibration, axis, spins_by_axis[axis], whole_turns)
        for axis in sorted(spins_by_axis)
    ]


def gravity_contradiction(calibration: Calibration, scale_factors: Sequence[SpinScaleFactor]) -> str:
    """Message if turns are not whole according to gravity, for gyros spun with a level axis; else empty.

    ``calibration``: with ``options.whole_turns`` None, so that only gravity determines the scale factors. A
    scale factor that depends on the rate lies between those of the spins.
    """
    for each in scale_factors:
        index = 3 + 4 * AXES.index(each.axis)
        value, sigma = 1e6 * calibration.common[index], 1e6 * calibration.sigmas[index]
        by_table = [row.scale_factor_ppm for row in each.spins]
        excess = max(min(by_table) - value, value - max(by_table))
        if calibration.is_observed[index] and excess > _MIN_SIGMAS * sigma + _MIN_PPM:
            return (
                f"whole turns of the {each.axis} gyro give a scale factor of {each.scale_factor_ppm:.1f} ppm "
                f"against the table, and {value:.1f} ± {sigma:.1g} ppm against gravity. Check the encoder: "
                "the table does not turn by whole turns"
            )
    return ""


def _gyro_scale_factor(
    calibration: Calibration, axis: int, timed: Sequence[tuple[float, SpinError]], whole_turns: float
) -> SpinScaleFactor:
    spins = [spin for _, spin in timed]
    path, error, duration_s = np.array([(each.path, each.error, each.duration_s) for each in spins]).T
    values = calibration.common[3 + 4 * axis] + error / path
    noise = calibration.problem.noise
    angle = noise.angle_random_walk[axis] ** 2 * duration_s + 2.0 * noise.white_angle[axis] ** 2
    bias_response = duration_s / path
    bias = calibration.sigmas[axis] if calibration.is_observed[axis] else COEFFICIENTS[axis].size
    covariance = np.diag((angle + whole_turns**2) / path**2) + bias**2 * np.outer(
        bias_response, bias_response
    )
    rates = np.array([each.rate for each in spins])
    common = _weights(np.ones((len(spins), 1)), covariance)
    mean = float((common @ values)[0])
    residuals = values - mean
    chi2 = float(residuals @ np.linalg.solve(covariance, residuals))
    sigmas = np.sqrt(np.diag(covariance))
    rows = [
        SpinRow(
            start_s,
            AXES[axis],
            float(np.rad2deg(spin.rate)),
            round(spin.path / (2.0 * np.pi)),
            1e6 * float(value),
            1e6 * float(sigma),
            1e6 * float(value - mean),
        )
        for (start_s, spin), value, sigma in zip(timed, values, sigmas, strict=True)
    ]
    return SpinScaleFactor(
        axis=AXES[axis],
        scale_factor_ppm=1e6 * mean,
        sigma_ppm=1e6 * float(np.sqrt(common @ covariance @ common.T)[0, 0]),
        spins=tuple(rows),
        rates=tuple(_by_rate(rates, values, covariance, common[0])),
        p_value=chi2_p_value(len(spins) - 1, chi2) if len(spins) > 1 else 1.0,
    )


def _by_rate(
    rates: FloatArray, values: FloatArray, covariance: FloatArray, common: FloatArray
) -> list[RateRow]:
    rows, remaining = [], np.argsort(np.abs(rates))
    while len(remaining):
        rate = abs(rates[remaining[0]])
        is_same_rate = np.abs(np.abs(rates[remaining]) / rate - 1.0) < _RATE_TOLERANCE
        indices, remaining = remaining[is_same_rate], remaining[~is_same_rate]
        signs = np.sign(rates[indices])
        is_both = len(set(signs)) == 2
        design = np.column_stack([np.ones(len(indices)), 0.5 * signs])[:, : 2 if is_both else 1]
        weights = np.zeros((design.shape[1], len(rates)))
        weights[:, indices] = _weights(design, covariance[np.ix_(indices, indices)])
        weights[0] -= common
        estimates = 1e6 * weights @ values
        sigmas = 1e6 * np.sqrt(np.maximum(np.diag(weights @ covariance @ weights.T), 0.0))
        asymmetry = (float(estimates[1]), float(sigmas[1])) if is_both else (None, None)
        rows.append(RateRow(float(np.rad2deg(rate)), float(estimates[0]), float(sigmas[0]), *asymmetry))
    return rows


def _weights(design: FloatArray, covariance: FloatArray) -> FloatArray:
    """Weights (k, n) of values in generalised least squares by the columns of a design (n, k)."""
    weighted = np.linalg.solve(covariance, design)
    return np.asarray(np.linalg.solve(design.T @ weighted, weighted.T))
