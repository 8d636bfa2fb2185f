"""One dwell: marks and frames in, a row of the dwell table out; or a dwell that checks a calibration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gyrobench.bench.bias.bias_filter import StateSpaceEstimate, estimate_state_space, navigation_fit
from gyrobench.bench.bias.dwell import BiasEstimate, Dwell
from gyrobench.bench.bias.dwell_table import NEIGHBOURS_ON, NOT_MEASURED, DwellRow
from gyrobench.bench.bias.error_split import ErrorParts
from gyrobench.bench.bias.joint_solution import JointInformation
from gyrobench.bench.bias.noise_estimate import RestMotion
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.paper import estimate_paper
from gyrobench.bench.bias.statistics import Chi2Test
from gyrobench.bench.bias.vertical_pairs import exceeds_declared
from gyrobench.bench.bias.window_filter import EPOCH_S
from gyrobench.bench.dwells.dwell_output import (
    check_signal_map,
    decoded_navigation,
    dwell_at_rest,
    turn_fault,
)
from gyrobench.bench.dwells.measurement_setup import MeasurementSetup
from gyrobench.bench.dwells.output_checks import OutputFault
from gyrobench.bench.dwells.setup_check import SetupEvidence, drift_fault, raise_setup_fault
from gyrobench.bench.dwells.temperatures import DwellTemperatures, dwell_temperatures
from gyrobench.bench.foundations.arrays import UG_TO_MPS2, Triple, triple
from gyrobench.bench.foundations.errors import MeasurementError, SignalMapError
from gyrobench.bench.navigation.earth import earth_rate_enu
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.runs.marks import DwellMarks
from gyrobench.drivers.frames import FrameBlock
from gyrobench.drivers.ins.navigation_data import EpochCounts, NavigationData

#: Below this p-value the fit fails: one in a hundred thousand good dwells.
_MIN_FIT_P_VALUE = 1e-5
#: The same for biases that differ between the windows: one in ten thousand.
_MIN_STEADY_P_VALUE = 1e-4
#: Attitude that is noisier than declared by this factor comes in steps of its sensors.
_COARSER = 5.0


@dataclass(frozen=True, eq=False, slots=True)
class MeasuredDwell:
    """A row for the table, what is behind it where there is a result, and how the frames came."""

    row: DwellRow
    estimate: StateSpaceEstimate | None  #: By the full error model, without its information.
    #: What it shows of the parameters that the dwells of a plateau share.
    joint_information: JointInformation | None
    #: Navigation at rest, an epoch a second, for the noise; empty where its output is disturbed, and where
    #: :mod:`gyrobench.bench.dwells.run_dwells` does not keep it.
    windows: tuple[RestMotion, ...]
    counts: EpochCounts  #: How the frames came.
    #: Those flags that a repeated dwell would have as well: noise larger than declared explains them, or the
    #: INS is at fault.
    persistent_flags: tuple[str, ...]
    #: What of signal map or latitude is wrong; every further dwell would be invalid too.
    setup_fault: str
    #: What it shows of scale and latitude; None where the output jumps.
    evidence: SetupEvidence | None
    are_signs_tested: bool  #: Whether wrong signs or axes of the velocities would have shown in it.

    @property
    def flags(self) -> tuple[str, ...]:
        """What was wrong; empty where nothing was."""
        return self.row.flags

    @property
    def is_disturbed(self) -> bool:
        """Whether something disturbed it, so that a repeated dwell may be better."""
        return self.estimate is None or not set(self.flags).issubset(self.persistent_flags)

    def flagged(self, flag: str) -> MeasuredDwell:
        """The same with one flag more."""
        return replace(self, row=replace(self.row, flags=(*self.flags, flag)))


@dataclass(eq=False)
class _Reading:
    """What the frames of a dwell show before anything is estimated, as far as they could be read."""

    flags: list[str]
    counts: EpochCounts = field(default_factory=EpochCounts)
    temperatures: DwellTemperatures = field(default_factory=DwellTemperatures)
    setup_fault: str = ""
    are_signs_tested: bool = False

    def decode(self, marks: DwellMarks, frames: FrameBlock, setup: MeasurementSetup) -> NavigationData:
        """Decode the frames and compare them with the signal map; raises MeasurementError."""
        navigation, decoding_flags = decoded_navigation(marks, frames, setup)
        self.flags += decoding_flags
        self.are_signs_tested = check_signal_map(marks, frames, navigation, setup)
        self.counts = navigation.counts
        self.temperatures = dwell_temperatures(navigation, *marks.span)
        return navigation

    def end(self, error: MeasurementError) -> None:
        """Flag the dwell with the reason why it can't be used."""
        self.flags.append(str(error))
        self.setup_fault = str(error) if isinstance(error, SignalMapError) else ""


