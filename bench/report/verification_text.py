"""Sentences and table rows of a verification."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from gyrobench.bench.closure.loadable_model import LoadableModel
from gyrobench.bench.closure.loop import NOT_SEARCHED
from gyrobench.bench.closure.outcome import Closure
from gyrobench.bench.closure.validation import LACK_OF_FIT_P
from gyrobench.bench.foundations.arrays import BoolArray
from gyrobench.bench.foundations.text import capitalised, counted, listed, plural, with_sigma
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.report.closure_text import found_labels
from gyrobench.bench.report.number_format import p_phrase, size_text
from gyrobench.bench.verification.coefficient_verification import CoefficientResult
from gyrobench.bench.verification.compensation_verification import (
    DECLARED,
    EFFECT,
    IN_WORDS,
    NONE,
    CompensationResult,
    VerificationResult,
    has_worse_constant,
    is_better,
    is_worse,
)
from gyrobench.bench.verification.measured_change import MeasuredChange
from gyrobench.bench.verification.run_residuals import VerificationRow
from gyrobench.drivers.ins.compensation import PARAMETER_NAMES

#: Names of the compensations as displayed.
LABELS = {NONE: "none", DECLARED: "declared", EFFECT: "with effect"}
_MODEL_NAMES = {DECLARED: "The declared model", EFFECT: "The model with the effects"}
#: Judgements of a verification.
CONFIRMED, IMPROVED, NOT_CONFIRMED, INCONCLUSIVE = "confirmed", "improved", "not confirmed", "inconclusive"

_BIAS_DEFINITION = (
    "Bias is the rms over all gyros including the constant of the power cycle, which changes at each "
    "power-on and can't be predicted. Varying is the same without each gyro's mean over the run. The spread "
    "between positions and the 24 h of a rotational INS do not depend on the constant, the velocity East "
    "does."
)
_NOISE_DEFINITION = (
    "Noise is the value expected from the uncertainty of the measurement alone: the rms, or the median of a "
    "maximum; over all plateaus, that of the plateau with the largest value. The compensation's own "
    "uncertainty, from the noise of the campaign, is stated beside it."
)
_DAY_DEFINITION = (
    "24 h is the largest position error within a day at rest of a dual-axis rotational INS with these "
    "biases. It turns through all six positions, each at two azimuths half a turn apart, with rests of 3 min."
)
_DO_NOT_LOAD = {
    DECLARED: "do not load this model alone, it makes this unit worse",
    EFFECT: "do not load this model, it makes this unit worse",
}
_SAME_SEED_TEXT = (
    "All runs had the same emulated world and seed, different from the campaign: they have the same "
    "constants of the power cycle, and the same noise as long as their times agree."
)
_OTHER_POWER_CYCLES_TEXT = (
    "Each run had a separate power cycle and noise: runs also differ by the noise stated here, and in bias "
    "and velocity by the constant of the power cycle."
)


def model_sentences(
    closure: Closure, models: Mapping[str, LoadableModel], searches: Sequence[Closure] = ()
) -> list[str]:
    """The compensations to load, and the part of the model that an INS can't subtract.

    ``searches``: searches in other coefficients.
    """
    declared = models[DECLARED].compensation
    low_c, high_c = declared.low_c.min(), declared.high_c.max()
    fitted_range = f"the fitted range, {low_c:z.0f} to {high_c:z.0f} °C."
    is_limited = models[DECLARED].is_limited
    limits = f"Temperatures are {'' if is_limited else 'not '}limited to {fitted_range}"
    if EFFECT in models:
        effects = listed([closure.label(name) for name in models[EFFECT].effects])
        summary = (
            f"Two compensations: the declared model (a polynomial for each gyro), and one with {effects}."
        )
    elif closure.effects:
        summary = f"One compensation, the declared model. No INS term exists for {found_labels(closure)}."
    elif any(each.effects for each in searches):
        summary = "One compensation, the declared model."
    else:
        verb = "searched" if closure.verdict == NOT_SEARCHED else "found"
        summary = f"One compensation, the declared model. No effect was {verb}."
    notes = models[EFFECT].notes if EFFECT in models else models[DECLARED].notes
    return [f"{summary} {limits}", *(f"{capitalised(note)}." for note in notes)]


def compensation_rows(models: Mapping[str, LoadableModel]) -> list[list[str]]:
    """Rows of the most complete compensation: name, number with standard uncertainty for x, y and z."""
    compensation = models.get(EFFECT, models[DECLARED]).compensation
    rows = []
    for name in (each for each in PARAMETER_NAMES if each in compensation.sigma):
        numbers = getattr(compensation, name), compensation.sigma[name]
        components = list(zip(*(each.reshape(3, -1).T for each in numbers), strict=True))
        for index, (values, sigmas) in enumerate(components):
            component = (
                f", T^{index}" if name == "polynomial_dph" else f", {AXES[index]}" if components[1:] else ""
            )
            pairs = zip(values, sigmas, strict=True)
            rows.append(
                [name + component, *(with_sigma(float(value), float(sigma)) for value, sigma in pairs)]
            )
    return rows


def outcome(result: VerificationResult) -> str:
    """Judgement of the most complete compensation measured, from its varying bias or all coefficients."""
    if len(result.results) < 2:
        return INCONCLUSIVE
    if result.coefficients:
        first, *_, last = result.coefficients
        if not last.is_better_than(first) or is_worse(result.results[-1], result.results[0]):
            return NOT_CONFIRMED
        return CONFIRMED if last.noise_p_value >= LACK_OF_FIT_P else IMPROVED
    before, after = _best_reference(result), result.results[-1]
    if not after.total.dwells:
        return INCONCLUSIVE
    is_noise = after.total.varying_p_value >= LACK_OF_FIT_P
    if not is_better(after, before):
        return INCONCLUSIVE if is_noise else NOT_CONFIRMED
    return CONFIRMED if is_noise else IMPROVED


def _best_reference(result: VerificationResult) -> CompensationResult:
    """The run with the smallest varying bias before the last one, to which the last one is compared."""
    return min(result.results[:-1], key=lambda each: each.total.varying_rms_dph)


def outcome_sentence(result: VerificationResult) -> str:
    """The values behind the judgement."""
    if len(result.results) < 2:
        return (
            f"Only the run {with_compensation(result.results[0])} was measured. Measure another one to "
            "compare."
        )
    if result.coefficients:
        ratios = [
            f"{each.ratio:.{0 if each.ratio >= 10.0 else 1}f} {with_compensation(each)}"
            for each in result.coefficients
        ]
        ratio = (
            f"Coefficients but the gyros' biases, rms in times the noise of the measurement: "
            f"{listed(ratios)} ({p_phrase(result.coefficients[-1].noise_p_value)} for noise of measurement "
            "and compensation)."
        )
        return " ".join([ratio, *degradation_sentences(result), *loading_problem_sentences(result)])
    last = result.results[-1]
    if not last.total.dwells:
        return "No dwell is valid in all runs, so the compensations can't be compared."
    first, *others = [
        f"{size_text(each.total.varying_rms_dph)} deg/h{{}} {with_compensation(each)}"
        for each in result.results
    ]
    sizes = (
        f"Varying bias: {', '.join([first.format(' rms'), *(each.format('') for each in others)])}; noise "
        f"{size_text(last.total.bias_noise_dph)} deg/h."
    )
    remarks = [*degradation_sentences(result), *loading_problem_sentences(result)]
    return " ".join([sizes, *remarks, _judgement_sentence(result)])


def _judgement_sentence(result: VerificationResult) -> str:
    before, after = _best_reference(result), result.results[-1]
    p = p_phrase(after.total.varying_p_value)
    match outcome(result):
        case "confirmed":
            return f"The residual {with_compensation(after)} is consistent with noise ({p})."
        case "improved":
            residual = f"The residual {with_compensation(after)} exceeds the noise ({p})"
            if not after.total.agreement_p_value >= LACK_OF_FIT_P:  # NaN if unknown
                return f"{residual}."
            explained = p_phrase(after.total.agreement_p_value)
            return f"{residual}; the uncertainty of the compensation itself explains that ({explained})."
        case "not confirmed":
            return f"The new measurements show no improvement {with_compensation(after)} beyond the noise."
        case _ if before.total.varying_p_value < LACK_OF_FIT_P:
            return (
                f"The residual {with_compensation(after)} is consistent with noise ({p}), but so is its "
                f"difference from that {with_compensation(before)}. Measure more dwells."
            )
        case _ if len(result.results) == 2:
            return "Both residuals are consistent with noise."
        case _:
            return (
                f"The residuals {with_compensation(before)} and {with_compensation(after)} are consistent "
                "with noise."
            )


def degradation_sentences(result: VerificationResult) -> list[str]:
    """Compensations with which the varying bias is larger than without one, by more than the noise."""
    uncompensated = next((each for each in result.results if each.compensation == NONE), None)
    return [
        f"The varying bias is larger {with_compensation(each)} than {with_compensation(uncompensated)} "
        f"({size_text(each.total.varying_rms_dph)} against {size_text(uncompensated.total.varying_rms_dph)} "
        f"deg/h): {_DO_NOT_LOAD[each.compensation]}."
        for each in result.results
        if uncompensated is not None and each is not uncompensated and is_worse(each, uncompensated)
    ]


def loading_problem_sentences(result: VerificationResult) -> list[str]:
    """Gyros whose bias did not change by the loaded compensation, and constants that do not fit."""
    sentences = []
    reference = result.results[0]
    for each in result.results[1:]:
        change = each.changes.get(reference.compensation)
        if change is not None and change.contradicts.any():
            sentences.append(
                f"From the run {with_compensation(reference)} to that {with_compensation(each)} the bias "
                f"changed by {_factors_text(change, change.contradicts)} times what was loaded: check that "
                "the INS applies the compensation once, and axes, signs and units of "
                "ins.commands.load_compensation."
            )
        if reference.compensation == NONE and has_worse_constant(each, reference):
            sentences.append(
                f"Including the constant the bias is {size_text(each.total.bias_rms_dph)} deg/h "
                f"{with_compensation(each)} and {size_text(reference.total.bias_rms_dph)} deg/h "
                f"{with_compensation(reference)}: the constant loaded does not fit this power cycle. "
                "Check its sign, and repeat the campaign over several power cycles."
            )
    return sentences


def _factors_text(change: MeasuredChange, is_selected: BoolArray) -> str:
    """Factors of the selected gyros (3,): "0.02 ± 0.05 (x) and -1.01 ± 0.03 (y)"."""
    return listed(
        [
            f"{with_sigma(float(change.factors[axis]), float(change.sigmas[axis]))} ({AXES[axis]})"
            for axis in np.flatnonzero(is_selected)
        ]
    )


def change_sentences(result: VerificationResult) -> list[str]:
    """New conditions, missing plateaus and dwells, notes, uncertainty, and the change of each quantity."""
    totals = [each.total for each in result.results]
    last = totals[-1]
    dwells = "all dwells" if len(totals) < 2 or result.is_complete else "the dwells compared"
    bias, _, spread, velocity, position = (each.fields for each in _SIZES)
    quantities: list[tuple[str, tuple[str, str], Callable[[float], str]]] = [
        (f"Bias in deg/h, rms over {dwells}, including the constant of the power cycle", bias, size_text),
        ("Largest difference between positions in deg/h", spread, size_text),
        ("Largest error of the velocity East in mm/s", velocity, lambda mps: f"{1000.0 * mps:.1f}"),
        ("Largest position error of a rotational INS in nmi", position, "{:.2f}".format),
    ]
    sentences = [
        new_conditions_sentence(result),
        *comparability_sentences(result),
        *result.notes,
        *_change_ratio_sentences(result),
        *_model_uncertainty_sentences(result),
    ]
    for quantity, (size, noise), text in quantities:
        sizes = [(getattr(each.total, size), with_compensation(each)) for each in result.results]
        if all(value >= 0.0 for value, _ in sizes):
            values = [f"{text(value)} {phrase}" for value, phrase in sizes]
            sentences.append(f"{quantity}: {listed(values)}; noise {text(getattr(last, noise))}.")
    return sentences


def comparability_sentences(result: VerificationResult) -> list[str]:
    """Plateaus and dwells that are not compared because some runs lack them; empty list if none."""
    sentences = []
    for plateau in result.plateaus:
        runs_without_it = [
            with_compensation(each)
            for each, row in zip(result.results, plateau.rows, strict=True)
            if row is None
        ]
        first = plateau.measured_rows[0]
        if runs_without_it:
            sentences.append(
                f"The plateau at {first.gyro_c:z.0f} °C (cycle {first.cycle}) has no valid dwell "
                f"{listed(runs_without_it)}: it is not part of the numbers for all plateaus."
            )
    valid = min(each.total.dwells for each in result.results)
    if len(result.results) > 1 and valid < result.dwells:
        sentences.append(
            f"{valid} of {counted(result.dwells, 'dwell')} {plural(valid, 'is', 'are')} valid in all runs; "
            f"only {plural(valid, 'this one is', 'these are')} compared."
        )
    missions = [mission for each in result.coefficients for mission in each.missions]
    compared = {mission.plateau for mission in missions if mission.is_in_all}
    if any(not mission.is_in_all for mission in missions):
        sentences.append(
            f"Coefficients are compared at the {counted(len(compared), 'plateau')} that all runs measured."
        )
    return sentences


def _change_ratio_sentences(result: VerificationResult) -> list[str]:
    """Ratio of measured to loaded change of each compensation, if the data determine it."""
    reference, *others = result.results
    changes = [(each, each.changes.get(reference.compensation)) for each in others]
    return [
        f"From the run {with_compensation(reference)} to that {with_compensation(each)} the varying bias "
        f"changed by {_factors_text(change, np.isfinite(change.factors))} times what the loaded compensation "
        "subtracts."
        for each, change in changes
        if change is not None and np.isfinite(change.factors).any()
    ]


def _model_uncertainty_sentences(result: VerificationResult) -> list[str]:
    """The uncertainty of each compensation, and whether the remaining bias agrees with it."""
    sentences = []
    for total in (each.total for each in result.results if each.total.compensation_sigma_dph >= 0.0):
        verb = "agrees with" if total.agreement_p_value >= LACK_OF_FIT_P else "exceeds"
        sentences.append(
            f"{_MODEL_NAMES[total.compensation]} has a standard uncertainty of "
            f"{size_text(total.compensation_sigma_dph)} deg/h in the varying bias. What remains "
            f"{verb} that and the noise ({p_phrase(total.agreement_p_value)})."
        )
    return sentences


def definition_sentences(result: VerificationResult) -> list[str]:
    """Definitions of the numbers."""
    day = [_DAY_DEFINITION] if _SIZES[-1] in _measured_sizes(result) else []
    return [
        _BIAS_DEFINITION,
        _NOISE_DEFINITION,
        *day,
        _SAME_SEED_TEXT if result.is_same_seed else _OTHER_POWER_CYCLES_TEXT,
    ]


def new_conditions_sentence(result: VerificationResult) -> str:
    """Temperatures and attitudes of the new measurements that were not in the fit."""
    rows = [plateau.measured_rows[0] for plateau in result.plateaus]
    new = [row for row in rows if row.fit != "fitted"]
    temperatures = listed([f"{row.gyro_c:z.0f} °C" for row in new])
    conditions = plural(len(new), "is at a gyro temperature that was", "are at gyro temperatures that were")
    return (
        f"All measurements are new. {len(new)} of {counted(len(rows), 'plateau')} {conditions} not fitted"
        f"{f' ({temperatures})' if new else ''}. {result.new_attitudes} of {counted(result.dwells, 'dwell')} "
        f"{plural(result.new_attitudes, 'begins', 'begin')} in a position and azimuth that are not in the "
        "campaign."
    )


def with_compensation(result: CompensationResult | CoefficientResult) -> str:
    """A compensation in a sentence: "with the declared model"."""
    return IN_WORDS[result.compensation]


class _Size(NamedTuple):
    """Quantity of a verification: column of its tables."""

    head: str
    unit: str
    fields: tuple[str, str]  #: Names of the fields of the size and of its noise.
    factor: float  #: Factor from the unit of the fields to ``unit``.
    decimals: int


_SIZES = (
    _Size("bias", "0.001 deg/h", ("bias_rms_dph", "bias_noise_dph"), 1000.0, 2),
    _Size("varying", "0.001 deg/h", ("varying_rms_dph", "bias_noise_dph"), 1000.0, 2),
    _Size("spread", "0.001 deg/h", ("spread_dph", "spread_noise_dph"), 1000.0, 2),
    _Size("V_E", "mm/s", ("velocity_east_mps", "velocity_noise_mps"), 1000.0, 1),
    _Size("24 h", "nmi", ("position_nmi", "position_noise_nmi"), 1.0, 2),
)


def _measured_sizes(result: VerificationResult) -> list[_Size]:
    """Sizes with a value at any plateau; on ramps, each plateau has only one position and no spread."""
    rows = [row for each in result.results for row in (*each.rows, each.total)]
    return [size for size in _SIZES if any(math.isfinite(getattr(row, size.fields[0])) for row in rows)]


def size_heads(result: VerificationResult) -> list[str]:
    """Column heads of the sizes measured."""
    return [size.head for size in _measured_sizes(result)]


def size_units(result: VerificationResult) -> str:
    """Units of the sizes measured: "bias and varying in 0.001 deg/h, 24 h in nmi"."""
    heads: dict[str, list[str]] = {}
    for size in _measured_sizes(result):
        heads.setdefault(size.unit, []).append(size.head)
    return ", ".join(f"{listed(names)} in {unit}" for unit, names in heads.items())


def total_rows(result: VerificationResult) -> list[list[str]]:
    """Rows of compensation and sizes over all plateaus, followed by the noise."""
    sizes, totals = _measured_sizes(result), [each.total for each in result.results]
    rows = [[LABELS[row.compensation], *_cells(row, sizes)] for row in totals]
    return [*rows, ["noise", *_cells(totals[-1], sizes, is_noise=True)]]


def plateau_rows(result: VerificationResult) -> list[list[str]]:
    """Rows of temperature, cycle, fit, compensation and sizes for each plateau, followed by its noise.

    The cells of a run without the plateau are empty.
    """
    sizes, rows = _measured_sizes(result), []
    for plateau in result.plateaus:
        first = plateau.measured_rows[0]
        value_rows = [
            [LABELS[each.compensation], *([""] * len(sizes) if row is None else _cells(row, sizes))]
            for each, row in zip(result.results, plateau.rows, strict=True)
        ]
        noise = [_cells(plateau.noise_row(size.fields[0]), [size], is_noise=True)[0] for size in sizes]
        plateau_cells = [f"{first.gyro_c:z.0f}", f"{first.cycle}", first.fit]
        for cells in [*value_rows, ["noise", *noise]]:
            rows.append([*plateau_cells, *cells])
            plateau_cells = [""] * len(plateau_cells)
    return rows


def _cells(row: VerificationRow, sizes: Sequence[_Size], is_noise: bool = False) -> list[str]:
    values = [size.factor * getattr(row, size.fields[is_noise]) for size in sizes]
    return [
        "" if math.isnan(value) else f"{value:.{size.decimals}f}"
        for size, value in zip(sizes, values, strict=True)
    ]
