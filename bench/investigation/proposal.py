"""Selects the next block: the one with the largest expected decrease of the entropy per hour."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.special import chdtrc, ndtr

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.closure.campaign import Campaign, campaign_of
from gyrobench.bench.closure.candidates import Candidate, best_start, solve_with
from gyrobench.bench.closure.problem import declared_problem
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, rms, triple
from gyrobench.bench.investigation.blocks import Block, BlockPlanner, catalogue
from gyrobench.bench.investigation.choice import (
    ExpectedEntropy,
    LinearizedHypothesis,
    Prediction,
    Rival,
    entropy,
    expected_entropy_after,
    linearize,
)
from gyrobench.bench.investigation.external_bench import AfterLastDwell
from gyrobench.bench.investigation.forecast import Forecast
from gyrobench.bench.investigation.profile import Profile, ProfileCalibration
from gyrobench.bench.navigation.positions import AXES

#: Number of blocks that are tried in pairs; maximum number of visits of a profile in a block.
_PAIRED, _VISITS = 4, 3
#: Spread of the bias from one power-on to the next, in units of the noise. It is large since the search uses
#: no information from the constant of a power-on, and a block must not be selected for it.
_RUN_SPREAD = 30.0
#: Smaller differences of a dwell's temperature from the forecast are not reported.
_MIN_OFF_K = 10.0
#: Dwells fit a prediction if the p-value of chi2 is at least this.
_MIN_P_VALUE = 1e-4
#: Probability from which on a hypothesis is settled.
SETTLED = 0.99
#: A block can help if its expected decrease of the entropy, nats, is larger than this, or if it settles a
#: hypothesis with more than this probability. Below this entropy a hypothesis is settled already.
MIN_GAIN, _MIN_CHANCE, _MIN_ENTROPY = 0.02, 0.5, 0.056


@dataclass(frozen=True)
class Proposal:
    """A block with its utility and the prediction of each rival."""

    block: Block  #: The block.
    rows: tuple[DwellRow, ...]  #: Its dwells with forecast temperatures.
    predictions: tuple[Prediction, ...]  #: Prediction of each rival for the biases of these dwells.
    entropy: float  #: Entropy of the rivals' probabilities before the block, nats.
    expected: ExpectedEntropy  #: Entropy after the block.
    #: Largest number of earlier blocks with one of its kinds, which settled no hypothesis.
    repeats: int = 0
    #: Hours of a profile that the block replaces; see :meth:`~.profile.ProfileCalibration.missing_h`.
    replaced_h: float = 0.0
    missing_h: float = 0.0  #: Hours of a profile that are still missing after the block.

    @property
    def gain_per_h(self) -> float:
        """Expected decrease of the entropy per hour on the bench, nats/h.

        Halved for each earlier block of a kind that settled no hypothesis: its predictions are too narrow.
        """
        return self.entropy_decrease * self.weight / self.block.plan.duration_h

    @property
    def entropy_decrease(self) -> float:
        """Expected decrease of the entropy, nats."""
        return self.entropy - self.expected.entropy

    @property
    def can_help(self) -> bool:
        """Whether the block is worth its time for the hypotheses."""
        chance = self.weight * (1.0 - self.expected.unsettled) if self.entropy > _MIN_ENTROPY else 0.0
        return self.entropy_decrease > MIN_GAIN or chance > _MIN_CHANCE

    @property
    def weight(self) -> float:
        """Weight of the expected decrease: halved for each earlier block that settled no hypothesis."""
        return 1.0 / 2.0**self.repeats

    @property
    def difference(self) -> float:
        """Squared Mahalanobis distance of the first rival's prediction to the closest other prediction."""
        first, *others = self.predictions
        differences_dph = [first.mean_dph - each.mean_dph for each in others]
        pairs = zip(differences_dph, others, strict=True)
        return min(
            float(difference_dph @ np.linalg.solve(each.covariance, difference_dph)) / each.correlation_factor
            for difference_dph, each in pairs
        )

    @property
    def tested_per_h(self) -> float:
        """Probability that the block settles the first rival if it is true, per hour.

        The log odds are normally distributed with variance :attr:`difference`, and half of it as mean.
        """
        sigma = max(float(np.sqrt(self.difference)), 1e-9)
        chance = float(ndtr(0.5 * sigma - np.log(SETTLED / (1.0 - SETTLED)) / sigma))
        return self.weight * chance / self.block.plan.duration_h


