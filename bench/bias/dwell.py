"""One dwell as an estimator sees it, and what an estimator gives back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.errors import MeasurementError
from bench.navigation.attitude import angle_between
from bench.navigation.earth import RADPS_TO_DPH
from bench.navigation.positions import POSITIONS, Position

#: Fewest epochs of a window.
MIN_EPOCHS = 30
#: Shortest window, s: a minute of navigation less the epochs that its commands cost.
MIN_DURATION = 55.0
#: Longest time between two epochs, as a multiple of the usual one.
MAX_GAP_EPOCHS = 5.5
#: Largest angle between the attitude of the INS and that of the table, rad.
MAX_ATTITUDE_DISAGREEMENT = np.deg2rad(5.0)


@dataclass(frozen=True, eq=False)
class NavigationWindow:
    """What the INS put out while the table stood still.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        Time of each epoch on the clock of the INS, increasing.
    velocity_enu_mps : ndarray, shape (n, 3)
        Velocity East, North, Up; at rest all of it is error.
    C_nb : ndarray, shape (n, 3, 3)
        Attitude that the INS computed.

    Raises
    ------
    MeasurementError
        Too few epochs or too short a time, a gap, times that do not increase, not a number.
    """

    time_s: NDArray[np.float64]
    velocity_enu_mps: NDArray[np.float64]
    C_nb: NDArray[np.float64]

    def __post_init__(self) -> None:
        count = len(self.time_s)
        if self.velocity_enu_mps.shape != (count, 3) or self.C_nb.shape != (count, 3, 3):
            raise MeasurementError(
                f"{count} times with velocities {self.velocity_enu_mps.shape} and attitudes "
                f"{self.C_nb.shape}; each epoch needs three velocities and a 3 by 3 attitude"
            )
        if count < MIN_EPOCHS:
            raise MeasurementError(f"only {count} epochs; a window needs {MIN_EPOCHS}. {_CHECK_INS}")
        _check_times(self.time_s)
        for name, values in (("velocity", self.velocity_enu_mps), ("attitude", self.C_nb)):
            bad = ~np.isfinite(values).reshape(count, -1).all(axis=1)
            if bad.any():
                raise MeasurementError(
                    f"{name} is not a number in {bad.sum()} epochs, first at {self.time_s[bad][0]:.3f} s. "
                    f"{_CHECK_INS}"
                )

    @property
    def duration_s(self) -> float:
        """Time from the first to the last epoch."""
        return float(self.time_s[-1] - self.time_s[0])


@dataclass(frozen=True, eq=False)
class Dwell:
    """Navigation before and after a turn about the vertical, in one position.

    Attributes
    ----------
    position_name : str
        Key of :data:`bench.navigation.positions.POSITIONS`.
    azimuth_before_rad : float
        Azimuth of the position before the turn; 0 in the paper.
    before, after : NavigationWindow
        Output of the INS, on one clock, without realignment in between.
    C_nb_table_before, C_nb_table_after : ndarray, shape (3, 3)
        Attitude of the unit by the table's word.
    gyro_c : tuple of float, optional
        Mean temperature of each gyro.

    Raises
    ------
    MeasurementError
        Unknown position, windows out of order, or an INS whose attitude is not the table's.
    """

    position_name: str
    azimuth_before_rad: float
    before: NavigationWindow
    after: NavigationWindow
    C_nb_table_before: NDArray[np.float64]
    C_nb_table_after: NDArray[np.float64]
    gyro_c: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        if self.position_name not in POSITIONS:
            raise MeasurementError(
                f"there is no position '{self.position_name}'; the positions are {', '.join(POSITIONS)}"
            )
        if self.after.time_s[0] <= self.before.time_s[-1]:
            raise MeasurementError(
                f"the window after the turn begins at {self.after.time_s[0]:.3f} s, before the first one "
                f"ends at {self.before.time_s[-1]:.3f} s on the clock of the INS. {_CHECK_INS}"
            )
        nominal = self.position.C_nb(self.azimuth_before_rad)
        self._check_attitude("position and azimuth", nominal, "table before the turn", self.C_nb_table_before)
        self._check_attitude("INS", self.before.C_nb[0], "table before the turn", self.C_nb_table_before)
        self._check_attitude("INS", self.after.C_nb[0], "table after the turn", self.C_nb_table_after)

    @property
    def position(self) -> Position:
        """The position that the name stands for."""
        return POSITIONS[self.position_name]

    def _check_attitude(
        self, what: str, C_one: NDArray[np.float64], other: str, C_other: NDArray[np.float64]
    ) -> None:
        angle = angle_between(C_one, C_other)
        if not angle <= MAX_ATTITUDE_DISAGREEMENT:
            raise MeasurementError(
                f"{self.position_name}: {what} and {other} disagree by {np.rad2deg(angle):.1f} deg "
                f"(at most {np.rad2deg(MAX_ATTITUDE_DISAGREEMENT):g} deg is allowed). Check how the station "
                "file mounts the unit on the table, and whether the INS had aligned"
            )


@dataclass(frozen=True, eq=False)
class WindowResiduals:
    """What an estimator's model leaves of one window.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        Time on the clock of the INS.
    velocity_en_mps : ndarray, shape (n, 2)
        Velocity East and North.
    heading_rad : ndarray, shape (n,)
        Rotation about Up.
    """

    time_s: NDArray[np.float64]
    velocity_en_mps: NDArray[np.float64]
    heading_rad: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BiasEstimate:
    """Gyro bias of one dwell.

    Attributes
    ----------
    bias_radps : ndarray, shape (3,)
        Bias of the x, y and z gyro.
    covariance : ndarray, shape (3, 3)
        Its covariance from the declared noise, (rad/s)^2; leaks of the method are not in it.
    residuals : tuple of WindowResiduals
        Before and after the turn.
    residual_ratio : float
        Rms of the residuals over the rms that the declared noise leads to expect. Residuals of
        integrated noise are few slow waves: two windows of 10 min give 0.7 to 1.4 in 95 % of
        dwells. Above that the noise is larger than declared, or the model does not fit.
    """

    bias_radps: NDArray[np.float64]
    covariance: NDArray[np.float64]
    residuals: tuple[WindowResiduals, WindowResiduals]
    residual_ratio: float

    @property
    def bias_dph(self) -> NDArray[np.float64]:
        """Bias of the x, y and z gyro, deg/h."""
        return self.bias_radps * RADPS_TO_DPH

    @property
    def sigma_dph(self) -> NDArray[np.float64]:
        """Standard uncertainty of the x, y and z gyro's bias, deg/h."""
        return np.sqrt(np.diag(self.covariance)) * RADPS_TO_DPH


_CHECK_INS = "Check the messages of the INS in the raw CAN log"


def _check_times(time_s: NDArray[np.float64]) -> None:
    if not np.isfinite(time_s).all():
        raise MeasurementError(f"the time of an epoch is not a number. {_CHECK_INS}")
    interval = np.diff(time_s)
    if not (interval > 0.0).all():
        raise MeasurementError(
            f"time does not increase after {time_s[:-1][interval <= 0.0][0]:.3f} s on the clock of the INS. "
            f"{_CHECK_INS}"
        )
    if time_s[-1] - time_s[0] < MIN_DURATION:
        raise MeasurementError(
            f"the window lasts {time_s[-1] - time_s[0]:.1f} s; it needs {MIN_DURATION:g} s. "
            "Lengthen the dwell"
        )
    widest = int(np.argmax(interval))
    if interval[widest] > MAX_GAP_EPOCHS * np.median(interval):
        raise MeasurementError(
            f"nothing from the INS for {interval[widest]:.3f} s after {time_s[widest]:.3f} s, where an epoch "
            f"is expected every {np.median(interval):.3f} s. {_CHECK_INS}"
        )
