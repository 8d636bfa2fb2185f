"""Dwell tables of a small simulated bench: chamber, unit, three gyros, and any undeclared effect.

Everything is computed on a fine grid of time and averaged over each dwell as a measurement is. Nothing
here comes from the search that is tried on it.
"""

import itertools
import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.navigation.positions import POSITIONS

STEP_S = 60.0
SIGMA_DPH = 0.002
#: Of the effects: hours and degC.
WARM_UP_H, LAG_H, SINUSOID_H, SQUARE_WAVE_C = 2.0, 1.5, 3.1, 10.7
NEIGHBOUR_LAG_H = 0.4
HALF_WIDTH_C, ONSET_C, ONSET_WIDTH_C, COLD_C = 5.0, 45.0, 3.0, 5.0

#: Set points of a cycle: temperature, ramp rate in K/min, hours of hold. It begins and ends at 20 degC.
PROFILE = ((-20.0, 1.0, 4.0), (20.0, 0.4, 3.0), (60.0, 1.0, 4.0), (20.0, 0.4, 3.0))
#: Up in body axes.
UP = {
    "z_up": (0, 0, 1), "z_down": (0, 0, -1), "y_up": (0, 1, 0),
    "y_down": (0, -1, 0), "x_up": (1, 0, 0), "x_down": (-1, 0, 0),
}  # fmt: skip
#: How much of an effect each gyro shows; the z gyro the least.
SHARES = np.array([1.0, -0.9, 0.8])
#: deg/h at the powers of a gyro's temperature over 50 degC; a row for each gyro.
CUBIC_DPH = np.array([[0.03, -0.02, 0.008], [-0.02, 0.025, -0.01], [0.015, 0.01, 0.012]])
CONSTANT_DPH = np.array([0.01, -0.02, 0.015])
RUN_SPREAD_DPH = 0.006
#: Of the electronics, over their heat capacity.
POWER_C_PER_H = 14.0
#: Ageing, and the direction of the Earth's magnetic field below the horizon.
AGEING_H, INCLINATION_DEG = 30.0, 60.0


@dataclass(frozen=True)
class Course:
    """What happens on the fine grid: m instants; temperatures of the gyros have shape (m, 3)."""

    time_h: np.ndarray
    since_power_on_h: np.ndarray
    run: np.ndarray
    cycle: np.ndarray
    up: np.ndarray
    set_c: np.ndarray
    air_c: np.ndarray
    case_c: np.ndarray
    optics_c: np.ndarray
    board_c: np.ndarray
    supply_w: np.ndarray
    room_c: np.ndarray
    neighbours_on: np.ndarray
    #: Unit vector of the Earth's magnetic field in body axes, (m, 3).
    field: np.ndarray


@dataclass(frozen=True)
class Measured:
    """A campaign: the table, and without noise the biases and their undeclared part, shape (n, 3)."""

    rows: list[DwellRow]
    bias_dph: np.ndarray
    undeclared_dph: np.ndarray
    course: Course


def set_points(profile, start_c=20.0):
    """Set point of one cycle at the middle of each step."""
    parts = []
    for to_c, rate_c_per_min, hold_h in profile:
        count = round(abs(to_c - start_c) / rate_c_per_min * 60.0 / STEP_S)
        parts.append(start_c + (to_c - start_c) * (np.arange(count) + 0.5) / max(count, 1))
        parts.append(np.full(round(hold_h * 3600.0 / STEP_S), to_c))
        start_c = to_c
    return np.concatenate(parts)


def temperatures(set_c, up, power_c_per_h, attitude_convection):
    """Air, case, optics and boards: first-order control, and a network of lumps with heat from the boards.

    Below the onset, what the boards give to the optics depends on gravity by ``attitude_convection``.
    """
    step_h = STEP_S / 3600.0
    lags_h = (1.0, 1.04, 0.97)
    air, case, optics, board = 20.0, 22.0, [26.0] * 3, [33.0] * 3
    courses = []
    # Floats: for three gyros an array takes ten times as long.
    for now_c, ups, power in zip(set_c.tolist(), up.tolist(), power_c_per_h.tolist(), strict=True):
        courses.append((air, case, *optics, *board))
        case_before, mean_board = case, sum(board) / 3.0
        air += step_h * (now_c - air) / 0.1
        case += step_h * ((air - case) / 0.7 + 0.1 * (mean_board - case))
        for gyro, (along, lag_h) in enumerate(zip(ups, lags_h, strict=True)):
            optics_c, board_c = optics[gyro], board[gyro]
            below = 1.0 / (1.0 + math.exp((optics_c - ONSET_C) / ONSET_WIDTH_C))
            into_optics = (board_c - optics_c) * (1.0 + attitude_convection * along * below) / (1.5 * lag_h)
            into_case = (case_before - optics_c) / (0.8 * lag_h)
            board[gyro] += step_h * (power + (case - board_c) / 1.0 - 0.7 * into_optics)
            optics[gyro] += step_h * (into_case + into_optics)
    return np.array(courses)


