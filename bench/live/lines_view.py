"""What a person sees of a run in the terminal: a line for each dwell, and where the run is now."""

from __future__ import annotations

from rich.console import Console
from rich.padding import Padding
from rich.status import Status
from rich.text import Text

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.state_space.bias_filter import StateSpaceEstimate
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.observers import RunObserver
from gyrobench.bench.foundations.text import counted
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.procedure.plan import Plan, PlannedStep
from gyrobench.bench.procedure.steps import Chamber
from gyrobench.bench.procedure.timeline import hours_minutes

_UNITS = "Biases in 0.001 deg/h with their standard uncertainty, temperatures in degC."
_UPDATE_EVERY_TICKS = 50
_HEAD = "dwell   cycle  position gyro x    bias x        bias y        bias z     left h"
_INDENT = 8


class LinesView(RunObserver):
    """Prints each dwell as soon as it is measured; on a terminal also a line that says where it is.

    Parameters
    ----------
    console : Console
        Where to print.
    plan : Plan
        What is being run.
    has_status : bool
        Whether a terminal gets the line that says where it is.
    """

    def __init__(self, console: Console, plan: Plan, has_status: bool = True) -> None:
        self._console = console
        self._plan = plan
        self._ticks = 0
        self._left_s = plan.duration_s
        self._step = ""
        self._so_far = ""
        self._has_head = False
        self._has_status = has_status and console.is_terminal
        self._status: Status | None = None

    def __enter__(self) -> LinesView:
        self._console.print(
            f"{self._plan.procedure.procedure}: {counted(len(self._plan.steps), 'step')}, "
            f"{counted(self._plan.dwell_count, 'dwell')}, {hours_minutes(self._plan.duration_s)} h planned"
        )
        if self._has_status:
            self._status = self._console.status("starting")
            self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._status:
            self._status.stop()

    def told(self, text: str) -> None:
        """Print a message."""
        self._console.print(text, highlight=False)

    def step_started(self, planned: PlannedStep, bench: LiveBench) -> None:
        """Show the step; the chamber's are printed, with the time since the start."""
        self._step = f"{planned.label}: {planned.step.describe()}"
        self._so_far = ""
        self._ticks = 0
        if isinstance(planned.step, Chamber):
            time = hours_minutes(bench.clock.now())
            now = f"chamber {bench.readings.chamber.temperature_c:.1f} degC now"
            self._console.print(f"{time:>5s} h  {planned.step.describe()}, {now}", highlight=False)

    def ticked(self, bench: LiveBench, left_s: float) -> None:
        """Show temperatures and time left, now and then."""
        self._left_s = left_s
        self._ticks += 1
        if self._status and self._ticks % _UPDATE_EVERY_TICKS == 1:
            optics = bench.readings.ins.optics_c
            gyro = f"gyro {optics[0]:.1f} degC | " if optics[0] == optics[0] else ""
            chamber = f"chamber {bench.readings.chamber.temperature_c:.1f} degC"
            where = f"{self._so_far} | " if self._so_far else f"{chamber}, {gyro}"
            text = f"{hours_minutes(left_s)} h left | {where}{self._step}"
            self._status.update(Text(text, no_wrap=True, overflow="ellipsis"))

    def estimated(self, estimate: StateSpaceEstimate) -> None:
        """Show the biases so far with the next update."""
        pairs = zip(AXES, 1e3 * estimate.bias_dph, 1e3 * estimate.sigma_dph, strict=True)
        self._so_far = " ".join(f"{axis} {bias:+z.1f}±{sigma:.1f}" for axis, bias, sigma in pairs)

    def dwell_measured(self, row: DwellRow) -> None:
        """Print a dwell; above the first one what its numbers are, below one with flags the reason."""
        if not self._has_head:
            self._console.print(f"{_UNITS}\n{_HEAD}", highlight=False)
            self._has_head = True
        number = f"{row.dwell:3d}/{self._plan.dwell_count:<3d}"
        head = f"{number} {row.cycle:5d}  {row.position:<7s} {row.gyro_c[0]:6.1f}"
        if row.flags:
            self._console.print(f"{head}  flagged", highlight=False)
            self._console.print(Padding(Text(row.flags), (0, 0, 0, _INDENT), expand=False))
            return
        values = " ".join(
            f"{bias * 1e3:+z7.2f} ±{sigma * 1e3:<4.2f}"
            for bias, sigma in zip(row.bias_dph, row.sigma_dph, strict=True)
        )
        self._console.print(f"{head} {values} {hours_minutes(self._left_s):>6s}", highlight=False)
