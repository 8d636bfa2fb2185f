"""Settings for turning frames into biases: decoding, table, site, noise and prior knowledge of a station."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from gyrobench.bench.bias.budget import BudgetInputs
from gyrobench.bench.bias.dwell import Dwell, NavigationWindow, RestOutput, TurnPath
from gyrobench.bench.bias.noise_estimate import estimate_noise
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.parameters import ErrorModel, PriorKnowledge
from gyrobench.bench.dwells.output_checks import OutputFault, exceeds_noise, output_faults, rounding
from gyrobench.bench.dwells.setup_check import SetupEvidence, setup_evidence
from gyrobench.bench.dwells.sign_check import SignCheck
from gyrobench.bench.foundations.arrays import ARCSEC_TO_RAD
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.location import NORMAL_GRAVITY_SIGMA
from gyrobench.bench.navigation.table_axes import TwoAxisTable
from gyrobench.bench.runs.marks import WindowMark
from gyrobench.bench.station.station import Station
from gyrobench.drivers.frames import FrameBlock
from gyrobench.drivers.ins.dbc_codec import DbcCodec
from gyrobench.drivers.ins.navigation_data import (
    Increments,
    NavigationData,
    decode_increments,
    decode_navigation,
)
from gyrobench.drivers.ins.resolution import ResolutionLimit, resolution_report
from gyrobench.drivers.ins.signal_map import SignalMap


@dataclass(frozen=True)
class MeasurementSetup:
    """Settings for turning frames into biases, the same for all dwells of a run."""

    decode: Callable[[FrameBlock], NavigationData]  #: Decodes frames by the signal map of the station.
    table: TwoAxisTable  #: Kinematics of the table with the unit on it.
    site: Site  #: Location of the bench.
    noise: NoiseModel | None  #: Declared noise of the INS; None to estimate it in each dwell.
    prior: PriorKnowledge  #: Prior knowledge of the INS.
    #: velocity_lsb_mps, heading_lsb_rad: Resolution of the INS's output.
    velocity_lsb_mps: float
    heading_lsb_rad: float
    resolution: tuple[ResolutionLimit, ...]  #: Estimates that the resolution limits, and by how much.
    signs: SignCheck | None = None  #: Test of the signal map's signs and axes.
    signals: SignalMap | None = None  #: As declared; without it the rate of the INS's clock is not tested.
    gyro_temperature_c: float | None = None  #: Standard uncertainty of the gyros' temperature sensors, K.
    #: Decodes increments; gives None if none are mapped.
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
        return TurnPath.at_constant_rate(begin_s, end_s, self.table.path(*angles))

    def output_faults(self, windows: tuple[NavigationWindow, ...], noise: NoiseModel) -> list[OutputFault]:
        """Find faults of the output: changes that are impossible at rest."""
        return output_faults(windows, noise, self.site.gravity, *self._resolutions)

    def evidence(
        self, dwell: Dwell, noise: NoiseModel, faults: Sequence[OutputFault], sent_latitude: float
    ) -> SetupEvidence | None:
        """Evidence of a dwell on scale and latitude; None if faults of the output hide it.

        ``sent_latitude``: latitude by the INS, rad; NaN if it sends none.
        """
        if any(not fault.may_be_noise for fault in faults):
            return None
        is_latitude_sent = math.isfinite(sent_latitude)
        return setup_evidence(dwell, self.error_model(noise), self.heading_lsb_rad, is_latitude_sent)

    def error_model(self, noise: NoiseModel) -> ErrorModel:
        """Error model of the INS with this noise."""
        return ErrorModel(self.site, noise, self.prior)

    @property
    def budget_inputs(self) -> BudgetInputs:
        """Inputs of the uncertainty budgets."""
        velocity, heading = (step / math.sqrt(12.0) for step in self._resolutions)
        return BudgetInputs(velocity, heading, self.gyro_temperature_c)

    @property
    def _resolutions(self) -> tuple[float, float]:
        return self.velocity_lsb_mps, self.heading_lsb_rad

    def noise_in(self, windows: tuple[NavigationWindow, ...]) -> NoiseModel:
        """Noise of the INS in these windows: as declared, or estimated if undeclared or exceeded.

        Raises MeasurementError if the noise must be estimated, but is not observable in these windows.
        """
        noise = self.noise
        if noise is None:
            noise = estimate_noise(windows, self.site.gravity).noise_model()
        elif exceeds_noise(windows, noise, self.site.gravity, *self._resolutions):
            noise = estimate_noise(windows, self.site.gravity).raised_model(noise)
        return noise.at_least(*self.rounding(windows))

    def rounding(self, rests: Sequence[RestOutput]) -> tuple[float, float]:
        """See :func:`gyrobench.bench.dwells.output_checks.rounding`."""
        return rounding(rests, *self._resolutions)


def measurement_setup(station: Station) -> MeasurementSetup:
    """Make the settings from a station.

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
        signals=signals,
        signs=SignCheck(signals, decode, station.table, station.site, velocity_lsb_mps),
        decode_increments=partial(decode_increments, signal_map=signals, codec=codec),
        table_repeatability=station.file.rate_table.repeatability_arcsec * ARCSEC_TO_RAD,
        gravity_and_sigma=station.gravity_and_sigma,
    )