@dataclass(frozen=True)
class PossibleBlocks:
    """Blocks that a bench can measure, and those that it has measured."""

    planner: BlockPlanner = field(default_factory=AfterLastDwell)  #: The bench.
    max_h: float = np.inf  #: Maximum duration of a block.
    #: Kinds of the blocks that the bench refused. A refused single kind is not proposed in a pair either; the
    #: kinds of a refused pair are proposed separately.
    refused: Collection[Sequence[str]] = ()
    measured: Sequence[Sequence[str]] = ()  #: Kinds of the blocks measured since the first table.

    def usable(self, blocks: Sequence[Block]) -> list[Block]:
        """Those blocks that can be measured, with the times of the bench."""
        not_refused = [
            each for each in blocks if not any(set(kinds) <= set(each.kinds) for kinds in self.refused)
        ]
        timed = filter(None, map(self.planner.timed, not_refused))
        return [each for each in timed if each.plan.duration_h <= self.max_h]

    def repeats(self, block: Block) -> int:
        """Largest number of measured blocks with one of the kinds of this block."""
        return max(sum(kind in kinds for kinds in self.measured) for kind in block.kinds)


def propose(
    forecast: Forecast,
    rivals: Sequence[Rival],
    possible: PossibleBlocks | None = None,
    profile: Profile | None = None,
    calibration: ProfileCalibration | None = None,
    *,
    is_settled: bool = False,
) -> list[Proposal]:
    """Possible blocks, best first: by entropy decrease per hour, or with a profile by remaining hours.

    ``forecast`` is from all dwells measured, ``rivals`` are the hypotheses fitted to them. ``possible``: by
    default all blocks, on a bench that stays in the state after the last dwell; a ``profile`` adds blocks
    with its dwells. With a ``calibration``, information about the biases of the profile counts too;
    ``is_settled``: whether only this counts, and the proposals have no predictions.
    """
    rows, possible = forecast.measured, possible or PossibleBlocks()
    start = possible.planner.start(rows)

    def proposal(block: Block) -> Proposal:
        repeats = possible.repeats(block)
        if calibration is None:
            return replace(proposal_of(forecast, block, rivals), repeats=repeats)
        new_rows = tuple(forecast.rows(block.plan))
        counted_rivals = calibration.rivals if is_settled else rivals
        variances, predictions = _profile_variances(
            forecast, calibration.profile_rows, calibration.profile.averaging_matrix, new_rows, counted_rivals
        )
        missing_h = calibration.missing_h(variances[: len(calibration.rivals)])
        replaced_h = calibration.missing_h(calibration.variances) - missing_h
        candidates = Proposal(block, new_rows, (), 0.0, ExpectedEntropy(0.0, 1.0, 0.0))
        if not is_settled:
            candidates = _proposal_with_utility(block, new_rows, predictions, rivals)
        return replace(candidates, repeats=repeats, replaced_h=replaced_h, missing_h=missing_h)

    profile_kinds = profile.kinds() if profile else ()
    refused_in_pairs = {kind for kinds in possible.refused if len(kinds) > 1 for kind in kinds}

    def sort_proposals(candidates: Sequence[Proposal]) -> list[Proposal]:
        key = (
            remaining_hours_of(candidates, is_settled=is_settled)
            if calibration
            else lambda each: -each.gain_per_h
        )
        return sorted(candidates, key=key)

    def proposals(sequences: Iterable[Sequence[str]] | None = None) -> list[Proposal]:
        return [proposal(each) for each in possible.usable(catalogue(rows, sequences, start, profile_kinds))]

    candidates = sort_proposals(proposals())
    best = [each.block.name for each in candidates[:_PAIRED]]
    candidates += proposals(
        itertools.permutations([name for name in best if name not in refused_in_pairs], 2)
    )
    if calibration is not None:
        names = [each.name for each in profile_kinds]
        visits = [each for each in candidates if each.block.name in names]
        for _ in range(_VISITS - 1):
            visits = proposals(
                (*each.block.kinds, name) for each in sort_proposals(visits)[:_PAIRED] for name in names
            )
            candidates += visits
    return sort_proposals(candidates)


