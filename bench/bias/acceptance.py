"""Judges whether a unit's gyros are fit for a rotational INS, allowing for the measurement uncertainty.

A rotational INS averages out a bias that is the same in all positions. So the largest difference of a
gyro's bias between positions decides. Positions are compared only within a plateau, at the same power cycle,
cycle and temperature, after the remaining effect of temperature is removed; see
:mod:`gyrobench.bench.bias.position_differences`. Results are listed by temperature bin.

Passes of one plateau are judged by their mean difference, whose uncertainty is smaller, if they agree
(chi-square, Holm over all plateaus of all gyros). If they disagree, as with an attitude effect that follows
the direction of the temperature change, each pass is judged separately. If passes differ by less than the
test detects, the mean may be within the limit and one pass beyond it.

The largest of several noisy differences is larger than the largest true one: with six equal positions it is
some 2.5 times the uncertainty of one. It is therefore not judged like a single difference:

* A gyro passes in a bin only if *every* pair of positions does: difference plus z times its standard
  uncertainty below the limit, z one-sided. If a true difference is at the limit or above, its own pair would
  have to pass by error, so no correction for the number of pairs is needed (an intersection-union test). Such
  a unit is accepted with a probability of at most ``1 - confidence``.
* It fails if *any* pair does: difference minus c times its standard uncertainty above the limit. Any
  pair of any plateau and gyro could exceed it by chance, so c is corrected for their number (Bonferroni).
  A unit without a difference above the limit is rejected with a probability of at most ``1 - confidence``.
* Between the two it is marginal: more cycles are needed.

Both rely on the stated uncertainties of the dwells. An error due to a common source, as accelerometers that
follow the temperature, counts as the same in each pass if that makes a difference less certain.

References
----------
JCGM 106:2012, "The role of measurement uncertainty in conformity assessment", 8.3 (guard bands).
Berger, "Multiparameter Hypothesis Testing and Acceptance Sampling", Technometrics 24 (1982) 295.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import get_args

from gyrobench.bench.bias.bins import DEFAULT_WIDTH_C
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.error_split import NONE_SHARED, SharedErrors
from gyrobench.bench.bias.plateaus import (
    MAX_PLANNED_FROM_MEAN_K,
    PlannedDwell,
    group_plateaus,
    passes_of_plateaus,
)
from gyrobench.bench.bias.position_differences import CubicBiasCurve, fit_bias_curve, position_differences
from gyrobench.bench.bias.statistics import holm
from gyrobench.bench.bias.verdicts import (
    Acceptance,
    AcceptanceLimits,
    GyroVerdict,
    JudgedQuantity,
    Judgement,
    NotMeasured,
    RunVerdict,
    Verdict,
)
from gyrobench.bench.navigation.positions import AXES, POSITIONS

_Plateau = Sequence[DwellRow]

#: Passes are judged one by one if their test of agreement has a smaller p-value.
_MAX_DISAGREEMENT_P_VALUE = 0.05


@dataclass(frozen=True)
class _JudgedValue:
    """A difference of two positions, or the bias in one, to be compared with a limit."""

    axis: int
    quantity: JudgedQuantity
    temperature_c: float
    positions: tuple[str, ...]
    value_dph: float
    sigma_dph: float
    passes_agree: bool = True
    passes: int = 1
    common_dph: float = 0.0  #: Part of the standard uncertainty that is the same in each pass.


def judge(
    rows: Iterable[DwellRow],
    limits: AcceptanceLimits | None,
    planned: Iterable[PlannedDwell] = (),
    width_c: float = DEFAULT_WIDTH_C,
    shared: SharedErrors = NONE_SHARED,
) -> Acceptance:
    """Judge the gyros of one unit by the rules in the module docstring.

    A run is accepted only if every planned dwell was compared with all others of its plateau, in each cycle,
    and plateaus connect all positions; a gyro that exceeds a limit is rejected even if not. Dwells with flags
    count as not measured. ``planned``: dwells that measure biases, in the order of time; ``width_c``: width
    of the temperature bins of the judgements, K; ``shared``: errors that are the same in all dwells.
    """
    if limits is None:
        return Acceptance()
    in_time = sorted((row for row in rows if not row.flags), key=lambda row: row.dwell)
    plateaus = group_plateaus(in_time)
    valid = [
        [good for plateau in plateaus if (good := _valid_rows(plateau, axis, limits))]
        for axis in range(len(AXES))
    ]
    curves = [fit_bias_curve(gyro_plateaus, axis) for axis, gyro_plateaus in enumerate(valid)]
    compared = [
        [plateau for plateau in gyro_plateaus if len({row.position for row in plateau}) > 1]
        for gyro_plateaus in valid
    ]
    values = _differences(compared, curves, shared, limits.vertical_difference_dph is not None)
    if limits.bias_dph is not None:
        values += _biases(valid)
    judgements = _judgements(values, limits, width_c)
    planned = list(planned)
    missing = _not_measured(valid, compared, planned, limits)
    measured = {each.position for each in planned} | {row.position for row in in_time}
    groups = [_connected_positions(measured, gyro_plateaus) for gyro_plateaus in compared]
    incomplete = {each.gyro for each in missing}
    incomplete |= {gyro for gyro, each in zip(AXES, groups, strict=True) if len(each) > 1}
    gyros = {gyro: _gyro_verdict(gyro, judgements, gyro in incomplete) for gyro in AXES}
    return Acceptance(
        verdict=_run_verdict(gyros),
        limits=limits,
        gyros=gyros,
        plateaus=max(map(len, compared)),
        judgements=judgements,
        not_measured=missing,
        unconnected=max(groups, key=len) if max(map(len, groups)) > 1 else [],
    )


def _valid_rows(plateau: _Plateau, axis: int, limits: AcceptanceLimits) -> list[DwellRow]:
    """Dwells of a plateau with a valid bias of a gyro."""
    max_sigma_dph = math.inf if limits.bias_sigma_dph is None else limits.bias_sigma_dph
    return [
        row
        for row in plateau
        if not math.isnan(row.gyro_c[axis] + row.bias_dph[axis]) and row.sigma_dph[axis] <= max_sigma_dph
    ]


def _differences(
    compared: Sequence[Sequence[_Plateau]],
    curves: Sequence[CubicBiasCurve],
    shared: SharedErrors,
    is_vertical_separate: bool,
) -> list[_JudgedValue]:
    """Differences on all plateaus of all gyros; if the passes of a plateau disagree, those of each pass."""
    of_all_passes = [
        (axis, passes, position_differences(passes, axis, curves[axis], shared))
        for axis, plateaus in enumerate(compared)
        for passes in passes_of_plateaus(plateaus, axis)
    ]
    p_values = holm([mean.p_value for _, _, mean in of_all_passes])
    values = []
    for (axis, passes, mean), p_value in zip(of_all_passes, p_values, strict=True):
        agree = not p_value < _MAX_DISAGREEMENT_P_VALUE
        if agree:
            results = [mean]
        else:
            results = [position_differences([each], axis, curves[axis], shared) for each in passes]
        values += [
            _JudgedValue(
                axis,
                "vertical difference"
                if is_vertical_separate and _is_vertical(axis, each.high, each.low)
                else "position difference",
                result.temperature_c,
                (each.high, each.low),
                each.value_dph,
                each.sigma_dph,
                agree,
                len(passes) if agree else 1,
                each.common_dph,
            )
            for result in results
            for each in result.differences
        ]
    return values


def _is_vertical(axis: int, *positions: str) -> bool:
    """Whether the axis of a gyro is vertical in all these positions."""
    return all(POSITIONS[name].up_axis == axis for name in positions)


def _biases(valid: Iterable[Iterable[_Plateau]]) -> list[_JudgedValue]:
    return [
        _JudgedValue(
            axis, "bias", row.gyro_c[axis], (row.position,), abs(row.bias_dph[axis]), row.sigma_dph[axis]
        )
        for axis, plateaus in enumerate(valid)
        for plateau in plateaus
        for row in plateau
    ]


def _judgements(values: Sequence[_JudgedValue], limits: AcceptanceLimits, width_c: float) -> list[Judgement]:
    risk = 1.0 - limits.confidence
    # Least distances of a value from its limit to pass and to fail, in standard uncertainties.
    factors = -NormalDist().inv_cdf(risk), -NormalDist().inv_cdf(risk / max(len(values), 1))
    bins: dict[tuple[int, int, int], list[_JudgedValue]] = {}
    for each in values:
        order = get_args(JudgedQuantity).index(each.quantity)
        key = (each.axis, math.floor(each.temperature_c / width_c), order)
        bins.setdefault(key, []).append(each)
    return [
        _judge_bin(bins[key], (key[1] * width_c, (key[1] + 1) * width_c), limits, factors)
        for key in sorted(bins)
    ]


def _judge_bin(
    values: Sequence[_JudgedValue],
    ends_c: tuple[float, float],
    limits: AcceptanceLimits,
    factors: tuple[float, float],
) -> Judgement:
    """Judge all values of one gyro, bin and quantity."""
    quantity = values[0].quantity
    limit_dph = limits.of(quantity)
    to_pass, to_fail = factors
    at_most_dph = max(each.value_dph + to_pass * each.sigma_dph for each in values)
    at_least_dph = max(each.value_dph - to_fail * each.sigma_dph for each in values)
    worst = max(values, key=lambda each: each.value_dph)
    measured = {position for each in values for position in each.positions}
    verdict: Verdict = "marginal"
    if at_most_dph < limit_dph:
        verdict = "pass"
    elif at_least_dph > limit_dph:
        verdict = "fail"
    return Judgement(
        gyro=AXES[worst.axis],
        quantity=quantity,
        bin_low_c=ends_c[0],
        bin_high_c=ends_c[1],
        positions=[name for name in POSITIONS if name in measured],
        worst=list(worst.positions),
        value_dph=worst.value_dph,
        sigma_dph=worst.sigma_dph,
        at_least_dph=max(at_least_dph, 0.0),
        at_most_dph=at_most_dph,
        limit_dph=limit_dph,
        verdict=verdict,
        passes_agree=all(each.passes_agree for each in values),
        passes=worst.passes,
        common_sigma_dph=worst.common_dph,
    )


def _not_measured(
    valid: Sequence[Sequence[_Plateau]],
    compared: Sequence[Sequence[_Plateau]],
    planned: Sequence[PlannedDwell],
    limits: AcceptanceLimits,
) -> list[NotMeasured]:
    """Planned dwells that were not compared with the others of their plateau, or not measured at all."""
    result, plateaus = [], group_plateaus(planned, MAX_PLANNED_FROM_MEAN_K)
    for axis, gyro in enumerate(AXES):
        measured = {row.dwell for plateau in valid[axis] for row in plateau}
        for plateau in plateaus:
            if len({dwell.position for dwell in plateau}) > 1:
                uncompared = _outside_largest(plateau, compared[axis])
            else:
                uncompared = [
                    dwell for dwell in plateau if limits.bias_dph is not None and dwell.dwell not in measured
                ]
            result += [
                NotMeasured(
                    gyro=gyro,
                    cycle=dwell.cycle,
                    chamber_set_c=None if math.isnan(dwell.chamber_set_c) else dwell.chamber_set_c,
                    position=dwell.position,
                )
                for dwell in uncompared
            ]
    return result


def _outside_largest(planned: Sequence[PlannedDwell], plateaus: Iterable[_Plateau]) -> list[PlannedDwell]:
    """Planned dwells of one plateau that are not in its largest part that was compared together."""
    compared_sets = ({row.dwell for row in plateau} for plateau in plateaus)
    inside = ([dwell for dwell in planned if dwell.dwell in compared] for compared in compared_sets)
    largest = max(inside, key=len, default=[])
    if len({dwell.position for dwell in largest}) < 2:
        return list(planned)
    return [dwell for dwell in planned if dwell not in largest]


def _connected_positions(positions: Iterable[str], plateaus: Iterable[_Plateau]) -> list[list[str]]:
    """Groups of positions that plateaus compare, directly or through other positions."""
    groups = [{name} for name in POSITIONS if name in positions]
    for plateau in plateaus:
        together = {row.position for row in plateau}
        joined = set().union(*(group for group in groups if group & together))
        groups = [joined, *(group for group in groups if not group & together)]
    in_order = [[name for name in POSITIONS if name in group] for group in groups]
    return sorted(in_order, key=lambda names: list(POSITIONS).index(names[0]))


def _gyro_verdict(gyro: str, judgements: Iterable[Judgement], is_incomplete: bool) -> GyroVerdict:
    verdicts = {each.verdict for each in judgements if each.gyro == gyro}
    if "fail" in verdicts:
        return "fail"
    if not verdicts or is_incomplete:
        return "not measured"
    return "marginal" if "marginal" in verdicts else "pass"


def _run_verdict(gyros: Mapping[str, GyroVerdict]) -> RunVerdict:
    verdicts = gyros.values()
    if "fail" in verdicts:
        return "rejected"
    if "not measured" in verdicts:
        return "not judged"
    return "marginal" if "marginal" in verdicts else "accepted"
