"""The simulated bench as a whole, brought to any later time on request."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.drivers.emulators.world.chamber_air import ChamberAir, ChamberParameters
from gyrobench.drivers.emulators.world.document import TableGeometry, WorldFile
from gyrobench.drivers.emulators.world.effects.effect import Conditions
from gyrobench.drivers.emulators.world.effects.undeclared_bias import UndeclaredBias
from gyrobench.drivers.emulators.world.inertial_unit import SAMPLE_RATE_HZ, Epochs, InertialUnit
from gyrobench.drivers.emulators.world.sensor_errors import (
    ARCSEC,
    DPH,
    TriadErrors,
    accelerometer_errors,
    gyro_errors,
)
from gyrobench.drivers.emulators.world.strapdown import sense, table_attitude, true_increments
from gyrobench.drivers.emulators.world.table_axis import AxisParameters, TableAxis
from gyrobench.drivers.emulators.world.thermal import ThermalNetwork

OUTER, INNER = 1, 2
_DT_S = 1.0 / SAMPLE_RATE_HZ
_OUTER_AXES = {"east": (1.0, 0.0, 0.0), "up": (0.0, 0.0, 1.0)}
_INNER_AXES = {"east": (0.0, 0.0, 1.0), "up": (1.0, 0.0, 0.0)}


class World:
    """The one truth behind the emulated instruments.

    Parameters
    ----------
    file : WorldFile
        What the bench is like.
    seed : int
        Everything random comes from it, and from the start.
    start_s : int
        Whole second at which this world begins: at room temperature, the unit off, the table at
        zero. What depends on time itself goes by the time since zero.

    Attributes
    ----------
    axes : dict of int to TableAxis
        The table's axes: 1 outer, 2 inner.
    air : ChamberAir
        The chamber.
    unit : InertialUnit
        The INS.
    on_epochs : callable
        Called with the navigation epochs as they come about.
    broken_sensors : dict of int to float
        What faulty temperature sensors read, by their place in :meth:`temperatures_c`.
    """

    def __init__(self, file: WorldFile, seed: int, start_s: int = 0) -> None:
        self.file = file
        # A bench that is made anew in the middle of a run must not repeat the noise of its beginning.
        self._random = np.random.default_rng((seed, 0, start_s) if start_s else seed)
        # Its own, so that what else is random does not depend on it.
        self._unit_random = np.random.default_rng((seed, 1, start_s) if start_s else (seed, 1))
        self._latitude = math.radians(file.latitude_deg)
        self._geometry = _Geometry(file.table)
        self.axes = {number: TableAxis(_axis_parameters(file.table)) for number in (OUTER, INNER)}
        self.air = ChamberAir(
            ChamberParameters(
                heating_limit_c_per_min=file.chamber.heating_limit_c_per_min,
                cooling_limit_c_per_min=file.chamber.cooling_limit_c_per_min,
                control_time_constant_s=file.chamber.control_time_constant_s,
                ambient_c=file.chamber.ambient_c,
            )
        )
        self.thermal = ThermalNetwork(file.thermal, file.chamber.ambient_c)
        self.unit = InertialUnit(file.ins, self._latitude, file.height_m)
        self.on_epochs: Callable[[Epochs], None] | None = None
        self.broken_sensors: dict[int, float] = {}
        self._gyro = gyro_errors(file.gyro)
        self._accelerometer = accelerometer_errors(file.accelerometer)
        self._power_on_bias = np.zeros(3)
        self._sample = start_s * SAMPLE_RATE_HZ
        self._powered_on_sample = self._sample
        self._remainders = np.zeros((2, 3))
        self._resting: tuple[FloatArray, FloatArray, FloatArray] | None = None
        self._errors_now: tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]] | None = None
        self._undeclared = UndeclaredBias(file.undeclared_effects)
        self._undeclared_dph = self._undeclared.added_dph(self._conditions(self.attitude()[2]))

    def power_unit(self, on: bool) -> None:
        """Switch the unit's supply; each power-on has gyro biases a little different."""
        if on and not self.thermal.powered:
            spread = self.file.gyro.power_on_repeatability_dph * DPH
            self._power_on_bias = self._random.normal(0.0, 1.0, 3) * spread
            self._powered_on_sample = self._sample
        self.thermal.powered = on
        self._feel(self.attitude()[2])
        self.unit.power(on)

    def temperatures_c(self) -> FloatArray:
        """Read the unit's temperature sensors: case, three optics, three electronics; shape (7,)."""
        noise = self._random.standard_normal(7)
        return self._as_read(self.thermal.nodes_c + self.file.thermal.sensor_noise_c * noise)

    def true_gyro_bias(self) -> FloatArray:
        """The gyro biases at this moment in rad/s, shape (3,): the truth that tests compare with."""
        return self._gyro_bias()[0]

    def undeclared_bias(self) -> FloatArray:
        """The undeclared effects' part of :meth:`true_gyro_bias`, rad/s, shape (3,)."""
        return self._undeclared_dph * DPH

    def attitude(self) -> FloatArray:
        """True ``C_nb`` (3, 3) at this moment."""
        time_s = np.array([self._sample * _DT_S])
        outer, inner = (np.radians(self.axes[n].position_deg(time_s))[0] for n in (OUTER, INNER))
        geometry = self._geometry
        return np.asarray(
            table_attitude(geometry.outer_axis, geometry.inner_axis, geometry.mounting, outer, inner)
        )

    def advance(self, time_s: float) -> None:
        """Bring everything to ``time_s``; an earlier time changes nothing."""
        end = math.floor(time_s * SAMPLE_RATE_HZ + 1e-6)
        while self._sample < end:
            into_second = self._sample % SAMPLE_RATE_HZ
            count = min(end - self._sample, SAMPLE_RATE_HZ - into_second)
            if into_second == 0:
                self._slow_second()
            self._fast_samples(count)

    def _slow_second(self) -> None:
        self.air.step(1.0)
        resting = self._at_rest()
        up_body = self.attitude()[2] if resting is None else resting[2]
        self.thermal.step(1.0, self.air.air_c, up_body)
        self._feel(up_body)
        if self.unit.powered:
            noise_c = self.file.thermal.sensor_noise_c * self._unit_random.standard_normal(6)
            read_c = self.thermal.nodes_c.copy()
            read_c[1:] += noise_c
            read_c = self._as_read(read_c)
            self.unit.sense_temperatures(read_c[1:4], read_c[4:])

    def _as_read(self, nodes_c: FloatArray) -> FloatArray:
        for place, reading_c in self.broken_sensors.items():
            nodes_c[place] = reading_c
        return nodes_c

    def _feel(self, up_body: FloatArray) -> None:
        """Let the undeclared effects act for the second that begins; the sensors' errors are new then."""
        self._undeclared_dph = self._undeclared.added_dph(self._conditions(up_body))
        self._errors_now = None

    def _conditions(self, up_body: FloatArray) -> Conditions:
        on_s = (self._sample - self._powered_on_sample) * _DT_S
        return Conditions(
            time_s=self._sample * _DT_S,
            since_power_on_s=on_s if self.thermal.powered else None,
            optics_c=self.thermal.optics_c,
            electronics_c=self.thermal.electronics_c,
            optics_rate_c_per_h=self.thermal.optics_rate_c_per_h,
            convected_w=self.thermal.convected_w,
            up_body=up_body,
            compressor_duty=self.air.compressor_duty,
        )

    def _fast_samples(self, count: int) -> None:
        rotation = velocity = np.empty((count, 3))
        resting = self._at_rest()
        if self.unit.senses:
            rotation, velocity = self._measured(count, resting)
        first = self._sample
        self._sample += count
        epochs = self.unit.advance(first, rotation, velocity)
        if epochs is not None and len(epochs.sample) and self.on_epochs:
            self.on_epochs(epochs)

    def _measured(
        self, count: int, resting: tuple[FloatArray, FloatArray, FloatArray] | None
    ) -> tuple[FloatArray, FloatArray]:
        rotation, velocity = self._felt(count) if resting is None else (each[:count] for each in resting[:2])
        # Drawn sample by sample, so that a stretch of time has the same noise however it is cut.
        noise = self._random.standard_normal((count, 2, 3)) * math.sqrt(_DT_S)
        if self._errors_now is None:
            self._errors_now = self._sensor_errors()
        (gyro_bias, gyro_matrix), accelerometer = self._errors_now
        if self.unit.compensation is not None:
            gyro_bias = gyro_bias - self.unit.compensation.bias_dph * DPH
        return (
            _sensed(rotation, (gyro_bias, gyro_matrix), noise[:, 0], self._gyro, self._remainders[0]),
            _sensed(velocity, accelerometer, noise[:, 1], self._accelerometer, self._remainders[1]),
        )

    def _at_rest(self) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """What is felt in a second, and Up in body axes, while the table rests; None while it moves."""
        if any(axis.is_moving(self._sample * _DT_S) for axis in self.axes.values()):
            self._resting = None
        elif self._resting is None:
            self._resting = (*self._felt(SAMPLE_RATE_HZ), self.attitude()[2])
        return self._resting

    def _felt(self, count: int) -> tuple[FloatArray, FloatArray]:
        edges_s = np.arange(self._sample, self._sample + count + 1, dtype=np.float64) * _DT_S
        outer, inner = (np.radians(self.axes[n].position_deg(edges_s)) for n in (OUTER, INNER))
        geometry = self._geometry
        rotation, velocity = true_increments(
            geometry.outer_axis, geometry.inner_axis, geometry.mounting, outer, inner,
            self._latitude, self.file.height_m, _DT_S,
        )  # fmt: skip
        return rotation, velocity

    def _sensor_errors(self) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
        case_c = np.full(3, self.thermal.case_c - self.file.reference_temperature_c)
        return self._gyro_bias(), self._accelerometer.at(case_c)

    def _gyro_bias(self) -> tuple[FloatArray, FloatArray]:
        bias, matrix = self._gyro.at(self.thermal.optics_c - self.file.reference_temperature_c)
        return bias + self._power_on_bias + self.undeclared_bias(), matrix