@cache
def course(
    cycles, profile, positions, headings_deg, steps_of_dwell, power_on_each_cycle, power_steps_h,
    attitude_convection,
):  # fmt: skip
    """Simulate a campaign; ``positions`` and ``headings_deg`` have one entry a dwell."""
    one = set_points(profile)
    set_c = np.tile(one, cycles)
    index = np.arange(len(set_c))
    hours = index * STEP_S / 3600.0
    up = np.array([UP[each] for each in positions], dtype=float)
    up = up[np.minimum(index // steps_of_dwell, len(positions) - 1)]
    inclination = np.deg2rad(INCLINATION_DEG)
    north = np.array(
        [
            POSITIONS[name].C_nb(np.deg2rad(heading))[1]
            for name, heading in zip(positions, headings_deg, strict=True)
        ]
    )
    north = north[np.minimum(index // steps_of_dwell, len(positions) - 1)]
    cycle = index // len(one)
    run = cycle if power_on_each_cycle else np.zeros_like(cycle)
    power = np.full(len(index), POWER_C_PER_H)
    if power_steps_h is not None:
        power *= np.where(np.floor(hours / power_steps_h) % 2.0 == 0.0, 1.0, 0.6)
    states = temperatures(set_c, up, power, attitude_convection)
    return Course(
        time_h=hours,
        since_power_on_h=hours - run * len(one) * STEP_S / 3600.0,
        run=run,
        cycle=cycle,
        up=up,
        set_c=set_c,
        air_c=states[:, 0],
        case_c=states[:, 1],
        optics_c=states[:, 2:5],
        board_c=states[:, 5:8],
        supply_w=40.0 + 3.0 * np.sign(np.sin(hours / 1.7)) + np.sin(hours / 0.9),
        room_c=21.0 + 1.5 * np.sin(2.0 * np.pi * (hours - 9.0) / 24.0) + 0.3 * np.sin(hours / 2.3),
        neighbours_on=(np.sin(hours / 2.9) > -0.4) + (np.sin(hours / 4.7) > 0.1) * 1.0,
        field=np.cos(inclination) * north - np.sin(inclination) * up,
    )


def _play(temperature_c):
    followed = temperature_c.copy()
    for before, now in itertools.pairwise(followed):
        now[:] = np.clip(before, now - HALF_WIDTH_C, now + HALF_WIDTH_C)
    return followed - temperature_c


def _lag(temperature_c):
    lagged = temperature_c.copy()
    for before, now in itertools.pairwise(lagged):
        now[:] = before + (now - before) * STEP_S / 3600.0 / LAG_H
    return lagged - temperature_c


def _neighbours(c):
    heat = np.zeros_like(c.neighbours_on)
    for at in range(1, len(heat)):
        heat[at] = heat[at - 1] + (c.neighbours_on[at] - heat[at - 1]) * STEP_S / 3600.0 / NEIGHBOUR_LAG_H
    return heat[:, None]


def _cooling(c):
    falling = np.diff(c.set_c, prepend=c.set_c[0]) < 0.0
    return (falling * 1.0 + (c.set_c < COLD_C) * 1.5)[:, None]


def jump(at):
    """A jump at a part of the whole time."""
    return lambda c: (c.time_h >= at * (c.time_h[-1] + STEP_S / 3600.0))[:, None] * 1.0


#: Undeclared effects, (m, 3) or (m, 1) without scale. The last two are not among the candidates.
EFFECTS = {
    "temperature_rate": lambda c: np.gradient(c.optics_c, axis=0),
    "thermal_gradient": lambda c: c.board_c - c.optics_c,
    "attitude_thermal": lambda c: (
        (c.board_c - c.optics_c) * c.up / (1.0 + np.exp((c.optics_c - ONSET_C) / ONSET_WIDTH_C))
    ),
    "thermal_hysteresis": lambda c: _play(c.optics_c),
    "thermal_lag": lambda c: _lag(c.optics_c),
    "warm_up": lambda c: np.exp(-c.since_power_on_h / WARM_UP_H)[:, None],
    "time_drift": lambda c: c.time_h[:, None],
    "g_sensitivity": lambda c: c.up @ np.array([[1.0, 0.3, 0.1], [0.2, 0.9, 0.3], [0.1, 0.2, 1.1]]),
    "thermal_g_sensitivity": lambda c: (
        c.optics_c * (c.up @ np.array([[0.9, 0.2, 0.1], [0.3, 1.1, 0.2], [0.2, 0.1, 1.0]]))
    ),
    "magnetic_sensitivity": lambda c: c.field @ np.array([[0.2, 1.0, 0.4], [0.9, 0.1, 0.3], [0.5, 0.6, 0.8]]),
    "supply_power": lambda c: c.supply_w[:, None],
    "daily_course": lambda c: c.room_c[:, None],
    "neighbouring_unit": _neighbours,
    "ageing": lambda c: np.exp(-c.time_h / AGEING_H)[:, None],
    "chamber_state": _cooling,
    "bias_jump": jump(0.4),
    "sinusoid": lambda c: np.sin(2.0 * np.pi * c.time_h / SINUSOID_H)[:, None],
    "square_wave": lambda c: np.sign(np.sin(2.0 * np.pi * c.optics_c / SQUARE_WAVE_C)),
}


def measure(
    effects=None,
    *,
    seed=0,
    cycles=3,
    profile=PROFILE,
    dwell_s=1800.0,
    pause_s=0.0,
    power_on_each_cycle=False,
    positions=None,
    headings_deg=(0.0,),
    power_steps_h=None,
    attitude_convection=0.0,
    sigma_dph=SIGMA_DPH,
    noise=1.0,
    sensors=("set", "air", "board"),
):
    """Measure one dwell after the other.

    Parameters
    ----------
    effects : mapping
        Undeclared effects, by name or as functions of the course; each with its rms over the dwells,
        without its mean, on the x gyro in times of ``sigma_dph``.
    profile : tuple of tuple of float
        As :data:`PROFILE`.
    positions : sequence of str, optional
        Position of each dwell, again from the first after the last; all six in an order that changes if
        not given.
    headings_deg : sequence of float
        Azimuth of each dwell, again from the first after the last.
    power_steps_h : float, optional
        Hours after which the electronics' power goes to 60 % and back.
    noise : float
        True noise over the stated ``sigma_dph``.
    sensors : sequence of str
        What is measured beside the optics: of "set", "air", "case", "board", "supply", "room" and
        "neighbours".
    """
    draw = np.random.default_rng(seed)
    period, steps = round((dwell_s + pause_s) / STEP_S), round(dwell_s / STEP_S)
    dwells = cycles * len(set_points(profile)) // period
    if positions is None:
        shuffled = np.random.default_rng(6)
        positions = np.concatenate([shuffled.permutation(list(UP)) for _ in range(dwells // 6 + 1)])
    names = tuple(str(positions[each % len(positions)]) for each in range(dwells))
    headings = tuple(headings_deg[each % len(headings_deg)] for each in range(dwells))
    c = course(
        cycles, profile, names, headings, period, power_on_each_cycle, power_steps_h, attitude_convection
    )
    starts = period * np.arange(dwells)

    def over_dwells(values):
        return values[: dwells * period].reshape(dwells, period, *values.shape[1:])[:, :steps].mean(axis=1)

    undeclared_dph = np.zeros((dwells, 3))
    for effect, size in (effects or {}).items():
        shape = over_dwells((EFFECTS[effect] if isinstance(effect, str) else effect)(c))
        undeclared_dph += size * sigma_dph * SHARES * shape / np.std(shape[:, 0])
    of_run = CONSTANT_DPH + RUN_SPREAD_DPH * draw.standard_normal((cycles, 3))
    powers = np.stack([(c.optics_c / 50.0) ** degree for degree in (1, 2, 3)], axis=2)
    declared_dph = np.einsum("mgk,gk->mg", powers, CUBIC_DPH) + of_run[c.run]
    bias_dph = over_dwells(declared_dph) + undeclared_dph
    measured_dph = bias_dph + noise * sigma_dph * draw.standard_normal(bias_dph.shape)
    inside_h = (np.arange(steps) - 0.5 * (steps - 1)) * STEP_S / 3600.0
    rates = [inside_h @ c.optics_c[first : first + steps] / (inside_h @ inside_h) for first in starts]

    def sensor(values, sigma_c, measured=True):
        means = over_dwells(values)
        means += sigma_c * draw.standard_normal(means.shape)
        return (means if measured else np.full_like(means, np.nan)).tolist()

    set_c = sensor(c.set_c, 0.0, "set" in sensors)
    air_c = sensor(c.air_c, 0.02, "air" in sensors)
    case_c = sensor(c.case_c, 0.005, "case" in sensors)
    gyro_c = sensor(c.optics_c, 0.002)
    board_c = sensor(c.board_c, 0.005, "board" in sensors)
    other = {"supply_w": ("supply", c.supply_w), "room_c": ("room", c.room_c)}
    other["neighbours_on"] = "neighbours", c.neighbours_on
    other = {name: over_dwells(values).tolist() for name, (kind, values) in other.items() if kind in sensors}
    rows = [
        DwellRow(
            unit="T1",
            run=f"R{c.run[first] + 1}",
            dwell=each + 1,
            cycle=int(c.cycle[first]) + 1,
            position=names[each],
            start_s=first * STEP_S,
            end_s=(first + steps) * STEP_S,
            since_power_on_s=float(c.since_power_on_h[first] * 3600.0),
            gyro_c=tuple(gyro_c[each]),
            gyro_rate_c_per_h=tuple(rates[each].tolist()),
            bias_dph=tuple(measured_dph[each].tolist()),
            sigma_dph=(sigma_dph,) * 3,
            chamber_set_c=set_c[each],
            chamber_c=air_c[each],
            case_c=case_c[each],
            board_c=tuple(board_c[each]),
            azimuth_deg=headings[each],
            other=tuple((name, values[each]) for name, values in other.items()),
        )
        for each, first in enumerate(starts.tolist())
    ]
    return Measured(rows, bias_dph, undeclared_dph, c)
