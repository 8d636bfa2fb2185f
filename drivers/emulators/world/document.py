"""The world file: everything about the simulated bench, checked like a procedure."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from bench.documents import StrictModel, read_document, validate
from drivers.emulators.world.effects.undeclared_bias import UndeclaredEffect
from drivers.emulators.world.quantities import NotNegative, Positive, Vector

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

    x: OverTemperature = 0.0
    y: OverTemperature = 0.0
    z: OverTemperature = 0.0


class PerPair(StrictModel):
    """One value over temperature for each ordered pair of different axes, as in (1) and (2)."""

    xy: OverTemperature = 0.0
    xz: OverTemperature = 0.0
    yx: OverTemperature = 0.0
    yz: OverTemperature = 0.0
    zx: OverTemperature = 0.0
    zy: OverTemperature = 0.0


class GyroErrors(StrictModel):
    """The gyros' twelve coefficients of the paper's equation (2), and their noise."""

    bias_dph: PerAxis = PerAxis()
    scale_factor_ppm: PerAxis = PerAxis()
    misalignment_arcsec: PerPair = PerPair()
    angle_random_walk_deg_per_sqrt_h: NotNegative = 0.0
    power_on_repeatability_dph: NotNegative = 0.0
    pulse_arcsec: NotNegative = 0.0


class AccelerometerErrors(StrictModel):
    """The accelerometers' twelve coefficients of the paper's equation (1), and their noise."""

    bias_ug: PerAxis = PerAxis()
    scale_factor_ppm: PerAxis = PerAxis()
    misalignment_arcsec: PerPair = PerPair()
    velocity_random_walk_ug_per_sqrt_hz: NotNegative = 0.0
    pulse_um_per_s: NotNegative = 0.0


class GyroThermal(StrictModel):
    """Heat capacities and paths of one gyro: electronics, optics, and the case around both."""

    optics_j_per_k: HeatCapacity = 500.0
    electronics_j_per_k: HeatCapacity = 250.0
    optics_power_w: NotNegative = 1.0
    electronics_power_w: NotNegative = 6.0
    optics_to_case_w_per_k: PositiveHeatConductance = 0.3
    electronics_to_case_w_per_k: PositiveHeatConductance = 0.25
    electronics_to_optics_w_per_k: HeatConductance = 0.06
    convection_w_per_k: HeatConductance = 0.04
    convection_gravity_share: Annotated[float, Field(ge=0.0, le=1.0)] = 0.6
    #: Body direction from the electronics to the optics: warm air rises along it.
    heat_path: Annotated[Vector, AfterValidator(_has_a_direction)]


class Thermal(StrictModel):
    """The thermal network of the unit."""

    case_j_per_k: Annotated[float, Field(ge=500.0)] = 4000.0
    case_to_air_w_per_k: Annotated[float, Field(gt=0.0, le=100.0)] = 5.0
    sensor_noise_c: NotNegative = 0.003
    x: GyroThermal
    y: GyroThermal
    z: GyroThermal


class InsBehaviour(StrictModel):
    """What the INS itself does."""

    serial_number: Annotated[int, Field(ge=0, lt=2**32)] = 1001
    boot_s: NotNegative = 8.0
    levelling_s: NotNegative = 10.0
    coarse_alignment_s: Positive = 30.0
    fine_alignment_s: Positive = 240.0
    latitude_error_arcmin: float = 0.0
    epoch_period_s: Annotated[
        float, Field(ge=0.01, le=1.0, multiple_of=0.01), AfterValidator(_goes_into_a_second)
    ] = 0.1


class TableGeometry(StrictModel):
    """How the table stands in the laboratory and how the unit sits on it."""

    outer_axis: Literal["east", "up"] = "east"
    tilt_arcsec: Vector = Field(default=[0.0, 0.0, 0.0])
    mounting_error_arcsec: Vector = Field(default=[0.0, 0.0, 0.0])
    position_error_arcsec: NotNegative = 1.0
    rate_limit_dps: Positive = 60.0
    acceleration_limit_dps2: Positive = 60.0
    jerk_limit_dps3: Positive = 240.0


class ChamberBehaviour(StrictModel):
    """The chamber's capability and the laboratory around it."""

    heating_limit_c_per_min: Positive = 5.0
    cooling_limit_c_per_min: Positive = 4.0
    control_time_constant_s: Positive = 90.0
    ambient_c: float = 23.0


class WorldFile(StrictModel):
    """A whole simulated bench."""

    world: str
    description: str = ""
    latitude_deg: Annotated[float, Field(ge=-85.0, le=85.0)]
    height_m: float = 0.0
    reference_temperature_c: float = 25.0
    gyro: GyroErrors = GyroErrors()
    accelerometer: AccelerometerErrors = AccelerometerErrors()
    thermal: Thermal
    ins: InsBehaviour = InsBehaviour()
    table: TableGeometry = TableGeometry()
    chamber: ChamberBehaviour = ChamberBehaviour()
    undeclared_effects: list[UndeclaredEffect] = Field(default=[])


def load_world(path: Path) -> WorldFile:
    """Read and check a world file.

    Raises
    ------
    DocumentError
        Lists everything wrong with it, with places.
    """
    return validate(read_document(path), WorldFile)
