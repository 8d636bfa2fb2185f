"""Dwells for an estimator, from the strapdown INS of the emulated bench."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gyrobench.bench.bias.dwell import Dwell, NavigationWindow, TurnPath
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.navigation.attitude import euler_rpy321
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.navigation.table_axes import TwoAxisTable
from tests.bench.bias.simulated_dwell import DwellScenario, Rest, Sensors, Table, simulate_dwell
from tests.bench.navigation.euler_sequences import euler_pry231

DPH = np.pi / 180.0 / 3600.0
UG = 9.80665e-6
LATITUDE_DEG = 36.4
EAST, UP = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])

#: Nothing acts but biases and noise.
CLEAN = PriorKnowledge.from_datasheet(
    1000.0,
    *(0.0,) * 5,
    accelerometer_drift_ug_per_h=0.0,
    accelerometer_transient_ug=0.0,
    accelerometer_slope_ug_per_c=0.0,
)
_TURN_ATTITUDES = 19


def noise_model(arw_deg_per_sqrt_h: float = 0.001, vrw_ug_per_sqrt_hz: float = 5.0) -> NoiseModel:
    """The noise of the benchmark: velocity of 1 mm/s and heading of 2 urad at each epoch."""
    return NoiseModel(arw_deg_per_sqrt_h * np.pi / 180.0 / 60.0, vrw_ug_per_sqrt_hz * UG, 1e-3, 2e-6)


def site(latitude_deg: float = LATITUDE_DEG) -> Site:
    return Site(np.radians(latitude_deg))


def sensors(
    bias_dph: Any = (0.0, 0.0, 0.0), accelerometer_ug: Any = (0.0, 0.0, 0.0), noise: NoiseModel | None = None,
    **errors: Any,
) -> Sensors:  # fmt: skip
    """Sensors with biases, the random walks of a noise model, and other errors of :class:`Sensors`."""
    if noise is not None:
        errors["angle_random_walk"] = noise.angle_random_walk
        errors["velocity_random_walk"] = noise.velocity_random_walk
    return Sensors(np.asarray(bias_dph) * DPH, np.asarray(accelerometer_ug) * UG, **errors)


def emulate(
    position: str = "z_up",
    ins: Sensors | None = None,
    *,
    noise: NoiseModel | None = None,
    random: np.random.Generator | None = None,
    stops_deg: tuple[float, ...] = (0.0, 180.0),
    outer_level: bool = False,
    gyro_c: Callable[[FloatArray], FloatArray] | None = None,
    lsb: tuple[float, float] = (0.0, 0.0),
    latitude_deg: float = LATITUDE_DEG,
    latitude_error_arcmin: float = 0.0,
    **scenario: Any,
) -> Dwell:
    """One dwell of the simulated INS, with a window at each azimuth of ``stops_deg``.

    The white parts of ``noise`` are added to the output; the random walks are those of ``ins``. With
    ``outer_level`` the table is as the emulated station's, on which a turn of level Z moves both axes;
    otherwise the outer axis is vertical. ``gyro_c``: time (n,) to the temperature of each gyro (n, 3); the
    accelerometers have the mean. ``lsb``: resolution of the velocity output, m/s, and of the Euler angles,
    deg. ``scenario``: other fields of :class:`DwellScenario`.
    """
    table, stops = _table(position, stops_deg, outer_level)
    latitude = np.radians(latitude_deg)
    error = np.radians(latitude_error_arcmin / 60.0)
    place = DwellScenario(table, stops, latitude, latitude_error=error, **scenario)
    rests = simulate_dwell(place, ins or Sensors(), random)
    return Dwell(
        position,
        np.radians(stops_deg[0]),
        tuple(_window(position, rest, noise, random, gyro_c, lsb) for rest in rests),
        tuple(table.attitude(*stop) for stop in stops),
        tuple(
            TurnPath.at_constant_rate(
                before.time_s[-1], after.time_s[0] - place.settle_s, _path(table, start, end)
            )
            for (before, after), (start, end) in zip(pairwise(rests), pairwise(stops), strict=True)
        ),
    )


def _table(
    position: str, stops_deg: tuple[float, ...], outer_level: bool
) -> tuple[Table, list[tuple[float, float]]]:
    C_nb = POSITIONS[position].C_nb()
    if not outer_level:
        return Table(UP, EAST, C_nb), [(np.radians(stop), 0.0) for stop in stops_deg]
    angles = [TwoAxisTable(EAST, UP, np.eye(3)).angles(POSITIONS[position].C_nb(np.radians(stops_deg[0])))]
    for turn_deg in np.diff(stops_deg):
        angles.append(TwoAxisTable(EAST, UP, np.eye(3)).turn(angles[-1], float(turn_deg)))
    return Table(EAST, UP, np.eye(3)), [(np.radians(outer), np.radians(inner)) for outer, inner in angles]


def _path(table: Table, start: tuple[float, float], end: tuple[float, float]) -> FloatArray:
    return np.array(
        [
            table.attitude(*(a + (b - a) * share for a, b in zip(start, end, strict=True)))
            for share in np.linspace(0.0, 1.0, _TURN_ATTITUDES)
        ]
    )


def _window(
    position: str,
    rest: Rest,
    noise: NoiseModel | None,
    random: np.random.Generator | None,
    gyro_c: Callable[[FloatArray], FloatArray] | None,
    lsb: tuple[float, float],
) -> NavigationWindow:
    velocity = np.column_stack([rest.velocity_en_mps, np.zeros(len(rest.time_s))])
    attitude = rest.C_nb
    if noise is not None and random is not None:
        velocity[:, :2] += noise.velocity_white * random.standard_normal((len(velocity), 2))
        attitude = turned_about_up(attitude, noise.heading_white * random.standard_normal(len(velocity)))
    if lsb[0] > 0.0:
        velocity = np.rint(velocity / lsb[0]) * lsb[0]
    if lsb[1] > 0.0:
        attitude = _rounded(attitude, np.radians(lsb[1]), position.startswith("y"))
    if gyro_c is None:
        return NavigationWindow(rest.time_s, velocity, attitude)
    temperatures_c = gyro_c(rest.time_s)
    return NavigationWindow(rest.time_s, velocity, attitude, temperatures_c, temperatures_c.mean(axis=1))


def turned_about_up(C_nb: FloatArray, angle: FloatArray) -> FloatArray:
    """Attitudes (n, 3, 3) turned about Up by angles (n,)."""
    return np.asarray(Rotation.from_rotvec(np.multiply.outer(angle, UP)).as_matrix() @ C_nb)


def _rounded(C_nb: FloatArray, lsb: float, pitch_first: bool) -> FloatArray:
    """Attitudes after rounding of the Euler angles that are regular there."""
    roll, pitch, yaw = (np.rint((euler_pry231 if pitch_first else euler_rpy321)(C_nb) / lsb) * lsb).T
    if pitch_first:
        turn = Rotation.from_euler("ZYX", np.column_stack([yaw, roll, pitch]))
    else:
        turn = Rotation.from_euler("ZXY", np.column_stack([yaw, pitch, roll]))
    return np.asarray(turn.as_matrix())
