"""The estimate of the dwell under way, from the frames that are there so far."""

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

#: Frames before the new ones that are decoded with them, for the status that they belong to.
_OVERLAP = 400
_ANY_NOISE = NoiseModel(1e-7, 1e-5, 1e-5, 1e-8)


def compile_estimator(setup: MeasurementSetup) -> None:
    """Compile what the estimates of a dwell need, or load it from numba's cache."""
    bias_filter = BiasFilter(setup.site, setup.noise or _ANY_NOISE, setup.prior)
    time_s, turned = np.arange(2.0), rotation_matrices(np.outer([0.0, np.pi], [0.0, 0.0, 1.0]))
    for number, C_nb in enumerate(turned):
        turn = TurnPath.steady(0.0, 1.0, turned) if number else None
        bias_filter.begin_window(2.0 * number, C_nb, turn)
        at_rest = np.zeros((2, 3)), np.tile(C_nb, (2, 1, 1)), np.zeros((2, 3))
        bias_filter.add(RestOutput(time_s + 2.0 * number, *at_rest))
    bias_filter.estimate(complete=True)


class LiveEstimate:
    """Biases of one dwell during its last window.

    Nothing is done before the first turn, since no bias is observable before it. With declared noise only
    new epochs are filtered; an estimate of the noise improves with the dwell, so all are filtered again.

    ``setup``: as for the dwell as a whole. ``frames``: the frames of the dwell from a number on.
    """

    def __init__(self, setup: MeasurementSetup, frames: Callable[[int], FrameBlock]) -> None:
        self._setup = setup
        self._frames = frames
        self._filter: BiasFilter | None = None
        self._begun: list[WindowMark] = []
        self._next_frame = 0

    def update(self, windows: Sequence[WindowMark]) -> StateSpaceEstimate | None:
        """Take what has come since the last call.

        ``windows``: the windows so far; the last one is under way and ends with the last frame that has come.
        Result: None as long as the biases are not observable, or where the data can't be used.
        """
        if len(windows) < 2:
            return None
        if self._setup.noise is None:
            self._filter, self._begun, self._next_frame = None, [], 0
        try:
            navigation, first_frame = self._decoded()
            if self._filter is None:
                self._filter = BiasFilter(
                    self._setup.site, self._noise(windows, navigation), self._setup.prior
                )
            for number, mark in enumerate(windows):
                if mark.end_frame > self._next_frame:
                    self._take(self._filter, number, mark, navigation, first_frame)
            self._next_frame = windows[-1].end_frame
            return self._filter.estimate()
        except MeasurementError:
            return None

    def _decoded(self) -> tuple[NavigationData, int]:
        first_frame = max(0, self._next_frame - _OVERLAP)
        return self._setup.decode(self._frames(first_frame)), first_frame

    def _noise(self, marks: Sequence[WindowMark], navigation: NavigationData) -> NoiseModel:
        """Declared, or that of all windows so far but for one that has only just begun."""
        if self._setup.noise is not None:
            return self._setup.noise
        windows = [rest_output(navigation, mark).checked() for mark in marks[:-1]]
        with suppress(MeasurementError):
            windows.append(rest_output(navigation, marks[-1]).checked())
        return self._setup.noise_in(tuple(windows))

    def _take(
        self,
        bias_filter: BiasFilter,
        number: int,
        mark: WindowMark,
        navigation: NavigationData,
        first_frame: int,
    ) -> None:
        begin = max(mark.first_frame, self._next_frame)
        new = replace(mark, first_frame=begin - first_frame, end_frame=mark.end_frame - first_frame)
        rest = rest_output(navigation, new)
        if not len(rest.time_s):
            return
        if number == len(self._begun):
            turn = self._setup.turn(self._begun[-1], mark, navigation, first_frame) if self._begun else None
            bias_filter.begin_window(rest.time_s[0], rest.C_nb[0], turn)
            self._begun.append(mark)
        bias_filter.add(rest)
