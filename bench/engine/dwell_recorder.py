"""Collects what makes a dwell while it lasts."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from bench.engine.live_bench import LiveBench
from bench.measurement.marks import DwellMarks, WindowMark
from bench.navigation.table_axes import Angles

#: The table's reading may differ by this much over a window, deg.
_STILL_DEG = 0.001


@dataclass
class DwellRecorder:
    """Marks of the dwell under way.

    Attributes
    ----------
    unit : str
        Serial number of the INS.
    run : int
        Counts power-ons.
    dwell, cycle : int
        Numbers of the dwell, set by the engine from the plan.
    position, azimuth_deg : str, float
        Where the table was sent last.
    """

    bench: LiveBench
    unit: str = ""
    run: int = 0
    dwell: int = 0
    cycle: int = 1
    position: str = ""
    azimuth_deg: float = 0.0
    _power_on_s: float = 0.0
    _start_s: float = 0.0
    _windows: list[WindowMark] = field(default_factory=list)
    _disturbances: list[str] = field(default_factory=list)

    def powered_on(self, time_s: float) -> None:
        """Note that the unit was switched on; a new ``run`` begins."""
        self.run += 1
        self._power_on_s = time_s

    def begin(self) -> None:
        """Begin a dwell with its alignment."""
        self.bench.begin_capture()
        self._windows.clear()
        self._disturbances.clear()
        self._azimuth_deg = self.azimuth_deg

    def begin_window(self) -> None:
        """Begin a stretch of navigation at rest."""
        self._first_frame = self.bench.captured_frames()
        if not self._windows:
            self._start_s = self.bench.clock.now()
            if self.bench.capture:
                self.bench.capture.chamber_c.clear()  # those of the alignment
        self._angles = self._table_angles()

    def end_window(self) -> None:
        """End it."""
        moved_deg = float(np.abs(np.subtract(self._table_angles(), self._angles)).max())
        if moved_deg > _STILL_DEG:
            self._disturbances.append(f"the table moved by {moved_deg:.4f} deg while the INS navigated")
        self._windows.append(WindowMark(self._first_frame, self.bench.captured_frames(), *self._angles))

    def _table_angles(self) -> Angles:
        return self.bench.station.table_axes_of(self.bench.instruments.table.read().position_deg)

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
            azimuth_deg=self._azimuth_deg,
            log_part=capture.log_part if capture else 0,
            windows=tuple(self._windows),
            start_s=round(self._start_s, 6),
            end_s=round(self.bench.clock.now(), 6),
            since_power_on_s=round(self._start_s - self._power_on_s, 6),
            chamber_set_c=self.bench.chamber_set_c,
            chamber_c=float(np.mean(chamber_c)) if chamber_c else None,
            disturbances=tuple(self._disturbances),
        )
