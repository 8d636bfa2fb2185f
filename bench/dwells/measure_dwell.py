"""Measures one dwell: from its marks and frames to a row of the dwell table, or to a check dwell."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gyrobench.bench.bias.bias_filter import StateSpaceEstimate, estimate_state_space, navigation_fit
from gyrobench.bench.bias.damping import Damping
from gyrobench.bench.bias.dwell import BiasEstimate, Dwell, NavigationWindow
from gyrobench.bench.bias.dwell_table import NEIGHBOURS_ON, NOT_MEASURED, DwellRow
from gyrobench.bench.bias.error_split import ErrorParts
from gyrobench.bench.bias.joint_solution import JointInformation
from gyrobench.bench.bias.noise_estimate import RestMotion
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.paper import estimate_paper
from gyrobench.bench.bias.parameters import ErrorModel, PriorKnowledge
from gyrobench.bench.bias.statistics import Chi2Test
from gyrobench.bench.bias.vertical_pairs import exceeds_declared
from gyrobench.bench.bias.window_filter import EPOCH_S
from gyrobench.bench.dwells.dwell_output import (
    check_signal_map,
    decode_dwell,
    dwell_at_rest,
    turn_angles,
    turn_fault,
)
from gyrobench.bench.dwells.measurement_setup import MeasurementSetup
from gyrobench.bench.dwells.output_checks import OutputFault
from gyrobench.bench.dwells.setup_check import SetupEvidence, drift_fault, raise_setup_fault, sequence_fault
from gyrobench.bench.dwells.temperatures import DwellTemperatures, dwell_temperatures
from gyrobench.bench.foundations.arrays import UG_TO_MPS2, Triple, triple
from gyrobench.bench.foundations.errors import MeasurementError, SignalMapError
from gyrobench.bench.navigation.earth import earth_rate_enu
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.runs.marks import DwellMarks
from gyrobench.drivers.frames import FrameBlock
from gyrobench.drivers.ins.navigation_data import EpochCounts, NavigationData

#: A dwell whose goodness of fit has a smaller p-value is flagged: one in a hundred thousand good dwells.
_MIN_FIT_P_VALUE = 1e-5
#: The same for the test that the biases of all windows are equal: one in ten thousand.
_MIN_STEADY_P_VALUE = 1e-4
#: If the attitude is noisier than declared by this factor, it moves in steps of the gyros' pulses.
_COARSE_ATTITUDE_FACTOR = 5.0


@dataclass(frozen=True, eq=False, slots=True)
class MeasuredDwell:
    """Result of one dwell: its table row, the estimate behind the row, and the counts of irregular epochs."""

    row: DwellRow
    #: By the full error model, with ``information`` removed; None if the dwell gave no result.
    estimate: StateSpaceEstimate | None
    #: Information on the parameters that the dwells of a plateau share.
    joint_information: JointInformation | None
    #: Navigation at rest, one epoch per second, for the noise estimate; empty if its output is disturbed, or
    #: if :mod:`gyrobench.bench.dwells.run_dwells` does not keep it.
    windows: tuple[RestMotion, ...]
    counts: EpochCounts  #: Irregular epochs.
    #: Flags that a repeated dwell would have as well: the noise is larger than declared, or the INS is at
    #: fault.
    persistent_flags: tuple[str, ...]
    #: Fault of signal map or latitude, which makes every further dwell invalid too; empty if there is none.
    setup_fault: str
    #: Evidence on scale and latitude; None if the output jumps.
    evidence: SetupEvidence | None
    are_signs_tested: bool  #: Whether the dwell would have revealed wrong signs or axes of the velocities.

    @property
    def flags(self) -> tuple[str, ...]:
        """Faults of the dwell; empty if there are none."""
        return self.row.flags

    @property
    def is_disturbed(self) -> bool:
        """Whether the dwell was disturbed, so that a repeated dwell may be better."""
        return self.estimate is None or not set(self.flags).issubset(self.persistent_flags)

    def with_larger_gyro_errors(self, factor: float, scale_factor_ratio: float = 1.0) -> MeasuredDwell:
        """Copy of the dwell whose gyro biases allow for larger errors of the gyros' matrix.

        ``scale_factor_ratio``: additional factor of the scale factors. The accelerometer biases keep their
        uncertainties: they are the evidence for such errors, and a search may name what they follow.
        """
        if self.estimate is None:
            return self
        parts, covariance = dict(self.estimate.parts), self.estimate.covariance
        for name, each in (("gyro_scale_factor", factor * scale_factor_ratio), ("gyro_misalignment", factor)):
            columns = parts[name].columns
            covariance = covariance + (each**2 - 1.0) * columns @ columns.T
            parts[name] = replace(parts[name], columns=each * columns, sigma=each * parts[name].sigma)
        estimate = replace(self.estimate, covariance=covariance, parts=ErrorParts(parts))
        row = replace(self.row, **_uncertainties(estimate))
        return replace(self, estimate=estimate, row=row)

    def with_flag(self, flag: str) -> MeasuredDwell:
        """Copy of the dwell with one more flag."""
        return replace(self, row=replace(self.row, flags=(*self.flags, flag)))


@dataclass(eq=False)
class _DwellDecoder:
    """Decodes the frames of a dwell; keeps what was read, and the flags, even if decoding fails."""

    flags: list[str]
    counts: EpochCounts = field(default_factory=EpochCounts)
    temperatures: DwellTemperatures = field(default_factory=DwellTemperatures)
    setup_fault: str = ""
    are_signs_tested: bool = False

    def decode(self, marks: DwellMarks, frames: FrameBlock, setup: MeasurementSetup) -> NavigationData:
        """Decode the frames and compare them with the signal map; raises MeasurementError."""
        navigation, decoding_flags = decode_dwell(marks, frames, setup)
        self.flags += decoding_flags
        self.are_signs_tested = check_signal_map(marks, frames, navigation, setup)
        self.counts = navigation.counts
        self.temperatures = dwell_temperatures(navigation, *marks.span)
        return navigation

    def fail(self, error: MeasurementError) -> None:
        """Flag the dwell with the reason why it can't be used."""
        self.flags.append(str(error))
        self.setup_fault = str(error) if isinstance(error, SignalMapError) else ""


