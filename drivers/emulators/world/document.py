"""The world file: everything about the simulated bench, checked like a procedure."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from gyrobench.bench.foundations.documents import StrictModel, read_document, validate
from gyrobench.drivers.emulators.world.effects.undeclared_bias import UndeclaredEffect
from gyrobench.drivers.emulators.world.quantities import NotNegative, Positive, Vector

# These bounds keep the thermal network's steps of one second stable.
HeatCapacity = Annotated[float, Field(ge=20.0)]
HeatConductance = Annotated[float, Field(ge=0.0, le=5.0)]
PositiveHeatConductance = Annotated[float, Field(gt=0.0, le=5.0)]


def _has_a_direction(vector: list[float]) -> list[float]:
    if not any(vector):
        raise ValueError("a direction has to have a component that is not zero")
    if not 1e-6 <= max(map(abs, vector)) <= 1e6:
        raise ValueError("the largest component of a direction has to be between 1e-6 and 1e6")
    return vector


def _goes_into_a_second(period_s: float) -> float:
    if 100 % round(100.0 * period_s):
        raise ValueError("a whole number of periods has to make one second")
    return period_s


#: A coefficient: a number, or the coefficients of a polynomial in temperature minus the
#: reference temperature, lowest degree first.
OverTemperature = float | Annotated[list[float], Field(min_length=1, max_length=6)]


class PerAxis(StrictModel):
    """One value over temperature for each body axis."""

    x: OverTemperature = Field(
        default=0.0, description="of the x axis: a number, or a polynomial in temperature from degree 0 up"
    )
    y: OverTemperature = Field(
        default=0.0, description="of the y axis: a number, or a polynomial in temperature from degree 0 up"
    )
    z: OverTemperature = Field(
        default=0.0, description="of the z axis: a number, or a polynomial in temperature from degree 0 up"
    )


class PerPair(StrictModel):
    """One value over temperature for each ordered pair of different axes, as in (1) and (2)."""

    xy: OverTemperature = Field(
        default=0.0, description="of the x sensor to the y axis: a number, or a polynomial from degree 0 up"
    )
    xz: OverTemperature = Field(
        default=0.0, description="of the x sensor to the z axis: a number, or a polynomial from degree 0 up"
    )
    yx: OverTemperature = Field(
        default=0.0, description="of the y sensor to the x axis: a number, or a polynomial from degree 0 up"
    )
    yz: OverTemperature = Field(
        default=0.0, description="of the y sensor to the z axis: a number, or a polynomial from degree 0 up"
    )
    zx: OverTemperature = Field(
        default=0.0, description="of the z sensor to the x axis: a number, or a polynomial from degree 0 up"
    )
    zy: OverTemperature = Field(
        default=0.0, description="of the z sensor to the y axis: a number, or a polynomial from degree 0 up"
    )


class GyroErrors(StrictModel):
    """The gyros' twelve coefficients of the paper's equation (2), and their noise."""

    bias_dph: PerAxis = Field(default=PerAxis(), description="bias, deg/h")
    scale_factor_ppm: PerAxis = Field(default=PerAxis(), description="scale factor error, ppm")
    misalignment_arcsec: PerPair = Field(default=PerPair(), description="misalignment, arcsec")
    angle_random_walk_deg_per_sqrt_h: NotNegative = Field(
        default=0.0, description="angle random walk of each gyro, deg/sqrt(h)"
    )
    power_on_repeatability_dph: NotNegative = Field(
        default=0.0, description="standard deviation of the bias from power-on to power-on, deg/h"
    )
    pulse_arcsec: NotNegative = Field(default=0.0, description="angle of one output pulse, arcsec")


class AccelerometerErrors(StrictModel):
    """The accelerometers' twelve coefficients of the paper's equation (1), and their noise."""

    bias_ug: PerAxis = Field(default=PerAxis(), description="bias, ug")
    scale_factor_ppm: PerAxis = Field(default=PerAxis(), description="scale factor error, ppm")
    misalignment_arcsec: PerPair = Field(default=PerPair(), description="misalignment, arcsec")
    velocity_random_walk_ug_per_sqrt_hz: NotNegative = Field(
        default=0.0, description="velocity random walk of each accelerometer, ug/sqrt(Hz)"
    )
    pulse_um_per_s: NotNegative = Field(default=0.0, description="velocity of one output pulse, um/s")


class GyroThermal(StrictModel):
    """Heat capacities and paths of one gyro: electronics, optics, and the case around both."""

    optics_j_per_k: HeatCapacity = Field(default=500.0, description="heat capacity of the optics, J/K")
    electronics_j_per_k: HeatCapacity = Field(
        default=250.0, description="heat capacity of the electronics, J/K"
    )
    optics_power_w: NotNegative = Field(default=1.0, description="heat made in the optics, W")
    electronics_power_w: NotNegative = Field(default=6.0, description="heat made in the electronics, W")
    optics_to_case_w_per_k: PositiveHeatConductance = Field(
        default=0.3, description="conductance from optics to case, W/K"
    )
    electronics_to_case_w_per_k: PositiveHeatConductance = Field(
        default=0.25, description="conductance from electronics to case, W/K"
    )
    electronics_to_optics_w_per_k: HeatConductance = Field(
        default=0.06, description="conductance from electronics to optics, W/K"
    )
    convection_w_per_k: HeatConductance = Field(
        default=0.04, description="conductance of the air between them, W/K"
    )
    convection_gravity_share: Annotated[float, Field(ge=0.0, le=1.0)] = Field(
        default=0.6, description="share of the convection that depends on the direction of gravity"
    )

    heat_path: Annotated[Vector, AfterValidator(_has_a_direction)] = Field(
        description="body direction from electronics to optics: warm air rises along it"
    )


class Thermal(StrictModel):
    """The thermal network of the unit."""

    case_j_per_k: Annotated[float, Field(ge=500.0)] = Field(
        default=4000.0, description="heat capacity of the case, J/K"
    )
    case_to_air_w_per_k: Annotated[float, Field(gt=0.0, le=100.0)] = Field(
        default=5.0, description="conductance from case to chamber air, W/K"
    )
    sensor_noise_c: NotNegative = Field(default=0.003, description="noise of each temperature sensor, K")
    x: GyroThermal = Field(description="the x gyro")
    y: GyroThermal = Field(description="the y gyro")
    z: GyroThermal = Field(description="the z gyro")


class InsBehaviour(StrictModel):
    """What the INS itself does."""

    serial_number: Annotated[int, Field(ge=0, lt=2**32)] = Field(
        default=1001, description="what it says it is"
    )
    boot_s: NotNegative = Field(default=8.0, description="from power-on to the first data, s")
    levelling_s: NotNegative = Field(default=10.0, description="levelling at the start of an alignment, s")
    coarse_alignment_s: Positive = Field(
        default=30.0, description="from the start of an alignment to coarse, s"
    )
    fine_alignment_s: Positive = Field(default=240.0, description="from the start of an alignment to fine, s")
    latitude_error_arcmin: float = Field(
        default=0.0, description="error of the latitude that it is given, arcmin"
    )
    epoch_period_s: Annotated[
        float, Field(ge=0.01, le=1.0, multiple_of=0.01), AfterValidator(_goes_into_a_second)
    ] = Field(default=0.1, description="time between navigation outputs, s")


class TableGeometry(StrictModel):
    """How the table stands in the laboratory and how the unit sits on it."""

    outer_axis: Literal["east", "up"] = Field(default="east", description="where the outer axis points")
    tilt_arcsec: Vector = Field(
        default=[0.0, 0.0, 0.0], description="tilt of the table about East, North and Up, arcsec"
    )
    mounting_error_arcsec: Vector = Field(
        default=[0.0, 0.0, 0.0], description="turn of the unit on its mount about x, y and z, arcsec"
    )
    position_error_arcsec: NotNegative = Field(
        default=1.0, description="standard deviation of a position that is reached, arcsec"
    )
    rate_limit_dps: Positive = Field(default=60.0, description="fastest rate of an axis, deg/s")
    acceleration_limit_dps2: Positive = Field(default=60.0, description="largest acceleration, deg/s2")
    jerk_limit_dps3: Positive = Field(default=240.0, description="largest jerk, deg/s3")


class ChamberBehaviour(StrictModel):
    """The chamber's capability and the laboratory around it."""

    heating_limit_c_per_min: Positive = Field(default=5.0, description="fastest rise of the air, degC/min")
    cooling_limit_c_per_min: Positive = Field(default=4.0, description="fastest fall of the air, degC/min")
    control_time_constant_s: Positive = Field(
        default=90.0, description="lag of the air behind its set point, s"
    )
    ambient_c: float = Field(default=23.0, description="temperature of the laboratory, degC")


