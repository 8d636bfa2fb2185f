"""Evidence of hypotheses: sets of effects, with or without a remainder from an unlisted effect.

The evidence of a set is the probability of the data, integrated over the priors of all fitted quantities: the
declared model (flat), the sizes of terms (analytic), their order of magnitude and that of the remainder
(sums), the noise of each gyro (analytic), and nonlinear parameters (Laplace). All priors are in this module;
docs/decisions/13-posterior.md has the theory.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.candidates import Candidate, Hypothesis, owners, stack
from gyrobench.bench.closure.effects.effect import Effect, Form, Parameter
from gyrobench.bench.closure.posterior import HypothesisProbability, Posterior
from gyrobench.bench.closure.problem import MIN_VISIBLE, Problem
from gyrobench.bench.closure.remainder import ALL_PROCESSES, remainder_of
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, IntArray, nan_rms

#: Prior probability of 0, 1, 2 and 3 effects; all sets of one size are equally probable.
EFFECT_COUNT_PRIOR = (0.4, 0.35, 0.15, 0.1)
#: Prior probability of a remainder with any set, divided equally among its processes; the sum of all
#: processes has a share of the prior of one.
REMAINDER_PRIOR = 0.05
_ALL_PROCESSES_SHARE = 0.1
#: Magnitudes of a size, all equally probable: rms of a term in the dwells searched, with the declared model
#: and the other effects projected out, in units of the noise. In each gyro an effect has its magnitude with
#: the probability below, otherwise any magnitude up to it.
MAGNITUDES = 0.5 * 4.0 ** np.arange(6)
_SAME_MAGNITUDE = 0.8
#: Ratio of the noise variance to the stated one, as a mixture of inverse gamma distributions: probability,
#: shape and scale. Stated uncertainties are right within 7 %, or too small by a factor of 1 to 1.7.
NOISE_PRIOR = ((0.9, 52.0, 51.0), (0.1, 4.0, 6.0))
#: Probability that a remainder of the detectable size becomes the most probable hypothesis.
REMAINDER_POWER = 0.9
#: Log odds above which the less probable hypothesis does not change a sum.
_NEGLIGIBLE = 12.0
#: Prior probability that a term of an effect with several terms is absent in a gyro.
_ABSENT_PRIOR = 0.5
#: Step of a derivative, as a share of the prior's width.
_STEP = 2e-3
_DRAWS = 200


@dataclass(frozen=True)
class _Terms:
    """Terms and data of a hypothesis with the declared model projected out, in units of the noise."""

    #: Shape (3, m, k + 1). Terms scaled to rms 1, then the data as last column; all over the square root of
    #: :attr:`Problem.correlation_factor`, so that correlated values count as fewer.
    columns: FloatArray
    kept: BoolArray  #: Shape (3, k). Terms that each gyro keeps.
    owner: IntArray  #: Shape (k,). Index of each term's effect.
    rms: FloatArray  #: Shape (3, k). Rms of the terms before they were scaled.

    @classmethod
    def of(cls, problem: Problem, candidates: Sequence[Candidate]) -> _Terms:
        """Terms of candidates in the dwells searched of a problem."""
        if candidates:
            all_columns, kept = stack(candidates, problem.campaign)
        else:
            all_columns, kept = np.zeros((len(problem.campaign), 3, 0)), np.ones((3, 0), dtype=bool)
        visible, rms_of_terms = problem.project_out(all_columns[problem.searched])
        owner = owners(candidates)
        rms_of_terms = rms_of_terms * _independent_shares(visible / rms_of_terms[:, None], kept, owner)
        columns = np.concatenate([visible / rms_of_terms[:, None], problem.residuals.T[..., None]], axis=2)
        return cls(columns / math.sqrt(problem.correlation_factor), kept, owner, rms_of_terms)

    @cached_property
    def products(self) -> FloatArray:
        """Inner products of the columns, shape (3, k + 1, k + 1)."""
        return np.asarray(np.swapaxes(self.columns, 1, 2) @ self.columns)


def _independent_shares(columns: FloatArray, kept: BoolArray, owner: IntArray) -> FloatArray:
    """Share (3, k) of columns of rms 1 (3, m, k) that is independent of the other effects' terms.

    The size of an effect is what it adds to the set. Otherwise a set with correlated effects of opposite
    sign would be probable wherever each of its effects is.
    """
    shares = np.ones(kept.shape)
    for gyro, effect in itertools.product(range(3), range(int(owner.max(initial=0)) + 1)):
        own, is_other = owner == effect, (owner != effect) & kept[gyro]
        if is_other.any():
            columns_of_others, _ = np.linalg.qr(columns[gyro][:, is_other])
            remainder = columns[gyro][:, own]
            remainder = remainder - columns_of_others @ (columns_of_others.T @ remainder)
            shares[gyro, own] = np.maximum(np.sqrt(np.mean(remainder**2, axis=0)), MIN_VISIBLE)
    return shares


class Evidences:
    """Evidence of hypotheses about one problem, which has the declared model alone."""

    def __init__(self, problem: Problem, effects: Sequence[Effect]) -> None:
        campaign = problem.campaign
        possible = [each for each in effects if not each.missing_input(campaign)]
        self._effect_count = len(possible)
        self._form_counts = {
            each.name: sum(not form.missing_input(campaign) for form in each.forms) for each in possible
        }
        self._problem, self._effects = problem, effects
        self._log_weights: dict[object, tuple[float, FloatArray]] = {}
        self._step_columns: dict[Form, tuple[FloatArray, FloatArray]] = {}
        fitted = np.array([basis.shape[1] for basis in problem.bases])
        dof = campaign.is_measured[problem.searched].sum(axis=0) - fitted.astype(np.float64)
        self._dof = dof / problem.correlation_factor
        self._remainder = remainder_of(problem)
        shares = np.array([_ALL_PROCESSES_SHARE if name == ALL_PROCESSES else 1.0 for name in self.processes])
        self._log_process_prior = np.log(REMAINDER_PRIOR * shares / shares.sum())

    @property
    def processes(self) -> tuple[str, ...]:
        """Drivers that a remainder may follow."""
        return (*self._remainder.names, "nothing else measured")

    def posterior(self, hypotheses: Iterable[Hypothesis]) -> Posterior:
        """Probabilities of hypotheses, which must include the declared model alone.

        The probabilities of a set of effects in different forms are added. An effect that can't be fitted
        because an input is missing gets the probability of the effect that it imitates.
        """
        by_names: dict[frozenset[str], list[tuple[float, FloatArray, tuple[Candidate, ...]]]] = {}
        hypotheses = sorted(hypotheses, key=lambda each: each.bic)
        max_log_weight = max(
            max(without_remainder, *processes)
            for without_remainder, processes in map(self.weights, hypotheses)
        )
        for each in hypotheses:
            without_remainder, processes = self.weights(each)
            # The sum over magnitudes is costly, and negligible if a remainder is improbable.
            if processes.max() > max_log_weight - _NEGLIGIBLE:
                without_remainder, processes = self.weights(each, is_summed=True)
            for names in (each.names, *_imitated_sets(each, self._effects, self._problem.campaign)):
                by_names.setdefault(names, []).append((without_remainder, processes, each.candidates))
        all_fits = [each for fits in by_names.values() for each in fits]
        log_total = np.logaddexp.reduce(
            np.concatenate([[without_remainder, *processes] for without_remainder, processes, _ in all_fits])
        )
        process_weights = np.exp(
            np.logaddexp.reduce([processes for _, processes, _ in all_fits], axis=0) - log_total
        )
        results = []
        for names, fits in by_names.items():
            for has_remainder in (False, True):
                log_weights = np.ravel(
                    [
                        processes if has_remainder else without_remainder
                        for without_remainder, processes, _ in fits
                    ]
                )
                form_weights = np.logaddexp.reduce(np.reshape(log_weights, (len(fits), -1)), axis=1)
                set_weight = np.logaddexp.reduce(form_weights)
                shares = np.exp(form_weights - set_weight).tolist()
                forms = tuple(zip(shares, (candidates for *_, candidates in fits), strict=True))
                probability = math.exp(set_weight - log_total)
                results.append(HypothesisProbability(names, has_remainder, probability, fits[0][2], forms))
        return Posterior(
            tuple(sorted(results, key=lambda each: -each.probability)),
            dict(zip(self.processes, (process_weights / process_weights.sum()).tolist(), strict=True)),
        )

    def log_odds(self, hypothesis: Hypothesis, other: Hypothesis) -> float:
        """Twice the logarithm of the odds of a hypothesis to another, both without a remainder."""
        return 2.0 * (self.weights(hypothesis)[0] - self.weights(other)[0])

    def weights(self, hypothesis: Hypothesis, *, is_summed: bool = False) -> tuple[float, FloatArray]:
        """Logarithm of prior times evidence, without a remainder and with each of the processes.

        ``is_summed``: with a process, sum over the magnitudes of the effects instead of taking the best.
        """
        key = (
            is_summed,
            *(
                (each.effect.name, each.form.name, each.values, each.kept.tobytes())
                for each in hypothesis.candidates
            ),
        )
        if key not in self._log_weights:
            self._log_weights[key] = self._compute_weights(hypothesis, is_summed=is_summed)
        return self._log_weights[key]

    def _compute_weights(self, hypothesis: Hypothesis, *, is_summed: bool) -> tuple[float, FloatArray]:
        terms, prior = _Terms.of(self._problem, hypothesis.candidates), self._log_prior(hypothesis)
        without_process, best = self._without_remainder(hypothesis, terms)
        with_process = self._with_remainder(terms, best, without_process, is_summed=is_summed)
        return (
            prior + math.log(1.0 - REMAINDER_PRIOR) + without_process,
            prior + self._log_process_prior + with_process,
        )

    def _without_remainder(self, hypothesis: Hypothesis, terms: _Terms) -> tuple[float, FloatArray]:
        """Log evidence without a remainder, and the most probable magnitudes (3, k)."""
        count = len(hypothesis.candidates)
        combinations = np.array(list(itertools.product(MAGNITUDES, repeat=count)))
        scales = combinations.reshape(len(MAGNITUDES) ** count, count)[:, terms.owner]
        per_gyro = self._log_evidence(terms.products[:, None], scales * terms.kept[:, None])
        best = scales[np.argmax(per_gyro[..., 0], axis=1)]
        per_gyro += self._term_subsets(terms, best)[:, np.newaxis]
        log_evidence = float(
            _sum_over_gyros(per_gyro.reshape(1, 3, *(len(MAGNITUDES),) * count, -1), count)[0]
        )
        log_evidence += _log_parameter_volume(self._problem, hypothesis.candidates, terms, best * terms.kept)
        return log_evidence + self._log_time_share(hypothesis.candidates, terms, best * terms.kept), best

    def _log_prior(self, hypothesis: Hypothesis) -> float:
        count = len(hypothesis.candidates)
        sets = math.comb(max(self._effect_count, count), count)
        forms = sum(math.log(self._form_counts[each.effect.name]) for each in hypothesis.candidates)
        optional = sum(each.kept.size for each in hypothesis.candidates if each.kept.shape[1] > 1)
        return math.log(EFFECT_COUNT_PRIOR[count] / sets) - forms + optional * math.log(_ABSENT_PRIOR)

    def _log_time_share(self, candidates: Sequence[Candidate], terms: _Terms, scales: FloatArray) -> float:
        """Log ratio of the mean evidence over all times of a step to the best; 0 without steps."""
        total, count = 0.0, len(terms.owner)
        for index, each in enumerate(candidates):
            if not any(math.isinf(parameter.low) for parameter in each.form.parameters):
                continue
            if each.form not in self._step_columns:
                self._step_columns[each.form] = _step_columns(self._problem, each.form)
            times_s, steps = self._step_columns[each.form]
            [term] = np.flatnonzero(terms.owner == index)
            log_evidence = np.zeros(len(times_s) + 1)
            for gyro in np.flatnonzero(terms.kept[:, term]):
                used = np.flatnonzero(terms.kept[gyro] & (np.arange(count) != term))
                basis, _ = np.linalg.qr(terms.columns[gyro][:, used])
                fitted, data = terms.columns[gyro][:, [term]], terms.columns[gyro][:, count]
                scale = max(terms.rms[gyro, term], 1e-9) * math.sqrt(self._problem.correlation_factor)
                columns = np.concatenate([steps[gyro] / scale, fitted], axis=1)
                columns = columns - basis @ (basis.T @ columns)
                weight = np.sum(columns**2, axis=0) + scales[gyro, term] ** -2
                log_evidence += 0.5 * ((columns.T @ data) ** 2 / weight - np.log(weight))
            density = np.exp(log_evidence - log_evidence.max())
            share = np.trapezoid(density[:-1], times_s) / np.ptp(times_s)
            total += math.log(max(share, _STEP))
        return total

    def _term_subsets(self, terms: _Terms, scales: FloatArray) -> FloatArray:
        """Log ratio of the evidence summed over all subsets of terms to that of the terms kept.

        Returns (3, components of the noise prior). Each term is dropped or added in turn, as if it were
        independent of the others; an effect keeps at least one term in each gyro. ``scales`` (3, k): those of
        all terms.
        """
        is_same_effect = terms.owner[:, np.newaxis] == terms.owner
        can_change = (is_same_effect.sum(axis=0) > 1) & (
            ~terms.kept | (terms.kept.astype(np.int64) @ is_same_effect > 1)
        )
        kept_after_change = terms.kept[:, np.newaxis] ^ np.eye(len(terms.owner), dtype=bool)
        ratios = self._log_evidence(terms.products[:, np.newaxis], scales[:, np.newaxis] * kept_after_change)
        ratios -= self._log_evidence(terms.products, scales * terms.kept)[:, np.newaxis]
        return np.asarray(np.sum(np.logaddexp(0.0, ratios) * can_change[..., np.newaxis], axis=1))

    def _with_remainder(
        self, terms: _Terms, best: FloatArray, without_process: float, *, is_summed: bool
    ) -> FloatArray:
        """Log evidence with each process.

        With the ``best`` magnitudes (3, k) of the effects, or summed over the magnitudes of one effect at a
        time. ``without_process``: log evidence without a process.
        """
        effects = range(int(terms.owner.max(initial=-1)) + 1 if is_summed else 0)
        trial_scales = [np.where(terms.owner == each, size, best) for each in effects for size in MAGNITUDES]
        scales = np.stack([best, *trial_scales], axis=1) * terms.kept[:, np.newaxis]

        def by_magnitude(per_gyro: FloatArray, axes: int) -> FloatArray:
            """Log evidence (processes, 1 + effects): with the best magnitudes, and summed for each effect.

            From that of each gyro (processes, 3, ..., scales, components).
            """
            per_effect = np.split(per_gyro[..., 1:, :], len(effects), axis=-2) if effects else []
            sums = [
                _sum_over_gyros(per_gyro[..., 0, :], axes),
                *(_sum_over_gyros(each, axes + 1) for each in per_effect),
            ]
            return np.stack(sums, axis=1)

        without = by_magnitude(self._log_evidence(terms.products[:, np.newaxis], scales)[np.newaxis], 0)
        gains = by_magnitude(self._per_process(terms, scales), 1) - without
        return np.asarray(without_process + gains[:, 0] + np.sum(gains[:, 1:] - gains[:, :1], axis=1))

    def _per_process(self, terms: _Terms, scales: FloatArray) -> FloatArray:
        """Log evidence of each gyro with each process, for ``scales`` (3, S, k) of the terms.

        Returns (processes, 3, magnitudes, S, components of the noise prior).
        """
        directions, powers = self._remainder.directions, self._remainder.powers
        projections = np.swapaxes(directions, 2, 3) @ terms.columns[:, np.newaxis]
        variances = MAGNITUDES[:, np.newaxis] ** 2 * powers[:, :, np.newaxis]
        weighted = (variances / (1.0 + variances))[..., np.newaxis] * projections[:, :, np.newaxis]
        products = terms.products[:, None, None] - np.swapaxes(projections, 2, 3)[:, :, None] @ weighted
        log_evidence = self._log_evidence(products[:, :, :, None], scales[:, None, None])
        log_evidence -= 0.5 * np.sum(np.log1p(variances), axis=3)[..., np.newaxis, np.newaxis]
        # Scatter is larger noise. The prior of the noise includes it below the second magnitude.
        larger = 1.0 + MAGNITUDES[1:, np.newaxis] ** 2
        products = terms.products[:, None] / larger[..., np.newaxis]
        scatter = np.full((3, 1, len(MAGNITUDES), *scales.shape[1:2], len(NOISE_PRIOR)), -1e9)
        scatter[:, 0, 1:] = self._log_evidence(products[:, :, None], scales[:, None])
        scatter[:, 0, 1:] -= 0.5 * self._dof[:, None, None, None] * np.log(larger)[..., np.newaxis]
        return np.concatenate([log_evidence, scatter], axis=1).swapaxes(0, 1)

    def _log_evidence(self, products: FloatArray, scales: FloatArray) -> FloatArray:
        """Log evidence (3, ..., components of the noise prior), integrated over sizes and noise.

        ``products`` (3, ..., k + 1, k + 1): inner products of terms and data. ``scales`` (3, ..., k): prior
        standard deviations of the sizes.
        """
        padded = np.concatenate([scales, np.ones((*scales.shape[:-1], 1))], axis=-1)
        matrix = products * padded[..., :, np.newaxis] * padded[..., np.newaxis, :]
        diagonal = np.arange(scales.shape[-1])
        matrix[..., diagonal, diagonal] += 1.0
        roots = np.diagonal(np.linalg.cholesky(matrix), axis1=-2, axis2=-1)
        half_chi2 = 0.5 * roots[..., -1] ** 2
        log_determinant = np.sum(np.log(roots[..., :-1]), axis=-1)
        half_dof = 0.5 * self._dof.reshape(3, *(1,) * (half_chi2.ndim - 1))
        components = [
            shape * math.log(scale)
            - math.lgamma(shape)
            + np.reshape([math.lgamma(shape + each) for each in half_dof.flat], half_dof.shape)
            - (shape + half_dof) * np.log(scale + half_chi2)
            for _, shape, scale in NOISE_PRIOR
        ]
        return np.asarray(np.stack(components, axis=-1) - log_determinant[..., np.newaxis])


def _sum_over_gyros(per_gyro: FloatArray, magnitude_axes: int) -> FloatArray:
    """Log evidence (h,) of h hypotheses for all gyros together.

    ``per_gyro`` (h, 3, magnitudes, ..., components of the noise prior): that of each gyro;
    ``magnitude_axes``: the number of axes for magnitudes.
    """
    count = len(per_gyro)
    max_per_gyro = per_gyro.reshape(count, 3, -1).max(axis=2).reshape(count, 3, *(1,) * (per_gyro.ndim - 2))
    shares = np.exp(per_gyro - max_per_gyro)
    for axis in range(2, 2 + magnitude_axes):
        shares = np.moveaxis(np.tensordot(_MAGNITUDE_IN_GYRO, shares, (1, axis)), 0, axis)
    joint = np.sum(np.log(np.maximum(shares, 1e-300)) + max_per_gyro, axis=1)
    joint += np.log([probability for probability, _, _ in NOISE_PRIOR])
    sums = np.logaddexp.reduce(joint.reshape(count, -1), axis=1)
    return np.asarray(sums - magnitude_axes * math.log(len(MAGNITUDES)))


def _magnitude_in_gyro() -> FloatArray:
    """Probability of each magnitude in a gyro (columns), given the magnitude of the effect (rows)."""
    count = len(MAGNITUDES)
    smaller = np.tril(np.ones((count, count))) / np.arange(1, count + 1)[:, np.newaxis]
    return np.asarray(_SAME_MAGNITUDE * np.eye(count) + (1.0 - _SAME_MAGNITUDE) * smaller)


_MAGNITUDE_IN_GYRO = _magnitude_in_gyro()


def _log_parameter_volume(
    problem: Problem, candidates: Sequence[Candidate], terms: _Terms, scales: FloatArray
) -> float:
    """Logarithm of the share of the nonlinear parameters' prior volume that the data allow (Laplace).

    The curvature is that of the fit, linearized in the parameters, with the sizes of all terms free. Times
    without bounds are omitted: the fit does not change with them between two dwells.
    """
    slopes = []
    for owner_index, each in enumerate(candidates):
        for index, parameter in enumerate(each.form.parameters):
            if math.isinf(parameter.low):
                continue
            value = each.values[index]
            width = prior_width(problem, parameter, value)
            step = _STEP * width if value + _STEP * width <= parameter.high else -_STEP * width
            moved = each.with_value(index, value + step)
            change = moved.columns(problem.campaign) - each.columns(problem.campaign)
            own = terms.owner == owner_index
            visible, _ = problem.project_out(change[problem.searched] * (width / step))
            scale = terms.rms[:, None, own] * math.sqrt(problem.correlation_factor)
            slopes.append((visible / scale, own))
    if not slopes:
        return 0.0
    count = len(terms.owner)
    information = np.zeros((len(slopes), len(slopes)))
    for gyro in range(3):
        used = np.flatnonzero(terms.kept[gyro])
        columns, data = terms.columns[gyro][:, used], terms.columns[gyro][:, count]
        normal = columns.T @ columns + np.diag(scales[gyro][used] ** -2)
        sizes = np.zeros(count)
        sizes[used] = np.linalg.solve(normal, columns.T @ data)
        change = np.stack([each[gyro] @ sizes[own] for each, own in slopes], axis=1)
        coupling = columns.T @ change
        information += change.T @ change - coupling.T @ np.linalg.solve(normal, coupling)
    return -0.5 * float(np.linalg.slogdet(np.eye(len(slopes)) + information / (2.0 * np.pi))[1])


def _step_columns(problem: Problem, form: Form) -> tuple[FloatArray, FloatArray]:
    """Times (t,) of a step at the edges and the middle of each dwell, and its columns (3, m, t).

    The declared model is projected out of the columns.
    """
    campaign, searched = problem.campaign, problem.searched
    edges_s = (campaign.start_s[searched], campaign.middle_s[searched], campaign.end_s[searched])
    times_s = np.unique(np.concatenate(edges_s))
    return times_s, problem.project_out(
        np.concatenate([form.columns(campaign, (time_s,))[searched] for time_s in times_s.tolist()], axis=2)
    )[0]


def prior_width(problem: Problem, parameter: Parameter, value: float) -> float:
    """Width of a parameter's uniform prior at a value.

    The prior of a scale is uniform in its logarithm. That of a time without bounds spans the dwells searched.
    """
    if not math.isfinite(parameter.low):
        campaign = problem.campaign
        return float(np.ptp(campaign.middle_s[problem.searched]))
    if parameter.is_scale:
        return value * math.log(parameter.high / parameter.low)
    return parameter.high - parameter.low


def detectable_dph(problem: Problem) -> dict[str, float]:
    """Smallest remainder that the data would show, by its driver: rms, deg/h.

    ``problem`` has the effects found as columns. A remainder of this size, the same in all gyros, becomes
    more probable than none with the probability ``REMAINDER_POWER``.
    """
    remainder = remainder_of(problem)
    chi2 = np.random.default_rng(0).chisquare(1.0, (_DRAWS, remainder.powers[:, 0].size))
    prior_odds = math.log((1.0 - REMAINDER_PRIOR) / REMAINDER_PRIOR * len(remainder.names) * len(MAGNITUDES))
    sizes = np.geomspace(0.1, 10.0, 25)
    detectable = {}
    for name, powers in zip(remainder.names, np.moveaxis(remainder.powers, 1, 0), strict=True):
        variances = sizes[:, np.newaxis] ** 2 * powers.ravel()
        log_odds = 0.5 * (variances @ chi2.T - np.sum(np.log1p(variances), axis=1, keepdims=True))
        is_detected = np.mean(log_odds > prior_odds, axis=1) >= REMAINDER_POWER
        detectable[name] = float(sizes[np.argmax(is_detected)]) if is_detected.any() else math.inf
    # For a remainder of equal size in all dwells. Outliers do not count, since they have a large sigma.
    noise_dph = 1.0 / nan_rms(
        1.0 / (problem.noise_scale * problem.campaign.known_sigma_dph[problem.searched])
    )
    return {name: size * noise_dph for name, size in detectable.items()}


def _imitated_sets(
    hypothesis: Hypothesis, effects: Sequence[Effect], campaign: Campaign
) -> list[frozenset[str]]:
    """Sets (of names) in which an effect that can't be fitted replaces one that it imitates."""
    not_fitted = {
        each.name for each in effects if each.missing_input(campaign) and each.may_imitate(campaign)
    }
    return [
        hypothesis.names - {candidate.effect.name} | {name}
        for candidate in hypothesis.candidates
        for name in candidate.effect.imitated_by
        if name in not_fitted
    ]
