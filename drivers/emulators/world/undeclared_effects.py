"""Undeclared effects of a world: sensor errors beyond the polynomials of the world file.

Each class is one kind of entry of the key ``undeclared_effects``. Effects are evaluated once a second, in
order of time, and summed.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import AfterValidator, Discriminator, Field, Tag
from typing_extensions import override

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.documents import StrictModel

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
#: One value for each body axis.
BodyVector = Annotated[list[float], Field(min_length=3, max_length=3)]
#: Three rows of three values, in body axes.
Matrix = Annotated[list[BodyVector], Field(min_length=3, max_length=3)]

_HOUR_S, _DAY_S, _ROOM_C = 3600.0, 86_400.0, 25.0


class Conditions(NamedTuple):
    """Conditions of the gyros in n successive seconds; for a single moment, without the first dimension."""

    #: time_s, since_power_on_s: Shape (n, 1). Time since the start of the world, and since power-on (infinite
    #: while the unit is off).
    time_s: FloatArray
    since_power_on_s: FloatArray
    #: optics_c, electronics_c: Shape (n, 3). Temperatures of each gyro.
    optics_c: FloatArray
    electronics_c: FloatArray
    optics_rate_c_per_h: FloatArray  #: Shape (n, 3). Change of each gyro's optics in the last second.
    #: Shape (n, 3). Attitude-dependent part of the heat flow from electronics to optics.
    convected_w: FloatArray
    up_body: FloatArray  #: Shape (n, 3), or (3,) while it is constant. Up in body axes.
    compressor_duty: FloatArray  #: Shape (n, 1). Share of the time that the chamber's compressor runs.
    #: Shape (n, 1). Rise of the air temperature around the unit caused by neighbouring units, K.
    neighbours_k: FloatArray = np.zeros((1, 1))


#: Function that returns an error caused by an effect, shape (n, 3); called in the order of time.
AddedError = Callable[[Conditions], FloatArray]


class _Effect(StrictModel):
    """Base class of the effects. A subclass overrides one of the errors, or ``start`` if it has a state."""

    def start(self) -> AddedError:
        """Return the function that evaluates the bias, deg/h, with its initial state."""
        return self.added_dph

    def added_dph(self, now: Conditions) -> FloatArray:
        """Bias caused by an effect without a state under these conditions, deg/h, shape (n, 3)."""
        return np.zeros(now.optics_c.shape)

    def added_scale_factor_ppm(self, now: Conditions) -> FloatArray:
        """Scale factor errors of the gyros caused by the effect, ppm, shape (n, 3)."""
        return np.zeros(now.optics_c.shape)

    def added_ug(self, now: Conditions) -> FloatArray:
        """Accelerometer biases caused by the effect, ug, shape (n, 3)."""
        return np.zeros(now.optics_c.shape)


class TemperatureRate(_Effect):
    """The bias follows the rate of temperature of each gyro's optics."""

    kind: Literal["temperature_rate"] = Field(description="name of the effect")
    sensitivity_dph_per_c_per_h: BodyVector = Field(
        description="bias of each gyro per rate of its optics, deg/h per K/h"
    )

    @override
    def added_dph(self, now: Conditions) -> FloatArray:
        return np.array(self.sensitivity_dph_per_c_per_h) * now.optics_rate_c_per_h


class ScaleFactorRate(_Effect):
    """The scale factor of each gyro follows the rate of temperature of its optics."""

    kind: Literal["scale_factor_rate"] = Field(description="name of the effect")
    sensitivity_ppm_per_c_per_h: BodyVector = Field(
        description="scale factor of each gyro per rate of its optics, ppm per K/h"
    )

    @override
    def added_scale_factor_ppm(self, now: Conditions) -> FloatArray:
        return np.array(self.sensitivity_ppm_per_c_per_h) * now.optics_rate_c_per_h


class ScaleFactorDrift(_Effect):
    """The scale factor of each gyro drifts after power-on, and swings with the time since."""

    kind: Literal["scale_factor_drift"] = Field(description="name of the effect")
    drift_ppm_per_h: BodyVector = Field(description="drift of each gyro's scale factor, ppm/h")
    swing_ppm: BodyVector = Field([0.0, 0.0, 0.0], description="amplitude of each gyro's swing, ppm")
    period_h: Positive = Field(1.0, description="period of the swing, h")

    @override
    def added_scale_factor_ppm(self, now: Conditions) -> FloatArray:
        hours = np.where(np.isfinite(now.since_power_on_s), now.since_power_on_s, 0.0) / _HOUR_S
        swing = np.array(self.swing_ppm) * np.sin(2.0 * math.pi * hours / self.period_h)
        return np.asarray(np.array(self.drift_ppm_per_h) * hours + swing)


