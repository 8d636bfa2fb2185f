"""Course of a simulated campaign: schedule, chamber with its controller, and the temperatures of a unit."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from gyrobench.bench.foundations.kernels import compiled
from gyrobench.bench.navigation.positions import POSITIONS

STEP_S, STEP_H = 60.0, 1.0 / 60.0
#: Up in body axes.
UP = {
    "z_up": (0, 0, 1), "z_down": (0, 0, -1), "y_up": (0, 1, 0),
    "y_down": (0, -1, 0), "x_up": (1, 0, 0), "x_down": (-1, 0, 0),
}  # fmt: skip
DESIGNS = ("plateaus", "continuous", "shuffled", "power cycles", "several rates", "headings")


@dataclass(frozen=True)
class Course:
    """m instants of a campaign; gyros have shape (m, 3)."""

    time_h: np.ndarray
    since_h: np.ndarray
    set_c: np.ndarray
    room_c: np.ndarray
    up: np.ndarray
    azimuth_deg: np.ndarray
    north: np.ndarray  #: North in body axes.
    power: np.ndarray  #: Of the electronics, over its usual value.
    air_c: np.ndarray = field(default_factory=lambda: np.empty(0))
    case_c: np.ndarray = field(default_factory=lambda: np.empty(0))
    optics_c: np.ndarray = field(default_factory=lambda: np.empty(0))
    board_c: np.ndarray = field(default_factory=lambda: np.empty(0))
    cooling: np.ndarray = field(default_factory=lambda: np.empty(0))  #: Demand of the chamber, K/h.
    laws_steps: int = 0  #: Steps whose length and spread laws depend on; 0 for all. More may follow.
    reference: "Course | None" = None  #: Course that laws depend on; None for this one.

    @property
    def length_h(self) -> float:
        """Time of the steps that laws depend on."""
        return float(self.of_laws(lambda course: course.time_h)[-1])

    def of_laws(self, values) -> np.ndarray:
        """Values, a function of a course, in these steps."""
        found = values(self.reference or self)
        return found[: self.laws_steps or len(found)]


class Schedule:
    """Steps of a campaign, one a minute, and its dwells."""

    def __init__(self, draw: np.random.Generator, design: str, cycles: int) -> None:
        self.set_c, self.position, self.azimuth_deg, self.is_on, self.power_on = [], [], [], [], []
        self.dwells: list[tuple[int, int, int, str]] = []  # first step, steps, cycle, position
        self._draw, self._design = draw, design
        self._now_c, self._order, self._steps = 22.0, list(UP), int(draw.choice([20, 30]))
        self.headings = (0.0, 90.0, 180.0, 270.0) if design == "headings" else (0.0,)
        again = {"power cycles": int(draw.integers(1, 3)), "headings": 1}.get(design, cycles)
        profile = self._profile()
        for cycle in range(cycles):
            if cycle % again == 0:
                self._power(off_min=int(draw.integers(20, 180)) if cycle else 0)
            self._cycle(cycle, profile)

    def _profile(self) -> list[tuple[float, float, int]]:
        """Set point, K/min and minutes of hold."""
        draw = self._draw
        cold, hot = draw.uniform(-36.0, -15.0), draw.uniform(48.0, 62.0)
        if self._design == "plateaus":
            temperatures = [hot, 20.5, cold, 0.4 * cold, 46.0, 20.5]
            rates, hold = (1.0, 1.0, 1.0, 2.0, 2.0, 1.0), 75
        elif self._design == "several rates":
            temperatures = [10.0, cold, 5.0, -5.0, 40.0, hot, 35.0, 20.0]
            rates, hold = draw.permutation([0.3, 0.5, 1.0, 2.0, 0.3, 0.7, 1.5, 0.4]), 110
        else:
            temperatures = [cold, 20.0, hot, 20.0] if draw.random() < 0.5 else [hot, 20.0, cold, 20.0]
            rates, hold = draw.uniform(0.3, 1.2, 4), int(draw.integers(120, 260))
        return list(zip(temperatures, map(float, rates), [hold] * len(temperatures), strict=True))

    def _power(self, off_min: int) -> None:
        for _ in range(off_min):
            self._step(
                self._now_c + math.copysign(min(1.5, abs(22.0 - self._now_c)), 22.0 - self._now_c), on=False
            )
        self.power_on.append(len(self.set_c))

    def _step(self, set_c: float, on: bool = True) -> None:
        self._now_c = set_c
        self.set_c.append(set_c)
        self.is_on.append(on)
        self.position.append(self.position[-1] if self.position else "z_up")
        self.azimuth_deg.append(self.azimuth_deg[-1] if self.azimuth_deg else 0.0)

    def _cycle(self, cycle: int, profile: list[tuple[float, float, int]]) -> None:
        first = len(self.set_c)
        for stage, (to_c, rate, hold) in enumerate(profile):
            ramp = max(1, round(abs(to_c - self._now_c) / rate))
            for value in np.linspace(self._now_c, to_c, ramp + 1)[1:]:
                self._step(float(value))
            if self._design == "plateaus":
                for _ in range(hold):
                    self._step(to_c)
                for name in self._order if (stage + cycle) % 2 == 0 else self._order[::-1]:
                    self._dwell(len(self.set_c), 20, cycle, name)
                    for _ in range(26):
                        self._step(to_c)
            else:
                for _ in range(hold):
                    self._step(to_c)
        if self._design != "plateaus":
            names: list[str] = []
            fixed = self._design == "continuous" or self._draw.random() < 0.3
            for begin in range(first, len(self.set_c) - self._steps + 1, self._steps):
                names = names or (self._order if fixed else self._draw.permutation(self._order).tolist())[:]
                self._dwell(begin, self._steps, cycle, names.pop(0))

    def _dwell(self, first: int, steps: int, cycle: int, name: str) -> None:
        self.dwells.append((first, steps, cycle, name))

    def course(self, draw: np.random.Generator, with_power_steps: bool) -> Course:
        count = len(self.set_c)
        time_h = STEP_H * (np.arange(count) + 0.5)
        names, azimuth_deg = np.array(["z_up"] * count, dtype="<U6"), np.zeros(count)
        for first, _, _, name in self.dwells:
            names[first:] = name
            azimuth_deg[first:] = draw.choice(self.headings)
        on = np.array(self.power_on)
        since_h = time_h - STEP_H * on[np.searchsorted(on, np.arange(count), side="right") - 1]
        power = np.ones(count)
        if with_power_steps:
            for at in draw.uniform(0.0, count, 9).astype(int):
                power[at:] = draw.uniform(0.55, 1.3)
        is_on = np.array(self.is_on)
        day = 2.0 * np.pi * (time_h / 24.0 + draw.random())
        weather = np.cumsum(draw.standard_normal(count // 240 + 2))[np.arange(count) // 240]
        room_c = 22.0 + draw.uniform(0.5, 2.0) * (np.sin(day) + 0.2 * np.sin(2.0 * day + 1.0))
        room_c += 0.15 * lagged(weather[:, None], 3.0)[:, 0]
        turns = {(name, azimuth) for name in UP for azimuth in self.headings}
        north_of = {each: POSITIONS[each[0]].C_nb(math.radians(each[1]))[1] for each in turns}
        return Course(
            time_h=time_h,
            since_h=since_h,
            set_c=np.array(self.set_c),
            room_c=room_c,
            up=np.array([UP[name] for name in names.tolist()], dtype=float),
            azimuth_deg=azimuth_deg,
            north=np.array(
                [north_of[each] for each in zip(names.tolist(), azimuth_deg.tolist(), strict=True)]
            ),
            power=power * is_on,
        )


def temperatures(draw, course: Course, attitude_convection: bool) -> Course:
    """Course with its temperatures: chamber and controller, case, frame, three gyros of three nodes."""
    unit = draw.uniform(0.75, 1.3, 8)
    gyros = draw.uniform(0.88, 1.14, (3, 6))
    along = draw.normal(0.0, 0.16 if attitude_convection else 0.03, (3, 3))
    states = _run_network(
        course.set_c, course.room_c, course.power, course.up, unit, gyros, along,
        draw.uniform(0.0, 0.3), draw.uniform(30.0, 55.0), draw.uniform(4.0, 12.0),
    )  # fmt: skip
    return replace(
        course,
        air_c=states[:, 0],
        case_c=states[:, 1],
        optics_c=states[:, 2:5],
        board_c=states[:, 5:8],
        cooling=states[:, 8],
    )


@compiled
def _run_network(set_c, room_c, power, up, unit, gyros, along, exponent, onset_c, width_c):
    """Rates in K/h; convection of the boards by a power of the difference, its direction by gravity."""
    out = np.zeros((len(set_c), 9))
    air, wall, case, frame, integral = 22.0, 22.0, 22.0, 22.0, 0.0
    shell, optics, board = np.full(3, 22.0), np.full(3, 22.0), np.full(3, 22.0)
    for now in range(len(set_c)):
        error = set_c[now] - air
        integral = min(max(integral + STEP_H * 20.0 * error, -60.0), 60.0)
        heat = min(max(14.0 * error + integral, -220.0), 220.0)
        out[now, 8] = max(-heat, 0.0)
        for _ in range(3):
            step = STEP_H / 3.0
            d_air = heat + (room_c[now] - air) / (2.5 * unit[0]) + 2.0 * (wall - air) + 0.3 * (case - air)
            d_wall = 1.2 * (air - wall) + 0.05 * (room_c[now] - wall)
            far = air - case
            d_case = 1.1 * unit[1] * far * (abs(far) / 5.0) ** 0.15 + 0.5 * unit[2] * (frame - case)
            d_case += 0.25 * ((wall + 273.15) ** 4 - (case + 273.15) ** 4) / (4.0 * 295.0**3)
            d_frame = 2.2 * unit[3] * (case - frame) + 1.6 * power[now] * unit[4]
            for gyro in range(3):
                ratio = max(optics[gyro] - onset_c, 0.0) / width_c
                share = (
                    along[gyro, 0] * up[now, 0] + along[gyro, 1] * up[now, 1] + along[gyro, 2] * up[now, 2]
                )
                share = max(-0.8, min(0.8, share / (1.0 + ratio * ratio)))
                over = board[gyro] - optics[gyro]
                flow = over * (abs(over) / 7.0 + 1e-6) ** exponent * (1.0 + share)
                d_optics = 0.4 * gyros[gyro, 0] * flow + 3.0 * gyros[gyro, 1] * (shell[gyro] - optics[gyro])
                d_shell = 2.6 * gyros[gyro, 2] * (frame - shell[gyro]) + 0.8 * (optics[gyro] - shell[gyro])
                d_shell += 0.15 * (board[gyro] - shell[gyro])
                d_board = 21.0 * gyros[gyro, 3] * power[now] * (1.0 + 0.0015 * (board[gyro] - 40.0))
                d_board += 0.85 * gyros[gyro, 4] * (case - board[gyro]) - 0.7 * flow
                d_frame += 0.12 * (shell[gyro] - frame)
                optics[gyro] += step * d_optics
                shell[gyro] += step * d_shell
                board[gyro] += step * d_board
            air += step * d_air
            wall += step * d_wall
            case += step * d_case
            frame += step * d_frame
        out[now, 0], out[now, 1] = air, case
        out[now, 2:5], out[now, 5:8] = optics, board
    return out


@compiled
def lagged(values, tau_h):
    """First-order lag of (m, k), at rest before; none for a time constant below a tenth of a minute."""
    out = values.copy()
    if tau_h * 600.0 < 1.0:
        return out
    keep = np.exp(-STEP_H / tau_h)
    for now in range(1, len(values)):
        out[now] = keep * out[now - 1] + (1.0 - keep) * values[now]
    return out
