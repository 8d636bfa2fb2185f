"""The outcome of a search: the effects found, each candidate alone, verdict, errors before and after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import starmap

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.candidates import Candidate
from gyrobench.bench.closure.compose import Composed
from gyrobench.bench.closure.effects.effect import Effect, Parameter
from gyrobench.bench.closure.held_out import HeldOutTest
from gyrobench.bench.closure.noise import CampaignNoise
from gyrobench.bench.closure.posterior import Posterior
from gyrobench.bench.closure.problem import Solution
from gyrobench.bench.closure.quantity import GYRO_BIAS, Quantity
from gyrobench.bench.closure.selection import NotAccepted
from gyrobench.bench.closure.uncertainty import Draws, bound_of
from gyrobench.bench.closure.validation import LackOfFit, measured_minus_model
from gyrobench.bench.foundations.arrays import S_PER_H, BoolArray, FloatArray, nan_rms
from gyrobench.bench.foundations.text import capitalised, decimals_of, plain_name, with_sigma

_UNITS = {"c": "degC"}
#: An interval is stated in place of a standard uncertainty if the value is off its middle by more than this
#: share of its length.
_ASYMMETRY = 0.125


@dataclass(frozen=True)
class OtherForm:
    """Another form of an effect found, which is not improbable."""

    candidate: Candidate  #: As fitted.
    probability: float  #: Of this form, given that the effects found are present.
    #: values_sigma, values_range: As in :class:`FoundEffect`.
    values_sigma: FloatArray
    values_range: tuple[tuple[float, float], ...]
    #: Largest difference that it makes to the modelled bias of any gyro, and the number of that dwell.
    difference_dph: float
    dwell: int

    @property
    def text(self) -> str:
        """Form, probability and parameters: "or, with P = 0.12, one width: half width 5.8 ± 0.5 degC"."""
        parameters = "; ".join(_parameter_texts(self.candidate, self.values_sigma, self.values_range))
        stated = f"{self.candidate.form.name}{f': {parameters}' if parameters else ''}"
        return f"or, with P = {self.probability:.2f}, {stated}"


@dataclass(frozen=True)
class FoundEffect:
    """An effect found in the data."""

    candidate: Candidate  #: The effect, its form and parameters.
    sizes_dph: FloatArray  #: Shape (3, k). Size of each term for each gyro; zero for terms not used.
    axes: tuple[str, ...]  #: Those of :attr:`Quantity.axes` that show it.
    p_value: float  #: Corrected for all candidate fits.
    candidate_fits: int  #: Number of candidate fits.
    rms_dph: float  #: Its rms in the dwells searched, without its mean.
    #: Share of the chi2 of each cycle that it explains with its size fitted to the other cycles; see
    #: :func:`gyrobench.bench.closure.validation.leave_out_cycles`.
    gains: dict[int, float]
    tied_with: tuple[str, ...]  #: Names of effects that fit equally well.
    probability: float  #: Of this effect in any set of effects.
    #: Standard uncertainties of the sizes (3, k), of the nonlinear parameters (p,), and of the rms.
    sizes_sigma_dph: FloatArray
    values_sigma: FloatArray
    rms_sigma_dph: float
    #: 95 % interval of each nonlinear parameter.
    values_range: tuple[tuple[float, float], ...]
    #: :attr:`Form.weights` (k,), and the standard uncertainties of sizes times these, shape (3, k).
    weights: FloatArray
    weighted_sigma_dph: FloatArray
    quantity: Quantity = GYRO_BIAS  #: The coefficients that show it.
    other_forms: tuple[OtherForm, ...] = ()  #: Most probable first; the sizes are those of :attr:`candidate`.

    @property
    def effect(self) -> Effect:
        """The effect."""
        return self.candidate.effect

    @property
    def form_probability(self) -> float:
        """Probability of its form, given that the effects found are present."""
        return 1.0 - sum(each.probability for each in self.other_forms)

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
        return _parameter_texts(self.candidate, self.values_sigma, self.values_range)

    @property
    def statement(self) -> str:
        """Sentence with the behaviour of the bias, its size, gyros and parameters, with uncertainties."""
        parameters = "; ".join(self.parameter_texts)
        if self.other_forms:
            form = f"{self.candidate.form.name} with P = {self.form_probability:.2f}"
            parameters = "; ".join(
                [f"{form}: {parameters}" if parameters else form, *(each.text for each in self.other_forms)]
            )
        gyros, unit = self.quantity.place(self.axes), self.quantity.unit
        size = f"{with_sigma(self.rms_dph, self.rms_sigma_dph)} {unit} rms on the {gyros}"
        sentence = capitalised(self.quantity.restated(self.effect.statement))
        return f"{sentence}: {size}{f' ({parameters})' if parameters else ''}."


@dataclass(frozen=True)
class CandidateResult:
    """How well one effect by itself explains the residuals of the declared model."""

    effect: Effect  #: The effect.
    #: The missing input that prevented a fit; the other fields are then unset.
    missing_input: str | None = None
    candidate: Candidate | None = None  #: As fitted by itself; None if not significant.
    #: Share of the excess variance explained, which is the sum of squares beyond the noise; NaN without
    #: excess.
    share: float = 0.0
    p_value: float = 1.0  #: Corrected for all candidate fits.
    #: Twice the logarithm of the odds of the effects found to this effect by itself.
    log_odds_against: float = np.nan
    #: Reason against an effect that is significant by itself or not improbable; empty otherwise.
    rejected: str = ""


@dataclass(frozen=True)
class HeldOutCycle:
    """Outcome of a search with one cycle held out."""

    cycle: int  #: The cycle.
    verdict: str = ""  #: As in :class:`Closure`; empty if the cycle can't be held out.
    effects: tuple[str, ...] = ()  #: Names of the effects found.
    #: error_before_dph, error_after_dph, noise_dph: Rms in this cycle; see :class:`Closure`.
    error_before_dph: float = np.nan
    error_after_dph: float = np.nan
    noise_dph: float = np.nan
    reason: str = ""  #: Reason why it can't be held out.


@dataclass(frozen=True)
class Closure:
    """Outcome of a search."""

    campaign: Campaign  #: All dwells.
    searched: BoolArray  #: Shape (n,). Dwells used by the search; the others are held out.
    #: "clean", "explained", "ambiguous" or "unexplained"; "not searched" by :func:`without_search`.
    verdict: str
    effects: tuple[FoundEffect, ...]  #: Strongest first.
    evidence: tuple[CandidateResult, ...]  #: Results of each candidate effect by itself.
    posterior: Posterior  #: Probabilities of all hypotheses.
    not_accepted: NotAccepted | None  #: The most probable set of effects, if none is found.
    detectable_dph: dict[str, float]  #: See :func:`gyrobench.bench.closure.evidence.detectable_dph`.
    #: before, after: Lack-of-fit tests of the declared model, and of the model with the effects.
    before: LackOfFit
    after: LackOfFit
    held_out: HeldOutTest  #: Test of the errors in the held-out dwells, with the effects.
    #: declared, model: The fitted declared model, and the model with the effects.
    declared: Solution
    model: Solution
    noise_dph: float  #: Noise of a measured bias, rms.
    confounding: tuple[str, ...]  #: Sentences on effects that the dwells searched can't distinguish.
    noise: CampaignNoise  #: Ratio of the noise to the stated uncertainties, and the outliers.
    #: error_before_dph, error_after_dph: Rms of measured minus predicted bias in the held-out dwells; NaN
    #: if there are none, as in a campaign of one cycle.
    error_before_dph: float
    error_after_dph: float
    #: error_before_sigma_dph, error_after_sigma_dph: Their standard uncertainties due to the noise.
    error_before_sigma_dph: float
    error_after_sigma_dph: float
    #: declared_draws, model_draws: Draws of the parameters of both models.
    declared_draws: Draws
    model_draws: Draws
    composed: Composed | None = None  #: Laws composed from the grammar; None if not requested.
    #: Each cycle held out in turn; empty if not requested.
    held_out_in_turn: tuple[HeldOutCycle, ...] = ()
    #: Names of the laws found that were composed from held-out dwells, which can't confirm them.
    circular: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """Verdict and effects: all fields would fill pages of a notebook."""
        return f"Closure(verdict={self.verdict!r}, names={self.names!r}, probability={self.probability:.3g})"

    @property
    def quantity(self) -> Quantity:
        """The coefficients searched; their unit replaces deg/h in all numbers."""
        return self.campaign.quantity

    @property
    def noise_scale(self) -> float:
        """Ratio of the noise to the stated uncertainties, rms over the gyros."""
        return self.noise.scale

    @cached_property
    def prediction_sigma_dph(self) -> FloatArray:
        """Standard uncertainty of the modelled bias in all dwells (n, 3), deg/h.

        Does not include the scatter of the constants of runs that were not searched.
        """
        return self.model_draws.sigma(self.model_draws.bias_dph(self.campaign), self.model.bias_dph)

    @property
    def dwell_noise_dph(self) -> FloatArray:
        """Standard deviation of the noise in all dwells (n, 3), deg/h; NaN where nothing was measured."""
        return self.campaign.noise_dph(self.noise.scales)

    def residuals_dph(self, model: Solution) -> FloatArray:
        """Measured bias minus a model (n, 3), deg/h, see :func:`~.validation.measured_minus_model`."""
        return measured_minus_model(self.campaign, self.searched, model)

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
    def tied(self) -> set[str]:
        """Names of the effects tied with one that was found."""
        return {name for each in self.effects for name in each.tied_with}

    @property
    def probability(self) -> float:
        """Probability that all effects found are present; if none are found, that of no undeclared effect."""
        return (
            self.posterior.joint_probability(self.names)
            if self.effects
            else self.posterior.no_effect_probability
        )

    @property
    def separating_measurement(self) -> str | None:
        """Next measurement, which resolves the first tie; None without ties."""
        experiments = {each.effect.name: each.effect.experiment for each in self.evidence}
        for effect in self.effects:
            if effect.tied_with:
                other = effect.tied_with[0]
                return (
                    f"To distinguish {effect.effect.display_name} from {self.label(other)}: "
                    f"{effect.effect.experiment}; for {self.label(other)}: {experiments[other]}."
                )
        return None

    @property
    def held_out_axes(self) -> list[str]:
        """Those of :attr:`Quantity.axes` that differ from the model in the held-out dwells."""
        return [self.quantity.axes[gyro] for gyro in self.held_out.gyros]

    @property
    def differs_held_out(self) -> bool:
        """Whether the verdict is unexplained only because the held-out dwells differ from the model."""
        is_searched_part_unexplained = self.after.is_significant or self.posterior.unlisted_probability > 0.5
        return (
            self.verdict == "unexplained"
            and self.held_out.is_significant
            and not is_searched_part_unexplained
        )

    @property
    def held_out_difference(self) -> str | None:
        """Text with the gyros that differ in the held-out dwells, and what to do; None if none differs."""
        gyros, held_out = self.held_out.gyros, ~self.searched
        if not gyros:
            return None
        errors_dph = self.residuals_dph(self.model)[held_out]
        expected_dph = np.hypot(self.dwell_noise_dph, self.prediction_sigma_dph)[held_out]
        error, expected = (nan_rms(each[:, gyros]) for each in (errors_dph, expected_dph))
        sensors = self.quantity.place(self.held_out_axes)
        cycles = np.unique(self.campaign.cycle[self.searched])
        advice = "Measure another cycle and hold that one out, so that these dwells are searched."
        if len(cycles) > 1:
            advice = (
                f"Hold out another cycle, so that these dwells are searched: --hold-out-cycle {cycles[0]}."
            )
        return (
            f"the {sensors} differ{'' if gyros[1:] else 's'} from the prediction in the held-out dwells, by "
            f"{error:.2g} {self.quantity.unit} rms; noise and the uncertainty of the prediction give "
            f"{expected:.2g} {self.quantity.unit}. {advice}"
        )

    @property
    def unexplained_part(self) -> str | None:
        """Size, position, temperatures and times of an unexplained residual; None without one."""
        if self.verdict != "unexplained":
            return None
        campaign, is_shown, where = self.campaign, self.searched, ""
        residual = self.residuals_dph(self.model)
        if self.differs_held_out:
            is_shown, where = (
                ~is_shown,
                f" of the {self.quantity.place(self.held_out_axes)} in the held-out dwells",
            )
            residual = residual[:, self.held_out.gyros]
        residual = residual[is_shown]
        squares = np.nansum(residual**2, axis=1)
        names = np.array(campaign.position)[is_shown]
        position = max(sorted(set(names)), key=lambda name: float(squares[names == name].mean()))
        low_c, high_c = _worst_span(campaign.gyro_c[is_shown].mean(axis=1), squares)
        low_h, high_h = _worst_span(campaign.middle_s[is_shown] / S_PER_H, squares)
        after, is_tested = self.after, not (self.differs_held_out or np.isnan(self.after.noise_ratio))
        test_text = f", {after.noise_ratio:.1f} times the noise, and follows {after.follows}" * is_tested
        return (
            f"The residual{where} is {nan_rms(residual):.2g} {self.quantity.unit} rms{test_text}. It is "
            f"largest in position {plain_name(position)}, at {low_c:.0f} to {high_c:.0f} degC, and "
            f"at {low_h:.0f} to {high_h:.0f} h."
        )


def _parameter_texts(
    candidate: Candidate, sigmas: FloatArray, ranges: Sequence[tuple[float, float]]
) -> tuple[str, ...]:
    values = zip(candidate.form.parameters, candidate.values, sigmas.tolist(), ranges, strict=True)
    return tuple(starmap(_parameter_text, values))


def _parameter_text(parameter: Parameter, value: float, sigma: float, interval: tuple[float, float]) -> str:
    """Name, value and uncertainty with their unit; the interval if it is not symmetric or at a bound."""
    words, _, unit = parameter.name.replace("_", " ").rpartition(" ")
    factor = 1.0
    if unit == "s" and abs(value) >= S_PER_H:
        factor, unit = S_PER_H, "h"
    unit = _UNITS.get(unit, unit)
    low, high = interval
    bound_name = bound_of(parameter, value)
    if not bound_name and abs(0.5 * (low + high) - value) <= _ASYMMETRY * (high - low):
        return f"{words} {with_sigma(value / factor, sigma / factor)} {unit}"
    decimals = decimals_of(max(sigma / factor, 1e-9))
    best, low_text, high_text = (f"{each / factor:.{decimals}f}" for each in (value, low, high))
    range_text = {"upper": f"above {low_text}", "lower": f"below {high_text}"}.get(
        bound_name, f"{low_text} to {high_text}"
    )
    bound_text = f", its {bound_name} bound" if bound_name else ""
    return f"{words} {best} {unit}{bound_text}, {range_text} {unit} with 95 %"


def _worst_span(values: FloatArray, squares: FloatArray) -> tuple[float, float]:
    """Eighth of the range of values with the largest mean square."""
    edges = np.linspace(values.min(), values.max(), 9)
    index = np.clip(np.digitize(values, edges) - 1, 0, 7)
    means = [float(squares[index == each].mean()) if np.any(index == each) else -1.0 for each in range(8)]
    worst = int(np.argmax(means))
    return float(edges[worst]), float(edges[worst + 1])
