"""Closing the loop on one campaign: residual, effects, verdict, error before and after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.candidates import Candidate, Hypothesis, solve_with
from gyrobench.bench.closure.compose import Composed, compose
from gyrobench.bench.closure.confounding import confounding
from gyrobench.bench.closure.effects import all_effects
from gyrobench.bench.closure.effects.effect import Effect, Parameter
from gyrobench.bench.closure.noise import Noise
from gyrobench.bench.closure.posterior import CLEAN, EXPLAINED, Posterior, detectable_dph
from gyrobench.bench.closure.problem import DEGREE, Solution, declared_problem
from gyrobench.bench.closure.quantity import GYRO_BIAS, Quantity
from gyrobench.bench.closure.search import Search
from gyrobench.bench.closure.selection import NotAccepted, Selected, select
from gyrobench.bench.closure.uncertainty import Draws, bound_of, draw, interval
from gyrobench.bench.closure.validation import (
    LackOfFit,
    is_confirmed,
    lack_of_fit,
    leave_out_cycles,
    measured_minus,
)
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, rms, rms_of_known
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.text import counted, decimals_of, listed, plain_name, with_sigma

#: Verdict without a search.
NOT_SEARCHED = "not searched"
#: Fewest degrees of freedom of the three gyros together beside the declared model.
_MIN_DOF = 18
_S_PER_H = 3600.0
_UNITS = {"c": "degC"}
#: An interval is stated in place of a standard uncertainty if its middle is off by this share of its length.
_ASYMMETRY = 0.125


@dataclass(frozen=True)
class FoundEffect:
    """An effect found in the data."""

    candidate: Candidate  #: The effect, its form and parameters.
    sizes_dph: FloatArray  #: Shape (3, k). Size of each term for each gyro; zero for terms not used.
    axes: tuple[str, ...]  #: Which of :attr:`Quantity.axes` show it.
    p_value: float  #: Corrected for all candidate fits.
    candidate_fits: int  #: Their number.
    rms_dph: float  #: Its size in the dwells searched, without its mean.
    #: Share of the chi2 of each cycle that it explains, its size fitted to the other cycles; see
    #: :func:`gyrobench.bench.closure.validation.leave_out_cycles`.
    gains: dict[int, float]
    tied_with: tuple[str, ...]  #: Names of effects that fit equally well.
    probability: float  #: Of this effect in any set of effects.
    #: Standard uncertainties: shape (3, k) of the sizes, (p,) of the nonlinear parameters, and of the rms. A
    #: term that is not used has none.
    sizes_sigma_dph: FloatArray
    values_sigma: FloatArray
    rms_sigma_dph: float
    #: Interval that holds each nonlinear parameter with 95 %.
    values_range: tuple[tuple[float, float], ...]
    #: :attr:`Form.weights` (k,), and the standard uncertainties of sizes times these, shape (3, k).
    weights: FloatArray
    weighted_sigma_dph: FloatArray
    quantity: Quantity = GYRO_BIAS  #: What shows it.

    @property
    def effect(self) -> Effect:
        """The effect."""
        return self.candidate.effect

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Names of the nonlinear parameters at a bound of the fit."""
        form, values = self.candidate.form, self.candidate.values
        return tuple(
            each.name for each, value in zip(form.parameters, values, strict=True) if bound_of(each, value)
        )

    @property
    def parameter_texts(self) -> tuple[str, ...]:
        """Each nonlinear parameter with its uncertainty: "tau 1.50 ± 0.08 h"."""
        form, values = self.candidate.form, self.candidate.values
        return tuple(
            _parameter_text(each, value, sigma, (low, high))
            for each, value, sigma, (low, high) in zip(
                form.parameters, values, self.values_sigma.tolist(), self.values_range, strict=True
            )
        )

    @property
    def statement(self) -> str:
        """One sentence: what the bias does, its size, the gyros and the parameters, with uncertainties."""
        parameters = "; ".join(self.parameter_texts)
        place, unit = self.quantity.place(self.axes), self.quantity.unit
        size = f"{with_sigma(self.rms_dph, self.rms_sigma_dph)} {unit} rms on the {place}"
        sentence = self.quantity.said(self.effect.statement)
        return f"{sentence[0].upper()}{sentence[1:]}: {size}{f' ({parameters})' if parameters else ''}."