class ThermalGradient(_Effect):
    """The bias follows the difference between electronics and optics temperature of each gyro."""

    kind: Literal["thermal_gradient"] = Field(description="name of the effect")
    sensitivity_dph_per_c: BodyVector = Field(
        description="bias of each gyro per kelvin of electronics above optics, deg/h/K"
    )

    @override
    def added_dph(self, now: Conditions) -> FloatArray:
        return np.array(self.sensitivity_dph_per_c) * (now.electronics_c - now.optics_c)


class AttitudeThermal(_Effect):
    """Convection carries heat from the electronics to one side of the optics.

    The bias follows the part of that heat flow that depends on the direction of gravity, and grows as
    the optics get colder than the onset temperature.
    """

    kind: Literal["attitude_thermal"] = Field(description="name of the effect")
    sensitivity_dph_per_w: BodyVector = Field(
        description="bias of each gyro per watt of heat that depends on attitude, deg/h/W"
    )
    onset_c: Positive = Field(50.0, description="below this the effect grows, degC")
    onset_width_c: Positive = Field(2.0, description="width of the onset, K")

    @override
    def added_dph(self, now: Conditions) -> FloatArray:
        below = (self.onset_c - now.optics_c) / self.onset_width_c
        softened = np.logaddexp(below, 0.0) * (self.onset_width_c / self.onset_c)
        return np.asarray(self.sensitivity_dph_per_w * (now.convected_w * softened))


class ThermalHysteresis(_Effect):
    """A part with friction follows the temperature of each gyro's optics with play.

    The bias follows the lead of that part over the temperature: plus the half width after enough cooling,
    minus the half width after enough heating, at any rate and at rest.
    """

    kind: Literal["thermal_hysteresis"] = Field(description="name of the effect")
    half_width_c: Positive = Field(description="half of the play, K")
    sensitivity_dph_per_c: BodyVector = Field(
        description="bias of each gyro per kelvin of play used, deg/h/K"
    )

    @override
    def start(self) -> AddedError:
        sensitivity = np.array(self.sensitivity_dph_per_c)
        follower_c: FloatArray | None = None  # starts at the first temperature

        def added_dph(now: Conditions) -> FloatArray:
            nonlocal follower_c
            lead_c = np.empty_like(now.optics_c)
            for row, optics_c in zip(np.atleast_2d(lead_c), np.atleast_2d(now.optics_c), strict=True):
                previous_c = optics_c if follower_c is None else follower_c
                low_c, high_c = optics_c - self.half_width_c, optics_c + self.half_width_c
                follower_c = np.minimum(np.maximum(previous_c, low_c), high_c)
                row[:] = follower_c - optics_c
            return np.asarray(sensitivity * lead_c)

        return added_dph


class WarmUp(_Effect):
    """A bias that decays after each power-on."""

    kind: Literal["warm_up"] = Field(description="name of the effect")
    bias_dph: BodyVector = Field(description="bias at power-on of each gyro, deg/h")
    time_constant_s: Positive = Field(description="time in which it falls to 37 %, s")

    @override
    def added_dph(self, now: Conditions) -> FloatArray:
        with np.errstate(over="ignore"):  # it may be over at once
            return np.array(self.bias_dph) * np.exp(-now.since_power_on_s / self.time_constant_s)


class TimeDrift(_Effect):
    """Biases that drift at a constant rate from the start of the world, as the gyros age."""

    kind: Literal["time_drift"] = Field(description="name of the effect")
    drift_dph_per_day: BodyVector = Field(description="drift of each gyro, deg/h per day")

    @override
    def added_dph(self, now: Conditions) -> FloatArray:
        return np.array(self.drift_dph_per_day) * now.time_s / _DAY_S


class BiasJump(_Effect):
    """Biases that change once, at a time counted from the start of the world."""

    kind: Literal["bias_jump"] = Field(description="name of the effect")
    bias_dph: BodyVector = Field(description="jump of each gyro, deg/h")
    at_h: NotNegative = Field(description="time of the jump since the start of the world, h")

    @override
    def added_dph(self, now: Conditions) -> FloatArray:
        return np.array(self.bias_dph) * (now.time_s >= self.at_h * _HOUR_S)


