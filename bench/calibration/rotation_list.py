"""Rotation lists, and the expected uncertainties of a calibration with one.

The unit rests, is turned about an axis of the table, rests, and so on. The responses are computed from ideal
increments of that motion. Whitened by the expected noise, they give the Fisher information; no measurement is
needed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from gyrobench.bench.bias.noise_model import NoiseModel, rounding_sigma
from gyrobench.bench.calibration.coefficients import COUNT
from gyrobench.bench.calibration.increment_recording import SensorNoise
from gyrobench.bench.calibration.information import IS_FORCE_SCALE, CalibrationOptions, gyros_spun_both_ways
from gyrobench.bench.calibration.problem import CalibrationProblem
from gyrobench.bench.calibration.section import REST_EPOCH_S, IncrementEpochs, IncrementSection
from gyrobench.bench.calibration.strapdown import PARAMETER_COUNT
from gyrobench.bench.foundations.arrays import (
    DEG_PER_SQRT_H_TO_SI,
    STANDARD_GRAVITY,
    UG_PER_SQRT_HZ_TO_SI,
    BoolArray,
    FloatArray,
)
from gyrobench.bench.foundations.documents import StrictModel, read_document, validate
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.navigation.attitude import rotation_matrices, rotation_vectors
from gyrobench.bench.navigation.earth import earth_rate_enu
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.positions import POSITIONS, PositionName
from gyrobench.bench.navigation.table_axes import Angles, TwoAxisTable

#: Time between two ideal increments, s, and the time in which an axis reaches its rate.
STEP_S, _RAMP_S = 0.05, 1.0
_WHOLE_TURN_DEG = 360.0
#: Angle and velocity random walk of a typical unit, SI, and its noise of the velocity at rest, m/s.
_TYPICAL_NOISE = (0.0006 * DEG_PER_SQRT_H_TO_SI, 5.0 * UG_PER_SQRT_HZ_TO_SI, 1e-3)
#: Smallest noise of the velocity at rest, m/s, which avoids a division by zero.
_MIN_WHITE_VELOCITY = 1e-6


class TableRotation(StrictModel):
    """One rotation about an axis of the table."""

    axis: Literal["outer", "inner"] = Field(
        description="axis of the table; the outer one carries the inner one"
    )
    angle_deg: float = Field(ge=-36000.0, le=36000.0, description="angle; whole turns are multiples of 360")
    rate_dps: float | None = Field(
        default=None, gt=0.0, le=1000.0, description="rate, deg/s; default: that of the list"
    )


class RotationList(StrictModel):
    """A list of rotations with rests before, between and after them."""

    rotation_list: str = Field(min_length=1, description="name")
    description: str = Field(default="", description="purpose, free text")
    start: PositionName = Field(default="z_up", description="position of the first rest, at azimuth 0")
    dwell_s: float = Field(ge=5.0, le=86400.0, description="length of each rest, s")
    rate_dps: float = Field(gt=0.0, le=1000.0, description="rate of the rotations, deg/s")
    rotations: list[TableRotation] = Field(min_length=1, max_length=500, description="in their order")

    def seconds(self, rotation: TableRotation) -> float:
        """Duration of a rotation."""
        return abs(rotation.angle_deg) / (rotation.rate_dps or self.rate_dps) + _RAMP_S

    @property
    def duration_s(self) -> float:
        """Length of the list from the first rest to the last."""
        return (len(self.rotations) + 1) * self.dwell_s + sum(map(self.seconds, self.rotations))


def load_rotation_list(path: Path) -> RotationList:
    """Read a rotation list. Raises DocumentError, which lists all problems of the file."""
    return validate(read_document(path), RotationList)


def rotation_list_text(rotations: RotationList) -> str:
    """Format a rotation list as YAML that :func:`load_rotation_list` reads."""
    lines = [
        f"rotation_list: {rotations.rotation_list}",
        f"description: {rotations.description}",
        f"start: {rotations.start}",
        f"dwell_s: {rotations.dwell_s:g}",
        f"rate_dps: {rotations.rate_dps:g}",
        "rotations:",
    ]
    for each in rotations.rotations:
        rate = "" if each.rate_dps is None else f", rate_dps: {each.rate_dps:g}"
        lines.append(f"  - {{axis: {each.axis}, angle_deg: {each.angle_deg:g}{rate}}}")
    return "\n".join(lines) + "\n"


def expected_noise(
    declared: NoiseModel | None, rotations: RotationList, velocity_step_mps: float
) -> SensorNoise:
    """Noise of a unit as declared in its station; if undeclared, that of a typical navigation-grade unit.

    ``velocity_step_mps``: resolution of the velocity, if increments are computed from it.
    """
    walk, velocity_walk, white = (
        _TYPICAL_NOISE
        if declared is None
        else (declared.angle_random_walk, declared.velocity_random_walk, declared.velocity_white)
    )
    # Mean change of velocity in a rest by the tilt that angle random walk accumulates over the list.
    tilt = walk * math.sqrt(2.0 / math.pi) * 2.0 / 3.0 * math.sqrt(rotations.duration_s)
    moved_mps = STANDARD_GRAVITY * tilt * rotations.dwell_s
    if velocity_step_mps:
        repeats = rotations.dwell_s / (1.0 + moved_mps / velocity_step_mps)
        white = math.hypot(white, rounding_sigma(velocity_step_mps, repeats))
    white = max(white, _MIN_WHITE_VELOCITY)
    return SensorNoise(np.full(3, walk), np.zeros(3), np.full(3, velocity_walk), np.full(3, white))


@dataclass(frozen=True, eq=False)
class RotationSetup:
    """Table, site and unit with which a list of rotations is measured."""

    table: TwoAxisTable
    site: Site
    noise: SensorNoise  #: Of the unit.
    max_rate_dps: float  #: Of the table.
    whole_turns: float | None = None  #: Standard uncertainty of its return after whole turns, rad.
    site_sigmas: tuple[float, float] = (0.0, 0.0)  #: Of gravity, m/s^2, and latitude, rad.
    has_vertical: bool = True  #: Whether the vertical velocity is measured, as by increments.


@dataclass(frozen=True, eq=False)
class ExpectedUncertainties:
    """Expected uncertainties of a calibration with a list of rotations."""

    duration_s: float
    sigmas: FloatArray  #: Shape (21,). Standard uncertainties, SI; meaningless if not observed.
    is_observed: BoolArray  #: Shape (21,).


def expected_uncertainties(rotations: RotationList, setup: RotationSetup) -> ExpectedUncertainties:
    """Expected uncertainties from the Fisher information, for biases that do not drift.

    Raises DocumentError if the table can't perform the rotations.
    """
    table, site = setup.table, setup.site
    start = table.angles(POSITIONS[rotations.start].C_nb())
    _check_reachable(rotations, table, start, setup.max_rate_dps)
    attitude, at_rest, spins = motion(rotations, table, start)
    angle, velocity = ideal_increments(attitude, site)
    size = round(REST_EPOCH_S / STEP_S)
    ends = np.arange(size, len(angle) + 1, size, dtype=np.int64)
    turns = [(first // size, -(-last // size), np.eye(3)) for first, last in spins]
    section = IncrementSection(
        STEP_S, angle, velocity, len(angle), IncrementEpochs(ends, at_rest[ends], turns, setup.has_vertical)
    )
    gravity_sigma, latitude_sigma = setup.site_sigmas
    paths = [angle[first:last].sum(axis=0) for first, last in spins]
    axes = [int(np.argmax(np.abs(path))) for path in paths]
    options = CalibrationOptions(
        whole_turns=setup.whole_turns,
        gravity_sigma=gravity_sigma,
        latitude_sigma=latitude_sigma,
        quadratic=None,
        asymmetries=gyros_spun_both_ways((axis, path[axis]) for axis, path in zip(axes, paths, strict=True)),
    )
    common = np.zeros(PARAMETER_COUNT)
    problem = CalibrationProblem([section], setup.noise, site, options)
    information = problem.information(problem.integrate([attitude[0]], common), common)
    _, covariance, is_observed = information.solve()
    if not setup.has_vertical:
        is_observed[:COUNT] &= ~np.array(IS_FORCE_SCALE)
    parts = covariance, *problem.site_covariances(information).values()
    variances = sum(np.diag(part)[:COUNT] for part in parts)
    return ExpectedUncertainties(rotations.duration_s, np.sqrt(variances), is_observed[:COUNT])


def _check_reachable(
    rotations: RotationList, table: TwoAxisTable, start: Angles, max_rate_dps: float
) -> None:
    angles = dict(zip(("outer", "inner"), start, strict=True))
    limits = {"outer": table.outer_limits_deg, "inner": table.inner_limits_deg}
    for number, rotation in enumerate(rotations.rotations, 1):
        name = f"{rotations.rotation_list}: rotation {number} ({rotation.axis} {rotation.angle_deg:+g} deg)"
        rate_dps = rotation.rate_dps or rotations.rate_dps
        if rate_dps > max_rate_dps:
            raise DocumentError(f"{name}: {rate_dps:g} deg/s; the table turns at most {max_rate_dps:g} deg/s")
        angles[rotation.axis] += rotation.angle_deg
        low, high = limits[rotation.axis]
        if low == high:
            raise DocumentError(f"{name}: the table of the station has no {rotation.axis} axis that turns")
        if not low <= angles[rotation.axis] <= high:
            raise DocumentError(
                f"{name} leads to {angles[rotation.axis]:g} deg; the limits of that axis are {low:g} "
                f"to {high:g} deg. Turn it the other way, or begin in another position"
            )


def motion(
    rotations: RotationList, table: TwoAxisTable, start: Angles
) -> tuple[FloatArray, BoolArray, list[tuple[int, int]]]:
    """Attitudes (n, 3, 3) at the edges of increments, mask (n,) of rests, and edges around spins."""
    rest = round(rotations.dwell_s / STEP_S)
    angles = {"outer": [np.full(rest + 1, start[0])], "inner": [np.full(rest + 1, start[1])]}
    at_rest, spins, count = [np.ones(rest + 1, bool)], [], rest + 1
    for rotation in rotations.rotations:
        steps = round(rotations.seconds(rotation) / STEP_S)
        time_s = STEP_S * np.arange(1.0, steps + 1.0)
        travelled_deg = rotation.angle_deg * _travelled_share(time_s, steps * STEP_S)
        for axis, parts in angles.items():
            present_deg = parts[-1][-1]
            path_deg = present_deg + travelled_deg if axis == rotation.axis else np.full(steps, present_deg)
            parts += [path_deg, np.full(rest, path_deg[-1])]
        at_rest += [np.zeros(steps, bool), np.ones(rest, bool)]
        if rotation.angle_deg and rotation.angle_deg % _WHOLE_TURN_DEG == 0.0:
            spins.append((count - 1, count - 1 + steps))
        count += steps + rest
    outer, inner = (np.deg2rad(np.concatenate(angles[axis])) for axis in ("outer", "inner"))
    attitudes = (
        rotation_matrices(outer[:, np.newaxis] * table.outer_axis_enu)
        @ rotation_matrices(inner[:, np.newaxis] * table.inner_axis_enu)
        @ table.C_mount
    )
    return attitudes, np.concatenate(at_rest), spins


def _travelled_share(time_s: FloatArray, duration_s: float) -> FloatArray:
    """Travelled share of the angle, with constant acceleration at both ends."""
    rate = 1.0 / (duration_s - _RAMP_S)
    early, late = np.minimum(time_s, _RAMP_S), np.minimum(duration_s - time_s, _RAMP_S)
    started = 0.5 * rate * early**2 / _RAMP_S + rate * (time_s - early)
    return np.asarray(started - 0.5 * rate * (_RAMP_S - late) ** 2 / _RAMP_S)


def ideal_increments(attitude: FloatArray, site: Site) -> tuple[FloatArray, FloatArray]:
    """Increments (n, 3) of angle and velocity between attitudes (n + 1, 3, 3) one step apart."""
    earth = rotation_matrices(earth_rate_enu(site.latitude) * STEP_S)
    before, after = attitude[:-1], attitude[1:]
    angle = rotation_vectors(before.transpose(0, 2, 1) @ earth @ after)
    return angle, 0.5 * site.gravity * STEP_S * (before[:, 2] + after[:, 2])
