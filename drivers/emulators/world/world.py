"""The simulated world of each inertial unit, which can be advanced to any later time.

The units on one bench share their surroundings: the table's axes, the chamber's air, and the heat that they
exchange.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from gyrobench.bench.foundations.arrays import DPH_TO_RADPS, FloatArray
from gyrobench.drivers.emulators.world.inertial_unit import SAMPLE_RATE_HZ, Epochs, InertialUnit
from gyrobench.drivers.emulators.world.normal_numbers import NormalNumbers
from gyrobench.drivers.emulators.world.sensor_errors import ARCSEC, AddedErrors, BiasWander, InertialSensors
from gyrobench.drivers.emulators.world.strapdown import table_attitude, true_increments
from gyrobench.drivers.emulators.world.table_axis import AxisParameters, TableAxis
from gyrobench.drivers.emulators.world.thermal import (
    ChamberAir,
    ChamberParameters,
    ThermalCourse,
    ThermalNetwork,
)
from gyrobench.drivers.emulators.world.undeclared_effects import Conditions, UndeclaredBias
from gyrobench.drivers.emulators.world.world_file import NeighbourHeating, TableGeometry, WorldFile

OUTER, INNER = 1, 2
_AXIS_KEYS = {"rate_limit_dps", "acceleration_limit_dps2", "jerk_limit_dps3", "position_error_arcsec"}


class Surroundings:
    """Table and chamber around the units, from ``start_s``, a whole second.

    Each unit joins once and then takes the air of every second. A unit is advanced when its output is needed,
    so units may be at different times. All are advanced before the table's motion changes; the caller
    advances them before it switches the supply of any unit.
    """

    def __init__(self, file: WorldFile, start_s: int) -> None:
        parameters = AxisParameters(**file.table.model_dump(include=_AXIS_KEYS))
        #: The table's axes: 1 outer, 2 inner.
        self.axes = {number: TableAxis(parameters) for number in (OUTER, INNER)}
        self.air = ChamberAir(ChamberParameters(**file.chamber.model_dump()))  #: The chamber.
        self.air_s = start_s  #: Time to which the chamber's air has been simulated.
        self.dissipated_w: dict[int, float] = {}  #: Present heat dissipation of each unit, by its number.
        self._start_s = start_s
        self._heating = file.neighbour_heating
        self._pending_air: list[list[FloatArray]] = []
        self._advance_units: list[Callable[[float], None]] = []
        for axis in self.axes.values():
            axis.before_motion = self._before_motion

    def join(self, number: int, advance: Callable[[float], None]) -> UnitAir:
        """Add a unit by its number; returns the air around it. Its air up to now is the present air.

        ``advance`` is a function that advances the unit to a time.
        """
        self._advance_units.append(advance)
        present = [[self.air.air_c], [self.air.compressor_duty]]
        course = [np.repeat(present, self.air_s - self._start_s, axis=1)]
        self._pending_air.append(course)
        return UnitAir(self, course, [each for each in self._heating if each.to_unit == number])

    def step_air(self, seconds: int) -> None:
        """Advance the chamber's air to the time ``seconds``."""
        if seconds > self.air_s:
            steps = self.air.step(1.0, seconds - self.air_s)
            self.air_s = seconds
            for course in self._pending_air:
                course.append(steps)

    def _before_motion(self, now_s: float) -> None:
        for advance in self._advance_units:
            advance(math.floor(now_s))


