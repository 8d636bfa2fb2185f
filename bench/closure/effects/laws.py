"""Effects of the unit itself, most of them a law of the grammar: driver, memory and factor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import (
    NO_INS_TERM,
    Effect,
    FittedForm,
    Form,
    InsTerms,
    MisalignmentTexts,
    Parameter,
    constant_at_end,
    fixed,
    needs_positions,
    same_for_all_gyros,
    searched_length_s,
    time_constant,
)
from gyrobench.bench.closure.effects.grammar import MEMORIES, Law, effect_of, form_of, ins_terms, mean_decay
from gyrobench.bench.foundations.arrays import S_PER_DAY, S_PER_H, FloatArray, rms

_LAG_TAU = time_constant(1.0, 300.0, 900.0, 2700.0, 7200.0)
_HALF_WIDTH = Parameter("half_width_c", 0.3, 40.0, fixed(1.0, 2.0, 4.0, 7.0, 12.0, 20.0))
_WARM_UP_TAU = time_constant(300.0, 900.0, 2700.0, 7200.0, 21_600.0, 64_800.0)
_TWO_DAYS_S = 2.0 * S_PER_DAY

TEMPERATURE_RATE = effect_of(
    Law("gyro_rate_c_per_h"),
    name="temperature_rate",
    statement="the bias follows the rate of change of the optics temperature",
    experiment=(
        "pass the same temperature at two ramp rates, upward and downward, then soak there: the effect is "
        "proportional to the rate, changes sign with it and vanishes in the soak"
    ),
    terms=("temperature rate, K/h",),
    imitated_by=("thermal_gradient",),
)

_LAG = Law("gyro_c", memory="decay", parameters=(_LAG_TAU,))
_SENSOR_AHEAD = ("sensor ahead of the lagging temperature, K",)
#: A temperature with at most this rate at the first dwell was settled before it.
_SETTLED_C_PER_H = 3.0
#: Ratio of the lag at the first dwell to that on a long ramp with the rate of that dwell; 0 if settled before
#: it.
_FIRST_LAG = Parameter("lag_at_first_dwell", 0.0, 1.0, fixed(0.0), is_place=True)


def _lag_with_initial_value(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    """Sensor minus a lagging temperature, with a lag already at the first dwell, K: (n, 3, 1)."""
    tau_s, share = values
    first_k = share * campaign.whole.rate_c_per_h[0] * tau_s / S_PER_H
    decay = mean_decay(campaign, campaign.whole.start_s[:1], tau_s)
    return np.asarray(_LAG.columns(campaign, (tau_s,)) + (decay[:, np.newaxis] * first_k)[:, :, np.newaxis])


def _begins_settled(campaign: Campaign) -> bool:
    rate_c_per_h = np.nan_to_num(campaign.whole.rate_c_per_h[0])  # not measured: taken as settled
    return bool(np.abs(rate_c_per_h).max() <= _SETTLED_C_PER_H)


def _terms_of_nearest(fitted: FittedForm, law: Law, values: tuple[float, ...], name: str) -> InsTerms:
    """Terms of a law that an INS can subtract, with the sizes that fit another one best.

    ``values``: parameters of the law. ``name``: what it is, for the note on what it leaves.
    """
    form, searched = form_of(law), fitted.searched
    course, nearest = (
        columns - columns[searched].mean(axis=0)
        for columns in (
            each.columns(fitted.campaign, own_values)[:, :, 0]
            for each, own_values in ((fitted.form, fitted.values), (form, values))
        )
    )
    products, squares = (np.sum((nearest * each)[searched], axis=0) for each in (course, nearest))
    sizes_dph = fitted.sizes_dph * (products / np.maximum(squares, 1e-300))[:, np.newaxis]
    residual_dph = course * fitted.sizes_dph[:, 0] - nearest * sizes_dph[:, 0]
    terms = ins_terms({form.name: law}, replace(fitted, form=form, values=values, sizes_dph=sizes_dph))
    note = f"compensated {name}, which leaves {rms(residual_dph[searched]):.2g} deg/h rms of it"
    return replace(terms, note=note, residual_dph=residual_dph)


def _lag_terms(fitted: FittedForm) -> InsTerms:
    """The temperature rate: on a long ramp, a lag is proportional to it."""
    return _terms_of_nearest(fitted, Law("gyro_rate_c_per_h"), (), "as the temperature rate")


#: What warmed or cooled an INS before the first dwell is not recorded, and acts for hours.
THERMAL_LAG = Effect(
    name="thermal_lag",
    statement="the bias follows a temperature that lags behind the measured one",
    experiment=(
        "step the temperature once and soak: the bias settles a time constant later than the sensor; a "
        "second sensor closer to the cavity shows the lag directly"
    ),
    imitated_by=("thermal_gradient",),
    contains=("temperature_rate",),
    compensation=_lag_terms,
    forms=(
        Form(
            _SENSOR_AHEAD,
            _LAG.columns,
            (_LAG_TAU,),
            lambda campaign: (
                None if _begins_settled(campaign) else "a settled temperature at the first dwell"
            ),
            "settled at first",
        ),
        Form(
            _SENSOR_AHEAD,
            _lag_with_initial_value,
            (_LAG_TAU, _FIRST_LAG),
            lambda campaign: (
                "a changing temperature at the first dwell" if _begins_settled(campaign) else None
            ),
            "changing at first",
        ),
    ),
)

_PLAY = Law("gyro_c", memory="play", parameters=(_HALF_WIDTH,))
#: Half widths of groups of equally many joints, in units of their mean: midpoints of equal parts of 0 to 2.
_JOINT_WIDTHS = (0.25, 0.75, 1.25, 1.75)


def _many_widths(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    """Mean of play with half widths from zero to twice the mean, (n, 3, 1)."""
    record, play = campaign.record, MEMORIES[_PLAY.memory]
    states = (play(record.gyro_c, record.time_s, values[0] * each) for each in _JOINT_WIDTHS)
    return campaign.means_over_dwells(np.asarray(sum(states)) / len(_JOINT_WIDTHS))[:, :, np.newaxis]


def _hysteresis_terms(fitted: FittedForm) -> InsTerms:
    if fitted.form.name == _ONE_WIDTH:
        return ins_terms({_ONE_WIDTH: _PLAY}, fitted)
    return _terms_of_nearest(fitted, _PLAY, fitted.values, "as play of a single width")


_ONE_WIDTH = "one width"
#: Joints that slip at one stress, or many that slip at different ones: the loops of Rayleigh's law.
THERMAL_HYSTERESIS = Effect(
    name="thermal_hysteresis",
    statement=(
        "the bias depends on whether a temperature was reached from above or below, at any rate, as by the "
        "play of one joint (one width) or of many different ones (many widths)"
    ),
    experiment=(
        "reach one temperature from above and from below and soak for hours: a lag decays, hysteresis "
        "remains; small temperature loops show its width"
    ),
    compensation=_hysteresis_terms,
    forms=(
        form_of(_PLAY, ("play behind the temperature, K",), _ONE_WIDTH),
        Form(
            ("mean play behind the temperature, K",),
            _many_widths,
            (_HALF_WIDTH,),
            _PLAY.missing_input,
            "many widths",
        ),
    ),
)

THERMAL_GRADIENT = effect_of(
    Law("above_optics_k"),
    name="thermal_gradient",
    statement=(
        "the bias follows the temperature difference between electronics and optics, equally in all positions"
    ),
    experiment=(
        "soak at one temperature and change the power of the electronics: the temperature difference "
        "changes, while the temperature rate soon returns to zero"
    ),
    terms=("electronics above optics, K",),
)

#: The specific force at rest is gravity, so the matrix of the sensors does the same.
_AS_MISALIGNMENT = "as misalignments do at rest"
_COMPENSATE_MATRIX = "compensate the matrix that rotations measure (rotate): at rest it includes both"

G_SENSITIVITY = effect_of(
    Law("constant", factor="up"),
    name="g_sensitivity",
    label="g-sensitivity",
    statement="the bias follows gravity along the body axes, equally at all temperatures",
    experiment=(
        "compare up and down at the hottest and the coldest temperature after a soak: the difference is the "
        "same at both; a magnetic shield or coil excludes the vertical magnetic field"
    ),
    terms=("Up along x", "Up along y", "Up along z"),
    imitated_by=("magnetic_sensitivity",),
    as_misalignment=MisalignmentTexts(
        "misalignment or g-sensitivity",
        f"the bias follows gravity along the body axes, {_AS_MISALIGNMENT}, equally at all temperatures",
        _COMPENSATE_MATRIX,
    ),
)

#: The springs of block and dither soften with temperature. :data:`G_SENSITIVITY` is the part that is equal at
#: all temperatures.
THERMAL_G_SENSITIVITY = effect_of(
    Law("gyro_c", factor="up"),
    name="thermal_g_sensitivity",
    label="temperature-dependent g-sensitivity",
    statement="the bias follows gravity along the body axes, in proportion to the optics temperature",
    experiment=(
        "compare up and down about each axis at five temperatures after a soak: the difference changes "
        "linearly over the whole range, and not with the power of the electronics"
    ),
    terms=("temperature by Up along x, K", "temperature by Up along y, K", "temperature by Up along z, K"),
    as_misalignment=MisalignmentTexts(
        "misalignment or g-sensitivity over temperature",
        f"the bias follows gravity along the body axes, {_AS_MISALIGNMENT}, in proportion to the temperature",
        _COMPENSATE_MATRIX,
    ),
)

WARM_UP = effect_of(
    Law("power_on", memory="decay", parameters=(_WARM_UP_TAU,)),
    name="warm_up",
    label="warm-up",
    statement="the bias decays exponentially after power-on",
    experiment="reach the same temperature soon after power-on and again hours later, in two power cycles",
    terms=("decay since power-on",),
    contains=("time_drift",),
)

TIME_DRIFT = effect_of(
    Law("time_days"),
    name="time_drift",
    statement="the bias drifts linearly with time",
    experiment=(
        "return to one position and temperature at the beginning, in the middle and at the end of a "
        "power cycle, over two days or more"
    ),
    terms=("time, days",),
    imitated_by=("daily_course",),
)


class _Ageing(Law):
    """A decay through all power cycles; in a single one it can't be distinguished from a slow warm-up."""

    def missing_input(self, campaign: Campaign) -> str | None:
        """Two power cycles and two days."""
        if len(campaign.power_on_s) > 1 and searched_length_s(campaign) > _TWO_DAYS_S:
            return None
        return "two power cycles and two days: in one, ageing looks like a slow warm-up"