class WorldFile(StrictModel):
    """A whole simulated bench."""

    world: str = Field(description="name of the world")
    description: str = Field(default="", description="what it is for, for people")
    latitude_deg: Annotated[float, Field(ge=-85.0, le=85.0)] = Field(description="geodetic latitude, deg")
    height_m: float = Field(default=0.0, description="height above the ellipsoid, m")
    reference_temperature_c: float = Field(
        default=25.0, description="where polynomials in temperature have their zero, degC"
    )
    gyro: GyroErrors = Field(default=GyroErrors(), description="errors of the gyros")
    accelerometer: AccelerometerErrors = Field(
        default=AccelerometerErrors(), description="errors of the accelerometers"
    )
    thermal: Thermal = Field(description="heat in the unit")
    ins: InsBehaviour = Field(default=InsBehaviour(), description="what the INS does")
    table: TableGeometry = Field(
        default=TableGeometry(), description="how the table stands, and what it can do"
    )
    chamber: ChamberBehaviour = Field(default=ChamberBehaviour(), description="what the chamber can do")
    undeclared_effects: list[UndeclaredEffect] = Field(
        default=[], description="what acts on the gyro biases beyond the polynomials; they add up"
    )


def load_world(path: Path) -> WorldFile:
    """Read and check a world file.

    Raises
    ------
    DocumentError
        Lists everything wrong with it, with places.
    """
    return validate(read_document(path), WorldFile)