@dataclass(frozen=True)
class Evidence:
    """How well one effect, alone, explains the residuals of the declared model."""

    effect: Effect  #: The effect.
    #: The input without which it was not fitted; then nothing else is known.
    missing_input: str | None = None
    candidate: Candidate | None = None  #: As fitted alone; None if not significant.
    #: Share of excess variance explained: 1 is all of the sum of squares beyond the noise. NaN if there is no
    #: excess.
    share: float = 0.0
    p_value: float = 1.0  #: Corrected for all candidate fits.
    #: Twice the logarithm of the odds of the effects found to this one alone.
    log_odds_against: float = np.nan
    rejected: str = ""  #: Why it is not found though significant alone or not improbable; empty otherwise.


@dataclass(frozen=True)
class Turn:
    """Outcome of a search with one cycle held out."""

    cycle: int  #: The cycle.
    verdict: str = ""  #: As in :class:`Closure`; empty if the cycle can't be held out.
    effects: tuple[str, ...] = ()  #: Names of the effects found.
    #: error_before_dph, error_after_dph, noise_dph: In the cycle, rms; see :class:`Closure`.
    error_before_dph: float = np.nan
    error_after_dph: float = np.nan
    noise_dph: float = np.nan
    reason: str = ""  #: Why it can't be held out.