def remaining_hours_of(
    proposals: Sequence[Proposal], *, is_settled: bool = False
) -> Callable[[Proposal], float]:
    """Key function: expected hours until hypothesis and biases are settled, if a block is measured next.

    After that block, entropy and missing information about biases are assumed to decrease at the rates of the
    best of these blocks. If no hypothesis is settled, at least the shortest block follows. If information is
    missing, the shortest block is added, since later blocks give less.
    """
    max_gain_per_h = max((each.gain_per_h for each in proposals), default=0.0)
    max_replaced_per_h = max(
        (each.replaced_h / each.block.plan.duration_h for each in proposals), default=0.0
    )
    shortest_h = min((each.block.plan.duration_h for each in proposals), default=0.0)

    def remaining_hours(each: Proposal) -> float:
        hours, discount = each.block.plan.duration_h, 1.0 - each.weight
        if not is_settled:
            entropy_left = each.weight * each.expected.unsettled_entropy + discount * each.entropy
            unsettled = each.weight * each.expected.unsettled + discount
            hours += max(entropy_left / max(max_gain_per_h, 1e-9), unsettled * shortest_h)
        if each.missing_h:
            hours += each.missing_h / max(max_replaced_per_h, 1e-9) + shortest_h
        return hours

    return remaining_hours


def proposal_of(forecast: Forecast, block: Block, rivals: Sequence[Rival]) -> Proposal:
    """Proposal of a block with its predictions and utility."""
    new = forecast.rows(block.plan)
    return _proposal_with_utility(block, new, _predictions(forecast, new, rivals), rivals)


def _proposal_with_utility(
    block: Block, new: Sequence[DwellRow], predictions: Sequence[Prediction], rivals: Sequence[Rival]
) -> Proposal:
    probabilities = np.array([each.probability for each in rivals])
    expected = expected_entropy_after(predictions, probabilities, SETTLED)
    return Proposal(block, tuple(new), tuple(predictions), float(entropy(probabilities)), expected)


def proposal_entry(proposal: Proposal, rivals: Sequence[Rival]) -> dict[str, Any]:
    """Journal entry of a proposal with its predictions."""
    return {
        "block": proposal.block.name,
        "what": proposal.block.instruction,
        "hours": proposal.block.plan.duration_h,
        "entropy": proposal.entropy,
        "expected_entropy": proposal.expected.entropy,
        "dwells": [row.dwell for row in proposal.rows],
        "predictions": [
            {
                "hypothesis": rival.title,
                "probability": rival.probability,
                **{
                    f"bias_{axis}_dph": prediction.mean_dph.reshape(3, -1)[gyro].tolist()
                    for gyro, axis in enumerate(AXES)
                },
                **{
                    f"sigma_{axis}_dph": np.sqrt(np.diag(prediction.covariance)).reshape(3, -1)[gyro].tolist()
                    for gyro, axis in enumerate(AXES)
                },
            }
            for rival, prediction in zip(rivals, proposal.predictions, strict=True)
        ],
    }


def calibration_of(
    forecast: Forecast, profile: Profile, rivals: Sequence[Rival], planner: BlockPlanner | None = None
) -> ProfileCalibration:
    """Uncertainty of a profile's biases with the dwells measured so far."""
    start = (planner or AfterLastDwell()).start(forecast.measured)
    profile_rows = tuple(forecast.rows(profile.whole_plan(forecast.measured, start)))
    averaging, rivals = profile.averaging_matrix, _most_probable(rivals)
    return ProfileCalibration(
        profile,
        profile_rows,
        rivals,
        _profile_variances(forecast, profile_rows, averaging, (), rivals)[0],
        _profile_variances(forecast, profile_rows, averaging, profile_rows, rivals, only_new=True)[0],
    )


def _most_probable(rivals: Sequence[Rival]) -> tuple[Rival, ...]:
    """The most probable rivals with a total probability of at least :data:`SETTLED`, normalized to 1."""
    cumulative = np.cumsum([0.0, *(each.probability for each in rivals)])[:-1]
    kept = list(itertools.compress(rivals, cumulative < SETTLED))
    total = sum(each.probability for each in kept)
    return tuple(replace(each, probability=each.probability / total) for each in kept)


