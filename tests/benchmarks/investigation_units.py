"""Simulated units with known undeclared effects that measure blocks: a bench for `gyrobench investigate`.

The physics are those of :mod:`tests.benchmarks.closure_units`: a thermal network with more nodes than the
search's, and effects of other laws than the candidates. The whole course is simulated again from the start
for each block, so that a unit behaves the same however its blocks are cut.
"""

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.investigation.external_bench import AfterLastDwell
from gyrobench.bench.navigation.positions import POSITIONS
from tests.benchmarks.closure_courses import (
    DESIGNS,
    STEP_H,
    STEP_S,
    UP,
    Course,
    Schedule,
    lagged,
    temperatures,
)
from tests.benchmarks.closure_laws import EFFECTS
from tests.benchmarks.closure_units import MAX_TAKEN_UP, beside_declared

_MAX_STEPS = 40_000


class SimulatedUnit(AfterLastDwell):
    """A unit with the effects ``kinds`` of ``sizes``: rms beside the declared model in units of the noise.

    Attributes
    ----------
    rows : list of DwellRow
        The first campaign.
    """

    def __init__(self, seed, kinds, sizes, cycles=3):
        self._begin(seed, kinds, sizes)
        draw = self._draw(16)
        design = str(draw.choice(DESIGNS))
        schedule = Schedule(draw, design, cycles)
        first, steps, *_ = schedule.dwells[-1]
        count = first + steps
        self._set_c, self._position = schedule.set_c[:count], schedule.position[:count]
        self._power = np.array(schedule.is_on[:count], dtype=float).tolist()
        self._power_on = list(schedule.power_on)
        self._azimuth_deg = [0.0] * count
        for number, (start, length, cycle, name) in enumerate(schedule.dwells, start=1):
            run = int(np.searchsorted(self._power_on, start, side="right"))
            azimuth_deg = float(self._draw(20, number).choice(schedule.headings))
            self._position[start:] = [name] * (count - start)
            self._azimuth_deg[start:] = [azimuth_deg] * (count - start)
            self._dwells.append((number, start, length, cycle + 1, name, f"R-{run}", azimuth_deg))
        if "supply_power" in self.kinds or draw.random() < 0.2:
            for at in draw.uniform(0.0, count, 9).astype(int):
                factor = draw.uniform(0.55, 1.3)
                self._power[at:] = [factor if each else 0.0 for each in self._power[at:]]
        self._first_steps = count
        self._sigma_dph = draw.uniform(0.0008, 0.0025) * draw.uniform(0.9, 1.1, 3)
        self._typical_steps = self._dwells[0][2]
        self.rows = self._measured(0)

    @classmethod
    def measured_by(cls, seed, kinds, sizes, plan):
        """A unit whose first campaign are the steps of a plan, the first of which switches it on."""
        unit = cls.__new__(cls)
        unit._begin(seed, kinds, sizes)
        draw = unit._draw(32)
        unit._sigma_dph = draw.uniform(0.0008, 0.0025) * draw.uniform(0.9, 1.1, 3)
        if "supply_power" in unit.kinds:
            for at in draw.uniform(0.0, plan.steps[-1].end_s / STEP_S, 9).astype(int):
                unit._supply[at:] = draw.uniform(0.55, 1.3)
        unit.rows = unit.measure(plan)
        unit._first_steps = len(unit._set_c)
        return unit

    def beginning_with(self, plan):
        """The same unit, and its first campaign the steps of another plan."""
        unit = type(self).__new__(type(self))
        unit._begin(self.seed, self.kinds, self._sizes)
        unit._sigma_dph, unit._supply = self._sigma_dph, self._supply
        unit._factors, unit._reference = self._factors, self._course()
        unit._first_steps = self._first_steps
        unit.rows = unit.measure(plan)
        return unit

    def _begin(self, seed, kinds, sizes):
        self.seed, self.kinds = seed, tuple(kinds)
        self._sizes = np.broadcast_to(np.asarray(sizes, dtype=float), (len(self.kinds),))
        self._set_c, self._position, self._power, self._azimuth_deg = [], [], [], []
        self._power_on, self._dwells = [], []
        self._supply, self._typical_steps = np.ones(_MAX_STEPS), 20
        self._first_steps, self._factors, self._reference = 0, None, None

    def measure(self, plan, folder=None):
        """Measure a block: the bench of an investigation."""
        first = len(self._dwells)
        for step in plan.steps:
            end = round(step.end_s / STEP_S)
            more, courses = end - len(self._set_c), {}
            for name, at_rest in {
                "set_c": 22.0,
                "power": 0.0,
                "position": "z_up",
                "azimuth_deg": 0.0,
            }.items():
                before = getattr(self, f"_{name}")
                courses[name] = np.full(more, before[-1] if before else at_rest)
            if step.kind == "power":
                if step.on and (not self._power or self._power[-1] == 0.0):
                    self._power_on.append(len(self._set_c))
                courses["power"][:] = (step.factor or 1.0) if step.on else 0.0
            elif step.kind == "chamber":
                at_c = self._set_c[-1] if self._set_c else 22.0
                courses["set_c"] = np.linspace(at_c, step.to_c, more + 1)[1:]
            elif step.kind == "dwell":
                courses["position"] = [step.position] * more
                courses["azimuth_deg"] = [step.azimuth_deg] * more
                start = len(self._set_c)
                self._dwells.append(
                    (step.dwell, start, more, step.cycle, step.position, step.run, step.azimuth_deg)
                )
            for name, values in courses.items():
                getattr(self, f"_{name}").extend(np.asarray(values).tolist())
        return self._measured(first)

    def _draw(self, *key):
        return np.random.default_rng([self.seed, *key])

    def _course(self):
        count, draw = len(self._set_c), self._draw(22)
        time_h = STEP_H * (np.arange(count) + 0.5)
        on = np.array(self._power_on)
        weather = np.cumsum(draw.standard_normal(_MAX_STEPS // 240))[np.arange(count) // 240]
        day = 2.0 * np.pi * (time_h / 24.0 + draw.random())
        room_c = 22.0 + draw.uniform(0.5, 2.0) * (np.sin(day) + 0.2 * np.sin(2.0 * day + 1.0))
        turns = list(zip(self._position, self._azimuth_deg, strict=True))
        north = {each: POSITIONS[each[0]].C_nb(np.radians(each[1]))[1] for each in set(turns)}
        course = Course(
            time_h=time_h,
            since_h=time_h - STEP_H * on[np.searchsorted(on, np.arange(count), side="right") - 1],
            set_c=np.array(self._set_c),
            room_c=room_c + 0.15 * lagged(weather[:, None], 3.0)[:, 0],
            up=np.array([UP[name] for name in self._position], dtype=float),
            azimuth_deg=np.array(self._azimuth_deg),
            north=np.array([north[each] for each in turns]),
            power=np.array(self._power) * self._supply[:count],
            laws_steps=self._first_steps,
            reference=self._reference,
        )
        return temperatures(self._draw(23), course, "attitude_thermal" in self.kinds)

    def _measured(self, first):
        course, chosen = self._course(), self._dwells[first:]
        starts, lengths = (np.array([each[place] for each in chosen]) for place in (1, 2))

        def over(values):
            sums = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
            return (sums[starts + lengths] - sums[starts]) / lengths.reshape(-1, *[1] * (values.ndim - 1))

        powers = np.stack([(course.optics_c / 50.0) ** degree for degree in (1, 2, 3)], axis=2)
        shapes = []
        for place, kind in enumerate(self.kinds):
            law = EFFECTS[kind](course, self._draw(18, place), False)
            shapes.append(np.einsum("ngk,gk->ng", over(law.terms), law.gains))
        runs = np.array([int(each[5].rsplit("-", 1)[1]) for each in chosen])
        if self._factors is None:
            searched = np.array([each[3] for each in chosen]) < max(each[3] for each in chosen)
            beside = beside_declared(over(powers), runs - 1, searched)
            noise_dph = float(np.sqrt(np.mean(self._sigma_dph**2)))
            self._factors = [
                size
                * noise_dph
                / max(
                    np.sqrt(np.mean(beside(shape) ** 2)), (1.0 - MAX_TAKEN_UP) * shape[searched].std(), 1e-12
                )
                for size, shape in zip(self._sizes, shapes, strict=True)
            ]
        of_run = [self._draw(24, run).normal(0.0, 1.0, 3) for run in runs.tolist()]
        spread_dph, coefficients = (
            self._draw(25).uniform(0.002, 0.008),
            self._draw(26).normal(0.0, 1.0, (3, 3)),
        )
        bias_dph = np.einsum("mgk,gk->mg", over(powers), coefficients * [0.02, 0.015, 0.008])
        bias_dph += spread_dph * np.array(of_run)
        bias_dph += sum(factor * shape for factor, shape in zip(self._factors, shapes, strict=True))
        sensors = self._draw(27)
        noise_c, off_c = sensors.uniform(0.002, 0.02), sensors.normal(0.0, [[0.2], [0.3]], (2, 3))
        means = {
            "gyro_c": over(course.optics_c) + off_c[0], "board_c": over(course.board_c) + off_c[1],
            "case_c": over(course.case_c), "chamber_c": over(course.air_c),
            "chamber_set_c": over(course.set_c), "supply_w": 30.0 * over(course.power),
            "room_c": over(course.room_c),
        }  # fmt: skip
        rows = []
        for index, (number, start, length, cycle, position, run, azimuth_deg) in enumerate(chosen):
            noise = self._draw(28, number)
            sigma_dph = self._sigma_dph * np.sqrt(self._typical_steps / length)
            hours = (np.arange(length) - 0.5 * (length - 1)) * STEP_H
            rate = hours @ course.optics_c[start : start + length] / (hours @ hours)
            read = {
                name: values[index]
                + noise_c * (name != "chamber_set_c") * noise.standard_normal(values.shape[1:])
                for name, values in means.items()
            }
            other = [(name, float(read.pop(name))) for name in ("supply_w", "room_c")]
            rows.append(
                DwellRow(
                    unit=f"S{self.seed}", run=run, dwell=number, cycle=cycle, position=position,
                    start_s=start * STEP_S, end_s=(start + length) * STEP_S, azimuth_deg=azimuth_deg,
                    since_power_on_s=float((course.since_h[start] - 0.5 * STEP_H) * 3600.0),
                    bias_dph=_values(bias_dph[index] + sigma_dph * noise.standard_normal(3)),
                    sigma_dph=_values(sigma_dph),
                    gyro_rate_c_per_h=_values(rate + 3.0 * noise_c * noise.standard_normal(3)),
                    other=tuple(other),
                    **{name: _values(values) for name, values in read.items()},
                )
            )  # fmt: skip
        return rows


def _values(values):
    return tuple(values.tolist()) if np.ndim(values) else float(values)
