"""The world file: all properties of the simulated bench, validated like a procedure."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.documents import StrictModel, read_document, validate
from gyrobench.drivers.emulators.world.undeclared_effects import (
    BodyVector,
    NotNegative,
    Positive,
    UndeclaredEffect,
)

# Within these bounds the thermal network is stable at steps of one second.
HeatCapacity = Annotated[float, Field(ge=20.0)]
HeatConductance = Annotated[float, Field(ge=0.0, le=5.0)]
PositiveHeatConductance = Annotated[float, Field(gt=0.0, le=5.0)]


def _check_direction(vector: list[float]) -> list[float]:
    if not any(vector):
        raise ValueError("a direction needs at least one component that is not zero")
    if not 1e-6 <= max(map(abs, vector)) <= 1e6:
        raise ValueError("the largest component of a direction must be between 1e-6 and 1e6")
    return vector


def _check_divides_one_second(period_s: float) -> float:
    if 100 % round(100.0 * period_s):
        raise ValueError("the period must divide one second, as 0.1 or 0.25 do")
    return period_s


#: A coefficient: a number, or the coefficients of a polynomial in temperature minus the
#: reference temperature, lowest degree first.
OverTemperature = float | Annotated[list[float], Field(min_length=1, max_length=6)]


class PerAxis(StrictModel):
    """One value for each body axis: a number, or a polynomial in temperature from degree 0 up."""

    x: OverTemperature = Field(0.0, description="of the x axis: number or polynomial")
    y: OverTemperature = Field(0.0, description="of the y axis: number or polynomial")
    z: OverTemperature = Field(0.0, description="of the z axis: number or polynomial")


class PerPair(StrictModel):
    """One value for each ordered pair of axes, as in (1) and (2): a number, or a polynomial as above."""

    xy: OverTemperature = Field(0.0, description="x sensor to y axis: number or polynomial")
    xz: OverTemperature = Field(0.0, description="x sensor to z axis: number or polynomial")
    yx: OverTemperature = Field(0.0, description="y sensor to x axis: number or polynomial")
    yz: OverTemperature = Field(0.0, description="y sensor to z axis: number or polynomial")
    zx: OverTemperature = Field(0.0, description="z sensor to x axis: number or polynomial")
    zy: OverTemperature = Field(0.0, description="z sensor to y axis: number or polynomial")


class GyroErrors(StrictModel):
    """The gyros' twelve coefficients of the paper's equation (2), and their noise."""

    bias_dph: PerAxis = Field(PerAxis(), description="bias, deg/h")
    scale_factor_ppm: PerAxis = Field(PerAxis(), description="scale factor error, ppm")
    misalignment_arcsec: PerPair = Field(PerPair(), description="misalignment, arcsec")
    angle_random_walk_deg_per_sqrt_h: NotNegative = Field(0.0, description="angle random walk, deg/sqrt(h)")
    power_on_repeatability_dph: NotNegative = Field(
        0.0, description="standard deviation of the bias over power-ons, deg/h"
    )
    bias_instability_dph: NotNegative = Field(0.0, description="bias instability (flicker noise), deg/h")
    rate_random_walk_dph_per_sqrt_h: NotNegative = Field(0.0, description="rate random walk, deg/h/sqrt(h)")
    pulse_arcsec: NotNegative = Field(0.0, description="angle of one output pulse, arcsec")
    scale_factor_repeatability_ppm: NotNegative = Field(
        0.0, description="standard deviation of the scale factor over power-ons, ppm"
    )
    scale_factor_asymmetry_ppm: BodyVector = Field(
        [0.0, 0.0, 0.0],
        description="scale factor of each gyro in positive direction less that in negative, ppm",
    )
    scale_factor_ppm_per_dps: BodyVector = Field(
        [0.0, 0.0, 0.0],
        description="change of each gyro's scale factor with the size of its rate, ppm per deg/s",
    )


class AccelerometerErrors(StrictModel):
    """The accelerometers' twelve coefficients of the paper's equation (1), and their noise."""

    bias_ug: PerAxis = Field(PerAxis(), description="bias, ug")
    scale_factor_ppm: PerAxis = Field(PerAxis(), description="scale factor error, ppm")
    misalignment_arcsec: PerPair = Field(PerPair(), description="misalignment, arcsec")
    velocity_random_walk_ug_per_sqrt_hz: NotNegative = Field(
        0.0, description="velocity random walk, ug/sqrt(Hz)"
    )
    pulse_um_per_s: NotNegative = Field(0.0, description="velocity of one output pulse, um/s")


class GyroThermal(StrictModel):
    """Heat capacities and conductances of one gyro: electronics, optics, and the case around both."""

    optics_j_per_k: HeatCapacity = Field(500.0, description="heat capacity of the optics, J/K")
    electronics_j_per_k: HeatCapacity = Field(250.0, description="heat capacity of the electronics, J/K")
    optics_power_w: NotNegative = Field(1.0, description="heat dissipated in the optics, W")
    electronics_power_w: NotNegative = Field(6.0, description="heat dissipated in the electronics, W")
    optics_to_case_w_per_k: PositiveHeatConductance = Field(
        0.3, description="conductance from optics to case, W/K"
    )
    electronics_to_case_w_per_k: PositiveHeatConductance = Field(
        0.25, description="conductance from electronics to case, W/K"
    )
    electronics_to_optics_w_per_k: HeatConductance = Field(
        0.06, description="conductance from electronics to optics, W/K"
    )
    convection_w_per_k: HeatConductance = Field(0.04, description="conductance of the air between them, W/K")
    convection_gravity_share: Annotated[float, Field(ge=0.0, le=1.0)] = Field(
        0.6, description="share of the convection that depends on gravity"
    )

    heat_path: Annotated[BodyVector, AfterValidator(_check_direction)] = Field(
        description="body direction from electronics to optics, the path of the rising warm air"
    )


class Thermal(StrictModel):
    """The thermal network of the unit."""

    case_j_per_k: Annotated[float, Field(ge=500.0)] = Field(
        4000.0, description="heat capacity of the case, J/K"
    )
    case_to_air_w_per_k: Annotated[float, Field(gt=0.0, le=100.0)] = Field(
        5.0, description="conductance from case to chamber air, W/K"
    )
    sensor_noise_c: NotNegative = Field(0.003, description="noise of each temperature sensor, K")
    x: GyroThermal = Field(description="the x gyro")
    y: GyroThermal = Field(description="the y gyro")
    z: GyroThermal = Field(description="the z gyro")


class InsBehaviour(StrictModel):
    """Behaviour of the INS."""

    serial_number: Annotated[int, Field(ge=0, lt=2**32)] = Field(
        1001, description="serial number that it reports"
    )
    boot_s: NotNegative = Field(8.0, description="from power-on to the first data, s")
    levelling_s: NotNegative = Field(10.0, description="levelling at the start of an alignment, s")
    coarse_alignment_s: Positive = Field(30.0, description="alignment time to coarse, s")
    fine_alignment_s: Positive = Field(240.0, description="alignment time to fine, s")
    latitude_error_arcmin: float = Field(0.0, description="error of the entered latitude, arcmin")
    epoch_period_s: Annotated[
        float, Field(ge=0.01, le=1.0, multiple_of=0.01), AfterValidator(_check_divides_one_second)
    ] = Field(0.1, description="time between navigation outputs, s")


Direction = Literal["east", "north", "up", "west", "south", "down"]
_EAST, _NORTH, _UP = np.eye(3)
_DIRECTIONS = {"east": _EAST, "north": _NORTH, "up": _UP, "west": -_EAST, "south": -_NORTH, "down": -_UP}


class Mounting(StrictModel):
    """Directions of the unit's axes while both axes of the table are at zero."""

    x: Direction = Field(description="direction of x")
    y: Direction = Field(description="direction of y")
    z: Direction = Field(description="direction of z")

    @property
    def matrix(self) -> FloatArray:
        """Body axes in ENU as columns, shape (3, 3)."""
        return np.array([_DIRECTIONS[direction] for direction in (self.x, self.y, self.z)]).T

    @model_validator(mode="after")
    def _check_rotation(self) -> Mounting:
        if np.linalg.det(self.matrix) < 0.5:
            raise ValueError("the axes must be three different, right-handed directions")
        return self