def _profile_variances(
    forecast: Forecast,
    profile_rows: Sequence[DwellRow],
    averaging: FloatArray,
    new: Sequence[DwellRow],
    rivals: Sequence[Rival],
    *,
    only_new: bool = False,
) -> tuple[FloatArray, list[Prediction]]:
    """Variances (k, m) of the profile's biases after the ``new`` dwells, and predictions of the new dwells.

    The profile is predicted in the power cycle with the most dwells. ``only_new``: whether the new dwells are
    the only ones measured.
    """
    runs = Counter(row.run for row in (new if only_new else forecast.measured))
    [(run, _)] = runs.most_common(1)
    delay_s = max(new[-1].end_s - profile_rows[0].start_s, 0.0) if new else 0.0
    first_dwell = 1 + max(row.dwell for row in [*profile_rows, *new])
    rows = [
        replace(
            row,
            dwell=first_dwell + index,
            run=run,
            start_s=row.start_s + delay_s,
            end_s=row.end_s + delay_s,
            since_power_on_s=row.since_power_on_s + delay_s,
        )
        for index, row in enumerate(profile_rows)
    ]
    variances, predictions = [], []
    for each, variance in _linearize_rivals(forecast, [*new, *rows], rivals):
        is_profile = np.arange(len(each.measured)) >= len(each.measured) - len(rows)
        is_new = ~(each.measured | is_profile)
        is_measured = is_new if only_new else ~is_profile
        variances.append(np.diag(averaging @ each.covariance(is_measured, is_profile) @ averaging.T))
        if new and not only_new:
            predictions.append(_prediction(forecast, each, is_new, variance))
    return np.array(variances), predictions


def _prediction(
    forecast: Forecast, linear: LinearizedHypothesis, is_new: BoolArray, variance: float
) -> Prediction:
    """Prediction of new dwells, including the variance of what a rival can't predict."""
    prediction = linear.prediction(is_new)
    covariance = prediction.covariance + variance * np.eye(len(prediction.mean_dph))
    return Prediction(prediction.mean_dph, covariance, forecast.correlation_factor)


def _predictions(forecast: Forecast, new: Sequence[DwellRow], rivals: Sequence[Rival]) -> list[Prediction]:
    """Prediction of each rival for new dwells at their temperatures."""
    linear_rivals = _linearize_rivals(forecast, new, rivals)
    return [_prediction(forecast, each, ~each.measured, variance) for each, variance in linear_rivals]


def _linearize_rivals(
    forecast: Forecast, new: Sequence[DwellRow], rivals: Sequence[Rival]
) -> list[tuple[LinearizedHypothesis, float]]:
    """Each rival linearized about its fit to the dwells, and the variance of what it can't predict."""
    rows, measured_campaign = forecast.measured, forecast.campaign
    campaign = campaign_of([*rows, *new], is_forecast=True)
    measured = ~np.isin(campaign.dwell, [row.dwell for row in new])
    if measured_campaign.above_optics_c is not None:
        # Avoids another fit of the thermal network, which would take a second.
        above_c = campaign.board_c - campaign.gyro_c
        above_c[measured] = measured_campaign.above_optics_c
        campaign = replace(campaign, forecast_above_optics_c=above_c)
    sigma_dph = forecast.noise_scale * np.array([row.sigma_dph for row in forecast.measured])
    spread_dph = _RUN_SPREAD * float(np.nanmedian(sigma_dph))
    result = []
    for each in rivals:
        candidates, unpredictable_dph = _predictable(each, campaign, measured, measured_campaign)
        linear = linearize(campaign, measured, candidates, forecast.noise_scale, spread_dph)
        result.append((linear, each.remainder_dph**2 + unpredictable_dph**2))
    return result


def _predictable(
    rival: Rival, campaign: Campaign, measured: BoolArray, measured_campaign: Campaign
) -> tuple[list[Candidate], float]:
    """Effects of a rival that the dwells of a campaign can show, and the size of its other effects, deg/h.

    An effect without a fit is predicted by the effect that it imitates, unless the new dwells have its input.
    """
    candidates = list(rival.candidates)
    for effect in rival.unfitted:
        forms = [form for form in effect.forms if form.missing_input(campaign) is None]
        if forms:
            start = best_start(declared_problem(campaign, measured), effect, forms[0])
            candidates = [*(each for each in candidates if each.effect.name in rival.names), start]
    missing = [each for each in candidates if each.form.missing_input(campaign)]
    if not missing:
        return candidates, 0.0
    problem = declared_problem(measured_campaign, measured_campaign.all_dwells)
    solution = solve_with(
        problem, [each for each in missing if not each.form.missing_input(measured_campaign)]
    )
    size_dph = rms(solution.bias_dph - solve_with(problem, ()).bias_dph)
    return [each for each in candidates if each not in missing], size_dph


