"""What of a bias model an INS can subtract by itself, and what it can't."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.loop import Closure, FoundEffect
from gyrobench.bench.closure.problem import DEGREE, SCALE_C
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.navigation.positions import AXES
from gyrobench.drivers.ins.command_map import Compensation

#: Numbers of a :class:`~gyrobench.drivers.ins.command_map.Compensation` by their names.
Numbers = dict[str, FloatArray]

_GYROS = len(AXES)
_NO_BOARDS = "{} is left out: it goes by the temperature of the electronics, and the INS has no sensors there"
_LEFT_OUT = MappingProxyType(
    {
        "chamber_state": "chamber_state is left out: it belongs to the chamber, not to the INS",
        "thermal_lag": "thermal_lag is left out: the INS has no term for a temperature that lags behind",
    }
)
_AT_THE_END = (
    "{} is taken as it was at the end of the campaign, as a constant: how it goes on the INS can't know"
)


@dataclass(frozen=True, eq=False)
class LoadableModel:
    """A bias model as an INS can subtract it.

    Attributes
    ----------
    compensation : Compensation
        Limited to the temperatures, rates and differences that were fitted.
    effects : tuple of str
        Names of the effects in it.
    notes : tuple of str
        What of the model is not in it, or only in part; sentences without their end.
    """

    compensation: Compensation
    effects: tuple[str, ...]
    notes: tuple[str, ...]


def declared_model(closure: Closure) -> LoadableModel:
    """The declared model alone: a polynomial for each gyro.

    Its constant is the mean over the power-ons that were searched: the best guess for the next one.
    """
    numbers = _declared(closure, closure.declared.declared)
    return LoadableModel(Compensation(**numbers), (), (_turn_on_note(closure),))


def model_with_effects(closure: Closure) -> LoadableModel:
    """The model with the effects found, as far as an INS can subtract them."""
    numbers = _declared(closure, closure.model.declared)
    loaded, notes = [], [_turn_on_note(closure)]
    for found in closure.effects:
        name = found.candidate.effect.name
        reason = _reason_to_leave_out(closure.campaign, name)
        if reason is not None:
            notes.append(reason)
            continue
        loaded.append(name)
        for key, values in _NUMBERS[name](closure, found).items():
            is_sum = key in numbers and key in _SUMMED
            numbers[key] = numbers[key] + values if is_sum else values
        if name in _ENDING:
            notes.append(_AT_THE_END.format(name))
        if found.tied_with:
            others = " or ".join(found.tied_with)
            notes.append(f"{name} could as well be {others}; it is {name} that is loaded")
    return LoadableModel(Compensation(**numbers), tuple(loaded), tuple(notes))


def _declared(closure: Closure, coefficients: FloatArray) -> Numbers:
    """Polynomial in degrees Celsius and its limits, from (3, DEGREE + runs) coefficients."""
    powers = coefficients[:, :DEGREE] / SCALE_C ** np.arange(1, DEGREE + 1)
    constants = _constants(closure, coefficients).mean(axis=1, keepdims=True)
    gyro_c = closure.campaign.gyro_c[closure.searched]
    return {
        "polynomial_dph": np.concatenate([constants, powers], axis=1),
        "low_c": gyro_c.min(axis=0),
        "high_c": gyro_c.max(axis=0),
    }


def _constants(closure: Closure, coefficients: FloatArray) -> FloatArray:
    """Constants (3, runs) of the power-ons that were searched; a part of one dwell is not enough."""
    runs = np.unique(closure.campaign.run[closure.searched])
    return np.asarray(coefficients[:, DEGREE + runs])


def _turn_on_note(closure: Closure) -> str:
    seen = _constants(closure, closure.declared.declared)
    if seen.shape[1] < 2:
        return (
            "the constant is that of the one power-on that was searched: the next one's differs from it, by "
            "how much the campaign does not tell"
        )
    scatter_dph = float(np.sqrt(np.mean(np.var(seen, axis=1, ddof=1))))
    return (
        f"the constant is the mean of {seen.shape[1]} power-ons, which scatter by {scatter_dph:.2g} deg/h: "
        "the next one's differs as much"
    )


def _reason_to_leave_out(campaign: Campaign, name: str) -> str | None:
    if name in _LEFT_OUT:
        return _LEFT_OUT[name]
    if name not in _NUMBERS:
        return f"{name} is left out: the INS has no term for it"
    if name in _BY_ELECTRONICS and not np.isfinite(campaign.whole.board_c).all():
        return _NO_BOARDS.format(name)
    return None


def _rate(closure: Closure, found: FoundEffect) -> Numbers:
    rate_c_per_h = closure.campaign.rate_c_per_h[closure.searched]
    return {
        "rate_dph_per_c_per_h": found.sizes_dph[:, 0],
        "rate_limit_c_per_h": np.abs(rate_c_per_h).max(axis=0),
    }


def _gradient(closure: Closure, found: FoundEffect) -> Numbers:
    return {"gradient_dph_per_k": found.sizes_dph[:, 0], **_difference_limits(closure)}


def _attitude(closure: Closure, found: FoundEffect) -> Numbers:
    """Part of the heat flow that is alike in all positions, and the part that gravity turns."""
    candidate = found.candidate
    onset_c, width_c = candidate.values
    return {
        **_gradient(closure, found),
        f"{candidate.form.name}_dph_per_k": found.sizes_dph[:, 1:],
        "onset_c": np.full(_GYROS, onset_c),
        "onset_width_c": np.full(_GYROS, width_c),
    }


def _difference_limits(closure: Closure) -> Numbers:
    """Range of what the electronics were above the optics, as the sensors of the INS read it."""
    campaign = closure.campaign
    above_k = (campaign.board_c - campaign.gyro_c)[closure.searched]
    return {"difference_low_k": above_k.min(axis=0), "difference_high_k": above_k.max(axis=0)}


def _gravity(_: Closure, found: FoundEffect) -> Numbers:
    return {"gravity_dph_per_g": found.sizes_dph}


def _warm_up(_: Closure, found: FoundEffect) -> Numbers:
    return {
        "warm_up_dph": found.sizes_dph[:, 0],
        "warm_up_s": np.full(_GYROS, found.candidate.values[0]),
    }


def _hysteresis(_: Closure, found: FoundEffect) -> Numbers:
    return {
        "hysteresis_dph_per_k": found.sizes_dph[:, 0],
        "half_width_k": np.full(_GYROS, found.candidate.values[0]),
    }


def _at_the_end(closure: Closure, found: FoundEffect) -> Numbers:
    columns = found.candidate.columns(closure.campaign)[-1]
    constant = np.sum(columns * found.sizes_dph, axis=1, keepdims=True)
    return {"polynomial_dph": np.pad(constant, ((0, 0), (0, DEGREE)))}


_NUMBERS: dict[str, Callable[[Closure, FoundEffect], Numbers]] = {
    "temperature_rate": _rate,
    "thermal_gradient": _gradient,
    "attitude_thermal": _attitude,
    "g_sensitivity": _gravity,
    "warm_up": _warm_up,
    "thermal_hysteresis": _hysteresis,
    "time_drift": _at_the_end,
    "bias_jump": _at_the_end,
}
_BY_ELECTRONICS = ("thermal_gradient", "attitude_thermal")
_ENDING = ("time_drift", "bias_jump")
#: Numbers that several effects may add to.
_SUMMED = ("polynomial_dph", "gradient_dph_per_k")