def measure_dwell(marks: DwellMarks, frames: FrameBlock, setup: MeasurementSetup) -> MeasuredDwell:
    """Measure the gyro biases of one dwell.

    If the dwell gives no result, its row has no biases and a flag with the reason.
    """
    decoder = _DwellDecoder(list(marks.disturbances))
    estimate, paper, joint_information = None, None, None
    persistent_flags: tuple[str, ...] = ()
    windows: tuple[RestMotion, ...] = ()
    evidence: SetupEvidence | None = None
    try:
        navigation = decoder.decode(marks, frames, setup)
        dwell = dwell_at_rest(marks, navigation, setup)
        if fault := sequence_fault(dwell.windows, setup.signals):
            raise SignalMapError(fault)
        noise = setup.noise_in(dwell.windows)
        if fault := turn_fault(dwell, setup, noise):
            decoder.flags.append(fault)
        faults = setup.output_faults(dwell.windows, noise)
        evidence = None if decoder.flags else setup.evidence(dwell, noise, faults, navigation.latitude)
        raise_setup_fault(evidence)
        with suppress(MeasurementError):  # the paper's method does not apply
            paper = estimate_paper(dwell, setup.site.gravity, noise)
        damping = evidence.velocities.damping if evidence else None
        estimated = estimate_dwell(dwell, setup, noise, faults, damping)
        estimate, persistent_flags = estimated.estimate, estimated.persistent_flags
        if estimate.information:
            joint_information = JointInformation.of(
                estimate.information, dwell.position, setup.prior, turn_angles(dwell, setup, noise)
            )
            estimate = replace(estimate, information=None)
        if not decoder.flags and all(fault.may_be_noise for fault in faults):
            windows = tuple(RestMotion.of(window.thinned(EPOCH_S)) for window in dwell.windows)
        decoder.flags += estimated.disturbances
        if evidence and (drift := drift_fault(evidence.velocities)):
            persistent_flags = (*persistent_flags, drift)
        decoder.flags += persistent_flags
    except MeasurementError as error:
        decoder.fail(error)
    return MeasuredDwell(
        row=_row(marks, decoder, estimate, paper),
        estimate=estimate,
        joint_information=joint_information,
        windows=windows,
        counts=decoder.counts,
        persistent_flags=persistent_flags,
        setup_fault=decoder.setup_fault,
        evidence=evidence,
        are_signs_tested=decoder.are_signs_tested,
    )


@dataclass(frozen=True, eq=False)
class EstimatedDwell:
    """Biases of a dwell, and its flags."""

    estimate: StateSpaceEstimate
    disturbances: tuple[str, ...]  #: Flags that a repeated dwell may not have again.
    persistent_flags: tuple[str, ...]  #: See :class:`MeasuredDwell`.


