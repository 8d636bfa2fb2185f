"""Estimates the biases of the present dwell from the frames that have arrived so far."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from gyrobench.bench.bias.bias_filter import BiasFilter, StateSpaceEstimate
from gyrobench.bench.bias.dwell import RestOutput, TurnPath
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.dwells.dwell_output import rest_output
from gyrobench.bench.dwells.measurement_setup import MeasurementSetup
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.attitude import rotation_matrices
from gyrobench.bench.runs.marks import WindowMark
from gyrobench.drivers.frames import FrameBlock
from gyrobench.drivers.ins.navigation_data import NavigationData

#: Earlier frames that are decoded together with the new ones, for the status that applies to these.
_OVERLAP_FRAMES = 400
_ANY_NOISE = NoiseModel(1e-7, 1e-5, 1e-5, 1e-8)


def compile_estimator(setup: MeasurementSetup) -> None:
    """Compile the kernels that estimate a dwell, or load them from numba's cache."""
    bias_filter = BiasFilter(setup.error_model(setup.noise or _ANY_NOISE))
    time_s, attitudes = np.arange(2.0), rotation_matrices(np.outer([0.0, np.pi], [0.0, 0.0, 1.0]))
    for index, C_nb in enumerate(attitudes):
        turn = TurnPath.at_constant_rate(0.0, 1.0, attitudes) if index else None
        bias_filter.begin_window(2.0 * index, C_nb, turn)
        at_rest = np.zeros((2, 3)), np.tile(C_nb, (2, 1, 1)), np.zeros((2, 3))
        bias_filter.add(RestOutput(time_s + 2.0 * index, *at_rest))
    bias_filter.estimate(complete=True)


class LiveEstimate:
    """Biases of one dwell during its last window.

    Nothing is computed before the first turn, since no bias is observable before it. With declared noise only
    new epochs are filtered. An estimate of the noise improves during the dwell, so all epochs are filtered
    again with it.

    ``setup``: as for the complete dwell. ``frames``: gives the frames of the dwell from an index on.
    """

    def __init__(self, setup: MeasurementSetup, frames: Callable[[int], FrameBlock]) -> None:
        self._setup = setup
        self._frames = frames
        self._filter: BiasFilter | None = None
        self._begun_windows: list[WindowMark] = []
        self._next_frame = 0

    def update(self, windows: Sequence[WindowMark]) -> StateSpaceEstimate | None:
        """Add the frames since the last call, and estimate the biases.

        ``windows``: the windows so far; the last one is not complete and ends with the latest frame.
        Result: None as long as the biases are not observable, or if the data can't be used.
        """
        if len(windows) < 2:
            return None
        if self._setup.noise is None:
            self._filter, self._begun_windows, self._next_frame = None, [], 0
        try:
            first_frame = max(0, self._next_frame - _OVERLAP_FRAMES)
            navigation = self._setup.decode(self._frames(first_frame))
            if self._filter is None:
                noise = self._noise(windows, navigation)
                self._filter = BiasFilter(self._setup.error_model(noise))
            for index, mark in enumerate(windows):
                if mark.end_frame > self._next_frame:
                    self._add_new_epochs(self._filter, index, mark, navigation, first_frame)
            self._next_frame = windows[-1].end_frame
            return self._filter.estimate()
        except MeasurementError:
            return None

    def _noise(self, marks: Sequence[WindowMark], navigation: NavigationData) -> NoiseModel:
        """Declared noise, or that of all windows so far, except one that is still too short."""
        if self._setup.noise is not None:
            return self._setup.noise
        windows = [rest_output(navigation, mark).as_window() for mark in marks[:-1]]
        with suppress(MeasurementError):
            windows.append(rest_output(navigation, marks[-1]).as_window())
        return self._setup.noise_in(tuple(windows))

    def _add_new_epochs(
        self,
        bias_filter: BiasFilter,
        index: int,
        mark: WindowMark,
        navigation: NavigationData,
        first_frame: int,
    ) -> None:
        begin = max(mark.first_frame, self._next_frame)
        new = replace(mark, first_frame=begin - first_frame, end_frame=mark.end_frame - first_frame)
        rest = rest_output(navigation, new)
        if not len(rest.time_s):
            return
        if index == len(self._begun_windows):
            turn = (
                self._setup.turn(self._begun_windows[-1], mark, navigation, first_frame)
                if self._begun_windows
                else None
            )
            bias_filter.begin_window(rest.time_s[0], rest.C_nb[0], turn)
            self._begun_windows.append(mark)
        bias_filter.add(rest)
