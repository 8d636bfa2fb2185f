"""What is known of an INS and its bench before anything is measured."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from gyrobench.bench.foundations.arrays import DPH_TO_RADPS, UG_TO_MPS2
from gyrobench.bench.foundations.errors import DocumentError

_ARCSEC = np.pi / 180.0 / 3600.0
_ARCMIN = 60.0 * _ARCSEC


@dataclass(frozen=True)
class PriorKnowledge:
    """Standard uncertainties of what acts beside the biases and the noise, SI.

    Each enters the estimate as an unknown of this size, so the bias's uncertainty holds its share.

    Attributes
    ----------
    accelerometer_bias : float
        m/s^2; so large that the data decide.
    accelerometer_drift : float
        Change of an accelerometer's bias in a dwell, m/s^3.
    gyro_scale_factor, gyro_misalignment : float
        Errors of the gyros in the turn and to the Earth's rotation, 1 and rad.
    tilt_step : float
        How far the sensors may tilt on their mount in a turn, rad.
    latitude : float
        Error of the latitude that the INS uses, rad.
    bias_slope : float
        Change of a gyro's bias with its temperature within a dwell, rad/s/K.
    accelerometer_misalignment : float
        rad; lets gravity in, so accelerometer biases seem to differ between positions. Only a
        solution of several dwells can tell.

    Raises
    ------
    DocumentError
        A value is negative or not a number.
    """

    accelerometer_bias: float = 1000.0 * UG_TO_MPS2
    gyro_scale_factor: float = 5e-6
    gyro_misalignment: float = 2.0 * _ARCSEC
    tilt_step: float = 1.0 * _ARCSEC
    latitude: float = 0.02 * _ARCMIN
    bias_slope: float = 0.001 * DPH_TO_RADPS
    accelerometer_misalignment: float = 5.0 * _ARCSEC
    accelerometer_drift: float = 2.0 * UG_TO_MPS2 / 3600.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (np.isfinite(value) and value >= 0.0):
                raise DocumentError(f"prior knowledge: {field.name} must not be negative; found {value}")

    @classmethod
    def from_datasheet(
        cls,
        accelerometer_bias_ug: float = 1000.0,
        gyro_scale_factor_ppm: float = 5.0,
        gyro_misalignment_arcsec: float = 2.0,
        tilt_step_arcsec: float = 1.0,
        latitude_arcmin: float = 0.02,
        bias_slope_dph_per_c: float = 0.001,
        accelerometer_misalignment_arcsec: float = 5.0,
        accelerometer_drift_ug_per_h: float = 2.0,
    ) -> PriorKnowledge:
        """The same in the units of data sheets."""
        return cls(
            accelerometer_bias_ug * UG_TO_MPS2,
            gyro_scale_factor_ppm * 1e-6,
            gyro_misalignment_arcsec * _ARCSEC,
            tilt_step_arcsec * _ARCSEC,
            latitude_arcmin * _ARCMIN,
            bias_slope_dph_per_c * DPH_TO_RADPS,
            accelerometer_misalignment_arcsec * _ARCSEC,
            accelerometer_drift_ug_per_h * UG_TO_MPS2 / 3600.0,
        )
