"""Candidate effects, their forms and parameters, and terms that several effects share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.foundations.arrays import S_PER_H, BoolArray, FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.text import plain_name

_MAX_TIME_S = 1e7


@dataclass(frozen=True)
class Parameter:
    """A nonlinear parameter of a form, common to the three gyros."""

    name: str  #: With its unit: "tau_s", "onset_c".
    #: low, high: Bounds of the fit.
    low: float
    high: float
    #: Starting values of the fit for a campaign; all are tried.
    starts: Callable[[Campaign], FloatArray]
    #: Whether the effect becomes another one at the upper bound: with a time constant as long as the campaign
    #: it is a drift.
    is_open_end: bool = False
    limit: Callable[[Campaign], float] | None = None  #: Upper bound in a campaign, if below ``high``.
    is_place: bool = (
        False  #: A position on an axis, such as an onset: prior uniform in the value, not its log.
    )

    @property
    def is_scale(self) -> bool:
        """Whether it is positive and the prior is uniform in its logarithm."""
        return self.low > 0.0 and not self.is_place


@dataclass(frozen=True, eq=False)
class Form:
    """One mathematical form of an effect."""

    terms: tuple[str, ...]  #: Quantity that each term follows, with its unit.
    #: Terms in a campaign at values of the parameters: shape (n, 3, k), without NaN. The bias of a gyro is
    #: the sum of its k terms, each multiplied by a fitted size in deg/h.
    columns: Callable[[Campaign, tuple[float, ...]], FloatArray]
    parameters: tuple[Parameter, ...] = ()  #: The nonlinear ones.
    #: Input that the form needs and a campaign lacks; None if it has all.
    missing_input: Callable[[Campaign], str | None] = lambda campaign: None  # noqa: ARG005
    name: str = ""  #: Distinguishes the forms of an effect; empty for a single one.
    #: Largest ratio of each term to the quantity that it follows, shape (k,), in a campaign at values of the
    #: parameters. Figures and tables divide terms by it, to show them in the unit of that quantity.
    weights: Callable[[Campaign, tuple[float, ...]], FloatArray] = lambda campaign, values: np.ones(1)  # noqa: ARG005
    weights_note: str = ""  #: Meaning of the terms in that unit; one or two sentences.


@dataclass(frozen=True)
class FittedForm:
    """A form as fitted to a campaign, from which an effect derives the terms of the INS."""

    campaign: Campaign  #: All n dwells.
    searched: BoolArray  #: Shape (n,). The dwells that were fitted.
    form: Form  #: The form chosen.
    values: tuple[float, ...]  #: Its parameters.
    sizes_dph: FloatArray  #: Shape (3, k). Size of each term for each gyro.

    @property
    def bias_dph(self) -> FloatArray:
        """Bias of the effect in all dwells (n, 3)."""
        columns = self.form.columns(self.campaign, self.values)
        return np.asarray(np.einsum("ngk,gk->ng", columns, self.sizes_dph))


@dataclass(frozen=True)
class InsTerms:
    """Terms with which an INS subtracts an effect."""

    #: By field of :class:`gyrobench.drivers.ins.compensation.Compensation`; empty if left out.
    coefficients: Mapping[str, FloatArray] = field(default_factory=dict)
    left_out: str = ""  #: Reason why the INS can't subtract the effect; empty if it can.
    note: str = ""  #: Note on a part that is not subtracted; empty if all is.
    #: Shape (n, 3). That part in all dwells of the campaign; all zero if everything is subtracted.
    residual_dph: FloatArray = field(default_factory=lambda: np.zeros((1, 3)))


def no_ins_term(reason: str) -> Callable[[FittedForm], InsTerms]:
    """Compensation of an effect that no INS can subtract."""
    return lambda fitted: InsTerms(left_out=reason)  # noqa: ARG005


NO_INS_TERM = no_ins_term("the INS has no term for it")


def always(campaign: Campaign) -> bool:  # noqa: ARG001
    """Default of :attr:`Effect.may_imitate`: True in all campaigns."""
    return True


@dataclass(frozen=True)
class MisalignmentTexts:
    """Texts of an effect that looks like misalignments of accelerometers at rest; see :class:`Effect`."""

    label: str
    statement: str
    experiment: str


@dataclass(frozen=True)
class Effect:
    """A physical effect on gyro bias that the declared model lacks."""

    name: str  #: As in ``closure.json`` and as the name of the entry point.
    statement: str  #: Behaviour of the bias; a sentence without its period: "the bias follows ...".
    #: The measurement that separates it from other effects, in the imperative without a period.
    experiment: str
    forms: tuple[Form, ...]  #: The candidate forms; the best one is used.
    #: Names of effects so correlated with it that they may be present instead if a missing input excludes
    #: them from the search.
    imitated_by: tuple[str, ...] = ()
    compensation: Callable[[FittedForm], InsTerms] = NO_INS_TERM  #: How the INS compensates it.
    label: str = ""  #: Displayed in place of the name; by default the name with spaces.
    #: Names of effects that are special cases of its laws in any campaign. If it is less probable than one of
    #: them, it is no rival.
    contains: tuple[str, ...] = ()
    may_imitate: Callable[[Campaign], bool] = always  #: Whether it may imitate another effect in a campaign.
    #: Runs from which an empirical law was composed, and the fingerprints of their dwells; empty if unknown.
    composed_from: tuple[str, ...] = ()
    composed_from_dwells: tuple[str, ...] = ()
    sensors: tuple[str, ...] = ("gyro", "accelerometer")  #: Sensors whose coefficients may show it.
    #: Texts for a search of accelerometers, if the effect looks like their misalignments at rest.
    as_misalignment: MisalignmentTexts | None = None

    def seen_by(self, sensor: str) -> Effect:
        """The effect with its texts for "gyro" or "accelerometer"."""
        if sensor != "accelerometer" or self.as_misalignment is None:
            return self
        return replace(self, **vars(self.as_misalignment))

    @property
    def display_name(self) -> str:
        """Name displayed on pages and in the terminal."""
        return f"{self.label or plain_name(self.name)}{' (empirical)' if self.composed_from else ''}"

    def bounded(self, campaign: Campaign) -> Effect:
        """The effect with the bounds of its parameters limited for a campaign."""
        if not any(parameter.limit for form in self.forms for parameter in form.parameters):
            return self
        forms = []
        for form in self.forms:
            parameters = [
                replace(each, high=min(each.high, each.limit(campaign)), limit=None) if each.limit else each
                for each in form.parameters
            ]
            forms.append(replace(form, parameters=tuple(parameters)))
        return replace(self, forms=tuple(forms))

    def missing_input(self, campaign: Campaign) -> str | None:
        """The missing input that prevents the fit of every form; None if one can be fitted."""
        missing = [form.missing_input(campaign) for form in self.forms]
        return missing[0] if missing and all(missing) else None


def checked(effect: Effect) -> Effect:
    """An external effect, with the columns of its forms checked whenever they are computed.

    The columns raise a MeasurementError if they have a wrong shape or are not finite.
    """

    def columns(form: Form, campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
        shape = (len(campaign), 3, len(form.terms))
        terms = np.asarray(form.columns(campaign, values), dtype=np.float64)
        if terms.shape != shape or not np.isfinite(terms).all():
            fault = "values that are not finite" if terms.shape == shape else f"shape {terms.shape}"
            raise MeasurementError(
                f"the terms of the effect {effect.name!r} have {fault}; required: finite values of shape "
                f"{shape}. Report this to the package's author"
            )
        return terms

    forms = (replace(form, columns=partial(columns, form)) for form in effect.forms)
    return replace(effect, forms=tuple(forms))


def fixed(*values: float) -> Callable[[Campaign], FloatArray]:
    """Starting values that do not depend on the campaign."""
    return lambda campaign: np.array(values)  # noqa: ARG005


def searched_length_s(campaign: Campaign) -> float:
    """Time from the first to the last dwell that is not held out, at least an hour."""
    is_used = ~campaign.held_out if not campaign.held_out.all() else slice(None)
    return max(float(campaign.end_s[is_used].max() - campaign.start_s[is_used].min()), S_PER_H)


def time_constant(low_s: float, *starts_s: float, lengths: float = 1.0) -> Parameter:
    """Parameter ``tau_s``, at most ``lengths`` campaigns long, since a longer one is another effect."""

    def limit(campaign: Campaign) -> float:
        return lengths * searched_length_s(campaign)

    def starts(campaign: Campaign) -> FloatArray:
        return np.unique(np.minimum(starts_s, limit(campaign)))

    return Parameter("tau_s", low_s, _MAX_TIME_S, starts, is_open_end=True, limit=limit)


def same_for_all_gyros(terms: FloatArray) -> FloatArray:
    """Terms (n, k) or values (n,) repeated for each gyro: (n, 3, k) or (n, 3)."""
    return np.repeat(terms[:, np.newaxis], 3, axis=1)


def above_optics_c(campaign: Campaign) -> FloatArray:
    """Temperature of the electronics above the optics (n, 3); NaN if unknown."""
    above_c = campaign.above_optics_c
    return np.full_like(campaign.gyro_c, np.nan) if above_c is None else above_c


def needs_positions(campaign: Campaign) -> str | None:
    """Missing input if all dwells are in one position."""
    if len(set(campaign.position)) > 1:
        return None
    is_of_dwells = campaign.quantity.row == "dwell"
    return "dwells in more than one position" if is_of_dwells else "a table with values of each position"


def needs_electronics(campaign: Campaign) -> str | None:
    """Missing input if the electronics temperatures are neither measured nor observable."""
    return (
        "temperature sensors at the gyros' electronics, or at the case with consecutive dwells"
        if campaign.above_optics_c is None
        else None
    )


def heat_flow_terms(fitted: FittedForm) -> InsTerms:
    """Gradient coefficient from the first term, limited to the differences that the INS measured."""
    campaign = fitted.campaign
    if not np.isfinite(campaign.whole.board_c).all():
        return InsTerms(
            left_out="it depends on the temperature of the electronics, and the INS has no sensors there"
        )
    above_k = (campaign.board_c - campaign.gyro_c)[fitted.searched]
    return InsTerms(
        {
            "gradient_dph_per_k": fitted.sizes_dph[:, 0],
            "difference_low_k": above_k.min(axis=0),
            "difference_high_k": above_k.max(axis=0),
        }
    )


def constant_at_end(fitted: FittedForm) -> InsTerms:
    """Constant with the value of the effect at the end of the campaign."""
    bias_dph = fitted.bias_dph
    return InsTerms(
        {"polynomial_dph": bias_dph[-1][:, np.newaxis]},
        note=(
            "compensated by its value at the end of the campaign, as a constant: the INS can't predict its "
            "course"
        ),
        residual_dph=bias_dph - bias_dph[-1],
    )
