"""The grammar of effects: a bias that follows factor x shape(memory(driver)).

The driver is a column of the dwell table or a state of the thermal network, the memory how the past acts,
the shape how the bias follows, the factor the direction of gravity. Built-in effects, those of files
(:mod:`gyrobench.bench.closure.effects.effect_file`) and composed laws
(:mod:`gyrobench.bench.closure.compose`) are made of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import (
    Effect,
    FittedForm,
    Form,
    InsTerms,
    MisalignmentTexts,
    Parameter,
    constant_at_end,
    heat_flow_terms,
    needs_electronics,
    needs_positions,
)
from gyrobench.bench.closure.temperature_record import followed_with_play, lag
from gyrobench.bench.foundations.arrays import S_PER_DAY, S_PER_H, FloatArray
from gyrobench.bench.navigation.positions import AXES

#: Degree of the polynomial in temperature that an INS subtracts in place of a shape.
_INS_DEGREE = 5


@dataclass(frozen=True)
class Law:
    """One law: what the bias follows, up to its sizes."""

    driver: str  #: Key of :data:`DRIVERS`, or a column of the dwell table; ``{axis}`` stands for the gyro's.
    shape: str = "linear"  #: Key of :data:`SHAPES`.
    memory: str = "none"  #: ``none`` or a key of :data:`MEMORIES`.
    factor: str = "none"  #: Key of :data:`_FACTORS`.
    degree: int = 1  #: Of a polynomial.
    parameters: tuple[Parameter, ...] = ()  #: Of the shape, then of the memory.

    def columns(self, campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
        """Terms (n, 3, k) in all dwells at values of the parameters."""
        count = len(SHAPES[self.shape].parameters)
        shaped = partial(self._shaped, values=values[:count])
        if self.memory == "none" and (self.shape == "linear" or self.driver == "constant"):
            terms = shaped(driver_values(self.driver, campaign))
        elif self.memory == "none":
            terms = self._curved(campaign, shaped)
        elif self.driver in EVENTS:
            mean = mean_decay(campaign, EVENTS[self.driver](campaign), *values[count:])
            terms = shaped(np.repeat(mean[:, np.newaxis], 3, axis=1))
        else:
            record = campaign.record
            state = MEMORIES[self.memory](course_of(self.driver, campaign), record.time_s, *values[count:])
            terms = [campaign.means_over_dwells(each) for each in shaped(state)]
        stacked = np.stack(terms, axis=2)
        axes = _FACTORS[self.factor]
        if not axes:
            return stacked
        product = stacked[:, :, :, np.newaxis] * campaign.up_body[:, np.newaxis, np.newaxis, list(axes)]
        return np.asarray(product.reshape(len(campaign), 3, -1))

    def missing_input(self, campaign: Campaign) -> str | None:
        """The input that a campaign does not have; None if it has all."""
        missing = needs_positions(campaign) if _FACTORS[self.factor] else None
        if missing is None and self.driver not in EVENTS:
            missing = _missing_driver(self.driver, campaign)
        return missing

    def terms(self) -> tuple[str, ...]:
        """What each term follows."""
        name = driver_label(self.driver)
        if self.memory != "none":
            name = f"{_MEMORY_WORDS[self.memory]} {name}"
        if self.shape == "polynomial":
            shaped = [f"{name}, power {power}" for power in range(1, self.degree + 1)]
        else:
            shaped = [f"{word}{name}" for word in SHAPES[self.shape].terms]
        axes = _FACTORS[self.factor]
        return tuple(f"{each} by gravity along {AXES[axis]}" for each in shaped for axis in axes) or (
            *shaped,
        )

    def _curved(
        self, campaign: Campaign, shaped: Callable[[FloatArray], list[FloatArray]]
    ) -> list[FloatArray]:
        """Means of the shape over the dwells: that of their means, and what the course within them adds."""
        course = course_of(self.driver, campaign)
        mean = campaign.means_over_dwells
        terms = zip(
            shaped(driver_values(self.driver, campaign)), shaped(course), shaped(mean(course)), strict=True
        )
        return [
            of_mean + mean(over_course) - of_course_mean for of_mean, over_course, of_course_mean in terms
        ]

    def _shaped(self, state: FloatArray, values: tuple[float, ...]) -> list[FloatArray]:
        if self.shape == "polynomial":
            return [state**power for power in range(1, self.degree + 1)]
        return SHAPES[self.shape].of(state, *values)


@dataclass(frozen=True)
class Shape:
    """How a bias follows a quantity."""

    of: Callable[..., list[FloatArray]]  #: Terms from the quantity and the parameters.
    parameters: tuple[str, ...] = ()  #: Names of its parameters, all in the unit of the driver.
    terms: tuple[str, ...] = ("",)  #: Words before the driver's name.


def _linear(state: FloatArray) -> list[FloatArray]:
    return [state]


def _above(state: FloatArray, onset: float, width: float) -> list[FloatArray]:
    return [width * np.logaddexp(0.0, (state - onset) / width)]


def _below(state: FloatArray, onset: float, width: float) -> list[FloatArray]:
    return [width * np.logaddexp(0.0, (onset - state) / width)]


def _saturation(state: FloatArray, centre: float, width: float) -> list[FloatArray]:
    return [np.exp(-np.logaddexp(0.0, (centre - state) / width))]


def _resonance(state: FloatArray, centre: float, half_width: float) -> list[FloatArray]:
    detuning = (state - centre) / half_width
    return [1.0 / (1.0 + detuning**2), detuning / (1.0 + detuning**2)]


#: A polynomial has as many terms as its degree; see :meth:`Law.columns`.
SHAPES: Mapping[str, Shape] = MappingProxyType(
    {
        "linear": Shape(_linear),
        "polynomial": Shape(_linear),
        "onset above": Shape(_above, ("onset", "width"), ("above the onset: ",)),
        "onset below": Shape(_below, ("onset", "width"), ("below the onset: ",)),
        "saturation": Shape(_saturation, ("centre", "width"), ("saturating with ",)),
        "resonance": Shape(
            _resonance, ("centre", "half_width"), ("resonance over ", "dispersion of the resonance over ")
        ),
    }
)


def _lag(state: FloatArray, time_s: FloatArray, tau_s: float) -> FloatArray:
    """First-order lag of a quantity (m, 3), at rest before the first of the times (m,)."""
    return state + lag(state, time_s, tau_s)


def _decay(state: FloatArray, time_s: FloatArray, tau_s: float) -> FloatArray:
    """What remains of the changes of a quantity, which decay: the quantity minus its lag."""
    return -lag(state, time_s, tau_s)


def _play(state: FloatArray, _: FloatArray, half_width: float) -> FloatArray:
    """How far a follower with play stands from the quantity (m, 3): at most the half width."""
    return followed_with_play(state, half_width, state[0]) - state


#: State (m, 3) of a quantity over time, from that, the times (m,) and the parameter.
MEMORIES: Mapping[str, Callable[..., FloatArray]] = MappingProxyType(
    {"lag": _lag, "play": _play, "decay": _decay}
)
_MEMORY_WORDS = {"lag": "lagging", "play": "play behind the", "decay": "decaying changes of the"}
#: Axes whose component of Up multiplies the terms.
_FACTORS: Mapping[str, tuple[int, ...]] = MappingProxyType(
    {"none": (), "up": (0, 1, 2), "up_x": (0,), "up_y": (1,), "up_z": (2,)}
)


def _of_gyros(values: FloatArray) -> FloatArray:
    return np.repeat(values[:, np.newaxis], 3, axis=1)


def _of_column(campaign: Campaign, name: str) -> FloatArray:
    missing = np.full(len(campaign), np.nan)
    names = [name.replace("{axis}", axis) for axis in AXES]
    return np.stack([campaign.columns.get(each, missing) for each in names], axis=1)


@dataclass(frozen=True)
class Driver:
    """A quantity that every dwell table has a place for, or a state of the thermal network."""

    label: str
    unit: str
    values: Callable[[Campaign], FloatArray | None]  #: Shape (n, 3); None or NaN where not measured.
    instrument: str = ""  #: What measures it.


_CHAMBER = "the chamber's readings"
DRIVERS: Mapping[str, Driver] = MappingProxyType(
    {
        "gyro_c": Driver("optics temperature", "c", lambda of: of.gyro_c),
        "gyro_rate_c_per_h": Driver("temperature rate", "c_per_h", lambda of: of.rate_c_per_h),
        "board_c": Driver(
            "electronics temperature", "c", lambda of: of.board_c, "temperature sensors at the electronics"
        ),
        "above_optics_k": Driver("electronics above optics", "k", lambda of: of.above_optics_c),
        "case_c": Driver(
            "case temperature", "c", lambda of: _of_gyros(of.case_c), "a temperature sensor at the case"
        ),
        "chamber_c": Driver("chamber air", "c", lambda of: _of_gyros(of.air_c), _CHAMBER),
        "chamber_set_c": Driver("chamber set point", "c", lambda of: _of_gyros(of.set_c), _CHAMBER),
        "supply_w": Driver(
            "supply power",
            "w",
            lambda of: _of_column(of, "supply_w"),
            "a logged power supply or power meter (column supply_w)",
        ),
        "room_c": Driver(
            "room temperature",
            "c",
            lambda of: _of_column(of, "room_c"),
            "a logged thermometer in the room (column room_c)",
        ),
        "time_days": Driver("time", "days", lambda of: _of_gyros((of.middle_s - of.middle_s[0]) / S_PER_DAY)),
        "since_power_on_h": Driver(
            "time since power-on",
            "h",
            lambda of: _of_gyros((of.since_power_on_s + 0.5 * (of.end_s - of.start_s)) / S_PER_H),
        ),
        "constant": Driver("", "", lambda of: np.ones_like(of.gyro_c)),
    }
)
#: Times of events, from which on a decay begins.
EVENTS: Mapping[str, Callable[[Campaign], FloatArray]] = MappingProxyType(
    {"power_on": lambda of: of.power_on_s, "start": lambda of: of.whole.start_s[:1]}
)


def driver_label(driver: str) -> str:
    """Name of a driver in sentences."""
    known = DRIVERS.get(driver)
    return known.label if known else driver.replace("_{axis}", "").replace("_", " ")


def driver_values(driver: str, campaign: Campaign) -> FloatArray:
    """Means over the dwells (n, 3); NaN where not measured."""
    known = DRIVERS.get(driver)
    if known is None:
        return _of_column(campaign, driver)
    values = known.values(campaign)
    return np.full_like(campaign.gyro_c, np.nan) if values is None else values


def _missing_driver(driver: str, campaign: Campaign) -> str | None:
    if driver == "above_optics_k":
        return needs_electronics(campaign)
    if np.isfinite(driver_values(driver, campaign)).all():
        return None
    known = DRIVERS.get(driver)
    return known.instrument if known else f"a column {driver.replace('{axis}', 'x')} in the dwell table"


def course_of(driver: str, campaign: Campaign) -> FloatArray:
    """A driver at the times of the campaign's record (m, 3), without influence of held-out dwells."""
    if driver == "gyro_c":
        return campaign.record.gyro_c
    whole = campaign.whole

    def course() -> FloatArray:
        values = driver_values(driver, whole)
        return whole.record.through_dwells(whole.start_s, whole.end_s, values, ~whole.held_out)

    return whole.computed_once(("course", driver), course)