class SupplyRipple(_Effect):
    """Biases that follow the mains supply, which varies with a building's load over hours."""

    kind: Literal["supply_ripple"] = Field(description="name of the effect")
    amplitude_dph: BodyVector = Field(description="amplitude of each gyro, deg/h")
    period_h: Positive = Field(description="period, h")
    phase_deg: float = Field(0.0, description="phase at the start of the world, deg")

    @override
    def added_dph(self, now: Conditions) -> FloatArray:
        phase = math.tau * now.time_s / (self.period_h * _HOUR_S) + math.radians(self.phase_deg)
        return np.array(self.amplitude_dph) * np.sin(phase)


def _shape(value: Any) -> str:
    return "matrix" if isinstance(value, list) and any(isinstance(row, list) for row in value) else "vector"


#: The shape is determined first, so that a mistake is reported for that shape only.
_VectorOrMatrix = Annotated[
    Annotated[BodyVector, Tag("vector")] | Annotated[Matrix, Tag("matrix")], Discriminator(_shape)
]


class GSensitivity(_Effect):
    """Block and dither springs bend under their own weight: biases linear in the direction of gravity.

    Three values are the sensitivity of each gyro to Up along its own axis; of a matrix, row i
    column j is that of gyro i to Up along axis j.
    """

    kind: Literal["g_sensitivity"] = Field(description="name of the effect")
    sensitivity_dph_per_g: _VectorOrMatrix = Field(
        description="bias per g along the gyro's own axis, three values, or three rows of three, deg/h/g"
    )
    lag_s: NotNegative = Field(
        0.0, description="time in which the bias follows a change of attitude to 63 %, as through heat, s"
    )

    @override
    def start(self) -> AddedError:
        if not self.lag_s:
            return self.added_dph
        followed: FloatArray | None = None  # starts at the first attitude
        last_s = 0.0

        def added_dph(now: Conditions) -> FloatArray:
            nonlocal followed, last_s
            ups = np.empty_like(now.optics_c)
            ups[...] = now.up_body
            for up, time_s in zip(np.atleast_2d(ups), np.ravel(now.time_s).tolist(), strict=True):
                before = up.copy() if followed is None else followed
                followed = before - math.expm1((last_s - time_s) / self.lag_s) * (up - before)
                up[:], last_s = followed, time_s
            return self.added_dph(now._replace(up_body=ups))

        return added_dph

    @override
    def added_dph(self, now: Conditions) -> FloatArray:
        sensitivity = np.array(self.sensitivity_dph_per_g)
        matrix = np.diag(sensitivity) if sensitivity.ndim == 1 else sensitivity
        return np.asarray((matrix @ now.up_body[..., np.newaxis])[..., 0])


class AccelerometerGravity(_Effect):
    """The mounts of the accelerometers bend under their weight: biases that follow Up in body axes.

    Row i column j is accelerometer i to Up along axis j, or to its square. Without the squares the biases
    are at rest those of misalignments and scale factors.
    """

    kind: Literal["accelerometer_gravity"] = Field(description="name of the effect")
    sensitivity_ug_per_g: Matrix = Field(description="bias per g along each axis, ug/g")
    per_c: float = Field(0.0, description="relative change of all per kelvin from 25 degC, 1/K")
    square_ug_per_g2: Matrix = Field([[0.0] * 3] * 3, description="bias per g2 along each axis, ug/g2")

    @override
    def added_ug(self, now: Conditions) -> FloatArray:
        linear, square = np.array(self.sensitivity_ug_per_g), np.array(self.square_ug_per_g2)
        up = now.up_body[..., np.newaxis]
        growth = 1.0 + self.per_c * (now.optics_c - _ROOM_C)
        return np.asarray((linear @ up + square @ up**2)[..., 0] * growth)


class ChamberState(_Effect):
    """Vibration of the chamber's compressor: a bias in proportion to the compressor's duty cycle."""

    kind: Literal["chamber_state"] = Field(description="name of the effect")
    bias_dph: BodyVector = Field(description="bias of each gyro while the compressor runs, deg/h")

    @override
    def added_dph(self, now: Conditions) -> FloatArray:
        return np.array(self.bias_dph) * now.compressor_duty


class NeighbouringUnit(_Effect):
    """The heat of the units beside it warms one side of the case: a bias in proportion to what it adds.

    The key ``neighbour_heating`` says which unit heats which.
    """

    kind: Literal["neighbouring_unit"] = Field(description="name of the effect")
    sensitivity_dph_per_k: BodyVector = Field(
        description="bias of each gyro per kelvin that the neighbours add to the air around it, deg/h/K"
    )

    @override
    def added_dph(self, now: Conditions) -> FloatArray:
        return np.array(self.sensitivity_dph_per_k) * now.neighbours_k


