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
from gyrobench.drivers.emulators.world.ins_compensation import (
    InsCompensation,
    TemperatureHistory,
    empty_table,
)
from gyrobench.drivers.emulators.world.strapdown import STATE_SIZE, add_up, gyrocompass, matrix_of, navigate
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


class Alignment(IntEnum):
    """Quality of the alignment so far."""

    INVALID = 0
    COARSE = 1
    FINE = 2


class Epochs(NamedTuple):
    """Navigation output at the INS's epochs."""

    sample: IntArray  #: Shape (n,). Sample index since the world began (time = sample / 100 s).
    states: FloatArray  #: Shape (n, 8). Quaternion body to ENU, velocity east and north, latitude, longitude.
    mode: Mode
    alignment: Alignment
    #: align_time_s, read_c: Shapes (k,), (k, 7). Time at rest used by the alignment, and readings of the
    #: temperature sensors, at the k epochs that are whole seconds.
    align_time_s: FloatArray
    read_c: FloatArray = np.empty((0, 7))
    #: First sample and measured increments, (m, 3) rad and m/s, where the unit sends them.
    increments: tuple[int, FloatArray, FloatArray] | None = None


class InertialUnit:
    """State of the INS.

    ``latitude`` is in rad, ``height`` in m.

    Attributes
    ----------
    loaded_table : ndarray, shape (3, 84)
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
        self._sums = np.zeros((2, 3))
        self._second_sums = np.zeros((2, 3))
        self._second_samples = 0
        self._aligned_samples = 0
        self._boot_samples = 0
        self._temperatures = TemperatureHistory()
        self.powered = False
        self.mode = Mode.OFF
        self.alignment = Alignment.INVALID
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
    def align_time_s(self) -> float:
        """Time at rest used by the present alignment."""
        return self._aligned_samples * _DT_S

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
        if self.mode is Mode.ALIGN and self.alignment >= Alignment.COARSE:
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
        up = self._second_sums[1]
        return up / math.sqrt(up @ up) if self._second_samples else np.zeros(3)

    def advance(self, first_sample: int, rotation: FloatArray, velocity: FloatArray) -> Epochs | None:
        """Take the next sensor samples.

        None of them is beyond the next whole second, unless the first is at one and the unit navigates, is
        in standby or off.

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
        if first_sample % SAMPLE_RATE_HZ == 0:
            self._evaluate_last_second()
        n = len(rotation)
        if self.mode is Mode.OFF:
            self._boot_samples -= n
            return None
        first = (-(first_sample + 1)) % self._every
        samples = np.arange(first_sample + 1 + first, first_sample + 1 + n, self._every)
        if self.mode is Mode.NAVIGATE:
            states = navigate(self._state, rotation, velocity, _DT_S, self._height, first, self._every)
        else:
            if self.mode is Mode.ALIGN:
                add_up(rotation, self._second_sums[0])
                add_up(velocity, self._second_sums[1])
                self._second_samples += n
            states = np.empty((len(samples), STATE_SIZE))
            states[:] = self._state
        seconds = (first_sample + n) // SAMPLE_RATE_HZ - first_sample // SAMPLE_RATE_HZ
        epochs = Epochs(samples, states, self.mode, self.alignment, np.full(seconds, self.align_time_s))
        if self.sends_increments and self.mode is Mode.NAVIGATE:
            return epochs._replace(increments=(first_sample, rotation, velocity))
        return epochs

    def _reset_state(self) -> None:
        self._sums[:] = 0.0
        self._aligned_samples = 0
        self._levelling_samples = round(self._behaviour.levelling_s * SAMPLE_RATE_HZ)
        self._reset_second()
        self.alignment = Alignment.INVALID
        self._state[:] = 0.0
        self._state[0] = 1.0
        self._state[6] = self._latitude

    def _reset_second(self) -> None:
        self._second_sums[:] = 0.0
        self._second_samples = 0

    def _evaluate_last_second(self) -> None:
        if self.mode is Mode.OFF:
            if self.powered and self._boot_samples <= 0:
                self.mode = Mode.STANDBY
        elif self.mode is Mode.ALIGN:
            limit = _MOTION_RADPS * _DT_S * self._second_samples + _PULSES_RAD
            if max(map(abs, self._second_sums[0].tolist())) > limit:
                self._reset_state()
            else:
                self._add_second()
                self._reset_second()

    def _add_second(self) -> None:
        if self._levelling_samples > 0:
            self._levelling_samples -= self._second_samples
            return
        self._sums += self._second_sums
        self._aligned_samples += self._second_samples
        if self.align_time_s >= self._behaviour.coarse_alignment_s and not self.never_aligns:
            fine = self.align_time_s >= self._behaviour.fine_alignment_s
            self.alignment = Alignment.FINE if fine else Alignment.COARSE
            self._state[:4] = gyrocompass(self._sums[0], self._sums[1])
