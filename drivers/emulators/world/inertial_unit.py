"""The simulated INS: boots, levels, gyrocompasses, navigates, applies a compensation.

Self-alignment skips the first seconds at rest, then averages the sensors' output: the mean specific
force is Up and the part of the mean rotation across it is North. So navigation starts with the attitude
errors that follow from the INS's own sensor errors (tilt from accelerometer bias, heading from the east
gyro). The sums are evaluated once a second, so the result does not depend on how the samples are split.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray, IntArray
from gyrobench.bench.foundations.kernels import compiled
from gyrobench.drivers.emulators.world.ins_compensation import (
    InsCompensation,
    TemperatureHistory,
    empty_table,
)
from gyrobench.drivers.emulators.world.strapdown import STATE_SIZE, gyrocompass, matrix_of, navigate
from gyrobench.drivers.emulators.world.world_file import InsBehaviour

#: Samples of the inertial sensors in a second.
SAMPLE_RATE_HZ = 100
_DT_S = 1.0 / SAMPLE_RATE_HZ
#: Rotation that counts as motion: this rate over a second, plus a few pulses.
_MOTION_RADPS = np.radians(0.02)
_PULSES_RAD = np.radians(2.0 / 3600.0)


class Mode(IntEnum):
    """Operating mode of the INS."""

    OFF = 0
    STANDBY = 1
    ALIGN = 2
    NAVIGATE = 3


class AlignmentQuality(IntEnum):
    """Quality of the alignment so far."""

    INVALID = 0
    COARSE = 1
    FINE = 2


class Epochs(NamedTuple):
    """Navigation output at the INS's epochs."""

    sample: IntArray  #: Shape (n,). Sample index since the world began (time = sample / 100 s).
    states: FloatArray  #: Shape (n, 8). Quaternion body to ENU, velocity east and north, latitude, longitude.
    mode: Mode
    alignment: AlignmentQuality
    #: align_time_s, read_c: Shapes (k,), (k, 7). Time at rest used by the alignment, and readings of the
    #: temperature sensors, at the k epochs that are whole seconds.
    align_time_s: FloatArray
    read_c: FloatArray = np.empty((0, 7))
    #: First sample and measured increments, (m, 3) rad and m/s, where the unit sends them.
    increments: tuple[int, FloatArray, FloatArray] | None = None
    taken: int = 0  #: Number of samples of the sensors that led to it.


