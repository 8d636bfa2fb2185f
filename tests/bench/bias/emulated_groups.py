"""All six positions at one temperature, from the strapdown INS of the emulated bench."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gyrobench.bench.bias.bias_filter import estimate_state_space
from gyrobench.bench.bias.joint_solution import JointDwell, JointInformation, JointSolution, solve_jointly
from gyrobench.bench.bias.parameters import ErrorModel, PriorKnowledge
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray
from gyrobench.bench.navigation.positions import POSITIONS
from tests.bench.bias.emulated_dwells import emulate, noise_model, sensors, site

ARCSEC = np.pi / 180.0 / 3600.0
ARCMIN = 60.0 * ARCSEC
NOISE = noise_model(0.0006)
ALL = tuple(POSITIONS)


@dataclass(frozen=True, eq=False)
class Unit:
    """An INS and its undeclared errors; biases in deg/h by position, accelerometers in ug."""

    bias_dph: dict[str, FloatArray]
    accelerometer_ug: FloatArray = field(default_factory=lambda: np.array([70.0, -60.0, 80.0]))
    accelerometer_matrix: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    gyro_matrix: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    latitude_error_arcmin: float = 0.0

    def true_bias_dph(self, positions: tuple[str, ...] = ALL) -> FloatArray:
        return np.array([self.bias_dph[name] for name in positions])


def any_unit(random: np.random.Generator, **fields: float) -> Unit:
    """A unit whose gyro biases depend on the position, only not between up and down of a vertical gyro."""
    bias = {name: 0.005 * random.standard_normal(3) for name in POSITIONS}
    for gyro, axis in enumerate("xyz"):
        bias[f"{axis}_down"][gyro] = bias[f"{axis}_up"][gyro]
    gyro_matrix = 2.0 * ARCSEC * random.standard_normal((3, 3))
    np.fill_diagonal(gyro_matrix, 5e-6 * random.standard_normal(3))
    return Unit(
        bias,
        random.choice([-1.0, 1.0], 3) * random.uniform(50.0, 100.0, 3),
        5.0 * ARCSEC * random.standard_normal((3, 3)),
        gyro_matrix,
        **fields,
    )


def follow_gravity(unit: Unit, change_dph: FloatArray) -> Unit:
    """Add to each gyro's bias when it points up, and take away when it points down."""
    bias = {name: values.copy() for name, values in unit.bias_dph.items()}
    for name, values in bias.items():
        up = POSITIONS[name].up_axis
        values[up] += POSITIONS[name].up_sign * change_dph[up]
    return Unit(
        bias, unit.accelerometer_ug, unit.accelerometer_matrix, unit.gyro_matrix, unit.latitude_error_arcmin
    )


def measure(
    unit: Unit,
    random: np.random.Generator | None,
    positions: tuple[str, ...] = ALL,
    *,
    first: int = 1,
    chamber_set_c: float = 20.0,
) -> list[JointDwell]:
    """One dwell in each position, numbered from ``first``, on a table with a level outer axis.

    Without ``random`` there is no noise.
    """
    return [
        _measured(unit, name, random, first + number, chamber_set_c) for number, name in enumerate(positions)
    ]


def _measured(
    unit: Unit, position: str, random: np.random.Generator | None, number: int, chamber_set_c: float
) -> JointDwell:
    ins = sensors(
        unit.bias_dph[position],
        unit.accelerometer_ug,
        NOISE,
        gyro_matrix=unit.gyro_matrix,
        accelerometer_matrix=unit.accelerometer_matrix,
    )
    dwell = emulate(
        position,
        ins,
        noise=NOISE,
        random=random,
        outer_level=True,
        latitude_error_arcmin=unit.latitude_error_arcmin,
    )
    estimate = estimate_state_space(dwell, ErrorModel(site(), NOISE))
    return JointDwell(number, position, estimate.information, 1, chamber_set_c, (25.0, 25.0, 25.0))


def is_vertical(positions: tuple[str, ...] = ALL) -> BoolArray:
    """Which gyro of each dwell is vertical, (m, 3)."""
    return np.array([np.arange(3) == POSITIONS[name].up_axis for name in positions])


def joint_solution_of(dwells: Sequence[JointDwell], prior: PriorKnowledge) -> JointSolution:
    """The joint solution of dwells that have all their information."""
    no_turns = np.zeros((0, 9)), np.zeros(0)
    return solve_jointly(
        [
            replace(each, information=JointInformation.of(each.information, each.position, prior, no_turns))
            for each in dwells
        ],
        prior,
    )