def mean_decay(campaign: Campaign, on_s: FloatArray, tau_s: float) -> FloatArray:
    """Mean over each dwell of decays (n,) that begin with 1: a dwell with an event has parts of two.

    ``on_s``: times of the events, ascending, at least one.
    """
    instants_s = np.stack([campaign.start_s, campaign.end_s])
    event = np.maximum(np.searchsorted(on_s, instants_s, "right") - 1, 0)
    since_s = np.maximum(instants_s - on_s[event], 0.0)
    earlier = np.cumsum(np.append(0.0, -np.expm1((on_s[:-1] - on_s[1:]) / tau_s)))
    until_start, until_end = tau_s * (earlier[event] - np.expm1(-since_s / tau_s))
    return np.asarray((until_end - until_start) / np.maximum(campaign.end_s - campaign.start_s, 1e-9))


def form_of(law: Law, terms: tuple[str, ...] = (), name: str = "") -> Form:
    """Form of a law; ``terms`` by default the law's own names."""
    return Form(terms or law.terms(), law.columns, law.parameters, law.missing_input, name)


def effect_of(
    law: Law,
    name: str,
    statement: str,
    experiment: str,
    terms: tuple[str, ...] = (),
    label: str = "",
    imitated_by: tuple[str, ...] = (),
    contains: tuple[str, ...] = (),
    as_misalignment: MisalignmentTexts | None = None,
) -> Effect:
    """Effect of one law, compensated by the INS's terms where the INS has them."""
    form = form_of(law, terms)
    compensation = partial(ins_terms, {form.name: law})
    return Effect(
        name, statement, experiment, (form,), imitated_by, compensation, label, contains,
        as_misalignment=as_misalignment,
    )  # fmt: skip