@dataclass(frozen=True)
class Closure:
    """Outcome of a search."""

    campaign: Campaign  #: All dwells.
    searched: BoolArray  #: Shape (n,). Dwells used by the search; the others are held out.
    #: "clean", "explained", "ambiguous" or "unexplained"; "not searched" by :func:`without_search`.
    verdict: str
    effects: tuple[FoundEffect, ...]  #: Strongest first.
    evidence: tuple[Evidence, ...]  #: Of each effect alone.
    posterior: Posterior  #: Probabilities of all hypotheses.
    not_accepted: NotAccepted | None  #: The most probable set of effects, where none is found.
    detectable_dph: dict[str, float]  #: See :func:`gyrobench.bench.closure.posterior.detectable_dph`.
    #: before, after: Tests of the declared model, and with the effects.
    before: LackOfFit
    after: LackOfFit
    #: declared, model: The declared model, and with the effects.
    declared: Solution
    model: Solution
    noise_dph: float  #: Noise of a measured bias, rms.
    confounding: tuple[str, ...]  #: What the dwells searched can't distinguish, one sentence each.
    noise: Noise  #: Its ratio to the stated uncertainties, and the outliers.
    #: error_before_dph, error_after_dph: Rms of measured minus predicted bias in the held-out dwells; NaN
    #: where none are, as in a campaign of one cycle.
    error_before_dph: float
    error_after_dph: float
    #: error_before_sigma_dph, error_after_sigma_dph: Their standard uncertainties by the noise of the dwells.
    error_before_sigma_dph: float
    error_after_sigma_dph: float
    #: declared_draws, model_draws: Draws of the parameters of both models.
    declared_draws: Draws
    model_draws: Draws
    composed: Composed | None = None  #: Laws composed from the grammar; None if that was not asked for.
    rotation: tuple[Turn, ...] = ()  #: Each cycle held out in turn; empty if that was not asked for.
    #: Names of the laws found that were composed from held-out dwells, which can't confirm them.
    circular: tuple[str, ...] = ()

    @property
    def quantity(self) -> Quantity:
        """What was searched; its unit is that of all numbers in deg/h otherwise."""
        return self.campaign.quantity

    @property
    def noise_scale(self) -> float:
        """Ratio of the noise to the stated uncertainties."""
        return self.noise.scale

    @cached_property
    def prediction_sigma_dph(self) -> FloatArray:
        """Standard uncertainty of the bias by the model in all dwells (n, 3), deg/h.

        Without the scatter of the constants in a run that was not searched.
        """
        return self.model_draws.sigma(self.model_draws.bias_dph(self.campaign), self.model.bias_dph)

    def label(self, name: str) -> str:
        """Label of a candidate effect."""
        return next(
            (each.effect.display_name for each in self.evidence if each.effect.name == name), plain_name(name)
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects found."""
        return tuple(each.effect.name for each in self.effects)

    @property
    def probability(self) -> float:
        """Probability that all effects found are there; of nothing undeclared if there are none."""
        return self.posterior.of_all(self.names) if self.effects else self.posterior.nothing

    @property
    def separating_measurement(self) -> str | None:
        """The next measurement, which resolves the first tie; None without ties."""
        experiments = {each.effect.name: each.effect.experiment for each in self.evidence}
        for found in self.effects:
            if found.tied_with:
                other = found.tied_with[0]
                return (
                    f"To distinguish {found.effect.display_name} from {self.label(other)}: "
                    f"{found.effect.experiment}; for {self.label(other)}: {experiments[other]}."
                )
        return None

    @property
    def unexplained_part(self) -> str | None:
        """Size, position, temperatures and times of an unexplained residual; None without one."""
        if self.verdict != "unexplained":
            return None
        campaign, searched = self.campaign, self.searched
        residual = measured_minus(campaign, searched, self.model)[searched]
        squares = np.nansum(residual**2, axis=1)
        names = np.array(campaign.position)[searched]
        position = max(sorted(set(names)), key=lambda name: float(squares[names == name].mean()))
        low_c, high_c = _worst_span(campaign.gyro_c[searched].mean(axis=1), squares)
        low_h, high_h = _worst_span(campaign.middle_s[searched] / _S_PER_H, squares)
        return (
            f"The residual is {rms_of_known(residual):.2g} {self.quantity.unit} rms, "
            f"{self.after.noise_ratio:.1f} times the noise, and follows {self.after.follows}. It is largest "
            f"in position {plain_name(position)}, at {low_c:.0f} to {high_c:.0f} degC, and "
            f"at {low_h:.0f} to {high_h:.0f} h."
        )


def close_loop(
    campaign: Campaign, hold_out_cycles: Sequence[int] = (), effects: Sequence[Effect] | None = None
) -> Closure:
    """Search a campaign for effects that the declared model lacks.

    Raises MeasurementError if there is no such cycle, or too little is left without it. Raises DocumentError
    if an effect of another package or of a file can't be used.

    Parameters
    ----------
    campaign : Campaign
        The measured dwells.
    hold_out_cycles : sequence of int
        Cycles that the search does not use; by default :attr:`Campaign.last_cycle`, of one cycle none.
    effects : sequence of Effect, optional
        Candidates; by default all installed ones and those of the user's files.
    """
    sources = [Path(each.name) for each in campaign.tables]
    sensor = campaign.quantity.sensor
    candidates = all_effects(*sources, sensor=sensor) if effects is None else tuple(effects)
    searched = _searched(campaign, hold_out_cycles)
    campaign = campaign.holding_out(np.unique(campaign.cycle[~searched]).tolist())
    return _closure(campaign, searched, candidates)


def without_search(campaign: Campaign) -> Closure:
    """The declared model fitted to all dwells, with the verdict "not searched".

    For a campaign of one cycle, where none can be held out. Raises MeasurementError if it has too few dwells.
    """
    return replace(_closure(campaign, _searched(campaign, ()), ()), verdict=NOT_SEARCHED)


def _closure(campaign: Campaign, searched: BoolArray, candidates: Sequence[Effect]) -> Closure:
    """Search the dwells ``searched`` (n,); the errors in the others are NaN where there are none."""
    selected = select(campaign, searched, candidates)
    search, found, weighed, after = selected.search, selected.found, selected.posterior, selected.after
    problem = search.problem
    declared, model = (solve_with(problem, each) for each in ((), found.candidates))
    declared_draws, model_draws = (draw(problem, each) for each in ((), found.candidates))
    before_dph, after_dph = (
        measured_minus(campaign, searched, each)[~searched] for each in (declared, model)
    )
    noise_dph = campaign.sigma_dph[~searched] * problem.noise_scale
    held_out = campaign.part(~searched)
    circular = tuple(each.effect.name for each in found.candidates if _is_circular(each.effect, held_out))
    return Closure(
        campaign=campaign,
        searched=searched,
        verdict=_verdict(
            found,
            after,
            weighed,
            is_confirmed=bool(found.candidates)
            and not searched.all()
            and not circular
            and is_confirmed(before_dph, after_dph, noise_dph),
        ),
        circular=circular,
        posterior=weighed,
        not_accepted=selected.not_accepted,
        detectable_dph=detectable_dph(selected.with_effects),
        effects=_found_effects(search, found, model, model_draws, weighed),
        evidence=_evidence(selected),
        before=lack_of_fit(problem, 0),
        after=after,
        declared=declared,
        model=model,
        noise_dph=selected.noise.scale * rms_of_known(campaign.known_sigma_dph[searched]),
        confounding=confounding(campaign, searched),
        noise=selected.noise,
        error_before_dph=rms_of_known(before_dph),
        error_after_dph=rms_of_known(after_dph),
        error_before_sigma_dph=_rms_sigma(before_dph, noise_dph),
        error_after_sigma_dph=_rms_sigma(after_dph, noise_dph),
        declared_draws=declared_draws,
        model_draws=model_draws,
    )


def composed(closure: Closure) -> Closure:
    """Same closure with laws composed from the grammar of effects, where it is unexplained."""
    if closure.verdict != "unexplained":
        return closure
    problem = closure.noise.problem(closure.campaign, closure.searched)
    return replace(closure, composed=compose(problem, [each.candidate for each in closure.effects]))


def rotated(closure: Closure) -> Closure:
    """Same closure with the outcome of a search for each cycle, held out alone."""
    campaign, effects = closure.campaign, [each.effect for each in closure.evidence]
    return replace(closure, rotation=tuple(_turn(campaign, cycle, effects) for cycle in campaign.cycles))


def _turn(campaign: Campaign, cycle: int, effects: Sequence[Effect]) -> Turn:
    try:
        closure = close_loop(campaign, [cycle], effects)
    except MeasurementError as error:
        return Turn(cycle, reason=str(error))
    return Turn(
        cycle,
        closure.verdict,
        closure.names,
        closure.error_before_dph,
        closure.error_after_dph,
        closure.noise_scale * rms_of_known(campaign.known_sigma_dph[campaign.cycle == cycle]),
    )


def _searched(campaign: Campaign, hold_out_cycles: Sequence[int]) -> BoolArray:
    cycles = campaign.cycles
    held_out = list(hold_out_cycles) or [campaign.last_cycle] * (len(cycles) > 1)
    unknown = sorted(set(held_out) - set(cycles))
    if unknown:
        raise MeasurementError(
            f"there is no cycle {_numbers(unknown)} to hold out; the table has {_numbers(cycles)}"
        )
    if len(cycles) == len(set(held_out)):
        raise MeasurementError(
            f"with cycle {_numbers(held_out)} held out nothing remains to search. Measure the profile at "
            "least twice, preferably three times"
        )
    searched: BoolArray = ~np.isin(campaign.cycle, held_out)
    dof, row = declared_problem(campaign, searched).dof, campaign.quantity.row
    if dof < _MIN_DOF:
        without = f" without cycle {_numbers(held_out)}" if held_out else ""
        needed = _MIN_DOF // 3 + DEGREE + len(np.unique(campaign.run[searched]))
        raise MeasurementError(
            f"a cubic in temperature leaves {dof} degrees of freedom in {counted(int(searched.sum()), row)}"
            f"{without}, required: {_MIN_DOF}. Measure the profile at least twice, each time with {needed} "
            f"{row}s or more, at temperatures reached from below and from above"
        )
    return searched


def _verdict(found: Hypothesis, after: LackOfFit, weighed: Posterior, *, is_confirmed: bool) -> str:
    if after.is_significant or weighed.not_on_list > 0.5:
        return "unexplained"
    if not found.candidates:
        return "clean" if weighed.nothing >= CLEAN else "ambiguous"
    is_settled = weighed.of_all(found.names) >= EXPLAINED and not weighed.rivals(found.names)
    return "explained" if is_settled and is_confirmed else "ambiguous"


def _is_circular(effect: Effect, held_out: Campaign) -> bool:
    """Whether a law was composed from held-out dwells, or from their runs if its dwells are not known."""
    if effect.composed_from_dwells:
        return not set(effect.composed_from_dwells).isdisjoint(held_out.fingerprints)
    return not {held_out.run_names[run] for run in held_out.run}.isdisjoint(effect.composed_from)


def _found_effects(
    search: Search, found: Hypothesis, model: Solution, draws: Draws, weighed: Posterior
) -> tuple[FoundEffect, ...]:
    problem, quantity = search.problem, search.problem.campaign.quantity
    result = []
    for index, each in enumerate(found.candidates):
        sizes = model.sizes[index]
        left_out_cycles = leave_out_cycles(problem, found.without(each), found.candidates)
        part = np.einsum("ngk,gk->ng", each.columns(problem.campaign), sizes)[problem.searched]
        part = part - part.mean(axis=0)
        values, sizes_drawn = (drawn[each.effect.name] for drawn in (draws.values, draws.sizes_dph))
        parts = draws.effect_dph(problem.campaign, each.effect.name)[:, problem.searched]
        parts -= parts.mean(axis=1, keepdims=True)
        weights = each.form.weights(problem.campaign, each.values)
        weights_drawn = np.array([each.form.weights(problem.campaign, tuple(one)) for one in values])
        shows = search.shows(found, index)
        result.append(
            FoundEffect(
                candidate=each,
                sizes_dph=sizes,
                axes=tuple(axis for axis, seen in zip(quantity.axes, shows, strict=True) if seen),
                p_value=search.p_value(found, index),
                candidate_fits=search.candidate_fits(each.effect),
                rms_dph=rms(part),
                gains={cycle: left_out.gain for cycle, left_out in left_out_cycles.items()},
                tied_with=weighed.tied_with(found.names, each.effect.name),
                probability=weighed.of_all([each.effect.name], has_remainder=None),
                sizes_sigma_dph=draws.sigma(sizes_drawn, sizes),
                values_sigma=draws.sigma(values, np.array(each.values)),
                rms_sigma_dph=float(draws.sigma(np.sqrt(np.mean(parts**2, axis=(1, 2))), rms(part))),
                values_range=tuple(map(interval, each.form.parameters, each.values, values.T)),
                weights=weights,
                weighted_sigma_dph=draws.sigma(sizes_drawn * weights_drawn[:, None, :], sizes * weights),
                quantity=quantity,
            )
        )
    return tuple(sorted(result, key=lambda each: -each.rms_dph))


def _evidence(selected: Selected) -> tuple[Evidence, ...]:
    search, found = selected.search, selected.found
    problem = search.problem
    excess = problem.chi2 - problem.dof

    def odds(alone: Hypothesis) -> float:
        return search.evidences.log_odds(found, alone)

    result = []
    for effect in search.effects:
        alone = search.alone.get(effect.name)
        missing = effect.missing_input(problem.campaign)
        if missing:
            result.append(Evidence(effect, missing))
        elif alone is None:
            rejected = selected.rejection(effect)
            result.append(Evidence(effect, log_odds_against=odds(search.declared), rejected=rejected))
        else:
            share = (problem.chi2 - alone.chi2) / excess if excess > 0.0 else np.nan
            p_value, rejected = search.p_value(alone, 0), selected.rejection(effect)
            result.append(Evidence(effect, None, alone.candidates[0], share, p_value, odds(alone), rejected))
    return tuple(sorted(result, key=lambda each: (each.missing_input is not None, each.log_odds_against)))


def _parameter_text(parameter: Parameter, value: float, sigma: float, interval: tuple[float, float]) -> str:
    """Name, value and uncertainty with their unit; the interval where it is not symmetric, or at a bound."""
    words, _, unit = parameter.name.replace("_", " ").rpartition(" ")
    factor = 1.0
    if unit == "s" and abs(value) >= _S_PER_H:
        factor, unit = _S_PER_H, "h"
    unit = _UNITS.get(unit, unit)
    low, high = interval
    end = bound_of(parameter, value)
    if not end and abs(0.5 * (low + high) - value) <= _ASYMMETRY * (high - low):
        return f"{words} {with_sigma(value / factor, sigma / factor)} {unit}"
    decimals = decimals_of(max(sigma / factor, 1e-9))
    best, low_text, high_text = (f"{each / factor:.{decimals}f}" for each in (value, low, high))
    reach = {"upper": f"above {low_text}", "lower": f"below {high_text}"}.get(
        end, f"{low_text} to {high_text}"
    )
    bound = f", its {end} bound" if end else ""
    return f"{words} {best} {unit}{bound}, {reach} {unit} with 95 %"


def _worst_span(values: FloatArray, squares: FloatArray) -> tuple[float, float]:
    """Eighth of the range of values with the largest mean square."""
    edges = np.linspace(values.min(), values.max(), 9)
    place = np.clip(np.digitize(values, edges) - 1, 0, 7)
    means = [float(squares[place == each].mean()) if np.any(place == each) else -1.0 for each in range(8)]
    worst = int(np.argmax(means))
    return float(edges[worst]), float(edges[worst + 1])


def _numbers(cycles: Sequence[int]) -> str:
    return listed(list(map(str, cycles)))


def _rms_sigma(errors_dph: FloatArray, noise_dph: FloatArray) -> float:
    """Standard uncertainty of an rms error by the noise of what was measured; NaN of none.

    The square of an error with the noise s has the variance ``2 s^4 + 4 s^2 d^2`` with its true part d.
    """
    known = ~np.isnan(errors_dph)
    if not known.any():
        return np.nan
    errors_dph, noise_dph = errors_dph[known], noise_dph[known]
    true = max(float(np.sum(errors_dph**2) - np.sum(noise_dph**2)), 0.0) / errors_dph.size
    variance = np.sum(2.0 * noise_dph**4 + 4.0 * noise_dph**2 * true)
    return float(np.sqrt(variance)) / (2.0 * errors_dph.size * max(rms(errors_dph), 1e-300))
