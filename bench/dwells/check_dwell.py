"""One dwell of a calibration check: an alignment, and the navigation straight after it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from gyrobench.bench.bias.bias_filter import navigation_fit
from gyrobench.bench.bias.dwell import Dwell
from gyrobench.bench.bias.dwell_table import NOT_MEASURED
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.window_filter import EPOCH_S
from gyrobench.bench.dwells.dwell_output import check_signal_map, decoded_navigation, dwell_at_rest
from gyrobench.bench.dwells.measure_dwell import MIN_FIT_P_VALUE, lack_of_fit_text
from gyrobench.bench.dwells.measurement_setup import MeasurementSetup
from gyrobench.bench.dwells.setup_check import raise_setup_fault
from gyrobench.bench.dwells.temperatures import DwellTemperatures, dwell_temperatures
from gyrobench.bench.foundations.arrays import Triple
from gyrobench.bench.foundations.errors import MeasurementError, SignalMapError
from gyrobench.bench.runs.marks import DwellMarks
from gyrobench.drivers.frames import FrameBlock
from gyrobench.drivers.ins.navigation_data import EpochCounts, NavigationData


@dataclass(frozen=True, eq=False)
class AlignedNavigation:
    """Navigation straight from an alignment, and the noise of the INS in it."""

    dwell: Dwell  #: An epoch a second.
    noise: NoiseModel  #: Declared, or as estimated from all epochs.


@dataclass(frozen=True, eq=False)
class CheckDwell:
    """An alignment, and the navigation straight after it."""

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
    flags = list(marks.disturbances)
    navigation, counts = None, EpochCounts()
    temperatures, aligning_c, setup_fault = DwellTemperatures(), NOT_MEASURED, ""
    are_signs_tested = False
    try:
        data, decoding_flags = decoded_navigation(marks, frames, setup)
        flags += decoding_flags
        are_signs_tested = check_signal_map(marks, frames, data, setup)
        counts = data.counts
        temperatures = dwell_temperatures(data, *marks.span)
        aligning_c = _aligning_c(data, marks.span[0], temperatures)
        dwell = dwell_at_rest(marks, data, setup)
        navigation = _navigation(dwell, setup)
        faults = setup.output_faults(dwell.windows, navigation.noise)
        if not flags:
            raise_setup_fault(setup.evidence(dwell, navigation.noise, faults))
        flags += [fault.text for fault in faults]
        (window,) = navigation.dwell.windows
        fit = navigation_fit(window, setup.site, navigation.noise, setup.prior)
        if fit.p_value < MIN_FIT_P_VALUE:
            flags.append(lack_of_fit_text(fit))
    except MeasurementError as error:
        flags.append(str(error))
        setup_fault = str(error) if isinstance(error, SignalMapError) else ""
    return CheckDwell(
        marks, navigation, temperatures, aligning_c, counts, tuple(flags), setup_fault, are_signs_tested
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
