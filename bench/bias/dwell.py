"""One dwell: its purpose, its output as the input of an estimator, and the estimated bias."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from gyrobench.bench.foundations.arrays import RADPS_TO_DPH, FloatArray, IntArray
from gyrobench.bench.foundations.errors import MeasurementError, SignalMapError
from gyrobench.bench.navigation.attitude import angle_between, rotation_vector_enu
from gyrobench.bench.navigation.positions import POSITIONS, Position

#: Fewest epochs of a window.
MIN_EPOCHS = 30
#: Shortest window, s: a minute of navigation without the epochs lost to commands.
MIN_DURATION = 55.0
#: Longest time between two epochs: this multiple of the median interval, or this time in s if that is longer.
#: Velocity and heading are integrals, which lose nothing in a gap.
_MAX_GAP_EPOCHS, _MAX_GAP_S = 5.5, 2.0
_SLOT_TOLERANCE = 1e-3
#: Largest angle between the attitude of the INS and that of the table, rad.
MAX_ATTITUDE_DISAGREEMENT = np.deg2rad(5.0)
#: If an attitude is wrong by right angles within this tolerance, rad, the mounting is wrong.
_RIGHT_ANGLE_TOLERANCE = np.deg2rad(2.0)
#: Largest change of the attitude of the INS within a window, rad: 3 deg/h for 10 min.
_MAX_MOVEMENT = np.deg2rad(0.5)


class DwellPurpose(StrEnum):
    """Purpose of a dwell."""

    CALIBRATION = "calibration"
    CALIBRATION_CHECK = "calibration_check"  #: One navigation straight from the alignment.
    ROTATIONS = "rotations"  #: Rotations about the table's axes.
    NOISE = "noise"  #: One long navigation for the gyros' noise.

    @property
    def gives_bias(self) -> bool:
        """Whether the dwell measures gyro biases by itself."""
        return self in (DwellPurpose.CALIBRATION, DwellPurpose.CALIBRATION_CHECK)


def interval_indices(time_s: FloatArray, first_s: float, interval_s: float) -> IntArray:
    """Index of the interval, counted from ``first_s``, in which each time (n,) lies."""
    return np.floor((time_s - first_s) / interval_s + _SLOT_TOLERANCE).astype(np.int64)


@dataclass(frozen=True, eq=False)
class RestOutput:
    """Output of the INS while the table holds its position."""

    time_s: FloatArray  #: Shape (n,). Time of each epoch on the clock of the INS, increasing.
    velocity_enu_mps: FloatArray  #: Shape (n, 3). Velocity East, North, Up; at rest all of it is error.
    C_nb: FloatArray  #: Shape (n, 3, 3). Attitude that the INS computed.
    gyro_c: FloatArray | None = None  #: Shape (n, 3), optional. Temperature of each gyro at each epoch.
    #: Shape (n,), optional. Temperature of the accelerometers.
    accelerometer_c: FloatArray | None = None

    def as_window(self) -> NavigationWindow:
        """Return this output as a window for the estimators; raises as :class:`NavigationWindow`."""
        return NavigationWindow(
            self.time_s, self.velocity_enu_mps, self.C_nb, self.gyro_c, self.accelerometer_c
        )


@dataclass(frozen=True, eq=False)
class NavigationWindow(RestOutput):
    """Output checked for use by the estimators.

    Raises MeasurementError for too few epochs, too short a time, a gap, times that do not increase, or NaN.
    """

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
        checked = {"velocity": self.velocity_enu_mps, "attitude": self.C_nb}
        if self.gyro_c is not None:
            if self.gyro_c.shape != (count, 3):
                raise MeasurementError(
                    f"{count} times with gyro temperatures {self.gyro_c.shape}; each epoch has three"
                )
            checked["gyro temperature"] = self.gyro_c
        if self.accelerometer_c is not None:
            if self.accelerometer_c.shape != (count,):
                raise MeasurementError(
                    f"{count} times with {self.accelerometer_c.shape} accelerometer temperatures"
                )
            checked["accelerometer temperature"] = self.accelerometer_c
        for name, values in checked.items():
            bad = ~np.isfinite(values).reshape(count, -1).all(axis=1)
            if bad.any():
                raise MeasurementError(
                    f"{name} is not a number in {bad.sum()} epochs, first at {self.time_s[bad][0]:.3f} s: "
                    "not sent, marked invalid, or not within the range of its signal in the DBC. Check "
                    "range, byte order and sign there, and the messages of the INS in the raw CAN log"
                )

    @property
    def duration_s(self) -> float:
        """Time from the first to the last epoch."""
        return float(self.time_s[-1] - self.time_s[0])

    def thinned(self, interval_s: float) -> NavigationWindow:
        """Window with only the first epoch of each interval."""
        first = np.flatnonzero(
            np.diff(interval_indices(self.time_s, self.time_s[0], interval_s), prepend=-1) > 0
        )
        gyro_c, accelerometer_c = (
            None if each is None else each[first] for each in (self.gyro_c, self.accelerometer_c)
        )
        return NavigationWindow(
            self.time_s[first], self.velocity_enu_mps[first], self.C_nb[first], gyro_c, accelerometer_c
        )


@dataclass(frozen=True, eq=False)
class TurnPath:
    """Rotation from one window to the next, as the table reports it."""

    #: Shape (k,). Times on the clock of the INS; before the first and after the last one the unit rests.
    time_s: FloatArray
    C_nb: FloatArray  #: Shape (k, 3, 3). Attitude at each of these times.

    @classmethod
    def at_constant_rate(cls, begin_s: float, end_s: float, C_nb: FloatArray) -> TurnPath:
        """Attitudes (k, 3, 3) at equal times from begin to end."""
        return cls(np.linspace(begin_s, end_s, len(C_nb)), C_nb)


@dataclass(frozen=True, eq=False)
class Dwell:
    """Navigation in one position: windows at rest, with turns about the vertical between them.

    Raises MeasurementError for an unknown position, windows out of order, or an attitude of the INS that
    disagrees with the table; SignalMapError if it disagrees by right angles.
    """

    position_name: str  #: Key of :data:`gyrobench.bench.navigation.positions.POSITIONS`.
    azimuth_rad: float  #: Azimuth of the position before the first turn; 0 in the paper.
    #: Output of the INS at rest, on one clock, without realignment in between; the paper has two.
    windows: tuple[NavigationWindow, ...]
    #: Shape (3, 3). Attitude of the unit in each window, as the table reports it.
    C_nb_table: tuple[FloatArray, ...]
    turns: tuple[TurnPath, ...]  #: From each window to the next.

    def __post_init__(self) -> None:
        if self.position_name not in POSITIONS:
            raise MeasurementError(
                f"there is no position '{self.position_name}'; the positions are {', '.join(POSITIONS)}"
            )
        if len(self.windows) != len(self.C_nb_table) or len(self.windows) != len(self.turns) + 1:
            raise MeasurementError(
                f"{len(self.windows)} windows with {len(self.C_nb_table)} attitudes of the table and "
                f"{len(self.turns)} turns between them"
            )
        if len({(window.gyro_c is None, window.accelerometer_c is None) for window in self.windows}) > 1:
            raise MeasurementError("only some windows have temperatures. " + _CHECK_INS)
        for earlier, later in itertools.pairwise(self.windows):
            if later.time_s[0] <= earlier.time_s[-1]:
                raise MeasurementError(
                    f"a window begins at {later.time_s[0]:.3f} s, before the previous one ends at "
                    f"{earlier.time_s[-1]:.3f} s on the clock of the INS. {_CHECK_INS}"
                )
        nominal = self.position.C_nb(self.azimuth_rad)
        self._check_attitude("position and azimuth", nominal, "table at the start", self.C_nb_table[0])
        for number, (window, C_nb) in enumerate(zip(self.windows, self.C_nb_table, strict=True), 1):
            self._check_attitude("INS", window.C_nb[0], f"table in window {number}", C_nb)
            self._check_rest(number, window)

    @property
    def position(self) -> Position:
        """The position by its name."""
        return POSITIONS[self.position_name]

    def _check_rest(self, number: int, window: NavigationWindow) -> None:
        rotation = np.linalg.norm(rotation_vector_enu(window.C_nb, window.C_nb[0]), axis=1)
        if not rotation.max() <= _MAX_MOVEMENT:
            raise MeasurementError(
                f"{self.position_name}: in window {number} the unit turned by "
                f"{np.rad2deg(rotation.max()):.1f} deg according to the INS (limit "
                f"{np.rad2deg(_MAX_MOVEMENT):g} deg). Check that the table holds its position"
            )

    def _check_attitude(
        self, first_name: str, C_first: FloatArray, second_name: str, C_second: FloatArray
    ) -> None:
        angle = angle_between(C_first, C_second)
        if not angle <= MAX_ATTITUDE_DISAGREEMENT:
            # An INS that has not aligned is off by any angle, a wrong mounting by right angles.
            turn = C_first.T @ C_second
            is_mounting = np.abs(turn - np.rint(turn)).max() < _RIGHT_ANGLE_TOLERANCE
            raise (SignalMapError if is_mounting else MeasurementError)(
                f"{self.position_name}: {first_name} and {second_name} disagree by "
                f"{np.rad2deg(angle):.1f} deg (at most {np.rad2deg(MAX_ATTITUDE_DISAGREEMENT):g} deg is "
                "allowed). Check directions and numbers of the axes and the mounting in rate_table of the "
                "station file, whether the INS had aligned, and, if earlier dwells agree, whether the table "
                "has lost its zero"
            )


@dataclass(frozen=True, eq=False, slots=True)
class BiasEstimate:
    """Gyro bias of one dwell."""

    bias_radps: FloatArray  #: Shape (3,). Bias of the x, y and z gyro.
    covariance: FloatArray  #: Shape (3, 3). Its covariance, (rad/s)^2.

    @property
    def bias_dph(self) -> FloatArray:
        """Bias of the x, y and z gyro, deg/h."""
        return self.bias_radps * RADPS_TO_DPH

    @property
    def sigma_dph(self) -> FloatArray:
        """Standard uncertainty of the x, y and z gyro's bias, deg/h."""
        return np.sqrt(np.diag(self.covariance)) * RADPS_TO_DPH


_CHECK_INS = "Check the messages of the INS in the raw CAN log"


def _check_times(time_s: FloatArray) -> None:
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
    if interval[widest] > max(_MAX_GAP_EPOCHS * np.median(interval), _MAX_GAP_S):
        raise MeasurementError(
            f"nothing from the INS for {interval[widest]:.3f} s after {time_s[widest]:.3f} s, where an epoch "
            f"is expected every {np.median(interval):.3f} s. {_CHECK_INS}"
        )
