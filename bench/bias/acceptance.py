"""Are a unit's gyros fit for a rotational INS? Limits, and verdicts that allow for the uncertainty.

A rotational INS averages out a bias that is the same in all positions. So the largest difference of a
gyro's bias between positions, temperature bin by temperature bin, decides.

The largest of several noisy differences is larger than the largest true one: six equal positions show
some 2.5 times the uncertainty of one. It is therefore not judged as if it were a single difference:

* A gyro passes in a bin only where *every* pair of positions does: difference plus z times its standard
  uncertainty below the limit, z one-sided. If a true difference is at the limit or above, its own pair
  has to err for that, so no allowance for the number of pairs is needed (an intersection-union test),
  and a unit with such a difference is accepted with a probability of at most ``1 - confidence``.
* It fails where *some* pair does: difference less c times its standard uncertainty above the limit. Each
  of all pairs in all bins of all gyros could err so by chance, so c allows for their number
  (Bonferroni), and a unit without a difference above the limit is rejected with a probability of at
  most ``1 - confidence``.
* Between the two it is marginal: the data do not tell, and more cycles would.

Both stand on the stated uncertainties, taken as independent between positions.

References
----------
JCGM 106:2012, "The role of measurement uncertainty in conformity assessment", 8.3 (guard bands).
Berger, "Multiparameter Hypothesis Testing and Acceptance Sampling", Technometrics 24 (1982) 295.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

from scipy.special import ndtri

from bench.bias.bins import BiasBin
from bench.bias.tables.dwell_table import DwellRow
from bench.bias.verdicts import (
    Acceptance,
    AcceptanceLimits,
    GyroVerdict,
    Judgement,
    NotMeasured,
    Quantity,
    RunVerdict,
    Verdict,
)
from bench.navigation.positions import AXES

#: Set point of the chamber, degC, or None where nothing sets it, and position.
Place = tuple[float | None, str]

_SAME_C = 1e-6
_Bins = Sequence[BiasBin]


@dataclass(frozen=True)
class _Factors:
    """Standard uncertainties that a value keeps from its limit to pass, and to fail."""

    to_pass: float
    to_fail: float


def judge(
    rows: Iterable[DwellRow],
    bins: Iterable[BiasBin],
    limits: AcceptanceLimits | None,
    planned: Iterable[Place] = (),
) -> Acceptance:
    """Judge the gyros of one unit; see the module for how.

    A run is accepted only if every planned position was compared with another one at its temperature, in
    one cycle at least; a gyro that breaks a limit is rejected whatever else is missing.

    Parameters
    ----------
    rows : iterable of DwellRow
        Dwells; those with flags count as not measured.
    bins : iterable of BiasBin
        What :func:`bench.bias.bins.bin_biases` made of the others.
    limits : AcceptanceLimits or None
        Of the procedure.
    planned : iterable of tuple
        Set point of the chamber and position of every planned dwell.
    """
    if limits is None:
        return Acceptance()
    measured = [each for each in bins if not each.is_empty and each.sigma_dph <= _most_sigma_dph(limits)]
    groups = _comparable(measured)
    judgements = _judgements(groups, limits)
    missing = _not_measured([row for row in rows if not row.flags], groups, list(planned))
    gyros = {gyro: _of_gyro(gyro, judgements, missing) for gyro in AXES}
    return Acceptance(
        verdict=_of_run(gyros),
        limits=limits,
        gyros=gyros,
        judgements=judgements,
        not_measured=missing,
    )


def _most_sigma_dph(limits: AcceptanceLimits) -> float:
    return math.inf if limits.bias_sigma_dph is None else limits.bias_sigma_dph


def _comparable(bins: Iterable[BiasBin]) -> list[list[BiasBin]]:
    """Bins of one gyro and temperature together, where there are two positions or more."""
    groups: dict[tuple[str, float], list[BiasBin]] = {}
    for each in bins:
        groups.setdefault((each.gyro, each.bin_low_c), []).append(each)
    return [group for _, group in sorted(groups.items()) if len(group) > 1]


def _judgements(groups: Sequence[_Bins], limits: AcceptanceLimits) -> list[Judgement]:
    pairs = sum(len(group) * (len(group) - 1) for group in groups)
    single = sum(map(len, groups)) if limits.bias_dph is not None else 0
    risk = 1.0 - limits.confidence
    factors = _Factors(float(-ndtri(risk)), float(-ndtri(risk / max(pairs + single, 1))))
    result = []
    for group in groups:
        differences = [
            (
                high.bias_dph - low.bias_dph,
                math.hypot(high.sigma_dph, low.sigma_dph),
                [high.position, low.position],
            )
            for high, low in permutations(group, 2)
        ]
        result.append(
            _judged(group, "position difference", differences, limits.position_difference_dph, factors)
        )
        if limits.bias_dph is not None:
            biases = [(abs(each.bias_dph), each.sigma_dph, [each.position]) for each in group]
            result.append(_judged(group, "bias", biases, limits.bias_dph, factors))
    return result


def _judged(
    group: _Bins,
    quantity: Quantity,
    values: Sequence[tuple[float, float, list[str]]],
    limit_dph: float,
    factors: _Factors,
) -> Judgement:
    """Judge the values of one gyro and bin, each with its standard uncertainty and its positions."""
    at_most_dph = max(value + factors.to_pass * sigma for value, sigma, _ in values)
    at_least_dph = max(value - factors.to_fail * sigma for value, sigma, _ in values)
    value_dph, sigma_dph, worst = max(values, key=lambda each: each[0])
    verdict: Verdict = "marginal"
    if at_most_dph < limit_dph:
        verdict = "pass"
    elif at_least_dph > limit_dph:
        verdict = "fail"
    return Judgement(
        gyro=group[0].gyro,
        quantity=quantity,
        bin_low_c=group[0].bin_low_c,
        bin_high_c=group[0].bin_high_c,
        positions=[each.position for each in group],
        worst=worst,
        value_dph=value_dph,
        sigma_dph=sigma_dph,
        at_least_dph=max(at_least_dph, 0.0),
        at_most_dph=at_most_dph,
        limit_dph=limit_dph,
        verdict=verdict,
    )


def _not_measured(
    rows: Sequence[DwellRow], groups: Sequence[_Bins], planned: Sequence[Place]
) -> list[NotMeasured]:
    """Planned positions, of those that have company at their temperature, without a comparison."""
    at: dict[float | None, list[str]] = {}
    for set_c, position in planned:
        if position not in at.setdefault(set_c, []):
            at[set_c].append(position)
    return [
        NotMeasured(gyro=gyro, chamber_set_c=set_c, position=position)
        for axis, gyro in enumerate(AXES)
        for set_c, positions in at.items()
        for position in positions
        if len(positions) > 1
        and not any(
            row.position == position and _is_set(row, set_c) and _is_compared(row, axis, groups)
            for row in rows
        )
    ]


def _is_set(row: DwellRow, set_c: float | None) -> bool:
    return math.isnan(row.chamber_set_c) if set_c is None else abs(row.chamber_set_c - set_c) < _SAME_C


def _is_compared(row: DwellRow, axis: int, groups: Sequence[_Bins]) -> bool:
    return any(
        each.gyro == AXES[axis]
        and each.position == row.position
        and each.bin_low_c <= row.gyro_c[axis] < each.bin_high_c
        for group in groups
        for each in group
    )


def _of_gyro(gyro: str, judgements: Iterable[Judgement], missing: Iterable[NotMeasured]) -> GyroVerdict:
    verdicts = {each.verdict for each in judgements if each.gyro == gyro}
    if "fail" in verdicts:
        return "fail"
    if not verdicts or any(each.gyro == gyro for each in missing):
        return "not measured"
    return "marginal" if "marginal" in verdicts else "pass"


def _of_run(gyros: Mapping[str, GyroVerdict]) -> RunVerdict:
    verdicts = gyros.values()
    if "fail" in verdicts:
        return "rejected"
    if "not measured" in verdicts:
        return "not judged"
    return "marginal" if "marginal" in verdicts else "accepted"