def ins_terms(laws: Mapping[str, Law], fitted: FittedForm) -> InsTerms:
    """What an INS subtracts of a fitted law; ``laws`` by the names of their forms."""
    law = laws[fitted.form.name]
    sizes, same = fitted.sizes_dph, np.ones(3)
    match law.driver, law.shape, law.memory, law.factor:
        case "gyro_rate_c_per_h", "linear", "none", "none":
            limit_c_per_h = np.abs(fitted.campaign.rate_c_per_h[fitted.searched]).max(axis=0)
            return InsTerms({"rate_dph_per_c_per_h": sizes[:, 0], "rate_limit_c_per_h": limit_c_per_h})
        case "above_optics_k", "linear", "none", "none":
            return heat_flow_terms(fitted)
        case "gyro_c", "linear", "play", "none":
            return InsTerms({"hysteresis_dph_per_k": sizes[:, 0], "half_width_k": fitted.values[0] * same})
        case "power_on", "linear", "decay", "none":
            return InsTerms({"warm_up_dph": sizes[:, 0], "warm_up_s": fitted.values[0] * same})
        case "constant", "linear", "none", _:
            vectors = np.zeros((3, 3))
            vectors[:, list(_FACTORS[law.factor])] = sizes
            return InsTerms({"gravity_dph_per_g": vectors})
        case "time_days" | "start", _, _, "none":
            return constant_at_end(fitted)
        case "gyro_c", _, "none", "none":
            return _as_polynomial(fitted)
    return InsTerms(left_out=f"the INS has no term for what follows the {law.terms()[0]}")


def _as_polynomial(fitted: FittedForm) -> InsTerms:
    """Polynomial in temperature that is closest to a function of temperature in the dwells searched."""
    part_dph = np.einsum("ngk,gk->ng", fitted.form.columns(fitted.campaign, fitted.values), fitted.sizes_dph)
    gyro_c, part_dph = fitted.campaign.gyro_c[fitted.searched], part_dph[fitted.searched]
    degree = min(_INS_DEGREE, len(gyro_c) // 4)
    fits = [
        np.polynomial.Polynomial.fit(gyro_c[:, gyro], part_dph[:, gyro], degree).convert()
        for gyro in range(3)
    ]
    coefficients = np.array([np.pad(each.coef, (0, degree + 1 - len(each.coef))) for each in fits])
    left = part_dph - np.stack([fit(each) for fit, each in zip(fits, gyro_c.T, strict=True)], axis=1)
    note = (
        f"compensated by a polynomial of degree {degree}, which leaves {np.sqrt(np.mean(left**2)):.2g} deg/h"
    )
    return InsTerms({"polynomial_dph": coefficients}, note=f"{note} rms of it")