def measure_dwell(marks: DwellMarks, frames: FrameBlock, setup: MeasurementSetup) -> MeasuredDwell:
    """Measure the gyro biases of one dwell.

    A dwell that can't give a result gives a row without biases, flagged with the reason.
    """
    reading = _Reading(list(marks.disturbances))
    estimate, paper, joint_information = None, None, None
    persistent_flags: tuple[str, ...] = ()
    windows: tuple[RestMotion, ...] = ()
    evidence: SetupEvidence | None = None
    flags = reading.flags
    try:
        navigation = reading.decode(marks, frames, setup)
        dwell = dwell_at_rest(marks, navigation, setup)
        if fault := turn_fault(dwell, setup):
            flags.append(fault)
        noise = setup.noise_in(dwell.windows)
        faults = setup.output_faults(dwell.windows, noise)
        evidence = None if flags else setup.evidence(dwell, noise, faults)
        raise_setup_fault(evidence)
        paper = _paper(dwell, setup.site, noise)
        estimated = estimate_dwell(dwell, setup, noise, faults)
        estimate, persistent_flags = estimated.estimate, estimated.persistent_flags
        if estimate.information:
            joint_information = JointInformation.of(estimate.information, dwell.position, setup.prior)
            estimate = replace(estimate, information=None)
        if not flags and all(fault.may_be_noise for fault in faults):
            windows = tuple(RestMotion.of(window.thinned(EPOCH_S)) for window in dwell.windows)
        flags += estimated.disturbances
        if evidence and (drift := drift_fault(evidence.velocities)):
            persistent_flags = (*persistent_flags, drift)
        flags += persistent_flags
    except MeasurementError as error:
        reading.end(error)
    return MeasuredDwell(
        _row(marks, reading.temperatures, estimate, paper, flags),
        estimate,
        joint_information,
        windows,
        reading.counts,
        persistent_flags,
        reading.setup_fault,
        evidence,
        reading.are_signs_tested,
    )


@dataclass(frozen=True, eq=False)
class EstimatedDwell:
    """Biases of a dwell, and its flags."""

    estimate: StateSpaceEstimate
    disturbances: tuple[str, ...]  #: What disturbed it.
    persistent_flags: tuple[str, ...]  #: See :class:`MeasuredDwell`.


def estimate_dwell(
    dwell: Dwell, setup: MeasurementSetup, noise: NoiseModel, faults: Sequence[OutputFault] | None = None
) -> EstimatedDwell:
    """Estimate the biases of a dwell; ``faults``: of its output, where they are known."""
    estimate = _estimate(dwell, setup, noise)
    faults = setup.output_faults(dwell.windows, noise) if faults is None else faults
    disturbances = [fault.text for fault in faults if not fault.may_be_noise]
    persistent_flags = _contradictions(estimate)
    pulse_rad = math.sqrt(12.0) * noise.heading_white
    is_flagged = bool(disturbances or persistent_flags)
    if is_flagged and setup.noise and noise.heading_white > _COARSER * setup.noise.heading_white:
        persistent_flags.insert(
            0,
            f"the resolution of the gyros limits this dwell: the attitude moves in steps of about "
            f"{math.degrees(pulse_rad) * 3600.0:.2g} arcsec. Measure with dithered gyros or finer pulses",
        )
    if step := estimate.probable_step:
        disturbances.append(
            f"a bias is not constant: that of the {AXES[step.gyro]} gyro seems to step by "
            f"{step.size_dph:.2g} deg/h at {step.time_s:.0f} s on the clock of the INS (p = "
            f"{step.p_value:.1g}, corrected for the search). Measure the dwell again"
        )
    by_noise = [fault.text for fault in faults if fault.may_be_noise]
    return EstimatedDwell(estimate, tuple(disturbances), (*by_noise, *persistent_flags))