class TableGeometry(StrictModel):
    """Installation of the table in the laboratory and of the unit on the table."""

    outer_axis: Literal["east", "up"] = Field("east", description="direction of the outer axis")
    tilt_arcsec: BodyVector = Field([0.0, 0.0, 0.0], description="tilt about East, North and Up, arcsec")
    mounting: Mounting = Field(
        Mounting(x="east", y="north", z="up"), description="direction of the unit's axes at zero"
    )
    mounting_error_arcsec: BodyVector = Field(
        [0.0, 0.0, 0.0], description="rotation of the unit about x, y, z, arcsec"
    )
    position_error_arcsec: NotNegative = Field(1.0, description="bound of an axis's error, arcsec")
    rate_limit_dps: Positive = Field(60.0, description="maximum rate of an axis, deg/s")
    acceleration_limit_dps2: Positive = Field(60.0, description="maximum acceleration, deg/s2")
    jerk_limit_dps3: Positive = Field(240.0, description="maximum jerk, deg/s3")


class ChamberBehaviour(StrictModel):
    """The chamber's capability and the laboratory around it."""

    heating_limit_c_per_min: Positive = Field(5.0, description="maximum heating rate, degC/min")
    cooling_limit_c_per_min: Positive = Field(4.0, description="maximum cooling rate, degC/min")
    control_time_constant_s: Positive = Field(90.0, description="lag of the air behind its set point, s")
    ambient_c: float = Field(23.0, description="temperature of the laboratory, degC")