class ModeHop(_Effect):
    """The path length control moves its mirrors back by one mode at fixed temperature intervals.

    Modes of even and odd number see the mirrors differently: the bias acts in every second mode,
    beginning with the one above the first reset.
    """

    kind: Literal["mode_hop"] = Field(description="name of the effect")
    bias_dph: BodyVector = Field(description="bias of each gyro in every second mode, deg/h")
    first_reset_c: float = Field(description="temperature of the first change of mode, degC")
    reset_every_c: Positive = Field(description="kelvin between changes of mode")

    @override
    def added_dph(self, now: Conditions) -> FloatArray:
        mode = np.floor((now.optics_c - self.first_reset_c) / self.reset_every_c)
        return np.asarray(np.array(self.bias_dph) * (mode % 2.0 == 0.0))


class LooseClamp(_Effect):
    """A clamp of the block comes free above one temperature: from there the bias grows with temperature."""

    kind: Literal["loose_clamp"] = Field(description="name of the effect")
    sensitivity_dph_per_c: BodyVector = Field(
        description="bias of each gyro per kelvin above the temperature, deg/h/K"
    )
    free_above_c: float = Field(description="temperature of the optics above which the clamp is free, degC")

    @override
    def added_dph(self, now: Conditions) -> FloatArray:
        free_k = np.maximum(now.optics_c - self.free_above_c, 0.0)
        return np.asarray(np.array(self.sensitivity_dph_per_c) * free_k)


def _two_gyros(names: list[str]) -> list[str]:
    if len(set(names)) != 2:
        raise ValueError("two different gyros are needed, as in [x, y]")
    return names


class DitherCrossing(_Effect):
    """At one temperature two gyros dither at the same frequency and drive each other.

    The frequencies separate in proportion to the mean temperature of both gyros' optics, so the biases
    are a resonance line over it.
    """

    kind: Literal["dither_crossing"] = Field(description="name of the effect")
    gyros: Annotated[
        list[Literal["x", "y", "z"]], Field(min_length=2, max_length=2), AfterValidator(_two_gyros)
    ] = Field(description="the two gyros")
    crossing_c: float = Field(description="mean temperature at which both dither alike, degC")
    half_width_c: Positive = Field(description="half width of the resonance, K")
    bias_dph: Annotated[list[float], Field(min_length=2, max_length=2)] = Field(
        description="bias of each of the two at the crossing, deg/h"
    )

    @override
    def added_dph(self, now: Conditions) -> FloatArray:
        pair = ["xyz".index(gyro) for gyro in self.gyros]
        mean_c = now.optics_c[..., pair].mean(axis=-1, keepdims=True)
        detuning = (mean_c - self.crossing_c) / self.half_width_c
        added_dph = np.zeros(now.optics_c.shape)
        added_dph[..., pair] = np.array(self.bias_dph) / (1.0 + detuning**2)
        return added_dph


if TYPE_CHECKING:
    UndeclaredEffect = _Effect
else:
    #: One entry of a world file's ``undeclared_effects``: each class above is a kind.
    UndeclaredEffect = Annotated[
        functools.reduce(operator.or_, _Effect.__subclasses__()), Field(discriminator="kind")
    ]


class UndeclaredBias:
    """The sum of all undeclared effects of a world."""

    def __init__(self, effects: Sequence[_Effect]) -> None:
        self._biases = [effect.start() for effect in effects]
        self._scale_factors, self._accelerometers = (
            [getattr(each, name) for each in effects if name in vars(type(each))]
            for name in ("added_scale_factor_ppm", "added_ug")
        )

    def added_dph(self, now: Conditions) -> FloatArray:
        """Sum of the biases of all effects, deg/h, shape (n, 3); must be called in the order of time."""
        return _sum(self._biases, now)

    def added_scale_factor_ppm(self, now: Conditions) -> FloatArray:
        """Sum of the scale factor errors of all effects, ppm, shape (n, 3)."""
        return _sum(self._scale_factors, now)

    def added_ug(self, now: Conditions) -> FloatArray:
        """Sum of the accelerometer biases of all effects, ug, shape (n, 3)."""
        return _sum(self._accelerometers, now)


def _sum(errors: Sequence[AddedError], now: Conditions) -> FloatArray:
    return sum((error(now) for error in errors), np.zeros(now.optics_c.shape))
