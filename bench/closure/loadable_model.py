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
from gyrobench.bench.foundations.arrays import FloatArray, rms
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.text import listed, plain_name
from gyrobench.drivers.ins.compensation import CORRECTION_DEGREE, PARAMETER_NAMES, Compensation, Correction

#: Terms that an INS has also for coefficients other than gyro biases, with their names for gyro biases.
_TERMS_OF_COEFFICIENTS = {"polynomial_dph", "rate_dph_per_c_per_h", "rate_limit_c_per_h", "gravity_dph_per_g"}
#: Elements of the sensors' matrix that follow gravity at rest like the biases of a quantity.
_FOLLOWS_GRAVITY = {"accelerometer_bias": ("accelerometer_scale", "accelerometer_misalignment")}
#: Coefficients to which several effects may contribute.
_SUMMED = ("polynomial_dph", "gradient_dph_per_k", "rate_dph_per_c_per_h")


@dataclass(frozen=True, eq=False)
class LoadableModel:
    """The part of a bias model that an INS can subtract."""

    #: Limited to the temperatures, rates and differences that were fitted, with standard uncertainties.
    compensation: Compensation
    effects: tuple[str, ...]  #: Names of the effects included.
    notes: tuple[str, ...]  #: Parts of the model that are left out or only partly included; without a period.
    is_limited: bool = True  #: Whether the INS gets the temperature limits; without them it extrapolates.


def declared_model(closure: Closure) -> LoadableModel:
    """Loadable form of the declared model: a polynomial for each gyro.

    Its constant is the mean over the power cycles searched, which is the best estimate for the next one.
    """
    coefficients = _declared_coefficients(closure, closure.declared.declared)
    sigma = _sigma(
        coefficients, lambda index: _declared_coefficients(closure, closure.declared_draws.declared[index])
    )
    return LoadableModel(_compensation(coefficients, sigma), (), (_constant_note(closure),))


def model_with_effects(closure: Closure) -> LoadableModel:
    """Loadable form of the model with the effects found, as far as an INS can subtract them.

    Of an effect without a term the constant gets the mean over the dwells searched. The rest of the joint fit
    can be worse without that effect than the declared model, which is then loaded.

    Raises MeasurementError if an effect of another package names a coefficient that an INS does not have.
    """
    of_effects = [_ins_terms(closure, each) for each in closure.effects]
    loaded, left_out, notes = [], [], []
    for found, terms in zip(closure.effects, of_effects, strict=True):
        name = found.effect.display_name
        if terms.left_out:
            left_out.append(f"{name} is left out: {terms.left_out}")
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
        if note := _form_note(found):
            notes.append(note)
    if note := _set_note(closure):
        notes.append(note)
    if refusal := _refusal(closure, of_effects):
        declared = declared_model(closure)
        return replace(declared, notes=(*declared.notes, *left_out, refusal))
    coefficients = _coefficients(closure, closure.model.declared, of_effects)
    draws = closure.model_draws

    def coefficients_of_draw(index: int) -> dict[str, FloatArray]:
        terms = [_ins_terms(closure, each, draws, index) for each in closure.effects]
        return _coefficients(closure, draws.declared[index], terms)

    compensation = _compensation(coefficients, _sigma(coefficients, coefficients_of_draw))
    notes = [_constant_note(closure), *left_out, *notes]
    return LoadableModel(compensation, tuple(each.effect.name for each in loaded), tuple(notes))


