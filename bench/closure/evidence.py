"""Evidence of hypotheses: sets of effects, with or without a remainder that is on no list.

The evidence of a set is the probability of the data with everything that is fitted integrated over its
prior: the declared model (flat), the sizes of terms (analytic), their order of magnitude and that of the
remainder (sums), the noise of each gyro (analytic), and nonlinear parameters (Laplace). All priors are in
this module; docs/decisions/13-posterior.md has the theory.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.candidates import Candidate, Hypothesis, owners, stack
from gyrobench.bench.closure.effects.effect import Effect, Form, Parameter
from gyrobench.bench.closure.posterior import HypothesisProbability, Posterior
from gyrobench.bench.closure.problem import MIN_VISIBLE, Problem
from gyrobench.bench.closure.remainder import TOGETHER, remainder_of
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, IntArray, nan_rms

#: Prior probability of 0, 1, 2 and 3 effects; all sets of one size are equally probable.
EFFECT_COUNT_PRIOR = (0.4, 0.35, 0.15, 0.1)
#: Prior probability of a remainder beside any set, shared equally by its processes; all of them together
#: have a share of that of one.
REMAINDER_PRIOR = 0.05
_TOGETHER_SHARE = 0.1
#: Magnitudes of a size, all equally probable: rms of a term in the dwells searched beside the
#: declared model and the other effects, in units of the noise. An effect has about the same in all gyros,
#: with this probability, or any smaller one in a gyro.
MAGNITUDES = 0.5 * 4.0 ** np.arange(6)
_SAME_MAGNITUDE = 0.8
#: Variance of the noise over the stated one, as inverse gamma distributions: probability, shape and scale.
#: Stated uncertainties are right to 7 %, or too small by 1 to 1.7.
NOISE_PRIOR = ((0.9, 52.0, 51.0), (0.1, 4.0, 6.0))
#: Probability with which a remainder of a detectable size would have been the most probable hypothesis.
REMAINDER_POWER = 0.9
#: Logarithm of odds that do not change a sum.
_NEGLIGIBLE = 12.0
#: A term of an effect with several terms is absent from a gyro with this probability.
_ABSENT = 0.5
#: Step of a derivative, as a share of the prior's width.
_STEP = 2e-3
_DRAWS = 200


@dataclass(frozen=True)
class _Terms:
    """Terms and data of a hypothesis beside the declared model, in units of the noise and each of rms 1."""

    columns: FloatArray  #: Shape (3, m, k + 1). The data are last.
    kept: BoolArray  #: Shape (3, k).
    owner: IntArray  #: Shape (k,). Index of each term's effect.
    rms: FloatArray  #: Shape (3, k). Of the terms before that.

    @classmethod
    def of(cls, problem: Problem, candidates: Sequence[Candidate]) -> _Terms:
        """Terms of effects in the dwells searched."""
        if candidates:
            all_columns, kept = stack(candidates, problem.campaign)
        else:
            all_columns, kept = np.zeros((len(problem.campaign), 3, 0)), np.ones((3, 0), dtype=bool)
        visible, rms_of_terms = problem.beside(all_columns[problem.searched])
        owner = owners(candidates)
        rms_of_terms = rms_of_terms * _share_beside_others(visible / rms_of_terms[:, None], kept, owner)
        columns = np.concatenate([visible / rms_of_terms[:, None], problem.residuals.T[..., None]], axis=2)
        return cls(columns, kept, owner, rms_of_terms)

    @cached_property
    def products(self) -> FloatArray:
        """Products of the columns, shape (3, k + 1, k + 1)."""
        return np.asarray(np.swapaxes(self.columns, 1, 2) @ self.columns)


def _share_beside_others(columns: FloatArray, kept: BoolArray, owner: IntArray) -> FloatArray:
    """Share (3, k) of columns of rms 1 (3, m, k) that is independent of the other effects' terms.

    What an effect adds to a set is its size: otherwise a set that contains correlated effects of opposite
    sign would be counted beside each of its parts.
    """
    shares = np.ones(kept.shape)
    for gyro, effect in itertools.product(range(3), range(int(owner.max(initial=0)) + 1)):
        mine, others = owner == effect, (owner != effect) & kept[gyro]
        if others.any():
            columns_of_others, _ = np.linalg.qr(columns[gyro][:, others])
            rest = columns[gyro][:, mine]
            rest = rest - columns_of_others @ (columns_of_others.T @ rest)
            shares[gyro, mine] = np.maximum(np.sqrt(np.mean(rest**2, axis=0)), MIN_VISIBLE)
    return shares


class Evidences:
    """Evidence of hypotheses about one problem, which has the declared model alone."""

    def __init__(self, problem: Problem, effects: Sequence[Effect]) -> None:
        campaign = problem.campaign
        fitted = [each for each in effects if not each.missing_input(campaign)]
        self._effect_count = len(fitted)
        self._form_counts = {
            each.name: sum(not form.missing_input(campaign) for form in each.forms) for each in fitted
        }
        self._problem, self._effects = problem, effects
        self._weights: dict[object, tuple[float, FloatArray]] = {}
        self._steps: dict[Form, tuple[FloatArray, FloatArray]] = {}
        self._dof = np.array([basis.shape[0] - basis.shape[1] for basis in problem.bases], dtype=np.float64)
        self._remainder = remainder_of(problem)
        shares = np.array([_TOGETHER_SHARE if name == TOGETHER else 1.0 for name in self.processes])
        self._log_process_prior = np.log(REMAINDER_PRIOR * shares / shares.sum())

    @property
    def processes(self) -> tuple[str, ...]:
        """What a remainder may follow."""
        return (*self._remainder.names, "nothing else measured")

    def posterior(self, hypotheses: Iterable[Hypothesis]) -> Posterior:
        """Probabilities of hypotheses, which include the declared model alone.

        Those of a set of effects in several forms are added. An effect that can't be fitted because an input
        is missing is as probable as the one that it imitates.
        """
        found: dict[frozenset[str], list[tuple[float, FloatArray, tuple[Candidate, ...]]]] = {}
        hypotheses = sorted(hypotheses, key=lambda each: each.bic)
        top = max(max(alone, *processes) for alone, processes in map(self.weights, hypotheses))
        for each in hypotheses:
            alone, processes = self.weights(each)
            # Where a remainder is improbable the magnitudes of the effects are those without it.
            if processes.max() > top - _NEGLIGIBLE:
                alone, processes = self.weights(each, is_summed=True)
            for names in (each.names, *_imitating(each, self._effects, self._problem.campaign)):
                found.setdefault(names, []).append((alone, processes, each.candidates))
        every = [each for fits in found.values() for each in fits]
        whole = np.logaddexp.reduce(np.concatenate([[alone, *processes] for alone, processes, _ in every]))
        follows = np.exp(np.logaddexp.reduce([processes for _, processes, _ in every], axis=0) - whole)
        results = []
        for names, fits in found.items():
            for has_remainder in (False, True):
                logs = np.ravel([processes if has_remainder else alone for alone, processes, _ in fits])
                sums = np.logaddexp.reduce(np.reshape(logs, (len(fits), -1)), axis=1)
                total = np.logaddexp.reduce(sums)
                shares = np.exp(sums - total).tolist()
                forms = tuple(zip(shares, (candidates for *_, candidates in fits), strict=True))
                probability = math.exp(total - whole)
                results.append(HypothesisProbability(names, has_remainder, probability, fits[0][2], forms))
        return Posterior(
            tuple(sorted(results, key=lambda each: -each.probability)),
            dict(zip(self.processes, (follows / follows.sum()).tolist(), strict=True)),
        )

    def log_odds(self, of: Hypothesis, to: Hypothesis) -> float:
        """Twice the logarithm of the odds of one hypothesis to another, both without a remainder."""
        return 2.0 * (self.weights(of)[0] - self.weights(to)[0])

    def weights(self, of: Hypothesis, *, is_summed: bool = False) -> tuple[float, FloatArray]:
        """Logarithm of prior times evidence, without a remainder and with each of the processes.

        ``is_summed``: sum over the magnitudes of the effects beside a process too.
        """
        key = (
            is_summed,
            *((each.effect.name, each.form.name, each.values, each.kept.tobytes()) for each in of.candidates),
        )
        if key not in self._weights:
            self._weights[key] = self._computed_weights(of, is_summed=is_summed)
        return self._weights[key]

    def _computed_weights(self, of: Hypothesis, *, is_summed: bool) -> tuple[float, FloatArray]:
        terms, prior = _Terms.of(self._problem, of.candidates), self._log_prior(of)
        alone, best = self._without_process(of, terms)
        with_process = self._with_processes(terms, best, alone, is_summed=is_summed)
        return (
            prior + math.log(1.0 - REMAINDER_PRIOR) + alone,
            prior + self._log_process_prior + with_process,
        )

    def _without_process(self, of: Hypothesis, terms: _Terms) -> tuple[float, FloatArray]:
        """Log evidence without a process, and the most probable magnitudes (3, k)."""
        count = len(of.candidates)
        combinations = np.array(list(itertools.product(MAGNITUDES, repeat=count)))
        scales = combinations.reshape(len(MAGNITUDES) ** count, count)[:, terms.owner]
        per_gyro = self._log_evidence(terms.products[:, None], scales * terms.kept[:, None])
        best = scales[np.argmax(per_gyro[..., 0], axis=1)]
        per_gyro += self._other_terms(terms, best)[:, np.newaxis]
        alone = float(_summed(per_gyro.reshape(1, 3, *(len(MAGNITUDES),) * count, -1), count)[0])
        alone += _log_parameter_volume(self._problem, of.candidates, terms, best * terms.kept)
        return alone + self._log_time_share(of.candidates, terms, best * terms.kept), best

    def _log_prior(self, of: Hypothesis) -> float:
        count = len(of.candidates)
        sets = math.comb(max(self._effect_count, count), count)
        forms = sum(math.log(self._form_counts[each.effect.name]) for each in of.candidates)
        optional = sum(each.kept.size for each in of.candidates if each.kept.shape[1] > 1)
        return math.log(EFFECT_COUNT_PRIOR[count] / sets) - forms + optional * math.log(_ABSENT)

    def _log_time_share(self, candidates: Sequence[Candidate], terms: _Terms, scales: FloatArray) -> float:
        """Logarithm of the mean evidence of all times of a step over that of the best; 0 without one."""
        total, count = 0.0, len(terms.owner)
        for place, each in enumerate(candidates):
            if not any(math.isinf(parameter.low) for parameter in each.form.parameters):
                continue
            if each.form not in self._steps:
                self._steps[each.form] = _steps(self._problem, each.form)
            times_s, steps = self._steps[each.form]
            [mine] = np.flatnonzero(terms.owner == place)
            log_evidence = np.zeros(len(times_s) + 1)
            for gyro in np.flatnonzero(terms.kept[:, mine]):
                used = np.flatnonzero(terms.kept[gyro] & (np.arange(count) != mine))
                basis, _ = np.linalg.qr(terms.columns[gyro][:, used])
                fitted, data = terms.columns[gyro][:, [mine]], terms.columns[gyro][:, count]
                columns = np.concatenate([steps[gyro] / max(terms.rms[gyro, mine], 1e-9), fitted], axis=1)
                columns = columns - basis @ (basis.T @ columns)
                weight = np.sum(columns**2, axis=0) + scales[gyro, mine] ** -2
                log_evidence += 0.5 * ((columns.T @ data) ** 2 / weight - np.log(weight))
            density = np.exp(log_evidence - log_evidence.max())
            share = np.trapezoid(density[:-1], times_s) / np.ptp(times_s)
            total += math.log(max(share, _STEP))
        return total

    def _other_terms(self, terms: _Terms, scales: FloatArray) -> FloatArray:
        """Log evidence of all subsets of terms over that of those kept, (3, components of the noise prior).

        Each term is dropped or added beside those kept, as if it were independent of the others. An effect
        keeps one term in each gyro. ``scales`` (3, k) are those of all terms.
        """
        mine = terms.owner[:, np.newaxis] == terms.owner
        can_change = (mine.sum(axis=0) > 1) & (~terms.kept | (terms.kept.astype(np.int64) @ mine > 1))
        changed = terms.kept[:, np.newaxis] ^ np.eye(len(terms.owner), dtype=bool)
        ratios = self._log_evidence(terms.products[:, np.newaxis], scales[:, np.newaxis] * changed)
        ratios -= self._log_evidence(terms.products, scales * terms.kept)[:, np.newaxis]
        return np.asarray(np.sum(np.logaddexp(0.0, ratios) * can_change[..., np.newaxis], axis=1))

    def _with_processes(
        self, terms: _Terms, best: FloatArray, alone: float, *, is_summed: bool
    ) -> FloatArray:
        """Log evidence with each process.

        The magnitudes of the effects are the ``best`` (3, k), or summed one at a time.
        """
        effects = range(int(terms.owner.max(initial=-1)) + 1 if is_summed else 0)
        trials = [np.where(terms.owner == each, size, best) for each in effects for size in MAGNITUDES]
        scales = np.stack([best, *trials], axis=1) * terms.kept[:, np.newaxis]

        def by_magnitude(found: FloatArray, axes: int) -> FloatArray:
            """Of (processes, 3, ..., scales, components): with the best, and those of each effect summed.

            Returns (processes, 1 + effects).
            """
            parts = np.split(found[..., 1:, :], len(effects), axis=-2) if effects else []
            sums = [_summed(found[..., 0, :], axes), *(_summed(each, axes + 1) for each in parts)]
            return np.stack(sums, axis=1)

        without = by_magnitude(self._log_evidence(terms.products[:, np.newaxis], scales)[np.newaxis], 0)
        added = by_magnitude(self._processes(terms, scales), 1) - without
        return np.asarray(alone + added[:, 0] + np.sum(added[:, 1:] - added[:, :1], axis=1))

    def _processes(self, terms: _Terms, scales: FloatArray) -> FloatArray:
        """Log evidence with each process: (processes, 3, magnitudes, scales, components of the noise prior).

        ``scales`` (3, S, k) are those of the terms.
        """
        directions, powers = self._remainder.directions, self._remainder.powers
        parts = np.swapaxes(directions, 2, 3) @ terms.columns[:, np.newaxis]
        variances = MAGNITUDES[:, np.newaxis] ** 2 * powers[:, :, np.newaxis]
        weighted = (variances / (1.0 + variances))[..., np.newaxis] * parts[:, :, np.newaxis]
        products = terms.products[:, None, None] - np.swapaxes(parts, 2, 3)[:, :, None] @ weighted
        found = self._log_evidence(products[:, :, :, None], scales[:, None, None])
        found -= 0.5 * np.sum(np.log1p(variances), axis=3)[..., np.newaxis, np.newaxis]
        # Scatter is larger noise: below the second magnitude it is what the prior of the noise includes.
        larger = 1.0 + MAGNITUDES[1:, np.newaxis] ** 2
        products = terms.products[:, None] / larger[..., np.newaxis]
        scatter = np.full((3, 1, len(MAGNITUDES), *scales.shape[1:2], len(NOISE_PRIOR)), -1e9)
        scatter[:, 0, 1:] = self._log_evidence(products[:, :, None], scales[:, None])
        scatter[:, 0, 1:] -= 0.5 * self._dof[:, None, None, None] * np.log(larger)[..., np.newaxis]
        return np.concatenate([found, scatter], axis=1).swapaxes(0, 1)

    def _log_evidence(self, products: FloatArray, scales: FloatArray) -> FloatArray:
        """Log evidence (3, ..., components of the noise prior), sizes and noise integrated.

        ``products`` (3, ..., k + 1, k + 1) are those of terms and data, ``scales`` (3, ..., k) standard
        deviations of sizes.
        """
        padded = np.concatenate([scales, np.ones((*scales.shape[:-1], 1))], axis=-1)
        matrix = products * padded[..., :, np.newaxis] * padded[..., np.newaxis, :]
        diagonal = np.arange(scales.shape[-1])
        matrix[..., diagonal, diagonal] += 1.0
        roots = np.diagonal(np.linalg.cholesky(matrix), axis1=-2, axis2=-1)
        half_chi2 = 0.5 * roots[..., -1] ** 2
        log_determinant = np.sum(np.log(roots[..., :-1]), axis=-1)
        half_dof = 0.5 * self._dof.reshape(3, *(1,) * (half_chi2.ndim - 1))
        parts = [
            shape * math.log(scale)
            - math.lgamma(shape)
            + np.reshape([math.lgamma(shape + each) for each in half_dof.flat], half_dof.shape)
            - (shape + half_dof) * np.log(scale + half_chi2)
            for _, shape, scale in NOISE_PRIOR
        ]
        return np.asarray(np.stack(parts, axis=-1) - log_determinant[..., np.newaxis])


def _summed(per_gyro: FloatArray, magnitudes: int) -> FloatArray:
    """Log evidence of all gyros (h,) from that of each.

    ``per_gyro`` (h, 3, magnitudes, ..., components of the noise prior) are those of h hypotheses.
    """
    count = len(per_gyro)
    top = per_gyro.reshape(count, 3, -1).max(axis=2).reshape(count, 3, *(1,) * (per_gyro.ndim - 2))
    shares = np.exp(per_gyro - top)
    for axis in range(2, 2 + magnitudes):
        shares = np.moveaxis(np.tensordot(_SMALLER, shares, (1, axis)), 0, axis)
    together = np.sum(np.log(np.maximum(shares, 1e-300)) + top, axis=1)
    together += np.log([probability for probability, _, _ in NOISE_PRIOR])
    sums = np.logaddexp.reduce(together.reshape(count, -1), axis=1)
    return np.asarray(sums - magnitudes * math.log(len(MAGNITUDES)))


def _smaller() -> FloatArray:
    """Probability of a magnitude in one gyro (columns), given that of the effect (rows)."""
    count = len(MAGNITUDES)
    smaller = np.tril(np.ones((count, count))) / np.arange(1, count + 1)[:, np.newaxis]
    return np.asarray(_SAME_MAGNITUDE * np.eye(count) + (1.0 - _SAME_MAGNITUDE) * smaller)


_SMALLER = _smaller()


def _log_parameter_volume(
    problem: Problem, candidates: Sequence[Candidate], terms: _Terms, scales: FloatArray
) -> float:
    """Logarithm of the share of the prior of nonlinear parameters that the data leave (Laplace).

    The curvature is that of the fit, linearized in the parameters, beside the sizes of all terms. A time
    without bounds is left out: nothing changes with it between two dwells.
    """
    slopes = []
    for place, each in enumerate(candidates):
        for index, parameter in enumerate(each.form.parameters):
            if math.isinf(parameter.low):
                continue
            value = each.values[index]
            width = prior_width(problem, parameter, value)
            step = _STEP * width if value + _STEP * width <= parameter.high else -_STEP * width
            values = (*each.values[:index], value + step, *each.values[index + 1 :])
            change = replace(each, values=values).columns(problem.campaign) - each.columns(problem.campaign)
            mine = terms.owner == place
            visible, _ = problem.beside(change[problem.searched] * (width / step))
            slopes.append((visible / terms.rms[:, None, mine], mine))
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
        change = np.stack([each[gyro] @ sizes[mine] for each, mine in slopes], axis=1)
        across = columns.T @ change
        information += change.T @ change - across.T @ np.linalg.solve(normal, across)
    return -0.5 * float(np.linalg.slogdet(np.eye(len(slopes)) + information / (2.0 * np.pi))[1])


def _steps(problem: Problem, form: Form) -> tuple[FloatArray, FloatArray]:
    """Times (t,) of a step, the edges and the middle of each dwell, and its columns (3, m, t) beside."""
    campaign, searched = problem.campaign, problem.searched
    edges_s = (campaign.start_s[searched], campaign.middle_s[searched], campaign.end_s[searched])
    times_s = np.unique(np.concatenate(edges_s))
    return times_s, problem.beside(
        np.concatenate([form.columns(campaign, (at_s,))[searched] for at_s in times_s.tolist()], axis=2)
    )[0]


def prior_width(problem: Problem, parameter: Parameter, value: float) -> float:
    """Width of a parameter's uniform prior at a value.

    The prior of a scale is uniform in its logarithm; a time without bounds is one in the dwells searched.
    """
    if not math.isfinite(parameter.low):
        campaign = problem.campaign
        return float(np.ptp(campaign.middle_s[problem.searched]))
    if parameter.is_scale:
        return value * math.log(parameter.high / parameter.low)
    return parameter.high - parameter.low


def detectable_dph(problem: Problem) -> dict[str, float]:
    """Smallest remainder that the data would show, by what it follows: rms, deg/h.

    ``problem`` has the effects found as columns. Shown, with probability ``REMAINDER_POWER``, is what makes a
    remainder more probable than none; its size is the same in all gyros.
    """
    remainder = remainder_of(problem)
    chi2 = np.random.default_rng(0).chisquare(1.0, (_DRAWS, remainder.powers[:, 0].size))
    prior_odds = math.log((1.0 - REMAINDER_PRIOR) / REMAINDER_PRIOR * len(remainder.names) * len(MAGNITUDES))
    sizes = np.geomspace(0.1, 10.0, 25)
    found = {}
    for name, powers in zip(remainder.names, np.moveaxis(remainder.powers, 1, 0), strict=True):
        variances = sizes[:, np.newaxis] ** 2 * powers.ravel()
        log_odds = 0.5 * (variances @ chi2.T - np.sum(np.log1p(variances), axis=1, keepdims=True))
        shown = np.mean(log_odds > prior_odds, axis=1) >= REMAINDER_POWER
        found[name] = float(sizes[np.argmax(shown)]) if shown.any() else math.inf
    # Of a remainder as large in all dwells; an outlier with its large deviation does not count.
    precisions = 1.0 / problem.campaign.known_sigma_dph[problem.searched]
    noise_dph = problem.noise_scale / nan_rms(precisions)
    return {name: size * noise_dph for name, size in found.items()}


def _imitating(of: Hypothesis, effects: Sequence[Effect], campaign: Campaign) -> list[frozenset[str]]:
    """Names of the sets in which an effect that can't be fitted takes the place of one that it imitates."""
    missing = {each.name for each in effects if each.missing_input(campaign) and each.may_imitate(campaign)}
    return [
        of.names - {one.effect.name} | {other}
        for one in of.candidates
        for other in one.effect.imitated_by
        if other in missing
    ]
