"""Corrects the dwells of a run for a wrong latitude, or flags them.

An INS computes the Earth's rotation for the latitude that was entered. An error of the latitude, or a
deflection of the vertical to the north, causes a rate Up that adds to the bias of the vertical gyro, and a
rate North that the level gyros measure independently of their biases, since it does not turn with the unit.
If both rates confirm the error, the biases are corrected; otherwise the dwells are flagged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gyrobench.bench.bias.joint_solution import JointSolution
from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.bias.vertical_pairs import Finding, UpRate, exceeds_declared
from gyrobench.bench.dwells.measure_dwell import MeasuredDwell
from gyrobench.bench.dwells.measurement_setup import MeasurementSetup
from gyrobench.bench.foundations.arrays import RAD_TO_ARCMIN, RADPS_TO_DPH, Triple
from gyrobench.bench.navigation.positions import POSITIONS


def without_latitude_error(
    dwells: Sequence[MeasuredDwell],
    solutions: Sequence[JointSolution],
    rate: UpRate | None,
    prior: PriorKnowledge,
) -> list[MeasuredDwell]:
    """The dwells of a run, with the biases of vertical gyros corrected for a wrong latitude.

    If rates North and Up together confirm that the latitude is off by more than declared, biases and
    uncertainties of the vertical gyros are those of the joint solution without that rate. If only the rate
    North indicates it, and no consistent rate Up contradicts it, the dwells are flagged. ``solutions`` are
    those of the run's plateaus, ``rate`` is the rate Up of all of them.
    """
    if rate is not None and rate.finding is Finding.LATITUDE_OFF:
        corrected = {
            dwell.number: biases
            for solution in solutions
            for corrected_biases in [solution.corrected(rate)]
            for dwell, *biases in zip(
                solution.dwells,
                RADPS_TO_DPH * corrected_biases.bias_radps,
                RADPS_TO_DPH * corrected_biases.sigma_radps,
                strict=True,
            )
        }
        return [_corrected(dwell, *corrected.get(dwell.row.dwell, ())) for dwell in dwells]
    if rate is not None and rate.applies and not rate.exceeds(prior.latitude):
        return list(dwells)
    flag = _north_flag(solutions, prior)
    numbers = {dwell.number for solution in solutions for dwell in solution.dwells}
    if not flag:
        return list(dwells)
    return [each.with_flag(flag) if each.row.dwell in numbers else each for each in dwells]


def with_latitude_uncertainty(setup: MeasurementSetup, rate: UpRate | None) -> MeasurementSetup:
    """Setup with the uncertainty of the latitude raised to its confirmed error.

    Otherwise the error would be taken for gyro scale factors.
    """
    if rate is None or rate.finding is not Finding.LATITUDE_OFF:
        return setup
    return replace(setup, prior=replace(setup.prior, latitude=abs(rate.latitude_error)))


def _corrected(dwell: MeasuredDwell, *biases: np.ndarray) -> MeasuredDwell:
    if not biases:
        return dwell
    row, axis = dwell.row, POSITIONS[dwell.row.position].up_axis
    bias_dph, sigma_dph = (
        _replace_axis(values, axis, float(joint[axis]))
        for values, joint in zip((row.bias_dph, row.sigma_dph), biases, strict=True)
    )
    common_dph = _replace_axis(row.common_sigma_dph, axis, 0.0)
    return replace(
        dwell, row=replace(row, bias_dph=bias_dph, sigma_dph=sigma_dph, common_sigma_dph=common_dph)
    )


def _replace_axis(values: Triple, axis: int, value: float) -> Triple:
    x, y, z = (value if index == axis else each for index, each in enumerate(values))
    return x, y, z


def _north_flag(solutions: Sequence[JointSolution], prior: PriorKnowledge) -> str:
    """Flag for a rate North that indicates a wrong latitude; empty if there is none."""
    agreeing = [each for each in solutions if each.agrees]
    if not agreeing:
        return ""
    rates, sigmas = np.array([each.north_rate for each in agreeing]).T
    _, _, earth_up = agreeing[0].dwells[0].information.earth_rate
    error = float((rates / sigmas**2).sum() / (1.0 / sigmas**2).sum() / earth_up)
    # The effect of the gyros' misalignments is common to all plateaus.
    sigma = float(np.hypot((1.0 / sigmas**2).sum() ** -0.5, sigmas.min() / 2.0) / abs(earth_up))
    if not exceeds_declared(error, sigma, prior.latitude):
        return ""
    return (
        "a rate North fixed in the navigation frame indicates a latitude error of "
        f"{RAD_TO_ARCMIN * error:+.2f} ± {RAD_TO_ARCMIN * sigma:.2f} arcmin "
        f"({RAD_TO_ARCMIN * prior.latitude:.2g} arcmin declared): the bias of the vertical gyro is wrong "
        "too. Check the latitude in station file and INS"
    )
