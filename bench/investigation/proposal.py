"""The next block to measure: the one that is expected to lower the entropy most per hour."""

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
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, rms
from gyrobench.bench.investigation.blocks import Block, BlockPlanner, catalogue
from gyrobench.bench.investigation.choice import (
    Expected,
    Linearized,
    Prediction,
    Rival,
    entropy,
    expected_after,
    linearized,
)
from gyrobench.bench.investigation.external_bench import AfterLastDwell
from gyrobench.bench.investigation.forecast import Forecast
from gyrobench.bench.investigation.profile import Profile, ProfileCalibration
from gyrobench.bench.navigation.positions import AXES

#: Blocks that are tried with another one after them, and visits of a profile in a block.
_PAIRED, _VISITS = 4, 3
#: Least spread of the bias from one power-on to the next, in units of the noise: the search takes nothing
#: from the constant of a power-on, and a block must not be chosen for what it would say.
_MIN_RUN_SPREAD = 30.0
#: Temperatures of dwells that differ by less from the forecast are not worth a notice.
_MIN_OFF_K = 10.0
#: Dwells of which every prediction is less probable by chi2 fit none.
_MIN_P_VALUE = 1e-4
#: A cause is settled at this probability.
SETTLED = 0.99
#: A block can help if it is expected to remove more of the entropy, nats, or to settle a cause with this
#: probability. With less entropy, a hypothesis is settled before it.
MIN_GAIN, _MIN_CHANCE, _MIN_ENTROPY = 0.02, 0.5, 0.056


@dataclass(frozen=True)
class Proposal:
    """A block with its utility and what each rival predicts."""

    block: Block  #: The block.
    rows: tuple[DwellRow, ...]  #: Its dwells with forecast temperatures.
    predictions: tuple[Prediction, ...]  #: Of each rival, for the biases of these dwells.
    entropy: float  #: Of the rivals' probabilities, nats.
    expected: Expected  #: After the block.
    #: How often its kinds were measured, the most of each, without settling the cause.
    repeats: int = 0
    #: Hours of a profile that the block replaces; see :meth:`~.profile.ProfileCalibration.missing_h`.
    replaced_h: float = 0.0
    missing_h: float = 0.0  #: Hours of a profile that are missing after the block.

    @property
    def gain_per_h(self) -> float:
        """Expected fall of the entropy per hour on the bench, nats/h.

        Halved each time that a kind did not settle the cause: its predictions are too narrow.
        """
        return self.fall * self.weight / self.block.plan.duration_h

    @property
    def fall(self) -> float:
        """Expected fall of the entropy, nats."""
        return self.entropy - self.expected.entropy

    @property
    def can_help(self) -> bool:
        """Whether the block is worth its time for the cause."""
        chance = self.weight * (1.0 - self.expected.unsettled) if self.entropy > _MIN_ENTROPY else 0.0
        return self.fall > MIN_GAIN or chance > _MIN_CHANCE

    @property
    def weight(self) -> float:
        """Share of the expected fall that counts: half for each time that a kind did not settle the cause."""
        return 1.0 / 2.0**self.repeats

    @property
    def difference(self) -> float:
        """Squared difference of the first rival's prediction from the closest other, in its uncertainty."""
        first, *others = self.predictions
        apart_dph = [first.mean_dph - each.mean_dph for each in others]
        found = zip(apart_dph, others, strict=True)
        return min(float(apart @ np.linalg.solve(each.covariance, apart)) for apart, each in found)

    @property
    def tested_per_h(self) -> float:
        """Probability that the block settles the first rival if it is the cause, per hour.

        The logarithm of their odds is normal with half the squared difference as mean, and that as variance.
        """
        sigma = max(float(np.sqrt(self.difference)), 1e-9)
        chance = float(ndtr(0.5 * sigma - np.log(SETTLED / (1.0 - SETTLED)) / sigma))
        return self.weight * chance / self.block.plan.duration_h


