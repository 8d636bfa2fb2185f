"""All coefficients of the sensors at each plateau, estimated from its dwells and its rotations together.

The dwells of a plateau determine the gyro biases and, through their half turns, parts of the matrices
(:mod:`gyrobench.bench.calibration.joint_coefficients`). Rotations between rests determine all coefficients
from the increments of the INS; if the INS sends no increments, they are computed from its navigation output
(:mod:`gyrobench.bench.dwells.rotated_dwell`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gyrobench.bench.bias.budget import Budget, coefficient_budget
from gyrobench.bench.bias.dwell_table import NOT_MEASURED, DwellRow
from gyrobench.bench.bias.joint_solution import JointDwell, JointSolution
from gyrobench.bench.bias.plateaus import MAX_FROM_MEAN_K, plateau_key
from gyrobench.bench.bias.statistics import chi2_p_value, lowest_polynomial
from gyrobench.bench.calibration.coefficients import (
    COEFFICIENTS,
    COUNT,
    CoefficientEstimate,
    SensorCoefficient,
)
from gyrobench.bench.calibration.joint_coefficients import attitude_p_value, joint_coefficients
from gyrobench.bench.calibration.results import coefficient_rows, common_scale_notes
from gyrobench.bench.dwells.measurement_setup import MeasurementSetup
from gyrobench.bench.dwells.run_rotations import GYRO_TEMPERATURE_FIELDS, PlateauRotations, combined_range
from gyrobench.bench.foundations.arrays import FloatArray, Triple, triple
from gyrobench.bench.navigation.positions import AXES, POSITIONS
from gyrobench.bench.runs.tables.coefficient_table import COMMON_SOURCES, PlateauCoefficientRow

#: Smallest spacing of plateau temperatures from which slopes are estimated, K, and degree of the curve.
_MIN_SPACING_C, _SLOPE_DEGREE = 2.0, 2
#: Dwells and rotations contradict each other if their difference has a smaller p-value, corrected for the
#: number of plateaus.
_MIN_P_VALUE = 1e-3
#: Largest mean specific force of the positions, relative to gravity, without effect on the mean biases.
_MAX_MEAN_UP = 0.05


@dataclass(frozen=True, eq=False)
class PlateauCalibration:
    """Coefficients of the sensors at one plateau, in the body frame of the accelerometers."""

    number: int  #: Number of the plateau, from 1.
    cycle: int
    chamber_set_c: float  #: NaN if the chamber is not controlled.
    #: gyro_c, case_c: Mean temperatures during the rotations; without rotations, during the dwells.
    gyro_c: Triple
    case_c: float
    #: From dwells and rotations together, without its parts; None without either.
    estimate: CoefficientEstimate | None
    #: Variances of the estimate by source, shape (21,) each, SI.
    variances: Mapping[str, FloatArray]
    finding: str = ""  #: Reason why the rotations give no result, or that they contradict the dwells.
    note: str = ""  #: Results of the rotations in addition to the coefficients.
    #: Estimate with the covariance it would have if the INS sent specific force; None if it does.
    with_force: CoefficientEstimate | None = None
    rotations: PlateauRotations | None = None  #: None if there are none.
    #: Shape (2, 4). Lowest and highest temperatures of gyros and case in dwells and rotations.
    range_c: FloatArray = field(default_factory=lambda: np.full((2, 4), np.nan))
    #: Declared standard uncertainties, SI, by key of :data:`gyrobench.bench.bias.budget.SOURCES`.
    inputs: Mapping[str, float] = field(default_factory=dict)

    def independent_value(self, k: int) -> tuple[float, float]:
        """Value of one of :data:`COEFFICIENTS` and its uncertainty, SI, without errors that plateaus share.

        NaN if not observed.
        """
        if self.estimate is None or not self.estimate.is_observed[k]:
            return math.nan, math.nan
        shared = sum(float(self.variances[each][k]) for each in COMMON_SOURCES if each in self.variances)
        return float(self.estimate.values[k]), math.sqrt(self.estimate.covariance[k, k] - shared)

    def change_c(self, coefficient: SensorCoefficient, sensor: int) -> float:
        """Range of a temperature while a coefficient was measured.

        ``sensor``: 0 to 2 for those of the gyros, 3 for that of the case.
        """
        is_bias = coefficient.kind == "bias" or self.rotations is None or self.rotations.calibration is None
        low_c, high_c = (self if is_bias or self.rotations is None else self.rotations).range_c
        return float(high_c[sensor] - low_c[sensor])

    def with_temperature_change(self, variances: FloatArray) -> PlateauCalibration:
        """Copy with the change of temperature as an additional error source with variances (21,)."""
        if self.estimate is None:
            return self
        estimate = replace(self.estimate, covariance=self.estimate.covariance + np.diag(variances))
        return replace(self, estimate=estimate, variances={**self.variances, "temperature_change": variances})

    @property
    def correlations(self) -> FloatArray:
        """Correlation coefficients (21, 21); NaN if not observed."""
        if self.estimate is None:
            return np.full((COUNT, COUNT), np.nan)
        both_observed = np.outer(self.estimate.is_observed, self.estimate.is_observed)
        return np.where(both_observed, self.estimate.correlations, np.nan)

    @property
    def budgets(self) -> list[tuple[SensorCoefficient, Budget]]:
        """Uncertainty budgets of the observed coefficients, in their units."""
        if self.estimate is None:
            return []
        inputs, dof = dict(self.inputs), math.inf
        if self.rotations is not None and self.rotations.calibration is not None:
            calibration = self.rotations.calibration
            noise, dof = vars(calibration.problem.noise), float(calibration.fit.dof)
            inputs |= {name: float(np.sqrt(np.mean(values**2))) for name, values in noise.items()}
        return [
            (
                each,
                coefficient_budget(
                    {name: float(its[i]) * each.per_si**2 for name, its in self.variances.items()},
                    inputs,
                    dof,
                ),
            )
            for i, each in enumerate(self.estimate.coefficients)
            if self.estimate.is_observed[i]
        ]

    def rows(self) -> list[PlateauCoefficientRow]:
        """Rows of ``coefficients.csv``; without values if there is no estimate."""
        estimate = self.estimate or CoefficientEstimate(np.zeros(COUNT), np.eye(COUNT), np.zeros(COUNT, bool))
        with_force = np.full(COUNT, np.nan)
        if self.with_force is not None:
            with_force = self.with_force.sigmas * [each.per_si for each in estimate.coefficients]
        rates = NOT_MEASURED  # also if the rotations give no result
        if self.rotations is not None and self.rotations.calibration is not None:
            rates = self.rotations.gyro_rate_c_per_h
        return [
            PlateauCoefficientRow(
                plateau=self.number,
                cycle=self.cycle,
                chamber_set_c=self.chamber_set_c,
                temperature_c=self.gyro_c[AXES.index(row.axis[0])]
                if row.coefficient.startswith("gyro")
                else self.case_c,
                coefficient=row.coefficient,
                axis=row.axis,
                value=math.nan if row.value is None else row.value,
                sigma=math.nan if row.sigma is None else row.sigma,
                unit=row.unit,
                finding="; ".join(text for text in (row.finding, self.finding) if text),
                sigma_with_force=sigma,
                gyro_rate_c_per_h=rates[AXES.index(row.axis[0])],
                note=self.note,
            )
            for row, sigma in zip(coefficient_rows(estimate), with_force.tolist(), strict=True)
        ]


def calibrate_plateaus(
    solutions: Sequence[JointSolution],
    rows: Iterable[DwellRow],
    rotations: Sequence[PlateauRotations],
    setup: MeasurementSetup,
) -> list[PlateauCalibration]:
    """Estimate the coefficients of each plateau, in the order of time.

    ``solutions``: of the plateaus with dwells; ``rows``: of the dwells in them; ``rotations``: in the order
    of time.
    """
    by_number = {row.dwell: row for row in rows}
    plateaus_in_time: list[tuple[int, JointSolution | None, PlateauRotations | None]] = []
    for solution in solutions:
        measured = [by_number[each.number] for each in solution.dwells]
        matching = _matching_rotations(rotations, solution.dwells[0], measured)
        rotations = [each for each in rotations if each is not matching]
        plateaus_in_time.append((measured[0].dwell, solution, matching))
    plateaus_in_time += [(each.marks.dwell, None, each) for each in rotations]
    comparisons = sum(
        solution is not None and matching is not None and matching.calibration is not None
        for _, solution, matching in plateaus_in_time
    )
    plateaus = [
        _calibrate_plateau(number, solution, matching, by_number, setup, comparisons)
        for number, (_, solution, matching) in enumerate(
            sorted(plateaus_in_time, key=lambda each: each[0]), 1
        )
    ]
    return with_temperature_change(plateaus)


def with_temperature_change(plateaus: Sequence[PlateauCalibration]) -> list[PlateauCalibration]:
    """Add the uncertainty due to the change of temperature within each plateau.

    Each coefficient was measured at some time of the plateau, at a temperature other than the mean. Slopes
    are those of a constant, line or parabola over all plateaus, of the lowest degree that the uncertainties
    allow. Differences of neighbouring temperatures would be less reliable, on ramps up and down and because
    of noise.
    """
    variances = np.zeros((len(plateaus), COUNT))
    for k, coefficient in enumerate(COEFFICIENTS):
        sensor = AXES.index(coefficient.axis[0]) if coefficient.sensor == "gyro" else 3
        temperatures_c = np.array([(*each.gyro_c, each.case_c)[sensor] for each in plateaus])
        values, sigmas = np.reshape([each.independent_value(k) for each in plateaus], (-1, 2)).T
        is_known = np.isfinite(temperatures_c) & np.isfinite(values)
        distinct = int(np.count_nonzero(np.diff(np.sort(temperatures_c[is_known])) > _MIN_SPACING_C))
        if distinct:
            degree = min(distinct, _SLOPE_DEGREE)
            curve = lowest_polynomial(temperatures_c[is_known], values[is_known], sigmas[is_known], degree)
            changes = curve.deriv()(temperatures_c) * [
                each.change_c(coefficient, sensor) for each in plateaus
            ]
            variances[:, k] = np.where(is_known & np.isfinite(changes), changes**2 / 12.0, 0.0)
    return [each.with_temperature_change(own) for each, own in zip(plateaus, variances, strict=True)]


def _matching_rotations(
    rotations: Sequence[PlateauRotations], first: JointDwell, rows: Sequence[DwellRow]
) -> PlateauRotations | None:
    """Rotations at the set point and the temperatures of these dwells, with the most similar slopes."""
    gyro_c, rates = (
        np.mean([getattr(row, name) for row in rows], axis=0) for name in GYRO_TEMPERATURE_FIELDS
    )
    near = [
        (float(np.nan_to_num(np.abs(rates - each.gyro_rate_c_per_h)).max()), number)
        for number, each in enumerate(rotations)
        if plateau_key(each.marks) == plateau_key(first)
        and not (np.abs(gyro_c - each.gyro_c) > MAX_FROM_MEAN_K).any()
    ]
    return rotations[min(near)[1]] if near else None


def _calibrate_plateau(
    number: int,
    solution: JointSolution | None,
    rotations: PlateauRotations | None,
    rows: Mapping[int, DwellRow],
    setup: MeasurementSetup,
    comparisons: int,
) -> PlateauCalibration:
    """``comparisons``: number of plateaus at which dwells are compared with rotations."""
    estimates: list[CoefficientEstimate] = []
    with_force = None
    findings: list[str] = []
    ranges = [np.full((2, 4), np.nan)]
    gyro_c, case_c = NOT_MEASURED, math.nan
    cycle, set_c = 0, None
    if solution is not None:
        dwell_estimate = joint_coefficients(solution, setup.prior)
        if rotations is not None and rotations.has_g_sensitivity and _has_mean_force(solution):
            dwell_estimate = _without_biases(dwell_estimate)
        estimates.append(dwell_estimate)
        cycle, set_c = solution.dwells[0].cycle, solution.dwells[0].chamber_set_c
        gyro_c = triple(np.mean([each.gyro_c for each in solution.dwells], axis=0))
        case_c = float(np.mean([rows[each.number].case_c for each in solution.dwells]))
        ranges += [np.array([(*each.gyro_c, rows[each.number].case_c)] * 2) for each in solution.dwells]
    if rotations is not None:
        cycle, set_c = rotations.marks.cycle, rotations.marks.chamber_set_c
        findings += rotations.findings
        ranges.append(rotations.range_c)
        if rotations.calibration is not None:
            estimates.append(rotations.calibration)
            if solution is not None and (
                lag := _attitude_finding(solution, rotations, rows, setup, comparisons)
            ):
                findings.append(lag)
                if not _has_mean_force(solution):
                    estimates[-1] = _without_biases(rotations.calibration)
            gyro_c, case_c = rotations.gyro_c, rotations.case_c
            if rotations.with_force is not None:
                with_force = _combine([*estimates[:-1], rotations.with_force])
    if len(estimates) > 1 and (p_value := comparisons * _agreement_p_value(*estimates)) < _MIN_P_VALUE:
        p_text = _p_text(p_value, comparisons)
        findings.append(f"dwells and rotations contradict each other ({p_text})")
    estimate = _combine(estimates) if estimates else None
    notes = [*(rotations.notes if rotations else ()), *(common_scale_notes(estimate) if estimate else ())]
    variances = {name: np.diag(part).copy() for name, part in estimate.parts.items()} if estimate else {}
    chamber_set_c = math.nan if set_c is None else set_c
    inputs = {"latitude": setup.prior.latitude, "table_return": setup.table_repeatability} | {
        "gravity": setup.gravity_and_sigma[1]
    }
    return PlateauCalibration(
        number, cycle, chamber_set_c, gyro_c, case_c, _without_parts(estimate), variances,
        "; ".join(findings), "; ".join(notes), _without_parts(with_force),
        rotations, combined_range(ranges), inputs,
    )  # fmt: skip


def _attitude_finding(
    solution: JointSolution,
    rotations: PlateauRotations,
    rows: Mapping[int, DwellRow],
    setup: MeasurementSetup,
    comparisons: int,
) -> str:
    """Finding if the gyro biases follow the attitude, but not so in the rotations; else empty."""
    if rotations.with_options is None:
        return ""
    start_s = np.array([rows[each.number].start_s for each in solution.dwells])
    p_value = comparisons * attitude_p_value(solution, setup.prior, start_s, rotations.with_options)
    if p_value >= _MIN_P_VALUE:
        return ""
    stated = "may be wrong" if _has_mean_force(solution) else "are the means of the dwells"
    return (
        "the gyro biases follow the attitude in the dwells and not so in the rotations "
        f"({_p_text(p_value, comparisons)}), as with a lag by heat. Those stated {stated}. Make the rests "
        "much longer than the lag"
    )


def _p_text(p_value: float, comparisons: int) -> str:
    return f"p = {p_value:.1g}" + (f", corrected for {comparisons} plateaus" if comparisons > 1 else "")


def _has_mean_force(solution: JointSolution) -> bool:
    """Whether the mean of the dwells' biases contains a part proportional to the specific force."""
    ups = [POSITIONS[each.position_name].C_nb()[2] for each in solution.dwells]
    return bool(np.linalg.norm(np.mean(ups, axis=0)) > _MAX_MEAN_UP)


