"""Collects what makes a dwell while it lasts, and measures it when it is over."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from bench.engine.live_bench import LiveBench
from bench.measurement.marks import DwellMarks, WindowMark


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

    def powered_on(self, time_s: float) -> None:
        """Note that the unit was switched on; a new ``run`` begins."""
        self.run += 1
        self._power_on_s = time_s

    def begin(self) -> None:
        """Begin a dwell with its alignment."""
        self.bench.begin_capture()
        self._windows.clear()

    def begin_window(self) -> None:
        """Begin a stretch of navigation at rest."""
        self._window_from = self.bench.frame_edge()
        if not self._windows:
            self._start_s = self.bench.clock.now()
        reading = self.bench.instruments.table.read()
        self._angles = self.bench.station.table_axes_of(reading.position_deg)

    def end_window(self) -> None:
        """End it."""
        self._windows.append(WindowMark(self._window_from, self.bench.frame_edge(), *self._angles))

    def marks(self) -> DwellMarks:
        """Everything about the dwell that is over."""
        capture = self.bench.capture
        chamber_c = capture.chamber_c if capture else []
        return DwellMarks(
            unit=self.unit,
            run=str(self.run),
            dwell=self.dwell,
            cycle=self.cycle,
            position=self.position,
            azimuth_deg=self.azimuth_deg,
            frames_from=capture.frames_from if capture else 0.0,
            windows=tuple(self._windows),
            start_s=round(self._start_s, 6),
            end_s=round(self.bench.clock.now(), 6),
            since_power_on_s=round(self._start_s - self._power_on_s, 6),
            chamber_set_c=self.bench.chamber_set_c,
            chamber_c=float(np.mean(chamber_c)) if chamber_c else None,
        )