def estimate_dwell(
    dwell: Dwell,
    setup: MeasurementSetup,
    noise: NoiseModel,
    faults: Sequence[OutputFault] | None = None,
    damping: Damping | None = None,
) -> EstimatedDwell:
    """Estimate the biases of a dwell; ``faults`` of its output are searched for unless given.

    ``damping``: of the velocities by the tilt, which a change of a bias does not affect. Without it, damping
    is estimated together with the biases.
    """
    estimate = _estimate(dwell, setup.error_model(noise), damping)
    faults = setup.output_faults(dwell.windows, noise) if faults is None else faults
    disturbances = [fault.text for fault in faults if not fault.may_be_noise]
    persistent_flags = _contradictions(estimate)
    pulse_rad = math.sqrt(12.0) * noise.heading_white
    is_flagged = bool(disturbances or persistent_flags)
    if (
        is_flagged
        and setup.noise
        and noise.heading_white > _COARSE_ATTITUDE_FACTOR * setup.noise.heading_white
    ):
        persistent_flags.insert(
            0,
            f"the resolution of the gyros limits this dwell: the attitude moves in steps of about "
            f"{math.degrees(pulse_rad) * 3600.0:.2g} arcsec. Measure with dithered gyros or finer pulses",
        )
    if step := estimate.probable_step:
        disturbances.append(
            f"a bias is not constant: that of the {AXES[step.gyro]} gyro seems to step by "
            f"{step.size_dph:.2g} deg/h at {step.time_s:.0f} s on the clock of the INS (p = "
            f"{step.p_value:.1g}, corrected for the search)"
        )
    by_noise = [fault.text for fault in faults if fault.may_be_noise]
    return EstimatedDwell(estimate, tuple(disturbances), (*by_noise, *persistent_flags))


def _estimate(dwell: Dwell, model: ErrorModel, damping: Damping | None) -> StateSpaceEstimate:
    """Estimate the biases with the declared latitude, or with another one if only that avoids a flag.

    All dwells of a run together decide on the latitude. Until then, the uncertainty of the vertical bias
    includes the effect of the whole latitude error.
    """

    def estimate_with(prior: PriorKnowledge) -> StateSpaceEstimate:
        estimate = estimate_state_space(dwell, replace(model, prior=prior))
        return estimate if damping is None else replace(estimate, damping=damping)

    estimate, prior = estimate_with(model.prior), model.prior
    error = abs(estimate.latitude_error)
    is_consistent = not (_contradictions(estimate) or estimate.probable_step)
    if is_consistent or not exceeds_declared(error, estimate.latitude_sigma, prior.latitude):
        return estimate
    refit = estimate_with(replace(prior, latitude=error))
    if _contradictions(refit) or refit.probable_step:
        return estimate
    _, north_rate, _ = earth_rate_enu(model.site.latitude)
    up_radps = error * north_rate * dwell.windows[0].C_nb[0, 2]
    latitude = refit.parts["latitude"]
    widened = replace(latitude, columns=np.column_stack([latitude.columns, up_radps]))
    return replace(
        refit,
        covariance=refit.covariance + np.outer(up_radps, up_radps),
        parts=ErrorParts({**refit.parts, "latitude": widened}),
    )


def _contradictions(estimate: StateSpaceEstimate) -> list[str]:
    """Flags of an estimate that the error model does not explain; larger noise than declared might."""
    flags = []
    if estimate.damping.is_significant(_MIN_STEADY_P_VALUE):
        flags.append(estimate.damping.text)
    if estimate.fit.p_value < _MIN_FIT_P_VALUE:
        flags.append(lack_of_fit_text(estimate.fit))
    if estimate.steady_p_value < _MIN_STEADY_P_VALUE:
        flags.append(
            f"the biases of the windows differ (p = {estimate.steady_p_value:.1g}): the table was turned "
            "slowly, or a bias jumped. Check the table and its base"
        )
    return flags


def lack_of_fit_text(fit: Chi2Test) -> str:
    """Flag of a dwell whose data the error model and the noise do not explain."""
    return (
        f"the residuals are {fit.ratio:.2f} times as large as the noise explains "
        f"(p = {fit.p_value:.1g}): the unit was disturbed, or its noise is not as declared"
    )