def _log_time(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    """Mean of log(1 + t / tau) over each dwell, (n, 3, 1)."""

    def integral(time_s: FloatArray) -> FloatArray:
        elapsed = np.maximum(time_s - campaign.whole.start_s[0], 0.0) / values[0]
        return np.asarray((1.0 + elapsed) * np.log1p(elapsed) - elapsed)

    spans = np.maximum(campaign.end_s - campaign.start_s, 1e-9) / values[0]
    mean = (integral(campaign.end_s) - integral(campaign.start_s)) / spans
    return same_for_all_gyros(mean[:, np.newaxis])


_EXPONENTIAL = _Ageing(
    "start", memory="decay", parameters=(time_constant(S_PER_DAY, S_PER_DAY, 3.0 * S_PER_DAY),)
)
#: For the logarithm it is the age of the INS at the first dwell, which the length of a campaign does not
#: limit.
_LOG_TAU = time_constant(0.5 * S_PER_DAY, S_PER_DAY, 3.0 * S_PER_DAY, lengths=3.0)
#: Stress that relaxes by many simultaneous processes follows the logarithm of time, as in the ageing of
#: crystals.
AGEING = Effect(
    name="ageing",
    statement=(
        "the bias settles over days, exponentially or by the logarithm of time, through all power cycles"
    ),
    experiment=(
        "return to one position and temperature every day for twice the time constant, with a power-off in "
        "between: ageing continues where it was, a warm-up begins again"
    ),
    compensation=constant_at_end,
    contains=("time_drift",),
    forms=(
        form_of(_EXPONENTIAL, ("decay since the first dwell",), "exponential"),
        Form(
            ("logarithm of the time since the first dwell",),
            _log_time,
            (_LOG_TAU,),
            _EXPONENTIAL.missing_input,
            "logarithmic",
        ),
    ),
)

_ROOM = Law("room_c")
_ROOM_TAU = Parameter("tau_s", 300.0, 14_400.0, fixed(900.0, 3600.0))
_LAGGING_ROOM = Law("room_c", memory="lag", parameters=(_ROOM_TAU,))
#: A rack of electronics or the wall of the chamber follows the temperature of the room with a lag.
DAILY_COURSE = Effect(
    name="daily_course",
    label="daily course of the room",
    statement="the bias follows the temperature of the room",
    experiment=(
        "log the temperature of the room beside one position and temperature held for two days: a daily "
        "course returns"
    ),
    compensation=NO_INS_TERM,
    forms=(
        form_of(_ROOM, ("room temperature, K",), "at once"),
        form_of(_LAGGING_ROOM, ("lagging room temperature, K",), "lagging"),
    ),
    imitated_by=("supply_power",),
    # Over two days and more a daily course repeats, so no drift looks like it.
    may_imitate=lambda campaign: float(campaign.end_s.max() - campaign.start_s.min()) < _TWO_DAYS_S,
)


def _after_jump(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    """Share of each dwell after the jump: (n, 3, 1)."""
    length_s = np.maximum(campaign.end_s - campaign.start_s, 1e-9)
    share = np.clip((campaign.end_s - values[0]) / length_s, 0.0, 1.0)
    return same_for_all_gyros(share[:, None])


def _starts_of_dwells(campaign: Campaign) -> FloatArray:
    return campaign.start_s[~campaign.held_out][1:]


BIAS_JUMP = Effect(
    name="bias_jump",
    statement="the bias steps to a new value at one time and remains there",
    experiment=(
        "repeat the positions and temperatures measured before the step within the same power cycle: a step "
        "remains"
    ),
    compensation=constant_at_end,
    forms=(
        Form(("after the jump",), _after_jump, (Parameter("jump_s", -np.inf, np.inf, _starts_of_dwells),)),
    ),
)


def _squares_across(campaign: Campaign, _: tuple[float, ...]) -> FloatArray:
    """Terms ``Kpp ap^2 + Koo ao^2`` of the model equation of an accelerometer, IEEE Std 1293: (n, 3, 1).

    For a level input axis the squares of gravity along the other axes add up to one, so that at rest only
    their difference is distinguished from the bias.
    """
    squares = campaign.up_body**2
    across = np.roll(squares, -1, axis=1) - np.roll(squares, -2, axis=1)
    return across[:, list(campaign.quantity.sensors), np.newaxis]


CROSS_AXIS_NONLINEARITY = Effect(
    name="cross_axis_nonlinearity",
    label="cross-axis nonlinearity",
    statement="the bias follows the square of gravity across the input axis",
    experiment=(
        "turn the unit about the level input axis by quarter turns: the bias is the same after half a turn, "
        "and differs after a quarter"
    ),
    forms=(
        Form(
            ("square of Up along the next axis less along the one after",),
            _squares_across,
            (),
            needs_positions,
        ),
    ),
    sensors=("accelerometer",),
)