@dataclass(frozen=True)
class PossibleBlocks:
    """Which blocks a bench can measure, and which it has measured."""

    planner: BlockPlanner = field(default_factory=AfterLastDwell)  #: The bench.
    max_h: float = np.inf  #: Longest block.
    #: Kinds of the blocks that the bench refused. One kind is not proposed in a pair either; the kinds of a
    #: refused pair are proposed alone.
    refused: Collection[Sequence[str]] = ()
    measured: Sequence[Sequence[str]] = ()  #: Kinds of the blocks measured since the first table.

    def usable(self, blocks: Sequence[Block]) -> list[Block]:
        """Those of some blocks that can be measured, with the times of the bench."""
        asked = [each for each in blocks if not any(set(kinds) <= set(each.kinds) for kinds in self.refused)]
        timed = filter(None, map(self.planner.timed, asked))
        return [each for each in timed if each.plan.duration_h <= self.max_h]

    def repeats(self, block: Block) -> int:
        """How often the kinds of a block were measured, the most of each."""
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
    """Blocks with their utilities, best first: by entropy removed per hour, or with a profile by hours left.

    Parameters
    ----------
    forecast : Forecast
        Of all dwells measured.
    rivals : sequence of Rival
        Hypotheses fitted to them.
    possible : PossibleBlocks, optional
        By default any, on a bench that stays as it is after the last dwell.
    profile : Profile, optional
        Its dwells are blocks too.
    calibration : ProfileCalibration, optional
        Where given, information about the biases of the profile counts as well.
    is_settled : bool
        Whether only that counts; the proposals are without predictions then.
    """
    rows, possible = forecast.measured, possible or PossibleBlocks()
    start = possible.planner.start(rows)

    def proposal(block: Block) -> Proposal:
        repeats = possible.repeats(block)
        if calibration is None:
            return replace(proposal_of(forecast, block, rivals), repeats=repeats)
        new = tuple(forecast.rows(block.plan))
        counting = calibration.rivals if is_settled else rivals
        after, predictions = _next_pass(forecast, calibration.whole, calibration.profile.means, new, counting)
        missing_h = calibration.missing_h(after[: len(calibration.rivals)])
        replaced_h = calibration.missing_h(calibration.variances) - missing_h
        found = Proposal(block, new, (), 0.0, Expected(0.0, 1.0, 0.0))
        if not is_settled:
            found = _weighed(block, new, predictions, rivals)
        return replace(found, repeats=repeats, replaced_h=replaced_h, missing_h=missing_h)

    more = profile.kinds() if profile else ()
    paired = {kind for kinds in possible.refused if len(kinds) > 1 for kind in kinds}

    def ordered(found: Sequence[Proposal]) -> list[Proposal]:
        key = hours_left(found, is_settled=is_settled) if calibration else lambda each: -each.gain_per_h
        return sorted(found, key=key)

    def proposals(sequences: Iterable[Sequence[str]] | None = None) -> list[Proposal]:
        return [proposal(each) for each in possible.usable(catalogue(rows, sequences, start, more))]

    found = ordered(proposals())
    best = [each.block.name for each in found[:_PAIRED]]
    found += proposals(itertools.permutations([name for name in best if name not in paired], 2))
    if calibration is not None:
        names = [each.name for each in more]
        visits = [each for each in found if each.block.name in names]
        for _ in range(_VISITS - 1):
            visits = proposals(
                (*each.block.kinds, name) for each in ordered(visits)[:_PAIRED] for name in names
            )
            found += visits
    return ordered(found)


def hours_left(proposals: Sequence[Proposal], *, is_settled: bool = False) -> Callable[[Proposal], float]:
    """Expected hours until the cause is settled and the biases are certain enough, by the next block.

    After it, entropy and missing information about biases fall at the rates of the best of these blocks.
    While no cause is settled, at least the shortest block follows. While information is missing, one as short
    is added, since later blocks bring less. ``is_settled``: the cause is settled.
    """
    fastest = max((each.gain_per_h for each in proposals), default=0.0)
    replacing = max((each.replaced_h / each.block.plan.duration_h for each in proposals), default=0.0)
    shortest_h = min((each.block.plan.duration_h for each in proposals), default=0.0)

    def left(each: Proposal) -> float:
        hours, discount = each.block.plan.duration_h, 1.0 - each.weight
        if not is_settled:
            entropy_left = each.weight * each.expected.unsettled_entropy + discount * each.entropy
            unsettled = each.weight * each.expected.unsettled + discount
            hours += max(entropy_left / max(fastest, 1e-9), unsettled * shortest_h)
        if each.missing_h:
            hours += each.missing_h / max(replacing, 1e-9) + shortest_h
        return hours

    return left


def proposal_of(forecast: Forecast, block: Block, rivals: Sequence[Rival]) -> Proposal:
    """The proposal of a block."""
    new = forecast.rows(block.plan)
    return _weighed(block, new, _predictions(forecast, new, rivals), rivals)


def _weighed(
    block: Block, new: Sequence[DwellRow], predictions: Sequence[Prediction], rivals: Sequence[Rival]
) -> Proposal:
    probabilities = np.array([each.probability for each in rivals])
    expected = expected_after(predictions, probabilities, SETTLED)
    return Proposal(block, tuple(new), tuple(predictions), float(entropy(probabilities)), expected)


