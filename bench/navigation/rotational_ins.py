"""Position error of a rotational INS in a day of navigation, due to the residual biases of its gyros.

A dual-axis rotational INS carries its sensors in two gimbals and turns them from one attitude to the next. A
bias that is constant in body axes rotates with the body and averages out. A bias that changes with attitude
does not, and makes the position drift.

The schemes here are assumptions. Chen et al. compare their scheme with one of 16 positions, whose table of
turns was not available. :data:`HALF_TURNS` turns by 180 deg about one of two axes at a time and repeats all
turns in the opposite direction, so that errors of the gyros' scale factors average out, but not those of
their misalignments; :data:`RETRACED_HALF_TURNS` cancels both. Dwell and rate are chosen freely.

References
----------
Chen et al., "Enhanced Dual-Axis Rotation Modulation Scheme for Inertial Navigation Systems Using a
64-Position Approach", Sensors 26(6):1796, 2026.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrobench.bench.foundations.arrays import DPH_TO_RADPS, FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.kernels import compiled
from gyrobench.bench.navigation.attitude import UP
from gyrobench.bench.navigation.earth import curvature_radii
from gyrobench.bench.navigation.error_model import INPUTS, STATES, Site, integrate
from gyrobench.bench.navigation.positions import AXES, POSITIONS
from gyrobench.bench.navigation.table_axes import TwoAxisTable

#: Function of the time since the start (n,), s, and Up in body axes (n, 3); returns the gyros' residual bias
#: (n, 3), deg/h.
ResidualBias = Callable[[FloatArray, FloatArray], FloatArray]

#: One nautical mile, m.
NAUTICAL_MILE_M = 1852.0
#: One day, s.
DAY_S = 86_400.0

_DWELL_STEP_S = 60.0
_TURN_STEPS = 6
#: Direction cosines of Up up to this are rounding.
_MIN_COSINE = 1e-9
_EAST_VELOCITY, _LATITUDE = 3, 5
#: Outer axis East, inner axis Up, body axes East, North, Up with both angles at zero.
GIMBALS = TwoAxisTable(np.array([1.0, 0.0, 0.0]), UP, np.eye(3))


@dataclass(frozen=True)
class RotationScheme:
    """Sequence of turns of the gimbals, which is repeated.

    Raises MeasurementError if the turns do not lead back to the initial angles.
    """

    #: Axis and angle of each turn. The outer axis points East, the inner one Up while the outer angle is
    #: zero.
    turns_deg: tuple[tuple[Literal["outer", "inner"], float], ...]
    #: Rest before each turn. With 300 s sixteen dwells would last a Schuler period, and errors would resonate
    #: instead of averaging out.
    dwell_s: ClassVar[float] = 180.0
    rate_dps: ClassVar[float] = 10.0  #: Rate of the turns.

    def __post_init__(self) -> None:
        if self.angles_deg()[-1] != (0.0, 0.0):
            raise MeasurementError(
                f"rotation scheme: the turns end at {self.angles_deg()[-1]} deg; they must lead back to zero"
            )

    def angles_deg(self) -> list[tuple[float, float]]:
        """Outer and inner angle before each turn, and after the last one."""
        steps = [(angle, 0.0) if axis == "outer" else (0.0, angle) for axis, angle in self.turns_deg]
        sums = itertools.accumulate(
            steps, lambda at, step: (at[0] + step[0], at[1] + step[1]), initial=(0.0, 0.0)
        )
        return list(sums)


def _both_directions(turns: tuple[tuple[Literal["outer", "inner"], float], ...]) -> RotationScheme:
    return RotationScheme((*turns, *((axis, -angle) for axis, angle in turns)))


#: Sixteen half turns: the inner axis stays vertical, in four attitudes of two positions. At 45 deg N a gyro
#: misalignment of 1 arcsec becomes up to 3.7 nmi in 24 h; by :data:`RETRACED_HALF_TURNS` 0.2 nmi.
HALF_TURNS = _both_directions(
    (*((("inner", 180.0), ("outer", 180.0)) * 2), *((("inner", -180.0), ("outer", -180.0)) * 2))
)

_FORWARD: tuple[tuple[Literal["outer", "inner"], float], ...] = (
    ("inner", 180.0),
    ("outer", 180.0),
    ("inner", -180.0),
    ("outer", -180.0),
) * 2
#: Sixteen half turns of which the last eight retrace the first eight, so that misalignments of the gyros
#: average out like their scale factors.
RETRACED_HALF_TURNS = RotationScheme((*_FORWARD, *((axis, -angle) for axis, angle in reversed(_FORWARD))))

#: Thirty-two turns through all six positions, each at azimuths half a turn apart: sixteen attitudes.
SIX_POSITIONS = _both_directions(
    (
        ("inner", 180.0), ("outer", 180.0), ("inner", -180.0), ("inner", 90.0),
        ("inner", 180.0), ("outer", -180.0), ("inner", -180.0), ("outer", 90.0),
        ("inner", 180.0), ("outer", 180.0), ("inner", -180.0), ("inner", -90.0),
        ("inner", 180.0), ("outer", -180.0), ("inner", -180.0), ("outer", -90.0),
    )
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class PositionError:
    """Errors of the navigation over time, from a start without error."""

    #: time_s, east_m, north_m: Shape (n,); the errors of k navigations (n, k). Each at the end of a step of a
    #: minute or less.
    time_s: FloatArray
    east_m: FloatArray
    north_m: FloatArray

    @property
    def distance_nmi(self) -> FloatArray:
        """Distance from the true position, shape (n,)."""
        return np.hypot(self.east_m, self.north_m) / NAUTICAL_MILE_M

    @property
    def max_nmi(self) -> float:
        """Largest distance from the true position."""
        return float(self.distance_nmi.max())


def rotate_for(
    duration_s: float, scheme: RotationScheme, residual_bias: ResidualBias, site: Site
) -> PositionError:
    """Navigate with gyros that have a residual bias, while the sensors are turned by a scheme.

    The vehicle rests; neither the accelerometers nor the initial navigation have errors.

    ``duration_s``: rounded up to whole steps. ``residual_bias``: called with the time of the middle of each
    step and Up in body axes at that time; see :func:`bias_by_position`. Raises MeasurementError if a residual
    bias is not finite.
    """
    steps_s, attitudes = _steps(duration_s, scheme)
    middle_s = np.cumsum(steps_s) - 0.5 * steps_s
    body_dph = np.asarray(residual_bias(middle_s, attitudes[:, 2]))
    return navigate_with_drift(steps_s, np.einsum("nij,nj->ni", attitudes, body_dph), site)


def rotate_for_each(
    duration_s: float, scheme: RotationScheme, biases_dph: Sequence[Mapping[str, ArrayLike]], site: Site
) -> PositionError:
    """Navigate with each of k residual biases by position, as :func:`rotate_for`; errors (n, k)."""
    steps_s, attitudes = _steps(duration_s, scheme)
    middle_s = np.cumsum(steps_s) - 0.5 * steps_s
    body_dph = [bias_by_position(each)(middle_s, attitudes[:, 2]) for each in biases_dph]
    return navigate_with_drift(steps_s, attitudes @ np.stack(body_dph, axis=2), site)


@lru_cache(maxsize=8)
def _steps(duration_s: float, scheme: RotationScheme) -> tuple[FloatArray, FloatArray]:
    """Lengths (n,), s, and attitudes (n, 3, 3) of the steps of a duration, rounded up to whole steps."""
    steps_s, attitudes = _cycle(scheme)
    cycles = int(np.ceil(duration_s / steps_s.sum()))
    steps_s, attitudes = np.tile(steps_s, cycles), np.tile(attitudes, (cycles, 1, 1))
    count = int(np.searchsorted(np.cumsum(steps_s), duration_s - 1e-6)) + 1
    for each in (steps_s, attitudes):  # all navigations of this time share them
        each.setflags(write=False)
    return steps_s[:count], attitudes[:count]


def navigate_with_drift(steps_s: FloatArray, drift_enu_dph: FloatArray, site: Site) -> PositionError:
    """Navigate at rest with gyro drifts in the navigation frame, each constant over a step.

    ``steps_s`` (n,): lengths of the steps. ``drift_enu_dph`` (n, 3): drift East, North and Up, or (n, 3, k)
    for k navigations. Raises MeasurementError if a drift is not finite.
    """
    if not np.isfinite(drift_enu_dph).all():
        raise MeasurementError("rotational INS: the residual bias must be finite at all times")
    lengths_s, duration_index = np.unique(steps_s, return_inverse=True)
    intervals = integrate(site, lengths_s, 0.0, 0.0)
    inputs = np.zeros((len(steps_s), INPUTS, *drift_enu_dph.shape[2:]))
    inputs[:, :3] = DPH_TO_RADPS * drift_enu_dph
    forced = np.einsum("nij,nj...->ni...", intervals.response[duration_index], inputs)
    states = np.concatenate([np.zeros((1, STATES, *drift_enu_dph.shape[2:])), forced])
    _propagate(states.reshape(len(states), STATES, -1), intervals.transition, duration_index)
    velocity_east = states[:, _EAST_VELOCITY]
    mean_velocities_mps = 0.5 * (velocity_east[:-1] + velocity_east[1:])
    meridian_m, _ = curvature_radii(site.latitude, site.height)
    return PositionError(
        time_s=np.cumsum(steps_s),
        east_m=np.cumsum((steps_s * mean_velocities_mps.T).T, axis=0),
        north_m=meridian_m * states[1:, _LATITUDE],
    )


@compiled
def _propagate(states: FloatArray, transitions: FloatArray, durations: NDArray[np.int64]) -> None:
    """Add to each of the states (n + 1, 6, k) the one before times its transition, of (m, 6, 6)."""
    _, size, navigations = states.shape
    for step in range(len(durations)):
        transition, before, after = transitions[durations[step]], states[step], states[step + 1]
        for row in range(size):
            for column in range(size):
                factor = transition[row, column]
                for each in range(navigations):
                    after[row, each] += factor * before[column, each]


def bias_by_position(biases_dph: Mapping[str, ArrayLike]) -> ResidualBias:
    """Residual bias that depends only on the position.

    Between positions the biases are weighted by the squares of the direction cosines of Up, which add up to
    one.

    ``biases_dph``: bias of the gyros, body axes, by the names of
    :data:`gyrobench.bench.navigation.positions.POSITIONS`. If a position is missing, the scheme must not pass
    through it. Raises MeasurementError if a name is not that of a position.
    """
    unknown = biases_dph.keys() - POSITIONS.keys()
    if unknown:
        raise MeasurementError(
            f"no such position: {', '.join(sorted(unknown))}; there are {', '.join(POSITIONS)}"
        )
    missing = np.full(3, np.nan)
    up, down = (
        np.array([biases_dph.get(f"{axis}_{end}", missing) for axis in AXES], dtype=np.float64)
        for end in ("up", "down")
    )

    def residual_bias(_: FloatArray, up_body: FloatArray) -> FloatArray:
        weights = np.where(np.abs(up_body) > _MIN_COSINE, up_body**2, 0.0)[:, :, np.newaxis]
        parts = np.where(up_body[:, :, np.newaxis] > 0.0, up, down)
        return np.asarray(np.sum(weights * np.where(weights > 0.0, parts, 0.0), axis=1))

    return residual_bias


@lru_cache(maxsize=8)
def _cycle(scheme: RotationScheme) -> tuple[FloatArray, FloatArray]:
    """Lengths (n,), s, of the steps of one cycle, and the attitude (n, 3, 3) in the middle of each step."""
    dwell_steps = int(np.ceil(scheme.dwell_s / _DWELL_STEP_S))
    angles, lengths = [], []
    for start, end in itertools.pairwise(scheme.angles_deg()):
        turn_s = float(np.abs(np.subtract(end, start)).sum()) / scheme.rate_dps
        shares = (np.arange(_TURN_STEPS) + 0.5) / _TURN_STEPS
        angles += [start] * dwell_steps
        angles += [tuple(np.add(start, share * np.subtract(end, start))) for share in shares]
        lengths += [scheme.dwell_s / dwell_steps] * dwell_steps + [turn_s / _TURN_STEPS] * _TURN_STEPS
    steps_s, attitudes = np.array(lengths), np.stack([GIMBALS.attitude(*each) for each in angles])
    for each in (steps_s, attitudes):  # all navigations by this scheme share them
        each.setflags(write=False)
    return steps_s, attitudes
