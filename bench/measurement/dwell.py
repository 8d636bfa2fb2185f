"""One dwell: marks and frames in, a row of the dwell table out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.bias.dwell import BiasEstimate, Dwell, NavigationWindow
from bench.bias.dwell_table import DwellRow, Triple
from bench.bias.noise import NoiseModel
from bench.bias.paper import estimate_paper
from bench.errors import MeasurementError
from bench.measurement.marks import DwellMarks, WindowMark
from bench.navigation.table_axes import TwoAxisTable
from drivers.ins.epochs import EpochCounts
from drivers.ins.frames import FrameBlock
from drivers.ins.navigation_data import NavigationData
from drivers.ins.readout import InsMode
from drivers.ins.resolution import ResolutionLimit

#: Residuals larger than this many times the expected ones are not noise: a dwell with the noise
#: that the station declares stays below 1.4 in 95 % of all cases.
MAX_RESIDUAL_RATIO = 3.0

_NOT_MEASURED: Triple = (math.nan, math.nan, math.nan)


@dataclass(frozen=True)
class MeasurementSetup:
    """What turns frames into biases, the same for all dwells of a run.

    Attributes
    ----------
    decode : callable
        Frames to navigation data, as the station maps them.
    table : TwoAxisTable
        Kinematics of the table with the unit on it.
    noise : NoiseModel
        Declared noise of the INS.
    gravity : float
        At the bench, m/s2.
    resolution : tuple of ResolutionLimit
        Which estimates the resolution of the INS's output limits, and by how much.
    """

    decode: Callable[[FrameBlock], NavigationData]
    table: TwoAxisTable
    noise: NoiseModel
    gravity: float
    resolution: tuple[ResolutionLimit, ...]


@dataclass(frozen=True, eq=False)
class MeasuredDwell:
    """A row for the table, the estimate behind it where there is one, and how the frames came."""

    row: DwellRow
    estimate: BiasEstimate | None
    counts: EpochCounts


def measure_dwell(marks: DwellMarks, frames: FrameBlock, setup: MeasurementSetup) -> MeasuredDwell:
    """Measure the gyro biases of one dwell.

    A dwell that can't give a result gives a row without biases, flagged with the reason.
    """
    flags = list(marks.disturbances)
    estimate = None
    counts = EpochCounts()
    temperatures = _Temperatures.unknown()
    try:
        navigation = setup.decode(frames)
        counts = navigation.counts
        temperatures = _Temperatures.of(navigation, marks)
        estimate = estimate_paper(_dwell(marks, navigation, setup), setup.gravity, setup.noise)
        if estimate.residual_ratio > MAX_RESIDUAL_RATIO:
            flags.append(
                f"the fit leaves {estimate.residual_ratio:.3g} times the residual that the declared noise "
                f"leads to expect (at most {MAX_RESIDUAL_RATIO:g})"
            )
    except MeasurementError as error:
        flags.append(str(error))
    return MeasuredDwell(_row(marks, temperatures, estimate, flags), estimate, counts)


def _dwell(marks: DwellMarks, navigation: NavigationData, setup: MeasurementSetup) -> Dwell:
    if len(marks.windows) != 2:
        raise MeasurementError(
            f"{len(marks.windows)} windows of navigation; the paper's method takes two, "
            "one on each side of a turn"
        )
    before, after = (_window(navigation, mark) for mark in marks.windows)
    C_before, C_after = (setup.table.attitude(mark.outer_deg, mark.inner_deg) for mark in marks.windows)
    return Dwell(
        position_name=marks.position,
        azimuth_before_rad=math.radians(marks.azimuth_deg),
        before=before,
        after=after,
        C_nb_table_before=C_before,
        C_nb_table_after=C_after,
    )


def _window(navigation: NavigationData, mark: WindowMark) -> NavigationWindow:
    inside = (navigation.row >= mark.first_frame) & (navigation.row < mark.end_frame)
    modes = set(navigation.mode[inside].tolist())
    if not modes <= {InsMode.NAVIGATE, InsMode.UNKNOWN}:
        raise MeasurementError(
            "the INS left navigation during the dwell. Look at its status in the raw CAN log"
        )
    if len(set(navigation.segment[inside].tolist())) > 1:
        raise MeasurementError("the clock of the INS was set anew in the dwell. Did it restart?")
    velocity = navigation.velocity_enu_mps[inside].copy()
    velocity[:, 2] = np.nan_to_num(velocity[:, 2])  # not every INS sends it, and no estimate needs it
    return NavigationWindow(navigation.ins_time_s[inside], velocity, navigation.attitude[inside])


@dataclass(frozen=True)
class _Temperatures:
    gyro_c: Triple
    gyro_rate_c_per_h: Triple
    board_c: Triple
    case_c: float

    @classmethod
    def unknown(cls) -> _Temperatures:
        return cls(_NOT_MEASURED, _NOT_MEASURED, _NOT_MEASURED, math.nan)

    @classmethod
    def of(cls, navigation: NavigationData, marks: DwellMarks) -> _Temperatures:
        """Means over the dwell, and the optics' slopes."""
        series = navigation.temperatures
        first, last = marks.windows[0], marks.windows[-1]
        epochs = (navigation.row >= first.first_frame) & (navigation.row < last.end_frame)
        if not epochs.any():
            raise MeasurementError(
                "no navigation frames in the dwell. Check the CAN cable and the station's DBC"
            )
        first_s, last_s = navigation.ins_time_s[epochs][[0, -1]]
        inside = (series.ins_time_s >= first_s) & (series.ins_time_s <= last_s)
        if np.count_nonzero(inside) < 2:
            raise MeasurementError(
                "no gyro temperatures in the dwell. Check the station's temperature signals"
            )
        time_h = series.ins_time_s[inside] / 3600.0
        centred = time_h - time_h.mean()
        slopes = centred @ series.optics_c[inside] / (centred @ centred)
        return cls(
            _triple(series.optics_c[inside].mean(axis=0)),
            _triple(slopes),
            _triple(series.electronics_c[inside].mean(axis=0)),
            float(series.case_c[inside].mean()),
        )


def _row(
    marks: DwellMarks, temperatures: _Temperatures, estimate: BiasEstimate | None, flags: list[str]
) -> DwellRow:
    return DwellRow(
        unit=marks.unit,
        run=marks.run,
        dwell=marks.dwell,
        cycle=marks.cycle,
        position=marks.position,
        start_s=marks.start_s,
        end_s=marks.end_s,
        since_power_on_s=marks.since_power_on_s,
        chamber_set_c=math.nan if marks.chamber_set_c is None else marks.chamber_set_c,
        chamber_c=math.nan if marks.chamber_c is None else marks.chamber_c,
        case_c=temperatures.case_c,
        gyro_c=temperatures.gyro_c,
        gyro_rate_c_per_h=temperatures.gyro_rate_c_per_h,
        board_c=temperatures.board_c,
        bias_dph=_triple(estimate.bias_dph) if estimate else _NOT_MEASURED,
        sigma_dph=_triple(estimate.sigma_dph) if estimate else _NOT_MEASURED,
        residual_ratio=estimate.residual_ratio if estimate else math.nan,
        flags="; ".join(flags),
    )


def _triple(values: NDArray[np.float64]) -> Triple:
    x, y, z = (float(value) for value in values)
    return x, y, z
