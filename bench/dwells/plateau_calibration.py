"""All coefficients of the sensors at each plateau, from its dwells and its rotations together.

The dwells of a plateau show gyro biases and, through their half turns, parts of the matrices
(:mod:`gyrobench.bench.calibration.joint_coefficients`). Rotations between rests show all coefficients, from
the increments of the INS. Where it sends none they follow from its navigation output: the change of attitude
and velocity from epoch to epoch is what its sensors measured, but for the vertical specific force, which an
INS of fixed altitude does not show. Gravity stands in its place, and shows nothing.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gyrobench.bench.bias.budget import Budget, coefficient_budget
from gyrobench.bench.bias.dwell_table import NOT_MEASURED, DwellRow, Triple
from gyrobench.bench.bias.joint_solution import JointDwell, JointSolution
from gyrobench.bench.bias.statistics import chi2_p_value
from gyrobench.bench.calibration.coefficients import COEFFICIENTS, COUNT, Coefficient, CoefficientEstimate
from gyrobench.bench.calibration.estimator import (
    Calibration,
    CalibrationOptions,
    Information,
    calibrate,
    covariances_by_source,
)
from gyrobench.bench.calibration.joint_coefficients import joint_coefficients
from gyrobench.bench.calibration.recording import MIN_REST_TOTAL_S, IncrementRecording, Rest
from gyrobench.bench.calibration.results import coefficient_rows
from gyrobench.bench.calibration.spins import spin_scale_factors
from gyrobench.bench.characteristics.scale_factor import SpinRecord
from gyrobench.bench.dwells.dwell import MeasurementSetup, checked_navigation
from gyrobench.bench.dwells.marks import DwellMarks
from gyrobench.bench.dwells.temperatures import dwell_temperatures, triple
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.attitude import rotation_matrices, rotation_vectors
from gyrobench.bench.navigation.earth import EARTH_RATE, curvature_radii
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.runs.tables.coefficient_table import PlateauCoefficientRow
from gyrobench.drivers.frames import FrameBlock
from gyrobench.drivers.ins.navigation_data import Increments, NavigationData

#: Part of the usual interval by which the time between two epochs may differ from it.
_MAX_STEP_ERROR = 0.5
#: Sum, rad or m/s, from which increments are compared with attitude and velocity, by how much of it they may
#: differ, as by gaps, and largest angle between two attitudes, rad.
_MIN_TURN, _MAX_AWAY, _MAX_STEP = 0.5, 0.5, 2.0
#: Temperatures of plateaus, K, between which coefficients show their slopes, and degree of the curve.
_MIN_APART_C, _SLOPE_DEGREE = 2.0, 2
#: Dwells and rotations contradict each other where chance gives the difference less often than this.
_MIN_P_VALUE = 1e-3


@dataclass(frozen=True, eq=False)
class PlateauRotations:
    """What the rotations of one plateau show."""

    marks: DwellMarks  #: Of the first dwell with rotations.
    #: gyro_c, case_c: Mean temperatures of the gyros and of the case, degC; NaN where not measured.
    gyro_c: Triple = NOT_MEASURED
    case_c: float = math.nan
    gyro_rate_c_per_h: Triple = NOT_MEASURED  #: Their slopes.
    #: Lowest and highest temperatures (2, 4) of gyros and case.
    range_c: FloatArray = field(default_factory=lambda: np.full((2, 4), np.nan))
    calibration: Calibration | None = None  #: None where there is a ``finding``, which says why.
    finding: str = ""
    #: As uncertain as if the INS sent specific forces; None where it does.
    with_force: CoefficientEstimate | None = None


@dataclass(frozen=True, eq=False)
class PlateauCalibration:
    """Coefficients of the sensors at one plateau, in the body frame of the accelerometers."""

    number: int  #: Number of the plateau, from 1.
    cycle: int
    chamber_set_c: float  #: NaN where the chamber is not controlled.
    #: gyro_c, case_c: As of the rotations, or where there are none of the dwells.
    gyro_c: Triple
    case_c: float
    estimate: CoefficientEstimate | None  #: Of dwells and rotations together; None without either.
    finding: str = ""  #: Why the rotations give nothing, or that they contradict the dwells.
    #: As uncertain as if the INS sent specific forces; None where it does.
    with_force: CoefficientEstimate | None = None
    rotations: PlateauRotations | None = None  #: None where there are none.
    #: Shape (2, 4). Lowest and highest temperatures of gyros and case in dwells and rotations.
    range_c: FloatArray = field(default_factory=lambda: np.full((2, 4), np.nan))
    #: Declared standard uncertainties, SI, by key of :data:`gyrobench.bench.bias.budget.SOURCES`.
    inputs: Mapping[str, float] = field(default_factory=dict)

    def value(self, k: int) -> float:
        """Value of one of :data:`COEFFICIENTS`, SI; NaN where not observed."""
        return float(self.estimate.values[k]) if self.estimate and self.estimate.is_observed[k] else math.nan

    def change_c(self, coefficient: Coefficient, sensor: int) -> float:
        """Range of a temperature, 0 to 2 of the gyros, 3 of the case, while a coefficient was measured."""
        is_bias = coefficient.kind == "bias" or self.rotations is None or self.rotations.calibration is None
        low_c, high_c = (self if is_bias or self.rotations is None else self.rotations).range_c
        return float(high_c[sensor] - low_c[sensor])

    def with_part(self, name: str, part: FloatArray) -> PlateauCalibration:
        """The same with one more source of uncertainty, of covariance (21, 21)."""
        if self.estimate is None:
            return self
        covariance, parts = self.estimate.covariance + part, {**self.estimate.parts, name: part}
        return replace(self, estimate=replace(self.estimate, covariance=covariance, parts=parts))

    @property
    def correlations(self) -> FloatArray:
        """Correlation coefficients (21, 21); NaN where not observed."""
        if self.estimate is None:
            return np.full((COUNT, COUNT), np.nan)
        seen = np.outer(self.estimate.is_observed, self.estimate.is_observed)
        return np.where(seen, self.estimate.correlations, np.nan)

    @property
    def budgets(self) -> list[tuple[Coefficient, Budget]]:
        """Uncertainty budgets of the observed coefficients, in their units."""
        if self.estimate is None:
            return []
        inputs, dof = dict(self.inputs), math.inf
        if self.rotations is not None and self.rotations.calibration is not None:
            noise, dof = vars(self.rotations.calibration.noise), float(self.rotations.calibration.fit.dof)
            inputs |= {name: float(np.sqrt(np.mean(values**2))) for name, values in noise.items()}
        return [
            (
                each,
                coefficient_budget(
                    {name: float(part[i, i]) * each.per_si**2 for name, part in self.estimate.parts.items()},
                    inputs,
                    dof,
                ),
            )
            for i, each in enumerate(self.estimate.coefficients)
            if self.estimate.is_observed[i]
        ]

    def rows(self) -> list[PlateauCoefficientRow]:
        """Rows of ``coefficients.csv``; without values where there is no estimate."""
        estimate = self.estimate or CoefficientEstimate(np.zeros(COUNT), np.eye(COUNT), np.zeros(COUNT, bool))
        with_force = np.full(COUNT, np.nan)
        if self.with_force is not None:
            with_force = self.with_force.sigmas * [each.per_si for each in estimate.coefficients]
        rates = NOT_MEASURED if self.rotations is None else self.rotations.gyro_rate_c_per_h
        return [
            PlateauCoefficientRow(
                self.number,
                self.cycle,
                self.chamber_set_c,
                self.gyro_c[AXES.index(row.axis[0])] if row.coefficient.startswith("gyro") else self.case_c,
                row.coefficient,
                row.axis,
                math.nan if row.value is None else row.value,
                math.nan if row.sigma is None else row.sigma,
                row.unit,
                "; ".join(text for text in (row.finding, self.finding) if text),
                sigma,
                rates[AXES.index(row.axis[0])],
            )
            for row, sigma in zip(coefficient_rows(estimate), with_force.tolist(), strict=True)
        ]


def calibrate_plateaus(
    solutions: Sequence[JointSolution],
    rows: Iterable[DwellRow],
    rotated: Iterable[tuple[DwellMarks, FrameBlock]],
    setup: MeasurementSetup,
) -> list[PlateauCalibration]:
    """Coefficients plateau by plateau, in the order of time.

    Parameters
    ----------
    solutions : sequence of JointSolution
        Of the plateaus with dwells.
    rows : iterable of DwellRow
        Of these dwells.
    rotated : iterable of (DwellMarks, FrameBlock)
        Dwells with rotations, in the order of time; those of one plateau are held at once.
    """
    groups = itertools.groupby(rotated, lambda each: _key(each[0]))
    rotations = [calibrate_rotations(list(group), setup) for _, group in groups]
    cases_c = {row.dwell: row.case_c for row in rows}
    places: list[tuple[int, JointSolution | None, PlateauRotations | None]] = []
    for solution in solutions:
        first = solution.dwells[0]
        found = next((each for each in rotations if _key(each.marks) == _key(first)), None)
        rotations = [each for each in rotations if each is not found]
        places.append((first.number, solution, found))
    places += [(each.marks.dwell, None, each) for each in rotations]
    plateaus = [
        _plateau(number, solution, found, cases_c, setup)
        for number, (_, solution, found) in enumerate(sorted(places, key=lambda each: each[0]), 1)
    ]
    return with_temperature_change(plateaus)


def with_temperature_change(plateaus: Sequence[PlateauCalibration]) -> list[PlateauCalibration]:
    """The coefficients with what they may change by while the temperature changes within their plateau.

    Each belongs to some time of the plateau, which its mean temperature does not name. Slopes are those of a
    parabola over all plateaus, for neighbours in temperature may differ by more, as on ramps up and down.
    """
    variances = np.zeros((len(plateaus), COUNT))
    for k, coefficient in enumerate(COEFFICIENTS):
        sensor = AXES.index(coefficient.axis[0]) if coefficient.sensor == "gyro" else 3
        at_c = np.array([(*each.gyro_c, each.case_c)[sensor] for each in plateaus])
        values = np.array([each.value(k) for each in plateaus])
        known = np.isfinite(at_c) & np.isfinite(values)
        apart = int(np.count_nonzero(np.diff(np.sort(at_c[known])) > _MIN_APART_C))
        if apart:
            curve = np.polynomial.Polynomial.fit(at_c[known], values[known], min(apart, _SLOPE_DEGREE))
            changes = curve.deriv()(at_c) * [each.change_c(coefficient, sensor) for each in plateaus]
            variances[:, k] = np.where(known & np.isfinite(changes), changes**2 / 12.0, 0.0)
    return [
        each.with_part("temperature_change", np.diag(its))
        for each, its in zip(plateaus, variances, strict=True)
    ]


def _key(member: DwellMarks | JointDwell) -> tuple[str, int, float | None]:
    """What all dwells of a plateau share: power cycle, cycle and set point."""
    set_c = member.chamber_set_c
    return member.run, member.cycle, None if set_c is None or math.isnan(set_c) else round(set_c, 3)


def _plateau(
    number: int,
    solution: JointSolution | None,
    rotations: PlateauRotations | None,
    cases_c: Mapping[int, float],
    setup: MeasurementSetup,
) -> PlateauCalibration:
    estimates, finding, with_force = [], "", None
    ranges = [np.full((2, 4), np.nan)]
    gyro_c, case_c = NOT_MEASURED, math.nan
    cycle, set_c = 0, None
    if solution is not None:
        estimates.append(joint_coefficients(solution, setup.prior))
        cycle, set_c = solution.dwells[0].cycle, solution.dwells[0].chamber_set_c
        gyro_c = triple(np.mean([each.gyro_c for each in solution.dwells], axis=0))
        case_c = float(np.mean([cases_c[each.number] for each in solution.dwells]))
        ranges += [np.array([(*each.gyro_c, cases_c[each.number])] * 2) for each in solution.dwells]
    if rotations is not None:
        cycle, set_c = rotations.marks.cycle, rotations.marks.chamber_set_c
        finding = rotations.finding
        ranges.append(rotations.range_c)
        if rotations.calibration is not None:
            estimates.append(rotations.calibration)
            gyro_c, case_c = rotations.gyro_c, rotations.case_c
            if rotations.with_force is not None:
                with_force = _combined([*estimates[:-1], rotations.with_force])
    if len(estimates) > 1 and (p_value := _agreement(*estimates)) < _MIN_P_VALUE:
        finding = f"dwells and rotations contradict each other (p = {p_value:.1g})"
    estimate = _combined(estimates) if estimates else None
    chamber_set_c = math.nan if set_c is None else set_c
    inputs = {"latitude": setup.prior.latitude, "table_return": setup.table_repeatability} | {
        "gravity": setup.gravity[1]
    }
    return PlateauCalibration(
        number, cycle, chamber_set_c, gyro_c, case_c, estimate, finding, with_force, rotations,
        _enclosing(ranges), inputs,
    )  # fmt: skip


def _enclosing(ranges_c: Sequence[FloatArray]) -> FloatArray:
    """Lowest and highest temperatures (2, 4) of several such ranges, those not measured left out."""
    low_c, high_c = np.moveaxis(np.array(ranges_c), 1, 0)
    return np.array([np.fmin.reduce(low_c), np.fmax.reduce(high_c)])


def _combined(estimates: Sequence[CoefficientEstimate]) -> CoefficientEstimate:
    """Mean of estimates from separate data, by their covariances but for gravity, which none shows."""
    if len(estimates) == 1:
        return estimates[0]
    sizes = np.array([each.size for each in COEFFICIENTS])
    shown = [each.covariance - each.parts.get("gravity", 0.0) for each in estimates]
    weights = [np.linalg.inv(each / np.outer(sizes, sizes)) for each in shown]
    covariance = np.linalg.inv(sum(weights))
    sums = sum(weight @ (each.values / sizes) for weight, each in zip(weights, estimates, strict=True))
    is_observed = np.any([each.is_observed for each in estimates], axis=0)
    parts: dict[str, FloatArray] = {}
    for weight, each in zip(weights, estimates, strict=True):
        gain = covariance @ weight * np.outer(sizes, 1.0 / sizes)
        for name, part in each.parts.items():
            parts[name] = parts.get(name, 0.0) + gain @ part @ gain.T
    whole = covariance * np.outer(sizes, sizes) + parts.get("gravity", 0.0)
    return CoefficientEstimate(sizes * (covariance @ sums), whole, is_observed, parts=parts)


def _agreement(one: CoefficientEstimate, other: CoefficientEstimate) -> float:
    """Probability of at least this difference of two estimates from separate data."""
    both = one.is_observed & other.is_observed
    difference = (one.values - other.values)[both]
    covariance = (one.covariance + other.covariance)[np.ix_(both, both)]
    roots = np.sqrt(np.diag(covariance))
    scaled = difference / roots
    chi2 = float(scaled @ np.linalg.solve(covariance / np.outer(roots, roots), scaled))
    return chi2_p_value(int(both.sum()), chi2)


def calibrate_rotations(
    dwells: Sequence[tuple[DwellMarks, FrameBlock]], setup: MeasurementSetup
) -> PlateauRotations:
    """Coefficients from all dwells with rotations at one plateau."""
    rotations, options = PlateauRotations(dwells[0][0]), _options(setup)
    try:
        measured = [_measured(marks, frames, setup) for marks, frames in dwells]
        temperatures_c = np.mean([each_c for _, each_c in measured], axis=0)
        rotations = replace(
            rotations,
            gyro_c=triple(temperatures_c[:3]),
            case_c=float(temperatures_c[3]),
            gyro_rate_c_per_h=triple(temperatures_c[4:]),
            range_c=_enclosing(
                [_range_c(each_c, marks) for (_, each_c), (marks, _) in zip(measured, dwells, strict=True)]
            ),
        )
        found = _calibrated([piece for pieces, _ in measured for piece in pieces], setup.site, options)
        with_force = None
        if not all(each.has_vertical for each in found.recordings):
            with_force = _with_force(found, setup.site, options)
    except MeasurementError as error:
        return replace(rotations, finding=f"the rotations give no coefficients: {error}")
    # The increments themselves are of no more use.
    found = replace(
        found, recordings=(), sections=(), parts=covariances_by_source(found, setup.site, options)
    )
    return replace(rotations, calibration=found, with_force=with_force)


def spin_record(marks: DwellMarks, frames: FrameBlock, setup: MeasurementSetup) -> SpinRecord:
    """Scale factors of the gyros by the whole turns of one dwell alone.

    Their biases are those of the rests: a bias that followed whole turns would take in an asymmetry.
    """
    at_s = 0.5 * (marks.start_s + marks.end_s)
    try:
        pieces, temperatures_c = _measured(marks, frames, setup)
        found = _calibrated(pieces, setup.site, replace(_options(setup), whole_turns=None))
        spun = spin_scale_factors(found, setup.site, setup.table_repeatability)
    except MeasurementError as error:
        return SpinRecord(marks.run, at_s, NOT_MEASURED, (), str(error).rstrip("."))
    return SpinRecord(marks.run, at_s, triple(temperatures_c[:3]), tuple(spun))


def _options(setup: MeasurementSetup) -> CalibrationOptions:
    noise = setup.noise
    walks = None if noise is None else (noise.angle_random_walk, noise.velocity_random_walk)
    gravity, gravity_sigma = setup.gravity
    return CalibrationOptions(
        whole_turns=setup.table_repeatability,
        gravity=gravity,
        walks=walks,
        gravity_sigma=gravity_sigma,
        latitude_sigma=setup.prior.latitude,
    )


def _calibrated(
    pieces: Sequence[tuple[IncrementRecording, list[Rest]]], site: Site, options: CalibrationOptions
) -> Calibration:
    if not pieces:
        raise MeasurementError("too many increments are missing in the rotations. Check the CAN bus")
    recordings, rests = zip(*pieces, strict=True)
    return calibrate(recordings, site, options, rests)


def _range_c(temperatures_c: FloatArray, marks: DwellMarks) -> FloatArray:
    """Lowest and highest temperatures (2, 4) of a dwell from means and slopes (7,)."""
    half = np.zeros(4)
    half[:3] = 0.5 * np.abs(temperatures_c[4:]) * (marks.end_s - marks.start_s) / 3600.0
    return np.array([temperatures_c[:4] - half, temperatures_c[:4] + half])


def _with_force(found: Calibration, site: Site, options: CalibrationOptions) -> CoefficientEstimate:
    """The same estimate as uncertain as it would be if the vertical specific force were measured."""
    sections = [replace(each, epochs=replace(each.epochs, has_vertical=True)) for each in found.sections]
    information = Information.of(sections, found.starts, found.unknowns, found.noise, site, options)
    _, covariance, is_observed = information.solve()
    by_site = sum(part[:COUNT, :COUNT] for part in found.by_site.values())
    return CoefficientEstimate(found.values, covariance[:COUNT, :COUNT] + by_site, is_observed[:COUNT])


def _measured(
    marks: DwellMarks, frames: FrameBlock, setup: MeasurementSetup
) -> tuple[list[tuple[IncrementRecording, list[Rest]]], FloatArray]:
    """Increments of a dwell in pieces without a gap, each with its rests; temperatures (7,).

    These are of gyros and case, and slopes of those of the gyros.

    Raises MeasurementError if what the INS sent can't be used.
    """
    navigation = checked_navigation(marks, frames, setup, [])
    first, end = marks.windows[0].first_frame, marks.windows[-1].end_frame
    temperatures = dwell_temperatures(navigation, first, end)
    increments = setup.decode_increments(frames)
    is_sent = increments is not None and len(increments.row) > 0
    navigated = navigated_increments(navigation, setup.site)
    if increments is None or not is_sent:
        increments = navigated
    else:
        _check_axes(increments, navigated, marks)
    begin, stop = np.searchsorted(increments.row, [first, end])
    gaps = begin + 1 + np.flatnonzero(~increments.follows[begin + 1 : stop])
    pieces = []
    for part in itertools.starmap(slice, itertools.pairwise([begin, *gaps.tolist(), stop])):
        ends = [
            np.searchsorted(increments.row[part], [each.first_frame, each.end_frame])
            for each in marks.windows
        ]
        rests = [Rest(int(a), int(b)) for a, b in ends if b > a]
        # Up to the end of a rest the table stands as it was read there.
        counts = np.diff([0, *(int(end) for _, end in ends[:-1]), part.stop - part.start])
        table = np.repeat(
            [setup.table.attitude(each.outer_deg, each.inner_deg) for each in marks.windows], counts, axis=0
        )
        if sum(rest.end - rest.begin for rest in rests) * increments.interval_s >= MIN_REST_TOTAL_S:
            angle, velocity = increments.angle[part], increments.velocity[part]
            recording = IncrementRecording(
                increments.interval_s, angle, velocity, has_vertical=is_sent, table=table
            )
            pieces.append((recording, rests))
    return pieces, np.array([*temperatures.gyro_c, temperatures.case_c, *temperatures.gyro_rate_c_per_h])


def _check_axes(sent: Increments, navigated: Increments, marks: DwellMarks) -> None:
    """Raise MeasurementError if increments have other axes, signs or units than attitude and velocity.

    Coefficients of axes that are exchanged in angle and velocity alike fit the increments as well.
    """
    rests = [(each.first_frame, each.end_frame) for each in marks.windows]
    between = [(before[1], after[0]) for before, after in itertools.pairwise(rests)]
    for name, spans in (("velocity", rests), ("angle", between)):
        for span in spans:
            found, expected = (
                getattr(each, name)[slice(*np.searchsorted(each.row, span))].sum(axis=0)
                for each in (sent, navigated)
            )
            if name == "angle" and _fastest(sent, span) * navigated.interval_s > _MAX_STEP:
                continue  # further between two epochs than attitudes show
            away = np.linalg.norm(found - expected)
            if np.linalg.norm(expected) > _MIN_TURN and away > _MAX_AWAY * np.linalg.norm(expected):
                raise MeasurementError(
                    f"the {name} increments add up to {_triple_text(found)}, by attitude and velocity "
                    f"{_triple_text(expected)}. Check axes, signs and units of ins.signals.increments"
                )


def _fastest(sent: Increments, span: tuple[int, int]) -> float:
    """Largest rate, rad/s."""
    angle = sent.angle[slice(*np.searchsorted(sent.row, span))]
    return float(np.linalg.norm(angle, axis=1).max(initial=0.0)) / sent.interval_s


def _triple_text(values: FloatArray) -> str:
    return "({:.4g}, {:.4g}, {:.4g})".format(*values)


def navigated_increments(navigation: NavigationData, site: Site) -> Increments:
    """What the sensors of an INS measured from epoch to epoch, by its attitude and velocity.

    The navigation frame turns with the Earth and with the velocity that the INS computes; to that belong the
    Coriolis acceleration and, in place of the vertical specific force, gravity.
    """
    time_s, C_nb = navigation.ins_time_s, navigation.attitude
    velocity = navigation.velocity_enu_mps[:, :2]
    interval_s = float(np.median(np.diff(time_s)))
    east, north = (0.5 * (velocity[1:] + velocity[:-1])).T
    meridian, across = curvature_radii(site.latitude, site.height)
    transport = np.stack([-north / meridian, east / across, east * np.tan(site.latitude) / across], axis=-1)
    # Where the INS takes itself to be: in hours its drift changes the Earth's rate that it subtracts.
    latitude = site.latitude + np.cumsum(north) * interval_s / meridian
    earth = EARTH_RATE * np.stack([np.zeros_like(latitude), np.cos(latitude), np.sin(latitude)], axis=-1)
    turned, half = (rotation_matrices(part * (earth + transport) * interval_s) for part in (1.0, 0.5))
    angle = rotation_vectors(C_nb[:-1].transpose(0, 2, 1) @ turned @ C_nb[1:])
    force = np.cross(2.0 * earth + transport, np.stack([east, north, np.zeros_like(east)], axis=-1))
    force[:, :2] += np.diff(velocity, axis=0) / interval_s
    force[:, 2] = site.gravity
    in_body = np.einsum("nji,njk,nk->ni", C_nb[:-1], half, force * interval_s)
    turning = np.cross(angle, in_body)
    sums = in_body - 0.5 * turning + np.cross(angle, turning) / 12.0
    # Rotation vectors and velocities hold coning and sculling, which increments of sensors do not.
    last = np.maximum(np.arange(len(angle)) - 1, 0)
    coning = np.cross(angle[last], angle) / 12.0
    sculling = (np.cross(angle[last], sums) + np.cross(sums[last], angle)) / 12.0
    steady = np.abs(np.diff(time_s) / interval_s - 1.0) < _MAX_STEP_ERROR
    return Increments(
        row=navigation.row[1:],
        angle=angle - coning,
        velocity=sums - sculling,
        follows=steady,
        interval_s=interval_s,
    )
