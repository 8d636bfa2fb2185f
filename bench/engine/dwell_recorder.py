"""Collects what makes a dwell while it lasts."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gyrobench.bench.bias.bias_filter import StateSpaceEstimate
from gyrobench.bench.dwells.dwell import MeasurementSetup
from gyrobench.bench.dwells.live import LiveEstimate
from gyrobench.bench.dwells.marks import DwellMarks, WindowMark
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.navigation.table_axes import Angles
from gyrobench.drivers.ins.can_bus import FrameBlock

#: One reading of the table may differ by this much from that at the window's begin, deg.
_STILL_DEG = 0.001
#: A creep of this size from the first third of a window's readings to the last moves a bias by sigmas.
_CREEP_DEG = 1e-4
#: Standard deviations of the readings' scatter that a creep has to exceed as well.
_CREEP_SIGMAS = 5.0


@dataclass
class DwellRecorder:
    """Marks of the dwell under way.

    Attributes
    ----------
    setup : MeasurementSetup
        What turns frames into biases.
    unit : str
        Serial number of the INS.
    run : int
        Counts power-ons.
    dwell, cycle : int
        Numbers of the dwell, set by the engine from the plan.
    is_verification : bool
        Whether the dwell verifies a calibration; set by the engine from the plan.
    position, azimuth_deg : str, float
        Where the table was sent last.
    """

    bench: LiveBench
    setup: MeasurementSetup
    unit: str = ""
    run: int = 0
    dwell: int = 0
    cycle: int = 1
    is_verification: bool = False
    position: str = ""
    azimuth_deg: float = 0.0
    _power_on_s: float = 0.0
    _align_begin_s: float = 0.0
    _start_s: float = 0.0
    _begun_at_deg: float = 0.0
    _first_frame: int = 0
    _angles: Angles = (0.0, 0.0)
    _turn: tuple[int | None, int | None] = (None, None)
    _windows: list[WindowMark] = field(default_factory=list)
    _disturbances: list[str] = field(default_factory=list)
    _live: LiveEstimate | None = None

    def powered_on(self, time_s: float) -> None:
        """Note that the unit was switched on; a new ``run`` begins."""
        self.run += 1
        self._power_on_s = time_s

    def begin(self) -> None:
        """Begin a dwell with its alignment."""
        self.bench.begin_capture()
        self._align_begin_s = self.bench.clock.now()
        self._windows.clear()
        self._disturbances.clear()
        self._turn = (None, None)
        self._begun_at_deg = self.azimuth_deg
        self._live = LiveEstimate(self.setup, self._frames)

    def begin_window(self) -> None:
        """Begin a stretch of navigation at rest."""
        self._first_frame = self.bench.captured_frames()
        if not self._windows:
            self._start_s = self.bench.clock.now()
            if self.bench.capture:
                self.bench.capture.chamber_c.clear()  # those of the alignment
        self._angles = self.bench.table_angles()
        if self.bench.capture:
            self.bench.capture.table_deg.clear()

    def end_window(self) -> None:
        """End it."""
        read_deg = [*(self.bench.capture.table_deg if self.bench.capture else ()), self.bench.table_angles()]
        moved_deg = float(np.abs(np.subtract(read_deg, self._angles)).max())
        if moved_deg > _STILL_DEG:
            self.disturb(f"the table moved by {moved_deg:.4f} deg while the INS navigated")
        elif (creep_deg := _creep_deg(np.array(read_deg))) > _CREEP_DEG:
            self.disturb(f"the table crept by {creep_deg:.5f} deg while the INS navigated")
        self._windows.append(self._window())
        self._turn = (None, None)

    def begin_turn(self) -> None:
        """Begin a turn."""
        if self._turn[0] is None:
            self._turn = (self.bench.captured_frames(), None)

    def end_turn(self) -> None:
        """End it: the table has come to rest."""
        self._turn = (self._turn[0], self.bench.captured_frames())

    @property
    def has_window(self) -> bool:
        """Whether the INS has navigated in this dwell."""
        return bool(self._windows)

    def estimate_so_far(self) -> StateSpaceEstimate | None:
        """Estimate the biases while a window goes on; None as long as they can't be told."""
        return self._live.update([*self._windows, self._window()]) if self._live else None

    def _window(self) -> WindowMark:
        return WindowMark(self._first_frame, self.bench.captured_frames(), *self._angles, *self._turn)

    def _frames(self, first: int) -> FrameBlock:
        capture = self.bench.capture
        return capture.frames(first) if capture else FrameBlock.from_messages([])

    def disturb(self, text: str) -> None:
        """Note that something went wrong in the dwell under way, which keeps it out of the bins."""
        if text not in self._disturbances:
            self._disturbances.append(text)

    def marks(self) -> DwellMarks:
        """Everything about the dwell that is over."""
        capture = self.bench.capture
        chamber_c = capture.chamber_c if capture else []
        return DwellMarks(
            unit=self.unit,
            run=f"{self.bench.clock.epoch:%Y%m%dT%H%M%S}-{self.run}",
            dwell=self.dwell,
            cycle=self.cycle,
            position=self.position,
            azimuth_deg=self._begun_at_deg,
            log_part=capture.log_part if capture else 0,
            windows=tuple(self._windows),
            start_s=round(self._start_s, 6),
            end_s=round(self.bench.clock.now(), 6),
            since_power_on_s=round(self._start_s - self._power_on_s, 6),
            chamber_set_c=self.bench.commanded_c,
            chamber_c=float(np.mean(chamber_c)) if chamber_c else None,
            is_verification=self.is_verification,
            align_s=round(self._start_s - self._align_begin_s, 6),
            disturbances=tuple(self._disturbances),
        )


def _creep_deg(read_deg: FloatArray) -> float:
    """How far readings in the order of time, shape (n, 2), creep beyond their own scatter; else zero."""
    count = len(read_deg) // 3
    if count == 0:
        return 0.0
    first, last = read_deg[:count], read_deg[-count:]
    creep_deg = np.abs(last.mean(axis=0) - first.mean(axis=0))
    scatter_deg = np.sqrt((first.var(axis=0) + last.var(axis=0)) / count)
    return float(np.where(creep_deg > _CREEP_SIGMAS * scatter_deg, creep_deg, 0.0).max())