class _Geometry:
    """True axes of the table in ENU, and the unit's mounting, with their small errors."""

    def __init__(self, table: TableGeometry) -> None:
        tilt = Rotation.from_rotvec(np.array(table.tilt_arcsec) * ARCSEC).as_matrix()
        self.outer_axis: FloatArray = tilt @ np.array(_OUTER_AXES[table.outer_axis])
        self.inner_axis: FloatArray = tilt @ np.array(_INNER_AXES[table.outer_axis])
        error = Rotation.from_rotvec(np.array(table.mounting_error_arcsec) * ARCSEC).as_matrix()
        self.mounting: FloatArray = np.ascontiguousarray(tilt @ error)


def _axis_parameters(table: TableGeometry) -> AxisParameters:
    return AxisParameters(
        rate_limit_dps=table.rate_limit_dps,
        acceleration_limit_dps2=table.acceleration_limit_dps2,
        jerk_limit_dps3=table.jerk_limit_dps3,
        position_error_arcsec=table.position_error_arcsec,
    )


def _sensed(
    true: FloatArray,
    errors: tuple[FloatArray, FloatArray],
    noise: FloatArray,
    triad: TriadErrors,
    remainder: FloatArray,
) -> FloatArray:
    bias, matrix = errors
    return np.asarray(sense(true, matrix, bias, noise * triad.random_walk, _DT_S, triad.pulse, remainder))