class FurtherUnit(StrictModel):
    """A unit beside the first one; each key that is absent is as in the first unit."""

    serial_number: Annotated[int, Field(ge=0, lt=2**32)] | None = Field(
        None, description="serial number that it reports; default: counted up from that of the first unit"
    )
    power_event: Annotated[int, Field(ge=1)] | None = Field(
        None, description="chamber event output that powers it; default: its number plus one"
    )
    mounting: Mounting | None = Field(None, description="direction of the unit's axes at zero")
    mounting_error_arcsec: BodyVector | None = Field(
        None, description="rotation of the unit about x, y, z, arcsec"
    )
    gyro: GyroErrors | None = Field(None, description="errors of its gyros")
    accelerometer: AccelerometerErrors | None = Field(None, description="errors of its accelerometers")
    thermal: Thermal | None = Field(None, description="its thermal network")
    ins: InsBehaviour | None = Field(None, description="behaviour of its INS")
    undeclared_effects: list[UndeclaredEffect] | None = Field(
        None, description="effects on its gyro biases beyond the polynomials"
    )


class NeighbourHeating(StrictModel):
    """One unit heats the air around another."""

    from_unit: Annotated[int, Field(ge=1)] = Field(description="number of the unit that dissipates")
    to_unit: Annotated[int, Field(ge=1)] = Field(description="number of the unit whose air it heats")
    coupling_k_per_w: NotNegative = Field(description="rise of the air per watt that it dissipates, K/W")
    time_constant_s: Positive = Field(600.0, description="lag of the rise behind the power, s")

    @model_validator(mode="after")
    def _check_two_units(self) -> NeighbourHeating:
        if self.from_unit == self.to_unit:
            raise ValueError("from_unit and to_unit must be two different units")
        return self


_UNIT_KEYS = ("gyro", "accelerometer", "thermal", "ins", "undeclared_effects")
_MOUNTING_KEYS = ("mounting", "mounting_error_arcsec")


class WorldFile(StrictModel):
    """A simulated bench."""

    world: str = Field(description="name of the world")
    description: str = Field("", description="purpose of the world")
    latitude_deg: Annotated[float, Field(ge=-85.0, le=85.0)] = Field(description="geodetic latitude, deg")
    height_m: float = Field(0.0, description="height above the ellipsoid, m")
    reference_temperature_c: float = Field(25.0, description="zero of the polynomials in temperature, degC")
    gyro: GyroErrors = Field(GyroErrors(), description="errors of the gyros")
    accelerometer: AccelerometerErrors = Field(
        AccelerometerErrors(), description="errors of the accelerometers"
    )
    thermal: Thermal = Field(description="thermal network of the unit")
    ins: InsBehaviour = Field(InsBehaviour(), description="behaviour of the INS")
    table: TableGeometry = Field(TableGeometry(), description="installation and limits of the table")
    chamber: ChamberBehaviour = Field(ChamberBehaviour(), description="limits of the chamber, and its room")
    undeclared_effects: list[UndeclaredEffect] = Field(
        [], description="effects on the gyro biases beyond the polynomials; they add up"
    )
    units: list[FurtherUnit] = Field(
        [], description="units beside the first one, from number 2 on, on the same table"
    )
    neighbour_heating: list[NeighbourHeating] = Field([], description="which unit heats the air of which")

    def of_unit(self, number: int) -> WorldFile:
        """World of one unit by its number; beyond ``units`` it equals the first but for its serial number."""
        if number == 1:
            return self
        further = self.units[number - 2] if number - 2 < len(self.units) else FurtherUnit()
        changes = {name: value for name in _UNIT_KEYS if (value := getattr(further, name)) is not None}
        mounting = {name: value for name in _MOUNTING_KEYS if (value := getattr(further, name)) is not None}
        ins = changes.pop("ins", self.ins)
        serial_number = further.serial_number
        if serial_number is None:
            serial_number = (self.ins.serial_number + number - 1) % 2**32
        changes["ins"] = ins.model_copy(update={"serial_number": serial_number})
        return self.model_copy(update=changes | {"table": self.table.model_copy(update=mounting)})

    def power_event(self, number: int) -> int:
        """Event output of the chamber that powers a unit, by the unit's number."""
        event = self.units[number - 2].power_event if 0 <= number - 2 < len(self.units) else None
        return number + 1 if event is None else event


def load_world(path: Path) -> WorldFile:
    """Read and validate a world file.

    Raises DocumentError, which lists all problems, each with its place in the file.
    """
    return validate(read_document(path), WorldFile)
