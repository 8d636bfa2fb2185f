"""The part of a bias model that an INS can subtract, and notes on the part that it can't."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gyrobench.bench.closure.effects.effect import FittedForm, InsTerms
from gyrobench.bench.closure.outcome import Closure, FoundEffect
from gyrobench.bench.closure.problem import DEGREE, SCALE_C
from gyrobench.bench.closure.uncertainty import DRAWS, Draws
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.text import plain_name
from gyrobench.drivers.ins.compensation import CORRECTION_DEGREE, PARAMETER_NAMES, Compensation, Correction

#: Terms that an INS has for other coefficients than the gyros' biases, as they are called for these.
_OF_OTHERS = {"polynomial_dph", "rate_dph_per_c_per_h", "rate_limit_c_per_h", "gravity_dph_per_g"}
#: What follows gravity at rest as the bias of a quantity would: a part of the sensors' matrix.
_SEEN_AS_GRAVITY = {"accelerometer_bias": ("accelerometer_scale", "accelerometer_misalignment")}
#: Coefficients that several effects may contribute to.
_SUMMED = ("polynomial_dph", "gradient_dph_per_k")


@dataclass(frozen=True, eq=False)
class LoadableModel:
    """A bias model as an INS can subtract it."""

    #: Limited to the temperatures, rates and differences that were fitted, with standard uncertainties.
    compensation: Compensation
    effects: tuple[str, ...]  #: Names of the effects in it.
    notes: tuple[str, ...]  #: What of the model is not in it, or only in part; sentences without a period.
    is_limited: bool = True  #: Whether the INS gets the limits of temperature; without them it extrapolates.


def declared_model(closure: Closure) -> LoadableModel:
    """The declared model alone: a polynomial for each gyro.

    Its constant is the mean over the power cycles searched: the best estimate for the next one.
    """
    coefficients = _declared(closure, closure.declared.declared)
    sigma = _sigma(coefficients, lambda index: _declared(closure, closure.declared_draws.declared[index]))
    return LoadableModel(_compensation(coefficients, sigma), (), (_constant_note(closure),))


def model_with_effects(closure: Closure) -> LoadableModel:
    """The model with the effects found, as far as an INS can subtract them.

    Raises MeasurementError if an effect of another package names a coefficient that an INS does not have.
    """
    loaded, notes = [], [_constant_note(closure)]
    for found in closure.effects:
        name = found.effect.display_name
        terms = _terms(closure, found)
        if terms.left_out:
            notes.append(f"{name} is left out: {terms.left_out}")
            continue
        unknown = sorted(terms.coefficients.keys() - set(PARAMETER_NAMES))
        if unknown:
            raise MeasurementError(
                f"the effect {found.effect.name!r} is compensated by {', '.join(unknown)}, which no INS has. "
                "Report this to the author of the effect"
            )
        loaded.append(found)
        if terms.note:
            notes.append(f"{name} is {terms.note}")
        if found.tied_with:
            rivals = " or ".join(map(closure.label, found.tied_with))
            notes.append(f"{name} is loaded, but {rivals} fits the data equally well")
    coefficients = _with_terms(closure, closure.model.declared, [_terms(closure, each) for each in loaded])
    draws = closure.model_draws

    def drawn(index: int) -> dict[str, FloatArray]:
        terms = [_terms(closure, each, draws, index) for each in loaded]
        return _with_terms(closure, draws.declared[index], terms)

    compensation = _compensation(coefficients, _sigma(coefficients, drawn))
    return LoadableModel(compensation, tuple(each.effect.name for each in loaded), tuple(notes))


def with_coefficients(model: LoadableModel, closures: Iterable[Closure], *, effects: bool) -> LoadableModel:
    """A model of the gyros' biases with what an INS can take of other coefficients.

    ``closures``: searches of these. ``effects``: whether with the effects that they found. Without one the
    polynomial that the model has already stays: searches see less, of accelerometers single dwells.
    """
    corrections = dict(model.compensation.coefficients)
    limit, names, notes = model.compensation.rate_limit_c_per_h.copy(), list(model.effects), list(model.notes)
    for closure in closures:
        quantity, loaded = closure.quantity, []
        for found in closure.effects if effects else ():
            terms = _terms(closure, found)
            label = f"{found.effect.display_name} in the {plain_name(quantity.name)}"
            is_gravity = found.effect.as_misalignment is not None or "gravity_dph_per_g" in terms.coefficients
            if is_gravity and any(
                each.startswith(_SEEN_AS_GRAVITY.get(quantity.name, ())) for each in corrections
            ):
                notes.append(
                    f"the effect {label} is left out: scale factors and misalignments compensate it already"
                )
                continue
            degree = terms.coefficients.get("polynomial_dph", np.zeros((3, 1))).shape[1] - 1
            if terms.left_out or terms.coefficients.keys() - _OF_OTHERS or degree > CORRECTION_DEGREE:
                reason = terms.left_out or "the INS has no term for it there"
                notes.append(f"the effect {label} is left out: {reason}")
                continue
            loaded.append(terms)
            names.append(f"{found.effect.name} in {quantity.name}")
        solution = (closure.model if effects else closure.declared).declared
        numbers = _with_terms(closure, solution, loaded)
        np.maximum.at(limit, list(quantity.sensors), numbers.get("rate_limit_c_per_h", np.zeros(3)))
        rates = numbers.get("rate_dph_per_c_per_h", np.zeros(3))
        gravity = numbers.get("gravity_dph_per_g", np.zeros((3, 3)))
        is_measured = closure.campaign.is_measured[closure.searched]
        gyro_c = closure.campaign.gyro_c[closure.searched]
        for place, coefficient in enumerate(quantity.coefficients):
            at_c = gyro_c[is_measured[:, place], place]
            if len(at_c) and (loaded or coefficient not in corrections):
                corrections[coefficient] = Correction(
                    numbers["polynomial_dph"][place],
                    float(rates[place]),
                    gravity[place],
                    (float(at_c.min()), float(at_c.max())),
                )
    compensation = replace(model.compensation, coefficients=corrections, rate_limit_c_per_h=limit)
    return replace(model, compensation=compensation, effects=tuple(names), notes=tuple(notes))


def _compensation(coefficients: Mapping[str, FloatArray], sigma: Mapping[str, FloatArray]) -> Compensation:
    numbers: dict[str, Any] = {**coefficients, "sigma": sigma}
    return Compensation(**numbers)


def _terms(closure: Closure, found: FoundEffect, draws: Draws | None = None, index: int = 0) -> InsTerms:
    """What an INS subtracts of an effect: as fitted, or as drawn."""
    candidate, name = found.candidate, found.effect.name
    values, sizes = candidate.values, found.sizes_dph
    if draws is not None:
        values, sizes = tuple(draws.values[name][index].tolist()), draws.sizes_dph[name][index]
    fitted = FittedForm(closure.campaign, closure.searched, candidate.form, values, sizes)
    return found.effect.compensation(fitted)


def _with_terms(closure: Closure, solution: FloatArray, terms: Sequence[InsTerms]) -> dict[str, FloatArray]:
    """Numbers of the declared model and of effects."""
    coefficients = _declared(closure, solution)
    for each in terms:
        for key, values in each.coefficients.items():
            is_sum = key in coefficients and key in _SUMMED
            coefficients[key] = _sum(coefficients[key], values) if is_sum else values
    return coefficients


def _sigma(
    stated: Mapping[str, FloatArray], drawn: Callable[[int], Mapping[str, FloatArray]]
) -> dict[str, FloatArray]:
    """Standard uncertainties of numbers, from those of each draw; limits have none."""
    draws = [drawn(index) for index in range(DRAWS)]
    sigma = {
        name: np.sqrt(np.mean([(each[name] - value) ** 2 for each in draws], axis=0))
        for name, value in stated.items()
    }
    return {name: value for name, value in sigma.items() if value.any()}


def _sum(coefficients: FloatArray, more: FloatArray) -> FloatArray:
    """Sum of coefficients; a shorter polynomial has zeros for the missing degrees."""
    if more.ndim == 1:
        return coefficients + more
    degree = max(coefficients.shape[1], more.shape[1])
    longer = [np.pad(each, ((0, 0), (0, degree - each.shape[1]))) for each in (coefficients, more)]
    return np.asarray(longer[0] + longer[1])


def _declared(closure: Closure, solution: FloatArray) -> dict[str, FloatArray]:
    """Polynomial in degrees Celsius and its limits, from (3, DEGREE + runs) coefficients."""
    powers = solution[:, :DEGREE] / SCALE_C ** np.arange(1, DEGREE + 1)
    constants = _constants(closure, solution).mean(axis=1, keepdims=True)
    gyro_c = closure.campaign.gyro_c[closure.searched]
    return {
        "polynomial_dph": np.concatenate([constants, powers], axis=1),
        "low_c": gyro_c.min(axis=0),
        "high_c": gyro_c.max(axis=0),
    }


def _constants(closure: Closure, solution: FloatArray) -> FloatArray:
    """Constants (3, runs) of the power cycles searched; a part of one dwell is not enough."""
    runs = np.unique(closure.campaign.run[closure.searched])
    return np.asarray(solution[:, DEGREE + runs])


def _constant_note(closure: Closure) -> str:
    constants = _constants(closure, closure.declared.declared)
    if constants.shape[1] < 2:
        return "the constant is that of the one power cycle searched: its scatter is not known"
    scatter_dph = float(np.sqrt(np.mean(np.var(constants, axis=1, ddof=1))))
    return (
        f"the constant is the mean of {constants.shape[1]} power cycles, which scatter by {scatter_dph:.2g} "
        "deg/h: expect the next one to differ by as much"
    )