class InertialUnit:
    """State of the INS.

    ``latitude`` is in rad, ``height`` in m.

    Attributes
    ----------
    loaded_table : ndarray, shape (3, 98)
        The compensation table as loaded so far.
    compensation : InsCompensation or None
        The applied compensation of the sensors' output.
    """

    def __init__(self, behaviour: InsBehaviour, latitude: float, height: float) -> None:
        self._behaviour = behaviour
        self._latitude = latitude + np.radians(behaviour.latitude_error_arcmin / 60.0)
        self._height = height
        self._every = round(behaviour.epoch_period_s * SAMPLE_RATE_HZ)
        self._state = np.zeros(STATE_SIZE)
        # Increments of the alignment, and of the second that is under way.
        self._sums = np.zeros((2, 2, 3))
        self._counts = np.zeros(4, np.int64)  # see _LEVELLING
        self._levelling_samples = round(behaviour.levelling_s * SAMPLE_RATE_HZ)
        self._boot_samples = 0
        self._temperatures = TemperatureHistory()
        self.powered = False
        self.mode = Mode.OFF
        self.pitch_first = False
        self.never_aligns = False  #: Alignment never reaches a result.
        self.sends_increments = False  #: Whether epochs come with the increments while it navigates.
        self.clear_compensation()
        self._reset_state()

    @property
    def uses_sensors(self) -> bool:
        """Whether the inertial sensors' output is used at present."""
        return self.mode is Mode.NAVIGATE or self.mode is Mode.ALIGN

    @property
    def changes_by_itself(self) -> bool:
        """Whether each second has to be simulated alone: it boots, or its compensation follows its state."""
        return self.powered and (self.mode is Mode.OFF or self.compensation is not None)

    @property
    def alignment(self) -> AlignmentQuality:
        """Quality of the present alignment."""
        return AlignmentQuality(self._counts[_ALIGNMENT])

    @property
    def align_time_s(self) -> float:
        """Time at rest used by the present alignment."""
        return float(self._counts[_ALIGNED]) * _DT_S

    def power(self, on: bool) -> None:
        """Switch the unit on (it boots) or off; the loaded table is lost."""
        if on != self.powered:
            self.powered = on
            self._boot_samples = round(self._behaviour.boot_s * SAMPLE_RATE_HZ)
            self.mode = Mode.OFF
            self.pitch_first = self.sends_increments = False
            self._temperatures = TemperatureHistory()
            self.clear_compensation()
            self._reset_state()

    def standby(self) -> None:
        """Stop aligning or navigating."""
        if self.mode is not Mode.OFF:
            self.mode = Mode.STANDBY
            self._reset_state()

    def align(self) -> None:
        """Restart self-alignment."""
        if self.mode is not Mode.OFF:
            self.mode = Mode.ALIGN
            self._reset_state()

    def navigate(self) -> None:
        """Switch from alignment to navigation; ignored before coarse alignment is complete."""
        if self.mode is Mode.ALIGN and self.alignment >= AlignmentQuality.COARSE:
            self.mode = Mode.NAVIGATE

    def clear_compensation(self) -> None:
        """Clear the loaded table and compensate nothing."""
        self.loaded_table = empty_table()
        self.compensation: InsCompensation | None = None

    def apply_compensation(self) -> None:
        """Apply the table as loaded now; later changes wait for the next call."""
        self.compensation = InsCompensation(self.loaded_table, self._temperatures, self._up_body())

    def sense_temperatures(self, optics_c: FloatArray, electronics_c: FloatArray) -> None:
        """Take the readings of the gyros' temperature sensors, shape (n, 3), at whole seconds.

        The compensation depends on them and on Up in the body, so with a compensation n is 1.
        """
        self._temperatures.read(optics_c, electronics_c)
        if self.compensation is not None:
            self.compensation.update(self._temperatures, self._up_body())

    def _up_body(self) -> FloatArray:
        """Up as navigated, or during alignment from the accelerometers in the present second."""
        if self.mode is Mode.NAVIGATE:
            return np.asarray(matrix_of(self._state[:4])[2])
        up = self._sums[1, 1]
        return up / math.sqrt(up @ up) if self._counts[_SECOND] else np.zeros(3)

    def advance(self, first_sample: int, rotation: FloatArray, velocity: FloatArray) -> Epochs | None:
        """Take the next sensor samples.

        None of them is beyond the next whole second, unless the first is at one. While it aligns, it takes
        them up to a second with which the quality of the alignment changes.

        Parameters
        ----------
        first_sample : int
            Index of the first sample; sample k ends at time (k + 1) / 100 s.
        rotation, velocity : ndarray, shape (n, 3)
            Measured increments, rad and m/s, compensation already subtracted.

        Returns
        -------
        Epochs or None
            The epochs that ended within these samples; None while the unit is off or boots.
        """
        n = len(rotation)
        if self.mode is Mode.OFF:
            if first_sample % SAMPLE_RATE_HZ == 0 and self.powered and self._boot_samples <= 0:
                self.mode = Mode.STANDBY
            else:
                self._boot_samples -= n
                return None
        first, alignment = (-(first_sample + 1)) % self._every, self._counts[_ALIGNMENT]
        if self.mode is Mode.ALIGN:
            coarse_s = math.inf if self.never_aligns else self._behaviour.coarse_alignment_s
            n, alignment, states, align_time_s = _align(
                self._state, self._sums, self._counts, rotation, velocity, first_sample, self._every,
                self._levelling_samples, self._latitude, coarse_s, self._behaviour.fine_alignment_s,
            )  # fmt: skip
        elif self.mode is Mode.NAVIGATE:
            states = navigate(self._state, rotation, velocity, _DT_S, self._height, first, self._every)
        else:
            states = np.empty((max(0, (n - 1 - first) // self._every + 1), STATE_SIZE))
            states[:] = self._state
        if self.mode is not Mode.ALIGN:
            seconds = (first_sample + n) // SAMPLE_RATE_HZ - first_sample // SAMPLE_RATE_HZ
            align_time_s = np.full(seconds, self.align_time_s)
        samples = np.arange(first_sample + 1 + first, first_sample + 1 + n, self._every)
        epochs = Epochs(samples, states, self.mode, AlignmentQuality(alignment), align_time_s, taken=n)
        if self.sends_increments and self.mode is Mode.NAVIGATE:
            return epochs._replace(increments=(first_sample, rotation, velocity))
        return epochs

    def _reset_state(self) -> None:
        _restart(self._state, self._sums, self._counts, self._levelling_samples, self._latitude)


#: Places of the samples of the second under way, those still to be left out, those used by the alignment, and
#: its quality.
_SECOND, _LEVELLING, _ALIGNED, _ALIGNMENT = range(4)
_COARSE, _FINE = int(AlignmentQuality.COARSE), int(AlignmentQuality.FINE)


@compiled
def _restart(
    state: FloatArray, sums: FloatArray, counts: IntArray, levelling_samples: int, latitude: float
) -> None:
    """Begin the alignment from the start."""
    for k in range(sums.size):
        sums.flat[k] = 0.0
    for k in range(counts.size):
        counts[k] = 0
    counts[_LEVELLING] = levelling_samples
    for k in range(STATE_SIZE):
        state[k] = 0.0
    state[0], state[6] = 1.0, latitude


@compiled
def _align(
    state: FloatArray, sums: FloatArray, counts: IntArray, rotation: FloatArray, velocity: FloatArray,
    first_sample: int, every: int, levelling_samples: int, latitude: float, coarse_s: float, fine_s: float,
) -> tuple[int, int, FloatArray, FloatArray]:  # fmt: skip
    """Take samples (n, 3) up to a second with which the quality of the alignment changes.

    Returns how many were taken, that quality, the states (m, 8) at the epochs, which are ``every`` samples
    apart, and the time used by the alignment at the whole seconds.
    """
    n = rotation.shape[0]
    states, align_time_s = np.empty((n // every + 1, STATE_SIZE)), np.empty(n // SAMPLE_RATE_HZ + 1)
    taken = epochs = seconds = 0
    alignment = counts[_ALIGNMENT]
    while taken < n:
        into_second = (first_sample + taken) % SAMPLE_RATE_HZ
        if into_second == 0:
            limit = _MOTION_RADPS * _DT_S * counts[_SECOND] + _PULSES_RAD
            if max(abs(sums[1, 0, 0]), abs(sums[1, 0, 1]), abs(sums[1, 0, 2])) > limit:
                _restart(state, sums, counts, levelling_samples, latitude)
            elif counts[_LEVELLING] > 0:
                counts[_LEVELLING] -= counts[_SECOND]
            else:
                for i in range(3):
                    sums[0, 0, i] += sums[1, 0, i]
                    sums[0, 1, i] += sums[1, 1, i]
                counts[_ALIGNED] += counts[_SECOND]
                if counts[_ALIGNED] * _DT_S >= coarse_s:
                    counts[_ALIGNMENT] = _FINE if counts[_ALIGNED] * _DT_S >= fine_s else _COARSE
                    quaternion = gyrocompass(sums[0, 0], sums[0, 1])
                    for i in range(4):
                        state[i] = quaternion[i]
            for i in range(3):
                sums[1, 0, i] = sums[1, 1, i] = 0.0
            counts[_SECOND] = 0
            if taken and counts[_ALIGNMENT] != alignment:
                break
            alignment = counts[_ALIGNMENT]
        stop = min(n, taken + SAMPLE_RATE_HZ - into_second)
        counts[_SECOND] += stop - taken
        for k in range(taken, stop):  # one by one: the sum does not depend on how they are split
            for i in range(3):
                sums[1, 0, i] += rotation[k, i]
                sums[1, 1, i] += velocity[k, i]
            if (first_sample + k + 1) % every == 0:
                for i in range(STATE_SIZE):
                    states[epochs, i] = state[i]
                epochs += 1
        taken = stop
        if (first_sample + taken) % SAMPLE_RATE_HZ == 0:
            align_time_s[seconds] = counts[_ALIGNED] * _DT_S
            seconds += 1
    return taken, alignment, states[:epochs], align_time_s[:seconds]