def _estimate(dwell: Dwell, setup: MeasurementSetup, noise: NoiseModel) -> StateSpaceEstimate:
    """Biases with the latitude as declared, unless another alone explains what would be flagged.

    All dwells of a run decide on the latitude: until then the vertical bias is uncertain by its whole error.
    """
    estimate = estimate_state_space(dwell, setup.site, noise, setup.prior)
    error, prior = abs(estimate.latitude_error), setup.prior
    is_sound = not (_contradictions(estimate) or estimate.probable_step)
    if is_sound or not exceeds_declared(error, estimate.latitude_sigma, prior.latitude):
        return estimate
    other = estimate_state_space(dwell, setup.site, noise, replace(prior, latitude=error))
    if _contradictions(other) or other.probable_step:
        return estimate
    _, north_rate, _ = earth_rate_enu(setup.site.latitude)
    up_radps = error * north_rate * dwell.windows[0].C_nb[0, 2]
    latitude = other.parts["latitude"]
    added = replace(latitude, columns=np.column_stack([latitude.columns, up_radps]))
    return replace(
        other,
        covariance=other.covariance + np.outer(up_radps, up_radps),
        parts=ErrorParts({**other.parts, "latitude": added}),
    )


def _contradictions(estimate: StateSpaceEstimate) -> list[str]:
    """What contradicts the estimate; noise larger than declared would explain it too."""
    flags = []
    if estimate.damping.shows(_MIN_STEADY_P_VALUE):
        flags.append(estimate.damping.text)
    if estimate.fit.p_value < _MIN_FIT_P_VALUE:
        flags.append(lack_of_fit_text(estimate.fit))
    if estimate.steady_p_value < _MIN_STEADY_P_VALUE:
        flags.append(
            f"the biases of the windows differ (p = {estimate.steady_p_value:.1g}): the table was turned "
            "slowly, or a bias jumped. Check the table and its base"
        )
    return flags


def _paper(dwell: Dwell, site: Site, noise: NoiseModel) -> BiasEstimate | None:
    """Estimate by the paper's method, which does not apply to every dwell."""
    try:
        return estimate_paper(dwell, site.gravity, noise)
    except MeasurementError:
        return None


def lack_of_fit_text(fit: Chi2Test) -> str:
    """Message where error model and noise do not explain the data."""
    return (
        f"the residuals are {fit.ratio:.2f} times as large as the noise explains "
        f"(p = {fit.p_value:.1g}): the unit was disturbed, or its noise is not as declared"
    )


def _row(
    marks: DwellMarks,
    temperatures: DwellTemperatures,
    estimate: StateSpaceEstimate | None,
    paper: BiasEstimate | None,
    flags: list[str],
) -> DwellRow:
    return DwellRow(
        unit=marks.unit,
        run=marks.run,
        dwell=marks.dwell,
        cycle=marks.cycle,
        position=marks.position,
        azimuth_deg=marks.azimuth_deg,
        start_s=marks.start_s,
        end_s=marks.end_s,
        since_power_on_s=marks.since_power_on_s,
        chamber_set_c=math.nan if marks.chamber_set_c is None else marks.chamber_set_c,
        chamber_c=math.nan if marks.chamber_c is None else marks.chamber_c,
        case_c=temperatures.case_c,
        gyro_c=temperatures.gyro_c,
        gyro_rate_c_per_h=temperatures.gyro_rate_c_per_h,
        board_c=temperatures.board_c,
        bias_dph=triple(estimate.bias_dph) if estimate else NOT_MEASURED,
        sigma_dph=triple(estimate.sigma_dph) if estimate else NOT_MEASURED,
        paper_bias_dph=triple(paper.bias_dph) if paper else NOT_MEASURED,
        paper_sigma_dph=triple(paper.sigma_dph) if paper else NOT_MEASURED,
        accelerometer_ug=triple(estimate.accelerometer_bias / UG_TO_MPS2) if estimate else NOT_MEASURED,
        accelerometer_sigma_ug=triple(estimate.accelerometer_sigma / UG_TO_MPS2)
        if estimate
        else NOT_MEASURED,
        fit_ratio=estimate.fit.ratio if estimate else math.nan,
        fit_p_value=estimate.fit.p_value if estimate else math.nan,
        other=() if marks.neighbours_on is None else ((NEIGHBOURS_ON, marks.neighbours_on),),
        flags=tuple(flags),
    )


