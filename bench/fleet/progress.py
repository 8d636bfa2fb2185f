"""How far a fleet is: a bar on a terminal, a line for each run elsewhere."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from gyrobench.bench.fleet.jobs import JobResult, JobState


class FleetProgress:
    """Shows results as they come; a context manager.

    Parameters
    ----------
    console : Console
        Where to show them.
    total : int
        Number of runs to come.
    """

    def __init__(self, console: Console, total: int) -> None:
        self._console = console
        self._total = total
        self._done = self._failed = 0
        self._bar = Progress(
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            TextColumn("{task.description}"),
            TimeRemainingColumn(compact=True),
            TextColumn("left"),
            console=console,
            transient=True,
        )
        self._task = self._bar.add_task("starting workers", total=total)

    def __enter__(self) -> FleetProgress:
        if self._console.is_terminal:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def advance(self, result: JobResult) -> None:
        """Show one more result."""
        self._done += 1
        self._failed += result.state != JobState.DONE
        if self._console.is_terminal:
            text = f"{self._failed} not done" if self._failed else "runs"
            self._bar.update(self._task, advance=1, description=text)
            return
        number = f"{self._done:>{len(str(self._total))}}/{self._total}"
        text = result.text if result.state == JobState.DONE else result.state.value
        self._console.print(
            f"{number} {Path(result.path).name}: {text}, {result.took_s:.1f} s", soft_wrap=True
        )