def with_coefficients(model: LoadableModel, closures: Iterable[Closure], *, effects: bool) -> LoadableModel:
    """Model of the gyro biases, with models of other coefficients added as far as an INS can subtract them.

    ``closures``: searches of these coefficients. ``effects``: whether to include the effects that they found.
    A coefficient without effects keeps the polynomial that ``model`` already has, which rests on more data
    than a search.
    """
    corrections = dict(model.compensation.coefficients)
    rate_limit, names, notes = (
        model.compensation.rate_limit_c_per_h.copy(),
        list(model.effects),
        list(model.notes),
    )
    for closure in closures:
        quantity, of_effects, loaded = closure.quantity, [], []
        for effect in closure.effects if effects else ():
            terms = _ins_terms(closure, effect)
            label = f"{effect.effect.display_name} in the {plain_name(quantity.name)}"
            is_gravity = (
                effect.effect.as_misalignment is not None or "gravity_dph_per_g" in terms.coefficients
            )
            if is_gravity and any(
                each.startswith(_FOLLOWS_GRAVITY.get(quantity.name, ())) for each in corrections
            ):
                notes.append(
                    f"the effect {label} is left out: scale factors and misalignments compensate it already"
                )
                continue
            degree = terms.coefficients.get("polynomial_dph", np.zeros((3, 1))).shape[1] - 1
            if terms.coefficients.keys() - _TERMS_OF_COEFFICIENTS or degree > CORRECTION_DEGREE:
                terms = _left_out(_fitted(closure, effect), "the INS has no term for it there")
            if terms.left_out:
                notes.append(f"the effect {label} is left out: {terms.left_out}")
            else:
                loaded.append(f"{effect.effect.name} in {quantity.name}")
            of_effects.append(terms)
        solution = (closure.model if effects else closure.declared).declared
        if refusal := _refusal(closure, of_effects):
            notes.append(f"{plain_name(quantity.name)}: {refusal}")
            solution, of_effects, loaded = closure.declared.declared, [], []
        names.extend(loaded)
        coefficients = _coefficients(closure, solution, of_effects)
        np.maximum.at(rate_limit, list(quantity.sensors), coefficients.get("rate_limit_c_per_h", np.zeros(3)))
        rates = coefficients.get("rate_dph_per_c_per_h", np.zeros(3))
        gravity = coefficients.get("gravity_dph_per_g", np.zeros((3, 3)))
        is_measured = closure.campaign.is_measured[closure.searched]
        gyro_c = closure.campaign.gyro_c[closure.searched]
        for index, coefficient in enumerate(quantity.coefficients):
            measured_c = gyro_c[is_measured[:, index], index]
            if len(measured_c) and (loaded or coefficient not in corrections):
                corrections[coefficient] = Correction(
                    coefficients["polynomial_dph"][index],
                    float(rates[index]),
                    gravity[index],
                    (float(measured_c.min()), float(measured_c.max())),
                )
    compensation = replace(model.compensation, coefficients=corrections, rate_limit_c_per_h=rate_limit)
    return replace(model, compensation=compensation, effects=tuple(names), notes=tuple(notes))


def _compensation(coefficients: Mapping[str, FloatArray], sigma: Mapping[str, FloatArray]) -> Compensation:
    arguments: dict[str, Any] = {**coefficients, "sigma": sigma}
    return Compensation(**arguments)


def _fitted(closure: Closure, effect: FoundEffect, draws: Draws | None = None, index: int = 0) -> FittedForm:
    """An effect as fitted, or in one draw."""
    candidate, name = effect.candidate, effect.effect.name
    values, sizes = candidate.values, effect.sizes_dph
    if draws is not None:
        values, sizes = tuple(draws.values[name][index].tolist()), draws.sizes_dph[name][index]
    return FittedForm(closure.campaign, closure.searched, candidate.form, values, sizes)


def _ins_terms(closure: Closure, effect: FoundEffect, draws: Draws | None = None, index: int = 0) -> InsTerms:
    """Terms with which an INS subtracts an effect: as fitted, or for one draw."""
    fitted = _fitted(closure, effect, draws, index)
    terms = effect.effect.compensation(fitted)
    return _left_out(fitted, terms.left_out) if terms.left_out else terms


def _left_out(fitted: FittedForm, reason: str) -> InsTerms:
    """Terms of an effect that is left out: its mean over the dwells searched, as a constant."""
    bias_dph = fitted.bias_dph
    mean_dph = bias_dph[fitted.searched].mean(axis=0)
    return InsTerms({"polynomial_dph": mean_dph[:, np.newaxis]}, left_out=reason, residual_dph=bias_dph)


def _refusal(closure: Closure, terms: Sequence[InsTerms]) -> str:
    """Note why no effect is loaded: effects are left out, and the declared model leaves less; or empty."""
    if not any(each.left_out for each in terms):
        return ""
    declared_dph, loaded_dph = _residuals_dph(closure, terms)
    if loaded_dph < declared_dph:
        return ""
    unit = closure.quantity.unit
    return (
        f"no effect is loaded: the terms of the INS would leave {loaded_dph:.2g} {unit} rms of the fitted "
        f"model, the declared model leaves {declared_dph:.2g} {unit}"
    )


def _residuals_dph(closure: Closure, terms: Iterable[InsTerms]) -> tuple[float, float]:
    """Rms of what the declared model and the terms of all effects leave of the joint model, deg/h.

    In the dwells searched, without the mean of each power cycle, which has a separate constant.
    """
    searched = closure.searched
    in_run = closure.campaign.run[searched, np.newaxis] == np.unique(closure.campaign.run[searched])
    means = (in_run / in_run.sum(axis=0)).T

    def varying_rms(bias_dph: FloatArray) -> float:
        return rms(bias_dph[searched] - in_run @ (means @ bias_dph[searched]))

    model_dph = closure.model.bias_dph
    left_dph = sum((each.residual_dph for each in terms), np.zeros_like(model_dph))
    return varying_rms(model_dph - closure.declared.bias_dph), varying_rms(left_dph)


