"""The grammar of effects: a bias that follows factor x shape(memory(driver)).

The driver is a column of the dwell table or a state of the thermal network; the memory describes how its past
acts, the shape how the bias depends on it, and the factor is a component of Up. Built-in effects, those of
files (:mod:`gyrobench.bench.closure.effects.effect_file`) and composed laws
(:mod:`gyrobench.bench.closure.compose`) are defined by it.
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
    same_for_all_gyros,
)
from gyrobench.bench.closure.temperature_record import followed_with_play, lag
from gyrobench.bench.foundations.arrays import S_PER_DAY, S_PER_H, FloatArray, rms
from gyrobench.bench.navigation.positions import AXES

#: Degree of the polynomial in temperature with which an INS approximates a shape.
_INS_DEGREE = 5


@dataclass(frozen=True)
class Law:
    """A law that the bias follows, without the sizes of its terms."""

    driver: str  #: Key of :data:`DRIVERS`, or a column of the dwell table; ``{axis}`` stands for the gyro's.
    shape: str = "linear"  #: Key of :data:`SHAPES`.
    memory: str = "none"  #: ``none`` or a key of :data:`MEMORIES`.
    factor: str = "none"  #: Key of :data:`_FACTORS`.
    degree: int = 1  #: Degree of a polynomial.
    parameters: tuple[Parameter, ...] = ()  #: Parameters of the shape, then of the memory.

    def columns(self, campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
        """Terms (n, 3, k) in all dwells at values of the parameters."""
        count = len(SHAPES[self.shape].parameters)
        apply_shape = partial(self._apply_shape, values=values[:count])
        if self.memory == "none" and (self.shape == "linear" or self.driver == "constant"):
            terms = apply_shape(driver_values(self.driver, campaign))
        elif self.memory == "none":
            terms = self._nonlinear_means(campaign, apply_shape)
        elif self.driver in EVENTS:
            mean = mean_decay(campaign, EVENTS[self.driver](campaign), *values[count:])
            terms = apply_shape(same_for_all_gyros(mean))
        else:
            record = campaign.record
            state = MEMORIES[self.memory](course_of(self.driver, campaign), record.time_s, *values[count:])
            terms = [campaign.means_over_dwells(each) for each in apply_shape(state)]
        stacked = np.stack(terms, axis=2)
        axes = _FACTORS[self.factor]
        if not axes:
            return stacked
        product = stacked[:, :, :, np.newaxis] * campaign.up_body[:, np.newaxis, np.newaxis, list(axes)]
        return np.asarray(product.reshape(len(campaign), 3, -1))

    def missing_input(self, campaign: Campaign) -> str | None:
        """The input that a campaign lacks; None if it has all."""
        missing = needs_positions(campaign) if _FACTORS[self.factor] else None
        if missing is None and self.driver not in EVENTS:
            missing = _missing_driver(self.driver, campaign)
        return missing

    def terms(self) -> tuple[str, ...]:
        """Name of the quantity that each term follows."""
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

    def _nonlinear_means(
        self, campaign: Campaign, apply_shape: Callable[[FloatArray], list[FloatArray]]
    ) -> list[FloatArray]:
        """Means over the dwells of a shape of the driver.

        The shape of the measured mean, plus the difference that the course within the dwell makes.
        """
        course = course_of(self.driver, campaign)
        mean = campaign.means_over_dwells
        triples = zip(
            apply_shape(driver_values(self.driver, campaign)),
            apply_shape(course),
            apply_shape(mean(course)),
            strict=True,
        )
        return [
            of_mean + mean(over_course) - of_course_mean for of_mean, over_course, of_course_mean in triples
        ]

    def _apply_shape(self, state: FloatArray, values: tuple[float, ...]) -> list[FloatArray]:
        if self.shape == "polynomial":
            return [state**power for power in range(1, self.degree + 1)]
        return SHAPES[self.shape].of(state, *values)


@dataclass(frozen=True)
class Shape:
    """Function by which the bias follows a quantity."""

    of: Callable[..., list[FloatArray]]  #: Computes the terms from the quantity and the parameters.
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
    """Changes of a quantity (m, 3) that decay exponentially: the quantity minus its lag."""
    return -lag(state, time_s, tau_s)


def _play(state: FloatArray, _: FloatArray, half_width: float) -> FloatArray:
    """Distance of a follower with play from the quantity (m, 3): at most the half width."""
    return followed_with_play(state, half_width, state[0]) - state


#: Functions of a quantity (m, 3), the times (m,) and the parameter that return its state (m, 3).
MEMORIES: Mapping[str, Callable[..., FloatArray]] = MappingProxyType(
    {"lag": _lag, "play": _play, "decay": _decay}
)
_MEMORY_WORDS = {"lag": "lagging", "play": "play behind the", "decay": "decaying changes of the"}
#: Axes whose component of Up multiplies the terms.
_FACTORS: Mapping[str, tuple[int, ...]] = MappingProxyType(
    {"none": (), "up": (0, 1, 2), "up_x": (0,), "up_y": (1,), "up_z": (2,)}
)


def _from_column(campaign: Campaign, name: str) -> FloatArray:
    missing = np.full(len(campaign), np.nan)
    names = [name.replace("{axis}", axis) for axis in AXES]
    return np.stack([campaign.columns.get(each, missing) for each in names], axis=1)


@dataclass(frozen=True)
class Driver:
    """A quantity with a standard column of the dwell table, or a state of the thermal network."""

    label: str
    unit: str
    values: Callable[[Campaign], FloatArray | None]  #: Shape (n, 3); None or NaN if not measured.
    instrument: str = ""  #: Instrument that measures it.


_CHAMBER = "the chamber's readings"
DRIVERS: Mapping[str, Driver] = MappingProxyType(
    {
        "gyro_c": Driver("optics temperature", "c", lambda campaign: campaign.gyro_c),
        "gyro_rate_c_per_h": Driver("temperature rate", "c_per_h", lambda campaign: campaign.rate_c_per_h),
        "board_c": Driver(
            "electronics temperature",
            "c",
            lambda campaign: campaign.board_c,
            "temperature sensors at the electronics",
        ),
        "above_optics_k": Driver("electronics above optics", "k", lambda campaign: campaign.above_optics_c),
        "case_c": Driver(
            "case temperature",
            "c",
            lambda campaign: same_for_all_gyros(campaign.case_c),
            "a temperature sensor at the case",
        ),
        "chamber_c": Driver(
            "chamber air", "c", lambda campaign: same_for_all_gyros(campaign.air_c), _CHAMBER
        ),
        "chamber_set_c": Driver(
            "chamber set point", "c", lambda campaign: same_for_all_gyros(campaign.set_c), _CHAMBER
        ),
        "supply_w": Driver(
            "supply power",
            "w",
            lambda campaign: _from_column(campaign, "supply_w"),
            "a logged power supply or power meter (column supply_w)",
        ),
        "room_c": Driver(
            "room temperature",
            "c",
            lambda campaign: _from_column(campaign, "room_c"),
            "a logged thermometer in the room (column room_c)",
        ),
        "time_days": Driver(
            "time",
            "days",
            lambda campaign: same_for_all_gyros((campaign.middle_s - campaign.middle_s[0]) / S_PER_DAY),
        ),
        "since_power_on_h": Driver(
            "time since power-on",
            "h",
            lambda campaign: same_for_all_gyros(
                (campaign.since_power_on_s + 0.5 * (campaign.end_s - campaign.start_s)) / S_PER_H
            ),
        ),
        "constant": Driver("", "", lambda campaign: np.ones_like(campaign.gyro_c)),
    }
)
#: Times of events at which a decay begins.
EVENTS: Mapping[str, Callable[[Campaign], FloatArray]] = MappingProxyType(
    {"power_on": lambda campaign: campaign.power_on_s, "start": lambda campaign: campaign.whole.start_s[:1]}
)


def driver_label(driver: str) -> str:
    """Name of a driver in sentences."""
    standard = DRIVERS.get(driver)
    return standard.label if standard else driver.replace("_{axis}", "").replace("_", " ")


def driver_values(driver: str, campaign: Campaign) -> FloatArray:
    """Means of a driver over the dwells (n, 3); NaN if not measured."""
    standard = DRIVERS.get(driver)
    if standard is None:
        return _from_column(campaign, driver)
    values = standard.values(campaign)
    return np.full_like(campaign.gyro_c, np.nan) if values is None else values


def _missing_driver(driver: str, campaign: Campaign) -> str | None:
    if driver == "above_optics_k":
        return needs_electronics(campaign)
    if np.isfinite(driver_values(driver, campaign)).all():
        return None
    standard = DRIVERS.get(driver)
    return standard.instrument if standard else f"a column {driver.replace('{axis}', 'x')} in the dwell table"


def course_of(driver: str, campaign: Campaign) -> FloatArray:
    """Driver at the times of the campaign's record (m, 3), not influenced by held-out dwells."""
    if driver == "gyro_c":
        return campaign.record.gyro_c
    whole = campaign.whole

    def course() -> FloatArray:
        values = driver_values(driver, whole)
        return whole.record.through_dwells(whole.start_s, whole.end_s, values, ~whole.held_out)

    return whole.computed_once(("course", driver), course)