def _uncertainties(estimate: StateSpaceEstimate) -> dict[str, Any]:
    """Standard uncertainties of an estimate, by their fields of a row."""
    return {
        "sigma_dph": triple(estimate.sigma_dph),
        "common_sigma_dph": triple(estimate.common_sigma_dph),
        "accelerometer_sigma_ug": triple(estimate.accelerometer_sigma / UG_TO_MPS2),
        "accelerometer_common_sigma_ug": triple(estimate.accelerometer_common_sigma / UG_TO_MPS2),
    }


def _row(
    marks: DwellMarks, decoder: _DwellDecoder, estimate: StateSpaceEstimate | None, paper: BiasEstimate | None
) -> DwellRow:
    temperatures = decoder.temperatures
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
        **(_uncertainties(estimate) if estimate else {"sigma_dph": NOT_MEASURED}),
        paper_bias_dph=triple(paper.bias_dph) if paper else NOT_MEASURED,
        paper_sigma_dph=triple(paper.sigma_dph) if paper else NOT_MEASURED,
        accelerometer_ug=triple(estimate.accelerometer_bias / UG_TO_MPS2) if estimate else NOT_MEASURED,
        fit_ratio=estimate.fit.ratio if estimate else math.nan,
        fit_p_value=estimate.fit.p_value if estimate else math.nan,
        other=() if marks.neighbours_on is None else ((NEIGHBOURS_ON, marks.neighbours_on),),
        flags=tuple(decoder.flags),
    )


@dataclass(frozen=True, eq=False)
class AlignedNavigation:
    """Navigation directly after an alignment, and the noise of the INS in it."""

    dwell: Dwell  #: One epoch per second.
    noise: NoiseModel  #: Declared, or estimated from all epochs.


@dataclass(frozen=True, eq=False)
class CheckDwell:
    """One dwell of a calibration check: an alignment, and the navigation directly after it."""

    marks: DwellMarks
    navigation: AlignedNavigation | None  #: None if it can't be used.
    temperatures: DwellTemperatures  #: During the navigation.
    alignment_c: Triple  #: Mean temperatures of the gyros over the alignment.
    counts: EpochCounts  #: Irregular epochs.
    flags: tuple[str, ...]  #: Faults of the dwell; empty if there are none.
    setup_fault: str = ""  #: Fault of signal map or latitude.
    #: Whether the dwell would have revealed wrong signs or axes of the velocities.
    are_signs_tested: bool = False

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
    """Measure one alignment and the navigation directly after it.

    If the dwell can't be used, it has a flag with the reason.
    """
    decoder = _DwellDecoder(list(marks.disturbances))
    navigation, alignment_c = None, NOT_MEASURED
    try:
        data = decoder.decode(marks, frames, setup)
        alignment_c = _mean_alignment_c(data, marks.span[0], decoder.temperatures)
        dwell = dwell_at_rest(marks, data, setup)
        window = only_window(dwell).thinned(EPOCH_S)
        navigation = AlignedNavigation(replace(dwell, windows=(window,)), setup.noise_in(dwell.windows))
        faults = setup.output_faults(dwell.windows, navigation.noise)
        if not decoder.flags:
            raise_setup_fault(setup.evidence(dwell, navigation.noise, faults, data.latitude))
        decoder.flags += [fault.text for fault in faults]
        fit = navigation_fit(window, setup.error_model(navigation.noise))
        if fit.p_value < _MIN_FIT_P_VALUE:
            decoder.flags.append(lack_of_fit_text(fit))
    except MeasurementError as error:
        decoder.fail(error)
    return CheckDwell(
        marks=marks,
        navigation=navigation,
        temperatures=decoder.temperatures,
        alignment_c=alignment_c,
        counts=decoder.counts,
        flags=tuple(decoder.flags),
        setup_fault=decoder.setup_fault,
        are_signs_tested=decoder.are_signs_tested,
    )


def only_window(dwell: Dwell) -> NavigationWindow:
    """Window of a dwell of a calibration check; raises MeasurementError if there is not one."""
    if len(dwell.windows) != 1:
        raise MeasurementError(
            f"{len(dwell.windows)} navigations; a calibration check has one, straight from the alignment"
        )
    return dwell.windows[0]


def _mean_alignment_c(data: NavigationData, end_frame: int, temperatures: DwellTemperatures) -> Triple:
    """Mean gyro temperatures over the alignment; if the INS does not send them, over the navigation."""
    try:
        alignment_c = dwell_temperatures(data, 0, end_frame).gyro_c
    except MeasurementError:
        return temperatures.gyro_c
    return temperatures.gyro_c if any(map(math.isnan, alignment_c)) else alignment_c