def _without_biases(estimate: CoefficientEstimate) -> CoefficientEstimate:
    """Estimate without information on the gyro biases."""
    wide = np.diag([each.size**2 * (k < 3) for k, each in enumerate(COEFFICIENTS)])
    is_observed = estimate.is_observed & (np.arange(COUNT) >= 3)
    parts = {**estimate.parts, "assumed_size": estimate.parts.get("assumed_size", 0.0) + wide}
    return replace(estimate, covariance=estimate.covariance + wide, is_observed=is_observed, parts=parts)


def _combine(estimates: Sequence[CoefficientEstimate]) -> CoefficientEstimate:
    """Mean of estimates from separate data, weighted by their covariances without the part of gravity."""
    if len(estimates) == 1:
        return estimates[0]
    sizes = np.array([each.size for each in COEFFICIENTS])
    covariances = [each.covariance - each.parts.get("gravity", 0.0) for each in estimates]
    weights = [np.linalg.inv(each / np.outer(sizes, sizes)) for each in covariances]
    covariance = np.linalg.inv(sum(weights))
    sums = sum(weight @ (each.values / sizes) for weight, each in zip(weights, estimates, strict=True))
    is_observed = np.any([each.is_observed for each in estimates], axis=0)
    parts: dict[str, FloatArray] = {}
    for weight, each in zip(weights, estimates, strict=True):
        gain = covariance @ weight * np.outer(sizes, 1.0 / sizes)
        for name, part in each.parts.items():
            parts[name] = parts.get(name, 0.0) + gain @ part @ gain.T
    with_gravity = covariance * np.outer(sizes, sizes) + parts.get("gravity", 0.0)
    return CoefficientEstimate(sizes * (covariance @ sums), with_gravity, is_observed, parts=parts)


def _without_parts(estimate: CoefficientEstimate | None) -> CoefficientEstimate | None:
    """Estimate without its covariances by source, of which a plateau keeps only the variances."""
    return None if estimate is None else replace(estimate, parts={})


def _agreement_p_value(first: CoefficientEstimate, second: CoefficientEstimate) -> float:
    """P-value of the difference of two estimates from separate data."""
    is_in_both = first.is_observed & second.is_observed
    difference = (first.values - second.values)[is_in_both]
    covariance = (first.covariance + second.covariance)[np.ix_(is_in_both, is_in_both)]
    roots = np.sqrt(np.diag(covariance))
    scaled = difference / roots
    chi2 = float(scaled @ np.linalg.solve(covariance / np.outer(roots, roots), scaled))
    return chi2_p_value(int(is_in_both.sum()), chi2)