def proposed(proposal: Proposal, rivals: Sequence[Rival]) -> dict[str, Any]:
    """A proposal with its predictions, for the journal."""
    return {
        "block": proposal.block.name,
        "what": proposal.block.what,
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
    """What the dwells measured determine of the biases of a profile."""
    start = (planner or AfterLastDwell()).start(forecast.measured)
    whole = tuple(forecast.rows(profile.whole(forecast.measured, start)))
    means, rivals = profile.means, _leading(rivals)
    return ProfileCalibration(
        profile,
        whole,
        rivals,
        _next_pass(forecast, whole, means, (), rivals)[0],
        _next_pass(forecast, whole, means, whole, rivals, is_alone=True)[0],
    )


def _leading(rivals: Sequence[Rival]) -> tuple[Rival, ...]:
    """The most probable rivals, of together :data:`SETTLED`, as if there were no others."""
    before = np.cumsum([0.0, *(each.probability for each in rivals)])[:-1]
    kept = list(itertools.compress(rivals, before < SETTLED))
    total = sum(each.probability for each in kept)
    return tuple(replace(each, probability=each.probability / total) for each in kept)


def _next_pass(
    forecast: Forecast,
    whole: Sequence[DwellRow],
    means: FloatArray,
    new: Sequence[DwellRow],
    rivals: Sequence[Rival],
    *,
    is_alone: bool = False,
) -> tuple[FloatArray, list[Prediction]]:
    """Variances of means of the dwells of a profile after new ones, (k, m), and predictions of the new ones.

    The power-on is the one that is known best. ``is_alone``: the new dwells are all that is measured.
    """
    runs = Counter(row.run for row in (new if is_alone else forecast.measured))
    [(run, _)] = runs.most_common(1)
    later_s = max(new[-1].end_s - whole[0].start_s, 0.0) if new else 0.0
    number = 1 + max(row.dwell for row in [*whole, *new])
    rows = [
        replace(
            row,
            dwell=number + index,
            run=run,
            start_s=row.start_s + later_s,
            end_s=row.end_s + later_s,
            since_power_on_s=row.since_power_on_s + later_s,
        )
        for index, row in enumerate(whole)
    ]
    found, predictions = [], []
    for each, variance in _linearized(forecast, [*new, *rows], rivals):
        place = np.arange(len(each.sigma_dph) // 3) - len(each.sigma_dph) // 3 + len(rows)
        is_new = (place < 0) & (place >= -len(new))
        known = is_new if is_alone else place < 0
        found.append(np.diag(means @ each.covariance(known, place >= 0) @ means.T))
        if new and not is_alone:
            predictions.append(_prediction(each, place < -len(new), is_new, variance))
    return np.array(found), predictions


def _prediction(linear: Linearized, measured: BoolArray, is_new: BoolArray, variance: float) -> Prediction:
    """Prediction of new dwells, with the variance of what a rival can't predict."""
    found = linear.prediction(measured, is_new)
    return replace(found, covariance=found.covariance + variance * np.eye(len(found.mean_dph)))


def _predictions(forecast: Forecast, new: Sequence[DwellRow], rivals: Sequence[Rival]) -> list[Prediction]:
    """What each rival, fitted to dwells, predicts for new ones at their temperatures."""
    found = []
    for each, variance in _linearized(forecast, new, rivals):
        is_new = np.arange(len(each.sigma_dph) // 3) >= len(each.sigma_dph) // 3 - len(new)
        found.append(_prediction(each, ~is_new, is_new, variance))
    return found


def _linearized(
    forecast: Forecast, new: Sequence[DwellRow], rivals: Sequence[Rival]
) -> list[tuple[Linearized, float]]:
    """Each rival linearized about its fit to the dwells, and the variance of what it can't predict."""
    rows, known = forecast.measured, forecast.campaign
    campaign = campaign_of([*rows, *new], is_forecast=True)
    measured = ~np.isin(campaign.dwell, [row.dwell for row in new])
    if known.above_optics_c is not None:
        # A network fitted again to the new dwells would take a second.
        above_c = campaign.board_c - campaign.gyro_c
        above_c[measured] = known.above_optics_c
        campaign = replace(campaign, forecast_above_optics_c=above_c)
    spread_dph = _run_spread_dph(forecast)
    found = []
    for each in rivals:
        candidates, unknown_dph = _predictable(each, campaign, measured, known)
        linear = linearized(campaign, measured, candidates, forecast.noise_scale, spread_dph)
        found.append((linear, each.remainder_dph**2 + unknown_dph**2))
    return found


def _predictable(
    rival: Rival, campaign: Campaign, measured: BoolArray, known: Campaign
) -> tuple[list[Candidate], float]:
    """Effects of a rival that the dwells of a campaign can show, and the size of its others, deg/h.

    An effect that was not fitted is predicted as what imitates it, unless the new dwells have its input.
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
    problem = declared_problem(known, np.ones(len(known), dtype=bool))
    solution = solve_with(problem, [each for each in missing if not each.form.missing_input(known)])
    size_dph = rms(solution.bias_dph - solve_with(problem, ()).bias_dph)
    return [each for each in candidates if each not in missing], size_dph


def _run_spread_dph(forecast: Forecast) -> float:
    """Standard deviation of the bias from one power-on to the next."""
    sigma_dph = float(np.nanmedian([row.sigma_dph for row in forecast.measured]))
    return _MIN_RUN_SPREAD * forecast.noise_scale * sigma_dph


@dataclass(frozen=True)
class Outcome:
    """What new dwells say about rivals that were fitted to the earlier ones."""

    probabilities: tuple[float, ...]  #: Of each rival, by its prediction and the dwells alone.
    #: Rms of measured minus predicted bias, deg/h, for each rival; of a new power-on without the mean.
    error_dph: tuple[float, ...]
    noise_dph: float  #: Rms of the noise of the new dwells.
    p_value: tuple[float, ...]  #: Of a chi2 test of the dwells against the prediction of each rival.
    #: Largest difference of a dwell's temperature from its forecast, K; zero unless it is above 10 K and half
    #: of what the block changes it by.
    off_forecast_k: float

    @property
    def fits(self) -> bool:
        """Whether the dwells fit the prediction of one rival."""
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
    """Whether the latest of the blocks that agree with a cause or contradict it agrees with it."""
    clear = [each for each in outcomes if each.is_clear]
    return bool(clear) and clear[-1].agrees


def outcome_of(
    forecast: Forecast, proposal: Proposal, new: Sequence[DwellRow], rivals: Sequence[Rival]
) -> Outcome | None:
    """Compare the dwells of a block with what each rival predicts at the temperatures measured there.

    Electronics without a sensor are as forecast. Dwells with flags do not count; None if all have flags.
    """
    expected = {row.dwell: row for row in proposal.rows}
    good = [_with_electronics(row, expected[row.dwell]) for row in new if not row.flags]
    if not good:
        return None
    bias_dph = np.array([row.bias_dph for row in good])
    predictions = _predictions(forecast, good, rivals)
    logs = np.array([float(each.log_likelihood(bias_dph.T.ravel()[np.newaxis])[0]) for each in predictions])
    logs += np.log([each.probability for each in rivals])
    shares = np.exp(logs - logs.max())
    known, runs = {row.run for row in forecast.measured}, np.array([row.run for row in good])
    errors = []
    for each in predictions:
        error_dph = bias_dph - each.mean_dph.reshape(3, -1).T
        for run in set(runs.tolist()) - known:
            error_dph[runs == run] -= error_dph[runs == run].mean(axis=0)
        errors.append(rms(error_dph))
    sigma_dph = forecast.noise_scale * np.array([row.sigma_dph for row in good])
    chi2 = [each.chi2(bias_dph.T.ravel()[np.newaxis])[0] for each in predictions]
    return Outcome(
        tuple((shares / shares.sum()).tolist()),
        tuple(errors),
        rms(sigma_dph),
        tuple(chdtrc(bias_dph.size, chi2).tolist()),
        _off_forecast_k(forecast.measured[-1], proposal.rows, good),
    )


def _off_forecast_k(last: DwellRow, expected: Sequence[DwellRow], measured: Sequence[DwellRow]) -> float:
    forecast_c = {row.dwell: float(np.mean(row.gyro_c)) for row in expected}
    change_k = float(np.ptp([np.mean(last.gyro_c), *forecast_c.values()]))
    off_k = max(abs(float(np.mean(row.gyro_c)) - forecast_c[row.dwell]) for row in measured)
    return off_k if off_k > max(_MIN_OFF_K, 0.5 * change_k) else 0.0


def _with_electronics(row: DwellRow, expected: DwellRow) -> DwellRow:
    """Same row; electronics that were not measured are as far above the optics as expected."""
    if np.isfinite(row.board_c).all():
        return row
    x_c, y_c, z_c = (np.array(row.gyro_c) + expected.board_c - expected.gyro_c).tolist()
    return replace(row, board_c=(x_c, y_c, z_c))