@dataclass(frozen=True, eq=False)
class AlignedNavigation:
    """Navigation straight from an alignment, and the noise of the INS in it."""

    dwell: Dwell  #: An epoch a second.
    noise: NoiseModel  #: Declared, or as estimated from all epochs.


@dataclass(frozen=True, eq=False)
class CheckDwell:
    """One dwell of a calibration check: an alignment, and the navigation straight after it."""

    marks: DwellMarks  #: Where and when.
    navigation: AlignedNavigation | None  #: None where it can't be used.
    temperatures: DwellTemperatures  #: Of the navigation.
    aligning_c: Triple  #: Mean temperatures of the gyros over the alignment.
    counts: EpochCounts  #: How the frames came.
    flags: tuple[str, ...]  #: What was wrong; empty where nothing was.
    setup_fault: str = ""  #: What of signal map or latitude is wrong.
    are_signs_tested: bool = False  #: Whether wrong signs or axes of the velocities would have shown in it.

    @property
    def dwell(self) -> int:
        """Number of the dwell."""
        return self.marks.dwell

    @property
    def run(self) -> str:
        """Power cycle of the unit."""
        return self.marks.run

    @property
    def cycle(self) -> int:
        """Cycle of the temperature profile."""
        return self.marks.cycle

    @property
    def chamber_set_c(self) -> float | None:
        """Set point of the chamber, degC."""
        return self.marks.chamber_set_c

    @property
    def gyro_c(self) -> Triple:
        """Mean temperatures of the gyros over the navigation, degC."""
        return self.temperatures.gyro_c

    @property
    def is_disturbed(self) -> bool:
        """Whether a fault disturbed it, so that a repeated dwell may be better."""
        return bool(self.flags)


def measure_check_dwell(marks: DwellMarks, frames: FrameBlock, setup: MeasurementSetup) -> CheckDwell:
    """Measure one alignment and the navigation straight after it.

    A dwell that can't be used is flagged with the reason.
    """
    reading = _Reading(list(marks.disturbances))
    navigation, aligning_c, flags = None, NOT_MEASURED, reading.flags
    try:
        data = reading.decode(marks, frames, setup)
        aligning_c = _aligning_c(data, marks.span[0], reading.temperatures)
        dwell = dwell_at_rest(marks, data, setup)
        navigation = _navigation(dwell, setup)
        faults = setup.output_faults(dwell.windows, navigation.noise)
        if not flags:
            raise_setup_fault(setup.evidence(dwell, navigation.noise, faults))
        flags += [fault.text for fault in faults]
        (window,) = navigation.dwell.windows
        fit = navigation_fit(window, setup.site, navigation.noise, setup.prior)
        if fit.p_value < _MIN_FIT_P_VALUE:
            flags.append(lack_of_fit_text(fit))
    except MeasurementError as error:
        reading.end(error)
    return CheckDwell(
        marks,
        navigation,
        reading.temperatures,
        aligning_c,
        reading.counts,
        tuple(flags),
        reading.setup_fault,
        reading.are_signs_tested,
    )


def _navigation(dwell: Dwell, setup: MeasurementSetup) -> AlignedNavigation:
    if len(dwell.windows) != 1:
        raise MeasurementError(
            f"{len(dwell.windows)} navigations; a calibration check has one, straight from the alignment"
        )
    thinned = tuple(window.thinned(EPOCH_S) for window in dwell.windows)
    return AlignedNavigation(replace(dwell, windows=thinned), setup.noise_in(dwell.windows))


def _aligning_c(data: NavigationData, first_frame: int, temperatures: DwellTemperatures) -> Triple:
    """Temperatures of the alignment; where the INS does not send them, those of the navigation."""
    try:
        aligning_c = dwell_temperatures(data, 0, first_frame).gyro_c
    except MeasurementError:
        return temperatures.gyro_c
    return temperatures.gyro_c if any(map(math.isnan, aligning_c)) else aligning_c
