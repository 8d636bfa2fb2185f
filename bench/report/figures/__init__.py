"""The figures of a run, and the files that they are kept in.

Each function gives a finished figure; none touches matplotlib's global state.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from gyrobench.bench.bias.bins import BiasBin
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.equality import compare_positions
from gyrobench.bench.bias.verdicts import Acceptance
from gyrobench.bench.foundations.files import make_folder
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.report.figures.bias import bias_figure, bias_span_dph
from gyrobench.bench.report.figures.differences import position_difference_figure
from gyrobench.bench.report.figures.temperatures import Readings, plan_figure, temperature_figure
from gyrobench.bench.report.style import png_bytes, save_figure
from gyrobench.bench.runs.folder import RunFolder

__all__ = [
    "bias_figure",
    "plan_figure",
    "png_bytes",
    "position_difference_figure",
    "run_figures",
    "save_figure",
    "save_figures",
    "temperature_figure",
]


def save_figures(
    folder: RunFolder,
    telemetry: Readings,
    dwells: Sequence[DwellRow],
    bins: Sequence[BiasBin],
    acceptance: Acceptance | None = None,
) -> list[Path]:
    """Draw everything that a run gives into its folder of figures.

    Returns
    -------
    list of Path
        Of temperature.png, bias_x.png, bias_y.png, bias_z.png and position_differences.png those
        that there are data for.

    Raises
    ------
    RunFolderError
        A file can't be written.
    """
    make_folder(folder.figures)
    paths = []
    for name, figure in run_figures(telemetry, dwells, bins, acceptance):
        paths.append(folder.figures / f"{name}.png")
        save_figure(figure, paths[-1])
    return paths


def run_figures(
    telemetry: Readings,
    dwells: Sequence[DwellRow],
    bins: Sequence[BiasBin],
    acceptance: Acceptance | None,
) -> Iterator[tuple[str, Figure]]:
    """Draw what a run gives, figure by figure, with its name."""
    if len(telemetry.get("time_s", ())) or dwells:
        yield "temperature", temperature_figure(telemetry, dwells)
    if bins or any(not row.flags for row in dwells):
        span_dph = bias_span_dph(dwells, bins)
        for gyro in AXES:
            yield f"bias_{gyro}", bias_figure(gyro, dwells, bins, span_dph)
    comparisons = compare_positions(bins)
    limits = acceptance.limits if acceptance else None
    limit_dph = limits.position_difference_dph if limits else None
    if comparisons:
        yield "position_differences", position_difference_figure(comparisons, limit_dph)
