"""The part of a bias model that an INS can subtract, and notes on the part that it can't."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from gyrobench.bench.closure.effects.effect import FittedForm
from gyrobench.bench.closure.loop import Closure, FoundEffect
from gyrobench.bench.closure.problem import DEGREE, SCALE_C
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.drivers.ins.command_map import Compensation

#: Coefficients that several effects may contribute to.
_SUMMED = ("polynomial_dph", "gradient_dph_per_k")
_COEFFICIENTS = {each.name for each in fields(Compensation)}


@dataclass(frozen=True, eq=False)
class LoadableModel:
    """A bias model as an INS can subtract it."""

    compensation: Compensation  #: Limited to the temperatures, rates and differences that were fitted.
    effects: tuple[str, ...]  #: Names of the effects in it.
    notes: tuple[str, ...]  #: What of the model is not in it, or only in part; sentences without a period.


def declared_model(closure: Closure) -> LoadableModel:
    """The declared model alone: a polynomial for each gyro.

    Its constant is the mean over the power cycles searched: the best estimate for the next one.
    """
    coefficients = _declared(closure, closure.declared.declared)
    return LoadableModel(Compensation(**coefficients), (), (_constant_note(closure),))


def model_with_effects(closure: Closure) -> LoadableModel:
    """The model with the effects found, as far as an INS can subtract them.

    Raises MeasurementError if an effect of another package names a coefficient that an INS does not have.
    """
    coefficients = _declared(closure, closure.model.declared)
    loaded, notes = [], [_constant_note(closure)]
    for found in closure.effects:
        name = found.effect.name
        terms = found.effect.compensation(_fitted(closure, found))
        if terms.left_out:
            notes.append(f"{name} is left out: {terms.left_out}")
            continue
        unknown = sorted(terms.coefficients.keys() - _COEFFICIENTS)
        if unknown:
            raise MeasurementError(
                f"the effect {name!r} is compensated by {', '.join(unknown)}, which no INS has. Report this "
                "to the author of the effect"
            )
        loaded.append(name)
        for key, values in terms.coefficients.items():
            is_sum = key in coefficients and key in _SUMMED
            coefficients[key] = _sum(coefficients[key], values) if is_sum else values
        if terms.note:
            notes.append(f"{name} is {terms.note}")
        if found.tied_with:
            notes.append(f"{name} is loaded, but {' or '.join(found.tied_with)} fits the data equally well")
    return LoadableModel(Compensation(**coefficients), tuple(loaded), tuple(notes))


def _fitted(closure: Closure, found: FoundEffect) -> FittedForm:
    candidate = found.candidate
    return FittedForm(closure.campaign, closure.searched, candidate.form, candidate.values, found.sizes_dph)


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
