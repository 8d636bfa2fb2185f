"""Estimates gyro bias and Earth rate from raw angular rates at rest, for a unit that does not navigate.

At rest a gyro measures its bias plus a component of the Earth's rotation; upside down it measures the same
bias and the opposite component. So two opposite attitudes determine both.

The rate of a recording is not estimated by the mean. The angle of a dithered ring laser gyro has noise that
does not grow with time (quantisation, residual dither), and the mean contains the full noise of the first and
the last sample. The generalised least-squares slope of the angle weights this noise against the random walk,
both estimated from the Allan variance of the recording.

References
----------
IEEE Std 952-1997, annex C (noise terms). Titterton and Weston, *Strapdown Inertial Navigation
Technology*, 2nd ed., chapter 8 (multi-position tests). Aitken, "On Least Squares and Linear
Combination of Observations", 1935.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gyrobench.bench.bias.allan import RANDOM_WALK, WHITE_ANGLE, allan_variance, fit_rate_noise
from gyrobench.bench.foundations.arrays import RADPS_TO_DPH, FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.earth import EARTH_RATE
from gyrobench.bench.navigation.positions import AXES

#: Shortest recording, s, and fewest samples.
_MIN_DURATION_S = 55.0
_MIN_SAMPLES = 100
#: Longest time between two samples, as a multiple of the usual one.
_MAX_GAP_SAMPLES = 1.5
#: Angles and forces are averaged over this time, s, to detect motion.
_MOTION_BLOCK_S = 1.0
#: Second differences of these averages are motion above this number of robust standard deviations,
#: and above 5 arcsec and 0.5 mm/s^2: at most 0.03 deg/h over 300 s.
_MOTION_SIGMAS = 8.0
_MOTION_RAD = np.deg2rad(5.0 / 3600.0)
_MOTION_MPS2 = 5e-4
#: Largest angle between a body axis and the vertical along which it should point, rad.
_MAX_TILT = np.deg2rad(5.0)

_MIN_IN_BLOCK = 5
_IQR_TO_SIGMA = 1.0 / 1.349


@dataclass(frozen=True, eq=False)
class RateRecording:
    """Output of the inertial sensors at rest, in body axes.

    Raises MeasurementError for NaN, times that do not increase, a gap, too short a time, a gyro that never
    changes, motion.
    """

    time_s: FloatArray  #: Shape (n,). Increasing.
    #: Shape (n, 3). Mean angular rate since the sample before. A coarse output must carry over its rounding
    #: errors, as counted pulses do, or its noise must exceed the rounding.
    rate_radps: FloatArray
    specific_force_mps2: FloatArray | None = None  #: Shape (n, 3), optional. For the vertical.

    def __post_init__(self) -> None:
        self._check_shapes()
        _check_times(self.time_s)
        for axis, rate in zip(AXES, self.rate_radps.T, strict=True):
            if np.ptp(rate) == 0.0:
                raise MeasurementError(
                    f"the rate of the {axis} gyro never changes: its resolution hides its noise, or it is "
                    "dead. Record increments or a finer output"
                )
        self._check_rest("angle", self.angle_rad, _MOTION_RAD)
        if self.specific_force_mps2 is not None:
            self._check_rest("specific force", self.specific_force_mps2, _MOTION_MPS2)

    @property
    def interval_s(self) -> float:
        """Mean time between two samples."""
        return float((self.time_s[-1] - self.time_s[0]) / (len(self.time_s) - 1))

    @property
    def angle_rad(self) -> FloatArray:
        """Integral of the rates since one interval before the first sample, (n + 1, 3)."""
        return np.vstack([np.zeros(3), np.cumsum(self.rate_radps * self.interval_s, axis=0)])

    @property
    def up(self) -> FloatArray | None:
        """Unit vector Up (3,) in body axes, if the specific force is there."""
        if self.specific_force_mps2 is None:
            return None
        mean = self.specific_force_mps2.mean(axis=0)
        return np.asarray(mean / np.linalg.norm(mean))

    def _check_shapes(self) -> None:
        count = len(self.time_s)
        channels = {"rate": self.rate_radps, "specific force": self.specific_force_mps2}
        for name, values in channels.items():
            if values is None:
                continue
            if values.shape != (count, 3):
                raise MeasurementError(
                    f"{count} times with a {name} of shape {values.shape}; give three a time"
                )
            is_nan = ~np.isfinite(values).all(axis=1)
            if is_nan.any():
                raise MeasurementError(
                    f"{name} is not a number in {is_nan.sum()} samples, first at "
                    f"{self.time_s[is_nan][0]:.3f} s. {_CHECK}"
                )
        if count < _MIN_SAMPLES:
            raise MeasurementError(f"only {count} samples; a recording needs {_MIN_SAMPLES}. Record longer")

    def _check_rest(self, name: str, values: FloatArray, min_limit: float) -> None:
        block = max(_MIN_IN_BLOCK, round(_MOTION_BLOCK_S / self.interval_s))
        used = len(values) // block * block
        second_differences = np.diff(values[:used].reshape(-1, block, 3).mean(axis=1), 2, axis=0)
        low, high = np.quantile(second_differences, [0.25, 0.75], axis=0)
        limit = np.maximum(_MOTION_SIGMAS * _IQR_TO_SIGMA * (high - low), min_limit)
        moved = (np.abs(second_differences) > limit).any(axis=1)
        if moved.any():
            about_s = self.time_s[(int(np.argmax(moved)) + 1) * block]
            raise MeasurementError(
                f"the {name} jumps at about {about_s:.0f} s: the unit was not at rest. Record with the table "
                "standing still"
            )


@dataclass(frozen=True, eq=False)
class RateEstimate:
    """Mean rate of a recording."""

    rate_radps: FloatArray  #: Shape (3,). Rate of each gyro.
    sigma_radps: FloatArray  #: Shape (3,). Its standard uncertainty from the noise in the recording.


@dataclass(frozen=True)
class UpDownEstimate:
    """Bias of a gyro and vertical Earth rate from two opposite attitudes."""

    #: bias_radps, bias_sigma_radps: Bias of that gyro and its standard uncertainty.
    bias_radps: float
    bias_sigma_radps: float
    #: earth_radps, earth_sigma_radps: Vertical part of the Earth's rotation, positive in the northern
    #: hemisphere.
    earth_radps: float
    earth_sigma_radps: float

    def sigmas_from(self, latitude_rad: float) -> float:
        """Difference of the Earth rate from that at a latitude, in standard uncertainties."""
        return (self.earth_radps - EARTH_RATE * float(np.sin(latitude_rad))) / self.earth_sigma_radps

    def latitude_rad(self) -> tuple[float, float]:
        """Latitude that the Earth rate implies, and its standard uncertainty.

        Raises MeasurementError if the rate is not that of the Earth at any latitude.
        """
        sine = self.earth_radps / EARTH_RATE
        if abs(sine) >= 1.0:
            raise MeasurementError(
                f"{self.earth_radps * RADPS_TO_DPH:.4f} deg/h about the vertical is more than the Earth "
                "turns. Check the scale factor of the gyro and its unit"
            )
        return float(np.arcsin(sine)), self.earth_sigma_radps / EARTH_RATE / float(np.sqrt(1.0 - sine**2))


def estimate_rate(recording: RateRecording) -> RateEstimate:
    """Estimate the mean rate of a recording by generalised least squares.

    Raises MeasurementError if the recording is too short to estimate its noise.
    """
    interval = recording.interval_s
    slopes = []
    for rate, angle in zip(recording.rate_radps.T, recording.angle_rad.T, strict=True):
        expected = fit_rate_noise(allan_variance([angle], interval)).mean_terms
        slopes.append(_slope(rate, interval, expected[WHITE_ANGLE], expected[RANDOM_WALK]))
    rates, variances = np.array(slopes).T
    return RateEstimate(rates, np.sqrt(variances))


def up_down_pair(up: RateRecording, down: RateRecording, axis: str) -> UpDownEstimate:
    """Separate bias and Earth rate by two recordings with one body axis, "x", "y" or "z", up and down.

    If specific forces are recorded, the rates are projected on the vertical determined by them. Otherwise the
    axis is assumed to be vertical, and a tilt adds a part of the horizontal Earth rate. Raises
    MeasurementError for no such axis, an axis far from the vertical, too short recordings.
    """
    if axis not in AXES:
        raise MeasurementError(f"there is no body axis '{axis}'; the axes are {', '.join(AXES)}")
    rate_up, variance_up = _vertical_rate(up, axis, 1.0)
    rate_down, variance_down = _vertical_rate(down, axis, -1.0)
    sigma = 0.5 * float(np.sqrt(variance_up + variance_down))
    return UpDownEstimate(0.5 * (rate_up - rate_down), sigma, 0.5 * (rate_up + rate_down), sigma)


_CHECK = "Check the recording"


def _check_times(time_s: FloatArray) -> None:
    if not np.isfinite(time_s).all():
        raise MeasurementError(f"the time of a sample is not a number. {_CHECK}")
    steps = np.diff(time_s)
    if not (steps > 0.0).all():
        raise MeasurementError(f"time does not increase after {time_s[:-1][steps <= 0.0][0]:.3f} s. {_CHECK}")
    if time_s[-1] - time_s[0] < _MIN_DURATION_S:
        raise MeasurementError(
            f"the recording lasts {time_s[-1] - time_s[0]:.1f} s; it needs {_MIN_DURATION_S:g} s. "
            "Record longer"
        )
    widest = int(np.argmax(steps))
    if steps[widest] > _MAX_GAP_SAMPLES * np.median(steps):
        raise MeasurementError(
            f"no sample for {steps[widest]:.4f} s after {time_s[widest]:.3f} s, where one is expected every "
            f"{np.median(steps):.4f} s: the angle in between is lost. Use the longer part alone"
        )


def _slope(rate: FloatArray, interval: float, white: float, walk: float) -> tuple[float, float]:
    """Generalised least-squares slope of the angle, and its variance.

    Neighbouring increments share the white noise of the angle between them.
    """
    from scipy.linalg import solveh_banded  # 0.1 s to import, which calibrations do without

    count = len(rate)
    bands = np.empty((2, count))
    bands[0], bands[1] = 2.0 * white + walk * interval, -white
    weights = solveh_banded(bands, np.ones(count), lower=True)
    total = weights.sum()
    return float(weights @ rate / total), float(1.0 / (total * interval**2))


def _vertical_rate(recording: RateRecording, axis: str, sign: float) -> tuple[float, float]:
    """Rate about Up and its variance."""
    nominal = sign * np.eye(3)[AXES.index(axis)]
    up = nominal if recording.up is None else recording.up
    tilt = float(np.arccos(np.clip(up @ nominal, -1.0, 1.0)))
    if not tilt <= _MAX_TILT:
        raise MeasurementError(
            f"the {axis} axis should point {'up' if sign > 0 else 'down'}, but by the specific force it is "
            f"{np.rad2deg(tilt):.1f} deg away from that. Check the order of the recordings"
        )
    estimate = estimate_rate(recording)
    return float(estimate.rate_radps @ up), float((up**2) @ estimate.sigma_radps**2)