def mean_decay(campaign: Campaign, event_s: FloatArray, tau_s: float) -> FloatArray:
    """Mean over each dwell (n,) of an exponential decay that starts at 1 with each event.

    A dwell that contains events has parts of several decays. ``event_s``: times of the events, ascending, at
    least one.
    """
    instants_s = np.stack([campaign.start_s, campaign.end_s])
    event = np.maximum(np.searchsorted(event_s, instants_s, "right") - 1, 0)
    since_s = np.maximum(instants_s - event_s[event], 0.0)
    completed = np.cumsum(np.append(0.0, -np.expm1((event_s[:-1] - event_s[1:]) / tau_s)))
    until_start, until_end = tau_s * (completed[event] - np.expm1(-since_s / tau_s))
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
    """Effect of one law, compensated by the terms of the INS if it has them."""
    form = form_of(law, terms)
    compensation = partial(ins_terms, {form.name: law})
    return Effect(
        name, statement, experiment, (form,), imitated_by, compensation, label, contains,
        as_misalignment=as_misalignment,
    )  # fmt: skip


def ins_terms(laws: Mapping[str, Law], fitted: FittedForm) -> InsTerms:
    """Terms with which an INS subtracts a fitted law; ``laws`` by the names of their forms."""
    law = laws[fitted.form.name]
    sizes, ones = fitted.sizes_dph, np.ones(3)
    match law.driver, law.shape, law.memory, law.factor:
        case "gyro_rate_c_per_h", "linear", "none", "none":
            limit_c_per_h = np.abs(fitted.campaign.rate_c_per_h[fitted.searched]).max(axis=0)
            return InsTerms({"rate_dph_per_c_per_h": sizes[:, 0], "rate_limit_c_per_h": limit_c_per_h})
        case "above_optics_k", "linear", "none", "none":
            return heat_flow_terms(fitted)
        case "gyro_c", "linear", "play", "none":
            return InsTerms({"hysteresis_dph_per_k": sizes[:, 0], "half_width_k": fitted.values[0] * ones})
        case "power_on", "linear", "decay", "none":
            return InsTerms({"warm_up_dph": sizes[:, 0], "warm_up_s": fitted.values[0] * ones})
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
    """Polynomial in temperature that fits a function of temperature best in the dwells searched."""
    gyro_c, searched, effect_dph = fitted.campaign.gyro_c, fitted.searched, fitted.bias_dph
    degree = min(_INS_DEGREE, int(searched.sum()) // 4)
    fits = [
        np.polynomial.Polynomial.fit(gyro_c[searched, gyro], effect_dph[searched, gyro], degree).convert()
        for gyro in range(3)
    ]
    coefficients = np.array([np.pad(each.coef, (0, degree + 1 - len(each.coef))) for each in fits])
    error_dph = effect_dph - np.stack([fit(each) for fit, each in zip(fits, gyro_c.T, strict=True)], axis=1)
    rms_dph = rms(error_dph[searched])
    note = f"compensated by a polynomial of degree {degree}, which leaves {rms_dph:.2g} deg/h rms of it"
    return InsTerms({"polynomial_dph": coefficients}, note=note, residual_dph=error_dph)