@dataclass(frozen=True)
class Outcome:
    """Result of new dwells for rivals that were fitted to the earlier dwells."""

    probabilities: tuple[float, ...]  #: Probability of each rival, updated by its prediction of the dwells.
    #: Rms of measured minus predicted bias of each rival, deg/h; without its mean in a new power cycle.
    error_dph: tuple[float, ...]
    noise_dph: float  #: Rms of the noise of the new dwells.
    p_value: tuple[float, ...]  #: p-value of chi2 of the dwells for the prediction of each rival.
    #: Largest difference of a dwell's temperature from its forecast, K; zero unless it exceeds 10 K and half
    #: of the temperature change of the block.
    off_forecast_k: float

    @property
    def fits(self) -> bool:
        """Whether the dwells fit the prediction of at least one rival."""
        return max(self.p_value) >= _MIN_P_VALUE

    @property
    def agrees(self) -> bool:
        """Whether the dwells fit, and settle the first rival."""
        return self.fits and self.probabilities[0] >= SETTLED

    @property
    def contradicts(self) -> bool:
        """Whether the dwells exclude the first rival."""
        return self.probabilities[0] <= 1.0 - SETTLED

    @property
    def is_clear(self) -> bool:
        """Whether the dwells agree with the first rival, or exclude it."""
        return self.agrees or self.contradicts


def is_confirmed_by(outcomes: Iterable[Outcome]) -> bool:
    """Whether the last clear outcome, which agrees with a hypothesis or contradicts it, agrees."""
    clear = [each for each in outcomes if each.is_clear]
    return bool(clear) and clear[-1].agrees


def outcome_of(
    forecast: Forecast, proposal: Proposal, new: Sequence[DwellRow], rivals: Sequence[Rival]
) -> Outcome | None:
    """Compare the dwells of a block with the prediction of each rival at the measured temperatures.

    Electronics without a sensor are as forecast. Dwells with flags are omitted; None if all have flags.
    """
    expected = {row.dwell: row for row in proposal.rows}
    usable = [_with_electronics(row, expected[row.dwell]) for row in new if not row.flags]
    if not usable:
        return None
    bias_dph = np.array([row.bias_dph for row in usable])
    predictions = _predictions(forecast, usable, rivals)
    log_weights = np.array(
        [float(each.log_likelihood(bias_dph.T.ravel()[np.newaxis])[0]) for each in predictions]
    )
    log_weights += np.log([each.probability for each in rivals])
    shares = np.exp(log_weights - log_weights.max())
    earlier_runs, runs = {row.run for row in forecast.measured}, np.array([row.run for row in usable])
    errors = []
    for each in predictions:
        error_dph = bias_dph - each.mean_dph.reshape(3, -1).T
        for run in set(runs.tolist()) - earlier_runs:
            error_dph[runs == run] -= error_dph[runs == run].mean(axis=0)
        errors.append(rms(error_dph))
    sigma_dph = forecast.noise_scale * np.array([row.sigma_dph for row in usable])
    chi2 = [each.chi2(bias_dph.T.ravel()[np.newaxis])[0] for each in predictions]
    return Outcome(
        tuple((shares / shares.sum()).tolist()),
        tuple(errors),
        rms(sigma_dph),
        tuple(chdtrc(predictions[0].dof, chi2).tolist()),
        _off_forecast_k(forecast.measured[-1], proposal.rows, usable),
    )


def _off_forecast_k(last: DwellRow, expected: Sequence[DwellRow], measured: Sequence[DwellRow]) -> float:
    forecast_c = {row.dwell: float(np.mean(row.gyro_c)) for row in expected}
    change_k = float(np.ptp([np.mean(last.gyro_c), *forecast_c.values()]))
    off_k = max(abs(float(np.mean(row.gyro_c)) - forecast_c[row.dwell]) for row in measured)
    return off_k if off_k > max(_MIN_OFF_K, 0.5 * change_k) else 0.0


def _with_electronics(row: DwellRow, expected: DwellRow) -> DwellRow:
    """The row with the expected temperature of the electronics above the optics, if that was not measured."""
    if np.isfinite(row.board_c).all():
        return row
    return replace(row, board_c=triple(np.array(row.gyro_c) + expected.board_c - expected.gyro_c))
