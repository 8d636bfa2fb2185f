"""The simulated INS: boots, levels, gyrocompasses, navigates, and applies a compensation.

Self-alignment skips the first seconds at rest, then averages the sensors' output: the mean specific
force gives Up, and the horizontal component of the mean rotation gives North. So navigation starts with the
attitude errors that the INS's own sensor errors cause (tilt from accelerometer bias, heading from the east
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
#: Rotation that counts as motion: that of this rate in a second, plus a few pulses.
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
    #: align_time_s, read_c: Shapes (k,), (k, 7). At the k epochs that are whole seconds: time at rest used by
    #: the alignment, and readings of the temperature sensors.
    align_time_s: FloatArray
    read_c: FloatArray = np.empty((0, 7))
    #: Index of the first sample, and measured increments, (m, 3), rad and m/s; None if the unit sends none.
    increments: tuple[int, FloatArray, FloatArray] | None = None
    used_samples: int = 0  #: Number of sensor samples that were processed for these epochs.


class InertialUnit:
    """State of the INS.

    ``latitude`` is in rad, ``height`` in m. ``loaded_table``, shape (3, 98), is the compensation table as
    loaded so far, ``compensation`` the one that is applied to the sensors' output, if any.
    """

    def __init__(self, behaviour: InsBehaviour, latitude: float, height: float) -> None:
        self._behaviour = behaviour
        self._latitude = latitude + np.radians(behaviour.latitude_error_arcmin / 60.0)
        self._height = height
        self._samples_per_epoch = round(behaviour.epoch_period_s * SAMPLE_RATE_HZ)
        self._state = np.zeros(STATE_SIZE)
        # Sums of the increments: of the alignment, and of the second in progress.
        self._sums = np.zeros((2, 2, 3))
        self._counts = np.zeros(4, np.int64)  # see _SECOND
        self._levelling_samples = round(behaviour.levelling_s * SAMPLE_RATE_HZ)
        self._boot_samples = 0
        self._temperatures = TemperatureHistory()
        self.powered = False
        self.mode = Mode.OFF
        self.pitch_first = False
        self.never_aligns = False  #: Whether alignment never succeeds.
        self.sends_increments = False  #: Whether epochs include the increments during navigation.
        self.clear_compensation()
        self._reset_state()

    @property
    def uses_sensors(self) -> bool:
        """Whether the present mode uses the output of the inertial sensors."""
        return self.mode is Mode.NAVIGATE or self.mode is Mode.ALIGN

    @property
    def changes_by_itself(self) -> bool:
        """Whether seconds must be simulated one by one: while it boots, or with a compensation in use."""
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
        """Clear the loaded table and end the compensation."""
        self.loaded_table = empty_table()
        self.compensation: InsCompensation | None = None

    def apply_compensation(self) -> None:
        """Apply a copy of the loaded table; later changes of the table have no effect until the next call."""
        self.compensation = InsCompensation(self.loaded_table, self._temperatures, self._up_body())

    def sense_temperatures(self, optics_c: FloatArray, electronics_c: FloatArray) -> None:
        """Process the readings of the gyros' temperature sensors, shape (n, 3), at whole seconds.

        With a compensation n must be 1, since it depends on these and on the present attitude.
        """
        self._temperatures.read(optics_c, electronics_c)
        if self.compensation is not None:
            self.compensation.update(self._temperatures, self._up_body())

    def _up_body(self) -> FloatArray:
        """Up in body axes: as navigated, or from the accelerometers in the present second; else zero."""
        if self.mode is Mode.NAVIGATE:
            return np.asarray(matrix_of(self._state[:4])[2])
        up = self._sums[1, 1]
        return up / math.sqrt(up @ up) if self._counts[_SECOND] else np.zeros(3)

    def advance(self, first_sample: int, rotation: FloatArray, velocity: FloatArray) -> Epochs | None:
        """Process the next sensor samples; the epochs within them, None while the unit is off or boots.

        Sample k ends at time (k + 1) / 100 s. ``rotation`` and ``velocity``, (n, 3), are measured increments,
        rad and m/s, compensation already subtracted. They must not extend beyond the next whole second,
        unless they start at a whole second. During alignment the samples are processed only up to the second
        in which the alignment quality changes; ``used_samples`` of the result gives their number.
        """
        n = len(rotation)
        if self.mode is Mode.OFF:
            if first_sample % SAMPLE_RATE_HZ == 0 and self.powered and self._boot_samples <= 0:
                self.mode = Mode.STANDBY
            else:
                self._boot_samples -= n
                return None
        first, alignment = (-(first_sample + 1)) % self._samples_per_epoch, self._counts[_ALIGNMENT]
        if self.mode is Mode.ALIGN:
            coarse_s = math.inf if self.never_aligns else self._behaviour.coarse_alignment_s
            n, alignment, states, align_time_s = _align(
                self._state, self._sums, self._counts, rotation, velocity, first_sample,
                self._samples_per_epoch, self._levelling_samples, self._latitude, coarse_s,
                self._behaviour.fine_alignment_s,
            )  # fmt: skip
        elif self.mode is Mode.NAVIGATE:
            states = navigate(
                self._state, rotation, velocity, _DT_S, self._height, first, self._samples_per_epoch
            )
        else:
            states = np.empty((max(0, (n - 1 - first) // self._samples_per_epoch + 1), STATE_SIZE))
            states[:] = self._state
        if self.mode is not Mode.ALIGN:
            seconds = (first_sample + n) // SAMPLE_RATE_HZ - first_sample // SAMPLE_RATE_HZ
            align_time_s = np.full(seconds, self.align_time_s)
        samples = np.arange(first_sample + 1 + first, first_sample + 1 + n, self._samples_per_epoch)
        epochs = Epochs(samples, states, self.mode, AlignmentQuality(alignment), align_time_s, used_samples=n)
        if self.sends_increments and self.mode is Mode.NAVIGATE:
            return epochs._replace(increments=(first_sample, rotation, velocity))
        return epochs

    def _reset_state(self) -> None:
        _restart(self._state, self._sums, self._counts, self._levelling_samples, self._latitude)


#: Indices in the counts: samples of the second in progress, samples still to be skipped for levelling,
#: samples used by the alignment, and the alignment quality.
_SECOND, _LEVELLING, _ALIGNED, _ALIGNMENT = range(4)
_COARSE, _FINE = int(AlignmentQuality.COARSE), int(AlignmentQuality.FINE)


@compiled
def _restart(
    state: FloatArray, sums: FloatArray, counts: IntArray, levelling_samples: int, latitude: float
) -> None:
    """Restart the alignment."""
    for k in range(sums.size):
        sums.flat[k] = 0.0
    for k in range(counts.size):
        counts[k] = 0
    counts[_LEVELLING] = levelling_samples
    for k in range(STATE_SIZE):
        state[k] = 0.0
    state[0], state[6] = 1.0, latitude


@compiled
def _use_second(
    state: FloatArray, sums: FloatArray, counts: IntArray, levelling_samples: int, latitude: float,
    coarse_s: float, fine_s: float,
) -> None:  # fmt: skip
    """Add the sums of the second in progress to those of the alignment; restart the alignment on motion."""
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


@compiled
def _align(
    state: FloatArray, sums: FloatArray, counts: IntArray, rotation: FloatArray, velocity: FloatArray,
    first_sample: int, every: int, levelling_samples: int, latitude: float, coarse_s: float, fine_s: float,
) -> tuple[int, int, FloatArray, FloatArray]:  # fmt: skip
    """Process samples (n, 3) up to the second in which the alignment quality changes.

    Returns the number of processed samples, their alignment quality, the states (m, 8) at the epochs, which
    are ``every`` samples apart, and the time used by the alignment at the whole seconds.
    """
    n = rotation.shape[0]
    states, align_time_s = np.empty((n // every + 1, STATE_SIZE)), np.empty(n // SAMPLE_RATE_HZ + 1)
    used = epochs = seconds = 0
    alignment = counts[_ALIGNMENT]
    while used < n:
        into_second = (first_sample + used) % SAMPLE_RATE_HZ
        if into_second == 0:
            _use_second(state, sums, counts, levelling_samples, latitude, coarse_s, fine_s)
            if used and counts[_ALIGNMENT] != alignment:
                break
            alignment = counts[_ALIGNMENT]
        stop = min(n, used + SAMPLE_RATE_HZ - into_second)
        counts[_SECOND] += stop - used
        for k in range(used, stop):  # one by one, so that the sum does not depend on how they are split
            for i in range(3):
                sums[1, 0, i] += rotation[k, i]
                sums[1, 1, i] += velocity[k, i]
            if (first_sample + k + 1) % every == 0:
                for i in range(STATE_SIZE):
                    states[epochs, i] = state[i]
                epochs += 1
        used = stop
        if (first_sample + used) % SAMPLE_RATE_HZ == 0:
            align_time_s[seconds] = counts[_ALIGNED] * _DT_S
            seconds += 1
    return used, alignment, states[:epochs], align_time_s[:seconds]
