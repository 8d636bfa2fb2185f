"""Simulated units with known undeclared effects, to calibrate what the search for effects states.

Nothing here comes from the search. The thermal network has more nodes than the search's, other time
constants, convection by a power of the difference, and radiation; the effects have other laws than the
candidates: heat flow by exponent, other onsets, several plays, lags of two poles, two decays after power-on.
Some are on no list. Everything is computed on a grid of minutes and averaged over each dwell.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from tests.benchmarks.closure_courses import DESIGNS, STEP_H, STEP_S, Schedule, lagged, temperatures
from tests.benchmarks.closure_laws import EFFECTS

NOISES = ("stated", "understated", "outliers", "understated, outliers")
#: An effect of which the declared model takes up more than this is scaled as if it took up this much.
MAX_TAKEN_UP = 0.95


@dataclass(frozen=True)
class Part:
    """One undeclared effect of a unit."""

    kind: str
    size: float  #: Rms beside the declared model, in standard deviations of the noise.
    bias_dph: np.ndarray  #: Shape (n, 3).
    #: sizes_dph, values: Where the law is a candidate's own: its sizes, shape (3, k), and parameters.
    sizes_dph: np.ndarray | None = None
    values: tuple[float, ...] = ()


@dataclass(frozen=True)
class Truth:
    """What is true of a unit; n dwells in the order of the rows."""

    seed: int
    design: str
    noise: str
    parts: tuple[Part, ...]
    bias_dph: np.ndarray  #: Shape (n, 3). Without noise.
    sigma_dph: np.ndarray  #: Shape (n, 3). True standard deviation of the noise, without outliers.
    outliers: tuple[int, ...] = ()  #: Numbers of the dwells.

    @property
    def kinds(self) -> frozenset[str]:
        """Effects of the unit."""
        return frozenset(each.kind for each in self.parts)


def make_unit(
    seed: int,
    effects: Sequence[str] = (),
    sizes: Sequence[float] | float = 3.0,
    *,
    design: str | None = None,
    noise: str = "stated",
    cycles: int = 3,
    looks: int = 1,
    candidates_own: bool = False,
) -> tuple[list[DwellRow], Truth]:
    """Simulate one unit: its dwell table, and what is true of it.

    Parameters
    ----------
    effects : sequence of str
        Undeclared effects, of :data:`EFFECTS`.
    sizes : float or sequence of float
        Rms of each in the searched dwells of all gyros beside the declared model, over the noise.
    design : str, optional
        Of :data:`DESIGNS`; drawn from the seed if not given.
    noise : str
        Of :data:`NOISES`.
    looks : int
        The same unit with this multiple of the data: the average of this number of campaigns.
    candidates_own : bool
        Effects that have a candidate follow its own law, so that its sizes and parameters have true values.
    """
    draw = np.random.default_rng([seed, 16])
    drawn_design, draw_noise = str(draw.choice(DESIGNS)), np.random.default_rng([seed, 17, looks])
    design = design or drawn_design
    schedule = Schedule(draw, design, cycles)
    is_logged = any(each.startswith("composed") for each in effects)
    has_steps = is_logged or "supply_power" in effects or draw.random() < 0.2
    course = temperatures(draw, schedule.course(draw, has_steps), "attitude_thermal" in effects)
    firsts, lengths = (np.array([each[place] for each in schedule.dwells]) for place in (0, 1))
    cycle = np.array([each[2] for each in schedule.dwells])
    run = np.searchsorted(schedule.power_on, firsts, side="right") - 1

    def over_dwells(values: np.ndarray) -> np.ndarray:
        sums = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
        shape = (-1, *[1] * (values.ndim - 1))
        return (sums[firsts + lengths] - sums[firsts]) / lengths.reshape(shape)

    count = len(firsts)
    stated_dph = (
        draw.uniform(0.0008, 0.0025) * draw.uniform(0.9, 1.1, 3) * draw.uniform(0.95, 1.05, (count, 3))
    )
    stated_dph /= math.sqrt(looks)
    right, understated = float(np.clip(draw.normal(1.0, 0.04), 0.9, 1.1)), draw.uniform(1.3, 1.4)
    scale = understated if "understated" in noise else right
    coefficients = draw.normal(0.0, 1.0, (3, 3)) * np.array([0.02, 0.015, 0.008])
    of_run = draw.normal(0.0, 0.02, 3) + draw.uniform(0.002, 0.008) * draw.normal(size=(run.max() + 1, 3))
    powers = np.stack([(course.optics_c / 50.0) ** degree for degree in (1, 2, 3)], axis=2)
    bias_dph = over_dwells(np.einsum("mgk,gk->mg", powers, coefficients)) + of_run[run]
    searched = cycle < cycle.max()
    beside = beside_declared(over_dwells(powers), run, searched)
    parts = []
    many = np.broadcast_to(np.asarray(sizes, dtype=float), (len(effects),))
    for place, (kind, size) in enumerate(zip(effects, many.tolist(), strict=True)):
        # One effect does not change when another one is added.
        law = EFFECTS[kind](course, np.random.default_rng([seed, 18, place]), candidates_own)
        terms = over_dwells(law.terms)
        shape = np.einsum("ngk,gk->ng", terms, law.gains)
        whole = np.sqrt(np.mean((shape - shape[searched].mean(axis=0))[searched] ** 2))
        seen = np.sqrt(np.mean(beside(shape) ** 2))
        # In units of one look: the effect is the same however long it is looked at.
        unit = size * math.sqrt(looks) * float(np.sqrt(np.mean(stated_dph**2)))
        factor = unit / max(seen, (1.0 - MAX_TAKEN_UP) * whole, 1e-12)
        own = candidates_own and law.is_candidates_own
        parts.append(
            Part(kind, size, factor * shape, factor * law.gains if own else None, law.values if own else ())
        )
    bias_dph = bias_dph + sum((each.bias_dph for each in parts), np.zeros((count, 3)))
    sigma_dph = scale * stated_dph
    errors_dph = sigma_dph * draw_noise.standard_normal((count, 3))
    bad = np.empty(0, dtype=int)
    if "outliers" in noise:
        bad = np.sort(draw_noise.choice(count, max(1, round(0.02 * count)), replace=False))
        which = draw_noise.random((len(bad), 3)) < 0.5
        which[np.arange(len(bad)), draw_noise.integers(0, 3, len(bad))] = True
        signs = draw_noise.choice([-1.0, 1.0], which.shape)
        errors_dph[bad] += which * signs * draw_noise.uniform(6.0, 15.0, (len(bad), 1)) * stated_dph[bad]
    truth = Truth(seed, design, noise, tuple(parts), bias_dph, sigma_dph, tuple((bad + 1).tolist()))
    logged = {"supply_w": 30.0 * over_dwells(course.power)} if has_steps else {}
    if draw.random() < (0.8 if "daily_course" in effects else 0.2) or is_logged:
        logged["room_c"] = over_dwells(course.room_c)
    logged = {name: each + 0.03 * draw_noise.standard_normal(count) for name, each in logged.items()}
    measured = _Sensors(draw, course, over_dwells, firsts, lengths, 0.0 if candidates_own else 1.0, is_logged)
    return [
        DwellRow(
            unit=f"S{seed}",
            run=f"R{run[each] + 1}",
            dwell=each + 1,
            cycle=int(cycle[each]) + 1,
            position=schedule.dwells[each][3],
            start_s=float(firsts[each]) * STEP_S,
            end_s=float(firsts[each] + lengths[each]) * STEP_S,
            since_power_on_s=float((course.since_h[firsts[each]] - 0.5 * STEP_H) * 3600.0),
            azimuth_deg=float(course.azimuth_deg[firsts[each]]),
            bias_dph=tuple((bias_dph + errors_dph)[each].tolist()),
            sigma_dph=tuple(stated_dph[each].tolist()),
            other=tuple((name, float(values[each])) for name, values in logged.items()),
            **measured.of(each),
        )
        for each in range(count)
    ], truth


def shape_known_error_dph(rows: Sequence[DwellRow], truth: Truth) -> float:
    """Held-out rms error of a fit that is given the course of each effect, against the true bias."""
    cycle = np.array([row.cycle for row in rows])
    run = np.unique([row.run for row in rows], return_inverse=True)[1]
    searched = cycle < cycle.max()
    squares: list[np.ndarray] = []
    for gyro in range(3):
        powers = (np.array([row.gyro_c[gyro] for row in rows])[:, None] / 50.0) ** np.arange(1, 4)
        of_run = (run[:, None] == np.unique(run[searched])) * 1.0
        design = np.column_stack([powers, of_run, *(each.bias_dph[:, gyro] for each in truth.parts)])
        weight = 1.0 / np.array([row.sigma_dph[gyro] for row in rows])[searched]
        keep = ~np.isin(np.arange(1, len(rows) + 1), truth.outliers)[searched]
        measured = np.array([row.bias_dph[gyro] for row in rows])[searched]
        lengths = np.maximum(np.linalg.norm(design[searched], axis=0), 1e-300)
        fitted = np.linalg.lstsq(
            (design[searched] / lengths * weight[:, None])[keep], (measured * weight)[keep], rcond=1e-9
        )[0]
        errors = design @ (fitted / lengths) - truth.bias_dph[:, gyro]
        for unseen in set(run[~searched].tolist()) - set(run[searched].tolist()):
            errors[run == unseen] -= errors[run == unseen].mean()
        squares.append(errors[~searched] ** 2)
    return float(np.sqrt(np.mean(squares)))


def beside_declared(powers, run, searched):
    """What remains of a bias in the dwells searched beside a cubic and a constant per power cycle."""
    of_run = (run[:, None] == np.unique(run[searched])) * 1.0
    bases = [np.linalg.qr(np.column_stack([powers[:, gyro], of_run])[searched])[0] for gyro in range(3)]

    def beside(bias: np.ndarray) -> np.ndarray:
        return np.stack(
            [each - basis @ (basis.T @ each) for basis, each in zip(bases, bias[searched].T, strict=True)],
            axis=1,
        )

    return beside


class _Sensors:
    """Temperatures as measured: each sensor with its offset, lag and noise; some are not there.

    ``errors`` of 0 leaves out offsets and lags; ``has_all``: none is missing.
    """

    def __init__(self, draw, course, over_dwells, firsts, lengths, errors, has_all):
        self._columns = {}
        noise_c = draw.uniform(0.002, 0.02)
        optics_c = lagged(course.optics_c, errors * draw.uniform(0.0, 0.02)) + errors * draw.normal(
            0.0, 0.2, 3
        )
        board_c = lagged(course.board_c, errors * draw.uniform(0.0, 0.02)) + errors * draw.normal(0.0, 0.3, 3)
        inside_h = [(np.arange(length) - 0.5 * (length - 1)) * STEP_H for length in lengths]
        rates = [
            hours @ optics_c[first : first + length] / (hours @ hours)
            for first, length, hours in zip(firsts, lengths, inside_h, strict=True)
        ]
        has = (draw.random(3) < (0.65, 0.85, 0.95)) | has_all
        for name, values, sigma_c, measured in (
            ("gyro_c", over_dwells(optics_c), noise_c, True),
            ("gyro_rate_c_per_h", np.array(rates), 3.0 * noise_c, True),
            ("board_c", over_dwells(board_c), 2.0 * noise_c, has[0]),
            ("case_c", over_dwells(course.case_c), noise_c, has[1]),
            ("chamber_c", over_dwells(course.air_c), 2.0 * noise_c, has[2]),
            ("chamber_set_c", over_dwells(course.set_c), 0.0, has[2]),
        ):
            read = values + sigma_c * draw.standard_normal(values.shape)
            self._columns[name] = read if measured else np.full_like(read, np.nan)

    def of(self, dwell: int) -> dict:
        values = {name: each[dwell].tolist() for name, each in self._columns.items()}
        return {name: tuple(each) if isinstance(each, list) else each for name, each in values.items()}