def _coefficients(closure: Closure, solution: FloatArray, terms: Sequence[InsTerms]) -> dict[str, FloatArray]:
    """Coefficients of the declared model and of effects."""
    coefficients = _declared_coefficients(closure, solution)
    for each in terms:
        for key, values in each.coefficients.items():
            is_sum = key in coefficients and key in _SUMMED
            coefficients[key] = _sum(coefficients[key], values) if is_sum else values
    return coefficients


def _sigma(
    stated: Mapping[str, FloatArray], coefficients_of_draw: Callable[[int], Mapping[str, FloatArray]]
) -> dict[str, FloatArray]:
    """Standard uncertainties of coefficients, from their values in each draw; limits have none."""
    draws = [coefficients_of_draw(index) for index in range(DRAWS)]
    sigma = {
        name: np.sqrt(np.mean([(each[name] - value) ** 2 for each in draws], axis=0))
        for name, value in stated.items()
    }
    return {name: value for name, value in sigma.items() if value.any()}


def _sum(coefficients: FloatArray, added: FloatArray) -> FloatArray:
    """Sum of coefficients; a shorter polynomial has zeros for the missing degrees."""
    if added.ndim == 1:
        return coefficients + added
    degree = max(coefficients.shape[1], added.shape[1])
    padded = [np.pad(each, ((0, 0), (0, degree - each.shape[1]))) for each in (coefficients, added)]
    return np.asarray(padded[0] + padded[1])


def _declared_coefficients(closure: Closure, solution: FloatArray) -> dict[str, FloatArray]:
    """Polynomial in degrees Celsius and its temperature limits, from coefficients (3, DEGREE + runs)."""
    powers = solution[:, :DEGREE] / SCALE_C ** np.arange(1, DEGREE + 1)
    constants = _constants(closure, solution).mean(axis=1, keepdims=True)
    gyro_c = closure.campaign.gyro_c[closure.searched]
    return {
        "polynomial_dph": np.concatenate([constants, powers], axis=1),
        "low_c": gyro_c.min(axis=0),
        "high_c": gyro_c.max(axis=0),
    }


def _constants(closure: Closure, solution: FloatArray) -> FloatArray:
    """Constants (3, runs) of the power cycles searched that have at least one whole dwell."""
    runs = np.unique(closure.campaign.run[closure.searched])
    return np.asarray(solution[:, DEGREE + runs])


def _form_note(found: FoundEffect) -> str:
    """Note on a form that is more probable than the loaded one; empty without one."""
    other = next(iter(found.other_forms), None)
    if other is None or other.probability <= found.form_probability:
        return ""
    change = f"{other.difference_dph:.2g} {found.quantity.unit}"
    return (
        f"{found.effect.display_name} is loaded with the form {found.candidate.form.name}, which has the "
        f"smallest BIC (P = {found.form_probability:.2f}), though {other.candidate.form.name} is more "
        f"probable (P = {other.probability:.2f}); that changes the bias by at most {change}, "
        f"in dwell {other.dwell}: repeat that dwell with those before it to decide"
    )


def _set_note(closure: Closure) -> str:
    """Note on effects with which the loaded ones are more probable; empty without any."""
    posterior, names = closure.posterior, frozenset(closure.names)
    best = next(each for each in posterior.hypotheses if not each.has_remainder)
    added = [each for each in closure.evidence if each.effect.name in best.names - names]
    probability = posterior.set_probability(names)
    if not names or not names < best.names or best.probability <= probability:
        return ""
    labels, is_one = listed([each.effect.display_name for each in added]), len(added) == 1
    reasons = [
        text for each in added for text in (each.rejected, f"to decide, {each.effect.experiment}") if text
    ]
    return (
        f"{labels} {'is' if is_one else 'are'} not loaded, though the effects found are more probable with "
        f"{'it' if is_one else 'them'} (P = {best.probability:.2g}) than alone (P = {probability:.2g}): "
        f"{'; '.join(reasons)}"
    )


def _constant_note(closure: Closure) -> str:
    constants = _constants(closure, closure.declared.declared)
    if constants.shape[1] < 2:
        return "the constant is that of the one power cycle searched: its scatter is not known"
    scatter_dph = float(np.sqrt(np.mean(np.var(constants, axis=1, ddof=1))))
    return (
        f"the constant is the mean of {constants.shape[1]} power cycles, which scatter by {scatter_dph:.2g} "
        "deg/h: expect the next one to differ by as much"
    )