class UnitAir:
    """The air around one unit."""

    def __init__(
        self, surroundings: Surroundings, course: list[FloatArray], heating: Sequence[NeighbourHeating]
    ) -> None:
        self._surroundings = surroundings
        self._course = course  # of the seconds that the unit has not yet taken
        self._heating = heating
        self._rises_k = [0.0] * len(heating)

    def take(self, seconds: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the air of the next seconds, to which the surroundings have been advanced.

        For each second (n,) the temperature of the air around the unit, the share of the time that the
        chamber's compressor runs, and the rise of that temperature by the heat of neighbouring units, K.
        """
        course = np.concatenate(self._course, axis=1)
        self._course[:] = [course[:, seconds:]]
        air_c, duty = course[:, :seconds]
        added_k = np.zeros(seconds)
        for index, each in enumerate(self._heating):
            final_k = each.coupling_k_per_w * self._surroundings.dissipated_w.get(each.from_unit, 0.0)
            decay = np.exp(-np.arange(1, seconds + 1) / each.time_constant_s)
            course_k = final_k + (self._rises_k[index] - final_k) * decay
            self._rises_k[index] = float(course_k[-1])
            added_k += course_k
        return air_c + added_k, duty, added_k


_DT_S = 1.0 / SAMPLE_RATE_HZ
#: Most seconds that are simulated in one step.
_MAX_SECONDS = 60
#: Substitute for the sensors' output while the unit does not use it.
_UNUSED = np.zeros((_MAX_SECONDS * SAMPLE_RATE_HZ, 3))
_NONE_DPH = np.zeros(3)
_OUTER_AXES = {"east": (1.0, 0.0, 0.0), "up": (0.0, 0.0, 1.0)}
_INNER_AXES = {"east": (0.0, 0.0, 1.0), "up": (1.0, 0.0, 0.0)}


class World:
    """The simulated physics of one unit on the bench.

    The world starts at ``start_s``, a whole second, at room temperature, with the unit off and the table at
    zero. ``seed`` and ``start_s`` determine all random numbers. Time-dependent effects count from time zero,
    not from ``start_s``. Further units have the ``surroundings`` of the first one and another ``number``.
    """

    def __init__(
        self,
        file: WorldFile,
        seed: int,
        start_s: int = 0,
        surroundings: Surroundings | None = None,
        number: int = 1,
    ) -> None:
        def seed_of(stream: int) -> tuple[int, ...]:
            # A bench that starts in the middle of a run must not repeat the noise of the run's start.
            return (seed, stream, start_s, *([number - 1] if number > 1 else []))

        self.file = file
        self._random = NormalNumbers(seed_of(0))
        # A separate stream, so that the unit's temperature readings do not change the other random numbers.
        self._unit_random = NormalNumbers(seed_of(1))
        self._latitude = math.radians(file.latitude_deg)
        self._geometry = _geometry(file.table)
        self.surroundings = surroundings or Surroundings(file, start_s)  #: Shared with the other units.
        #: axes, air: The table's axes, 1 outer and 2 inner, and the chamber, of the surroundings.
        self.axes, self.air = self.surroundings.axes, self.surroundings.air
        self._outer, self._inner = self.axes[OUTER], self.axes[INNER]
        self._number = number
        self._unit_air = self.surroundings.join(number, self.advance)
        self._neighbours_k = np.zeros(1)
        self._switched_on = self._has_lost_supply = False
        self.thermal = ThermalNetwork(file.thermal, file.chamber.ambient_c)
        self.unit = InertialUnit(file.ins, self._latitude, file.height_m)  #: The INS.
        #: Called with the navigation epochs in order of time.
        self.on_epochs: Callable[[Epochs], None] | None = None
        #: Readings of faulty temperature sensors, by index in :meth:`temperatures_c`.
        self.broken_sensors: dict[int, float] = {}
        self._sensors = InertialSensors(file)
        self._wander = BiasWander(file.gyro, np.random.default_rng(seed_of(2)))
        self._wander_dph = np.zeros((1, 3))
        self._power_on_ppm = np.zeros(3)
        self._scale_random = NormalNumbers(seed_of(3))
        self._sample = start_s * SAMPLE_RATE_HZ
        self._powered_on_sample = self._sample
        self._resting: tuple[FloatArray, FloatArray, FloatArray] | None = None
        self._resting_from_s: tuple[float, float] | None = None
        self._undeclared = UndeclaredBias(file.undeclared_effects)
        self._update_undeclared(self.attitude()[2])

    def power_unit(self, on: bool) -> None:
        """Switch the unit's supply; each power-on draws new repeatability errors of the gyros."""
        self._switched_on = on
        on = on and not self._has_lost_supply
        if on and not self.thermal.powered:
            spread = self.file.gyro.power_on_repeatability_dph * DPH_TO_RADPS
            self._sensors.power_on_bias = self._random.standard_normal(3) * spread
            spread_ppm = self.file.gyro.scale_factor_repeatability_ppm
            self._power_on_ppm = self._scale_random.standard_normal(3) * spread_ppm
            self._powered_on_sample = self._sample
        self.thermal.powered = on
        self.surroundings.dissipated_w[self._number] = self.thermal.power_w if on else 0.0
        self._update_undeclared(self.attitude()[2])
        self.unit.power(on)

    def lose_supply(self) -> None:
        """Switch the unit off until the supply is restored, even if it is switched on meanwhile."""
        self._has_lost_supply = True
        self.power_unit(self._switched_on)

    def restore_supply(self) -> None:
        """End the loss of the supply: the unit is on if it was switched on."""
        self._has_lost_supply = False
        self.power_unit(self._switched_on)

    def temperatures_c(self) -> FloatArray:
        """Read the unit's temperature sensors: case, three optics, three electronics; shape (7,)."""
        normal = self._random.standard_normal((1, 7))
        return self._with_faults(self.thermal.read_c(self.thermal.nodes_c[np.newaxis], normal)).ravel()

    def true_gyro_bias(self) -> FloatArray:
        """True gyro biases at the present time, rad/s, shape (3,)."""
        return self._sensors.gyro_bias(self.thermal.optics_c) + self.undeclared_bias()

    def undeclared_bias(self) -> FloatArray:
        """Part of :meth:`true_gyro_bias` caused by undeclared effects, rad/s, shape (3,)."""
        return np.asarray(self._added.gyro_dph[-1] * DPH_TO_RADPS)

    def attitude(self) -> FloatArray:
        """True ``C_nb``, shape (3, 3), at the present time."""
        return np.asarray(self._attitudes(1)[0])

    def _attitudes(self, seconds: int) -> FloatArray:
        """True ``C_nb``, shape (n, 3, 3), at the present time and each of the next whole seconds."""
        time_s = (self._sample + SAMPLE_RATE_HZ * np.arange(float(seconds))) * _DT_S
        angles = (np.radians(axis.position_deg(time_s)).tolist() for axis in (self._outer, self._inner))
        return np.array([table_attitude(*self._geometry, *each) for each in zip(*angles, strict=True)])

    def advance(self, time_s: float) -> None:
        """Advance to ``time_s``; does nothing if that is in the past."""
        end = _sample_count(time_s)
        while self._sample < end:
            remaining, into_second = end - self._sample, self._sample % SAMPLE_RATE_HZ
            seconds, count = 1, min(remaining, SAMPLE_RATE_HZ - into_second)
            resting = self._at_rest()
            if count == SAMPLE_RATE_HZ and not self.unit.changes_by_itself:
                seconds = min(remaining // SAMPLE_RATE_HZ, _MAX_SECONDS)
            if into_second == 0:
                up_body = self._attitudes(seconds)[:, 2] if resting is None else resting[2]
                self._begin_seconds(seconds, up_body)
            self._step_samples(seconds, count, resting)

    def advance_air(self, time_s: float) -> None:
        """Advance only the chamber's air to ``time_s``."""
        if time_s > self.surroundings.air_s:
            self.surroundings.step_air(math.ceil(_sample_count(time_s) / SAMPLE_RATE_HZ))

    def _begin_seconds(self, seconds: int, up_body: FloatArray) -> None:
        """Simulate chamber, temperatures and undeclared effects for the next seconds, second by second.

        ``up_body`` is Up in body axes in each second, shape (n, 3), or in all, (3,).
        """
        self.surroundings.step_air(self._sample // SAMPLE_RATE_HZ + seconds)
        air_c, duty, self._neighbours_k = self._unit_air.take(seconds)
        self.thermal.step(1.0, air_c, up_body)
        self._update_undeclared(up_body, duty[:, np.newaxis])
        if self.unit.powered:
            normal = self._unit_random.standard_normal((seconds, 6))
            read_c = self._with_faults(self.thermal.read_c(self.thermal.course.nodes_c, normal))
            self.unit.sense_temperatures(read_c[:, 1:4], read_c[:, 4:])

    def _with_faults(self, read_c: FloatArray) -> FloatArray:
        for index, reading_c in self.broken_sensors.items():
            read_c[:, index] = reading_c
        return read_c

    def _update_undeclared(self, up_body: FloatArray, duty: FloatArray | None = None) -> None:
        """Evaluate the undeclared effects for the next seconds; without ``duty``, for the present second."""
        course = self.thermal.course
        if self._wander.is_any:
            self._wander_dph = self._wander.next_dph(0 if duty is None else len(duty))
        if duty is None:
            duty = np.full((1, 1), self.air.compressor_duty)
            course = ThermalCourse(*(each[-1:] for each in course))
        if not self.file.undeclared_effects:
            none = np.zeros((len(duty), 3))
            self._added = AddedErrors(none + self._wander_dph, none + self._power_on_ppm, none)
            return
        sample = self._sample + SAMPLE_RATE_HZ * np.arange(float(len(duty)))[:, np.newaxis]
        on_s = (sample - self._powered_on_sample) * _DT_S
        now = Conditions(
            time_s=sample * _DT_S,
            since_power_on_s=on_s if self.thermal.powered else np.full_like(on_s, np.inf),
            optics_c=course.optics_c,
            electronics_c=course.electronics_c,
            optics_rate_c_per_h=course.optics_rate_c_per_h,
            convected_w=course.convected_w,
            up_body=up_body,
            compressor_duty=duty,
            neighbours_k=self._neighbours_k[-len(duty) :, np.newaxis],
        )
        self._added = AddedErrors(
            self._undeclared.added_dph(now) + self._wander_dph,
            self._undeclared.added_scale_factor_ppm(now) + self._power_on_ppm,
            self._undeclared.added_ug(now),
        )

    def _step_samples(
        self, seconds: int, count: int, resting: tuple[FloatArray, FloatArray, FloatArray] | None
    ) -> None:
        """Simulate the inertial sensors and the INS for ``count`` samples of each of some seconds.

        ``resting``: result of :meth:`_at_rest`.
        """
        unit, first = self.unit, self._sample
        # Drawn by second and sample, so that the noise does not depend on how the time is split.
        readings = 7 if self.on_epochs and (first + count) % SAMPLE_RATE_HZ == 0 else 0
        normal = np.empty((seconds, 0))
        rotation = velocity = _UNUSED[: seconds * count]
        if unit.uses_sensors:
            normal = self._random.standard_normal((seconds, 6 * count + readings))
            rotation, velocity = self._measured_increments(normal, count, resting)
        self._sample += seconds * count
        epoch_blocks, used = [], 0
        while used < seconds * count:
            epochs = unit.advance(first + used, rotation[used:], velocity[used:])
            if epochs is None:
                return
            used += epochs.used_samples
            if len(epochs.sample) or epochs.increments:
                epoch_blocks.append(epochs)
        if not (self.on_epochs and epoch_blocks):
            return
        if readings and not normal.size:
            normal = self._random.standard_normal((seconds, readings))
        read_c = self.thermal.course.nodes_c[-seconds:]
        if readings:
            read_c = self._with_faults(self.thermal.read_c(read_c, normal[:, -readings:]))
        for epochs in epoch_blocks:
            self.on_epochs(epochs._replace(read_c=read_c[: len(epochs.align_time_s)]))
            read_c = read_c[len(epochs.align_time_s) :]

    def _measured_increments(
        self, normal: FloatArray, count: int, resting: tuple[FloatArray, FloatArray, FloatArray] | None
    ) -> tuple[FloatArray, FloatArray]:
        rotation, velocity = self._ideal_increments(len(normal) * count) if resting is None else resting[:2]
        seconds, compensation = len(normal), self.unit.compensation
        measured = self._sensors.measure(
            rotation, velocity, count, _DT_S, self.thermal.course.nodes_c[-seconds:], normal,
            self._added.last(seconds), _NONE_DPH if compensation is None else compensation.bias_dph,
        )  # fmt: skip
        return measured if compensation is None else compensation.correct_increments(*measured, _DT_S)

    def _at_rest(self) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Ideal increments of one second, and Up in body axes; None if the table moves."""
        settled_from_s = self._outer.settled_from_s, self._inner.settled_from_s
        if max(settled_from_s) > self._sample * _DT_S:
            return None
        if settled_from_s != self._resting_from_s:
            self._resting = (*self._ideal_increments(SAMPLE_RATE_HZ), self.attitude()[2])
            self._resting_from_s = settled_from_s
        return self._resting

    def _ideal_increments(self, count: int) -> tuple[FloatArray, FloatArray]:
        edges_s = np.arange(self._sample, self._sample + count + 1, dtype=np.float64) * _DT_S
        outer, inner = (np.radians(axis.position_deg(edges_s)) for axis in (self._outer, self._inner))
        rotation, velocity = true_increments(
            *self._geometry, outer, inner, self._latitude, self.file.height_m, _DT_S
        )
        return rotation, velocity


def _sample_count(time_s: float) -> int:
    """Number of samples that end at or before a time."""
    return math.floor(time_s * SAMPLE_RATE_HZ + 1e-6)


def _geometry(table: TableGeometry) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Outer and inner table axis and mounting of the unit, in ENU, with their errors."""
    tilt, mounting_error = _rotation_matrix(table.tilt_arcsec), _rotation_matrix(table.mounting_error_arcsec)
    axes = (tilt @ np.array(by_outer[table.outer_axis]) for by_outer in (_OUTER_AXES, _INNER_AXES))
    return *axes, np.ascontiguousarray(tilt @ table.mounting.matrix @ mounting_error)


def _rotation_matrix(vector_arcsec: Sequence[float]) -> FloatArray:
    vector = np.array(vector_arcsec) * ARCSEC
    angle = float(np.linalg.norm(vector))
    axis = vector / (angle or 1.0)
    return np.asarray(table_attitude(axis, axis, np.eye(3), angle, 0.0))
