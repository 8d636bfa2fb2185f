"""One dwell: marks and frames in, a row of the dwell table out."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from gyrobench.bench.bias.bias_filter import StateSpaceEstimate, estimate_state_space
from gyrobench.bench.bias.budget import BudgetInputs
from gyrobench.bench.bias.dwell import BiasEstimate, Dwell, NavigationWindow, RestOutput, TurnPath
from gyrobench.bench.bias.dwell_table import NEIGHBOURS_ON, NOT_MEASURED, DwellRow
from gyrobench.bench.bias.error_split import ErrorParts
from gyrobench.bench.bias.joint_solution import JointInformation
from gyrobench.bench.bias.noise_estimate import RestMotion, estimate_noise
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.paper import estimate_paper
from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.bias.statistics import GoodnessOfFit
from gyrobench.bench.bias.vertical_pairs import exceeds_declared
from gyrobench.bench.bias.window_filter import EPOCH_S
from gyrobench.bench.dwells.output_checks import OutputFault, exceeds_noise, output_faults, rounding
from gyrobench.bench.dwells.setup_check import (
    SetupEvidence,
    drift_fault,
    latitude_fault,
    raise_setup_fault,
    setup_evidence,
)
from gyrobench.bench.dwells.sign_check import SignCheck
from gyrobench.bench.dwells.temperatures import (
    DwellTemperatures,
    dwell_temperatures,
    temperatures_at,
    valid_temperatures,
)
from gyrobench.bench.foundations.arrays import ARCSEC_TO_RAD, UG_TO_MPS2, BoolArray, triple
from gyrobench.bench.foundations.errors import MeasurementError, SignalMapError
from gyrobench.bench.foundations.text import flag_text
from gyrobench.bench.navigation.earth import NORMAL_GRAVITY_SIGMA, earth_rate_enu
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.navigation.table_axes import TwoAxisTable
from gyrobench.bench.runs.marks import DwellMarks, WindowMark
from gyrobench.bench.station.station import Station
from gyrobench.drivers.frames import FrameBlock
from gyrobench.drivers.ins.dbc_codec import DbcCodec
from gyrobench.drivers.ins.navigation_data import (
    EpochCounts,
    Increments,
    NavigationData,
    decode_increments,
    decode_navigation,
)
from gyrobench.drivers.ins.readout import InsMode
from gyrobench.drivers.ins.resolution import ResolutionLimit, resolution_report

#: Below this p-value the fit fails: one in a hundred thousand good dwells.
MIN_FIT_P_VALUE = 1e-5
#: The same for biases that differ between the windows: one in ten thousand.
_MIN_STEADY_P_VALUE = 1e-4
#: Attitude that is noisier than declared by this factor comes in steps of its sensors.
_COARSER = 5.0


@dataclass(frozen=True)
class MeasurementSetup:
    """What turns frames into biases, the same for all dwells of a run."""

    decode: Callable[[FrameBlock], NavigationData]  #: Frames to navigation data, as the station maps them.
    table: TwoAxisTable  #: Kinematics of the table with the unit on it.
    site: Site  #: Where the bench stands.
    noise: NoiseModel | None  #: Declared noise of the INS; None to estimate it in each dwell.
    prior: PriorKnowledge  #: What is known of the INS beforehand.
    #: velocity_lsb_mps, heading_lsb_rad: Resolution of the INS's output.
    velocity_lsb_mps: float
    heading_lsb_rad: float
    resolution: tuple[ResolutionLimit, ...]  #: Which estimates it limits, and by how much.
    signs: SignCheck | None = None  #: Test of the signal map's signs and axes.
    gyro_temperature_c: float | None = None  #: Standard uncertainty of the gyros' temperature sensors, K.
    #: Frames to increments; None where none are mapped.
    decode_increments: Callable[[FrameBlock], Increments | None] = lambda _: None
    table_repeatability: float = ARCSEC_TO_RAD  #: Of the table's return to an angle, rad.
    #: Local gravity, m/s^2, None for normal gravity of the site; its standard uncertainty.
    gravity_and_sigma: tuple[float | None, float] = (None, NORMAL_GRAVITY_SIGMA)

    def turn(
        self, before: WindowMark, after: WindowMark, navigation: NavigationData, first_frame: int = 0
    ) -> TurnPath:
        """Attitude of the table between two windows; ``navigation`` begins with frame ``first_frame``."""
        angles = [(mark.outer_deg, mark.inner_deg) for mark in (before, after)]
        begin = before.end_frame if after.turn_first_frame is None else after.turn_first_frame
        end = after.first_frame if after.turn_end_frame is None else after.turn_end_frame
        rows = np.searchsorted(navigation.row, [begin - first_frame, end - first_frame])
        begin_s, end_s = navigation.ins_time_s[np.minimum(rows, len(navigation.row) - 1)]
        return TurnPath.steady(begin_s, end_s, self.table.path(*angles))

    def output_faults(self, windows: tuple[NavigationWindow, ...], noise: NoiseModel) -> list[OutputFault]:
        """Find output that is impossible at rest."""
        return output_faults(windows, noise, self.site.gravity, *self._steps)

    def evidence(
        self, dwell: Dwell, noise: NoiseModel, faults: Sequence[OutputFault]
    ) -> SetupEvidence | None:
        """Evidence of the set-up in a dwell; None where faults of the output hide it."""
        if any(not fault.may_be_noise for fault in faults):
            return None
        return setup_evidence(dwell, self.site, noise, self.prior, self.heading_lsb_rad)

    @property
    def budget_inputs(self) -> BudgetInputs:
        """Inputs of the uncertainty budgets."""
        velocity, heading = (step / math.sqrt(12.0) for step in self._steps)
        return BudgetInputs(velocity, heading, self.gyro_temperature_c)

    @property
    def _steps(self) -> tuple[float, float]:
        return self.velocity_lsb_mps, self.heading_lsb_rad

    def noise_in(self, windows: tuple[NavigationWindow, ...]) -> NoiseModel:
        """Noise of the INS in these windows: estimated from them, or declared and not exceeded by them.

        Raises MeasurementError if it is to be estimated, and is not observable in these windows.
        """
        noise = self.noise
        if noise is None:
            noise = estimate_noise(windows, self.site.gravity).noise_model()
        elif exceeds_noise(windows, noise, self.site.gravity, *self._steps):
            noise = estimate_noise(windows, self.site.gravity).exceeding(noise)
        return noise.at_least(*self.rounding(windows))

    def rounding(self, rests: Sequence[RestOutput]) -> tuple[float, float]:
        """See :func:`gyrobench.bench.dwells.output_checks.rounding`."""
        return rounding(rests, *self._steps)


@dataclass(frozen=True, eq=False, slots=True)
class MeasuredDwell:
    """A row for the table, what is behind it where there is a result, and how the frames came."""

    row: DwellRow
    estimate: StateSpaceEstimate | None  #: By the full error model, without its information.
    #: What it shows of the parameters that the dwells of a plateau share.
    joint_information: JointInformation | None
    #: Navigation at rest, an epoch a second, for the noise estimate; empty where it is disturbed, and where
    #: :mod:`gyrobench.bench.dwells.run_dwells` does not keep it.
    windows: tuple[RestMotion, ...]
    counts: EpochCounts  #: How the frames came.
    #: Those flags that a repeated dwell would have as well: noise larger than declared explains them, or the
    #: INS is at fault.
    persistent_flags: tuple[str, ...]
    #: What of signal map or latitude is wrong; every further dwell would be invalid too.
    setup_fault: str = ""
    #: What it shows of scale and latitude; None where the output jumps.
    evidence: SetupEvidence | None = None
    are_signs_tested: bool = False  #: Whether wrong signs or axes of the velocities would have shown in it.

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


def measure_dwell(marks: DwellMarks, frames: FrameBlock, setup: MeasurementSetup) -> MeasuredDwell:
    """Measure the gyro biases of one dwell.

    A dwell that can't give a result gives a row without biases, flagged with the reason.
    """
    flags = list(marks.disturbances)
    estimate, paper, joint_information = None, None, None
    persistent_flags: tuple[str, ...] = ()
    windows: tuple[RestMotion, ...] = ()
    counts, temperatures, setup_fault = EpochCounts(), DwellTemperatures(), ""
    evidence: SetupEvidence | None = None
    are_signs_tested = False
    try:
        navigation, decoding_flags = decoded_navigation(marks, frames, setup)
        flags += decoding_flags
        are_signs_tested = check_signal_map(marks, frames, navigation, setup)
        counts = navigation.counts
        temperatures = dwell_temperatures(
            navigation, marks.windows[0].first_frame, marks.windows[-1].end_frame
        )
        dwell = dwell_at_rest(marks, navigation, setup)
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
        flags += estimated.disturbances
        if not flags:
            windows = tuple(RestMotion.of(window.thinned(EPOCH_S)) for window in dwell.windows)
        if evidence and (drift := drift_fault(evidence.velocities)):
            persistent_flags = (*persistent_flags, drift)
        flags += persistent_flags
    except MeasurementError as error:
        flags.append(str(error))
        setup_fault = str(error) if isinstance(error, SignalMapError) else ""
    row = _row(marks, temperatures, estimate, paper, flags)
    return MeasuredDwell(
        row,
        estimate,
        joint_information,
        windows,
        counts,
        persistent_flags,
        setup_fault,
        evidence,
        are_signs_tested,
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


def decoded_navigation(
    marks: DwellMarks, frames: FrameBlock, setup: MeasurementSetup
) -> tuple[NavigationData, list[str]]:
    """Decode a dwell, and flag what frames and temperature sensors do wrong.

    Raises MeasurementError if the dwell never came to a window.
    """
    if not marks.windows:
        raise MeasurementError("the INS never navigated at rest in this dwell")
    navigation, sensor_flags = valid_temperatures(
        setup.decode(frames), marks.windows[0].first_frame, marks.windows[-1].end_frame
    )
    flags = list(sensor_flags)
    if navigation.counts.contradicted:
        flags.append(
            f"{navigation.counts.contradicted} frames of the INS contradict those of the same epoch: does a "
            "second node send with its identifiers? Check the bus"
        )
    return navigation, flags


def check_signal_map(
    marks: DwellMarks, frames: FrameBlock, navigation: NavigationData, setup: MeasurementSetup
) -> bool:
    """Check latitude, signs and axes; returns whether wrong signs or axes of the velocities would have shown.

    Raises SignalMapError if the dwell contradicts them, MeasurementError if a jump of its output does.
    """
    if fault := latitude_fault(navigation.latitude, setup.site):
        raise SignalMapError(fault)
    try:
        return setup.signs is not None and setup.signs.check(marks, frames, navigation)
    except SignalMapError:
        # A jump of the output parts tilt and velocity as a wrong sign does.
        windows = _windows(marks, navigation)
        faults = setup.output_faults(windows, setup.noise_in(windows))
        if jumps := [fault.text for fault in faults if not fault.may_be_noise]:
            raise MeasurementError(flag_text(jumps)) from None
        raise


def dwell_at_rest(marks: DwellMarks, navigation: NavigationData, setup: MeasurementSetup) -> Dwell:
    """Navigation in the windows of a dwell, with the attitude of the table.

    Raises MeasurementError if the INS was not navigating all the time, restarted, or what it sent can't be
    used.
    """
    _check_navigating(
        navigation,
        (navigation.row >= marks.windows[0].first_frame) & (navigation.row < marks.windows[-1].end_frame),
    )
    return Dwell(
        position_name=marks.position,
        azimuth_rad=math.radians(marks.azimuth_deg),
        windows=_windows(marks, navigation),
        C_nb_table=tuple(setup.table.attitude(mark.outer_deg, mark.inner_deg) for mark in marks.windows),
        turns=tuple(setup.turn(*pair, navigation) for pair in itertools.pairwise(marks.windows)),
    )


def _windows(marks: DwellMarks, navigation: NavigationData) -> tuple[NavigationWindow, ...]:
    return tuple(rest_output(navigation, mark).checked() for mark in marks.windows)


def _contradictions(estimate: StateSpaceEstimate) -> list[str]:
    """What contradicts the estimate; noise larger than declared would explain it too."""
    flags = []
    if estimate.damping.shows(_MIN_STEADY_P_VALUE):
        flags.append(estimate.damping.text)
    if estimate.fit.p_value < MIN_FIT_P_VALUE:
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


def lack_of_fit_text(fit: GoodnessOfFit) -> str:
    """Message where error model and noise do not explain the data."""
    return (
        f"the residuals are {fit.ratio:.2f} times as large as the noise explains "
        f"(p = {fit.p_value:.1g}): the unit was disturbed, or its noise is not as declared"
    )


def rest_output(navigation: NavigationData, mark: WindowMark) -> RestOutput:
    """Output in one window.

    The temperatures are those of :func:`gyrobench.bench.dwells.temperatures.temperatures_at`.
    Raises MeasurementError if the INS was not navigating all the time, or restarted.
    """
    inside = (navigation.row >= mark.first_frame) & (navigation.row < mark.end_frame)
    _check_navigating(navigation, inside)
    time_s = navigation.ins_time_s[inside]
    velocity = navigation.velocity_enu_mps[inside].copy()
    velocity[:, 2] = np.nan_to_num(velocity[:, 2])  # not every INS sends it, and no estimate needs it
    temperatures = temperatures_at(time_s, navigation.temperatures)
    return RestOutput(time_s, velocity, navigation.attitude[inside], *temperatures)


def _check_navigating(navigation: NavigationData, inside: BoolArray) -> None:
    """Turns count as well: an INS that realigns in a turn starts with other errors after it."""
    if not np.isin(navigation.mode[inside], (InsMode.NAVIGATE, InsMode.UNKNOWN)).all():
        raise MeasurementError(
            "the INS left navigation during the dwell or its turn. Check its status in the raw CAN log"
        )
    if len(np.unique(navigation.alignment[inside])) > 1:
        raise MeasurementError(
            "the INS reported another alignment during the dwell or its turn. Did it realign?"
        )
    if len(np.unique(navigation.segment[inside])) > 1:
        raise MeasurementError("the clock of the INS was reset during the dwell. Did it restart?")
    if not np.isfinite(navigation.attitude[inside]).all():
        raise MeasurementError(
            "the INS reported an invalid attitude during the dwell or its turn. Did it realign?"
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


def measurement_setup(station: Station) -> MeasurementSetup:
    """Decoding, kinematics and noise of a station.

    Raises DocumentError if the DBC file is wrong, or lacks signals that the station file maps.
    """
    codec = DbcCodec(station.database())
    signals = station.file.ins.signals
    limits = resolution_report(signals, codec)
    velocity_lsb_mps = max(limit.lsb for limit in limits if limit.unit == "m/s")
    heading_lsb_rad = math.radians(max(limit.lsb for limit in limits if limit.unit == "deg"))
    decode = partial(decode_navigation, signal_map=signals, codec=codec)
    return MeasurementSetup(
        decode=decode,
        table=station.table,
        noise=station.noise(velocity_lsb_mps, heading_lsb_rad),
        velocity_lsb_mps=velocity_lsb_mps,
        heading_lsb_rad=heading_lsb_rad,
        site=station.site,
        prior=station.prior(),
        gyro_temperature_c=station.file.ins.uncertainty.gyro_temperature_c,
        resolution=tuple(limits),
        signs=SignCheck(signals, decode, station.table, station.site, velocity_lsb_mps),
        decode_increments=partial(decode_increments, signal_map=signals, codec=codec),
        table_repeatability=station.file.rate_table.repeatability_arcsec * ARCSEC_TO_RAD,
        gravity_and_sigma=station.gravity_and_sigma,
    )
