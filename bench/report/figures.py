"""The figures of a run, and the files that they are kept in.

Each function gives a finished figure; none touches matplotlib's global state.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from bench.bias.bins import BiasBin
from bench.bias.equality import compare_positions
from bench.bias.tables.dwell_table import DwellRow
from bench.files import make_folder
from bench.navigation.positions import AXES
from bench.report.bias_figure import bias_figure
from bench.report.difference_figure import position_difference_figure
from bench.report.style import png_bytes, save_figure
from bench.report.temperature_figures import Readings, plan_figure, temperature_figure
from bench.run_store.folder import RunFolder

__all__ = [
    "bias_figure",
    "plan_figure",
    "png_bytes",
    "position_difference_figure",
    "save_figure",
    "save_figures",
    "temperature_figure",
]


def save_figures(
    folder: RunFolder, telemetry: Readings, dwells: Sequence[DwellRow], bins: Sequence[BiasBin]
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
    for name, figure in _figures(telemetry, dwells, bins):
        paths.append(folder.figures / f"{name}.png")
        save_figure(figure, paths[-1])
    return paths


def _figures(
    telemetry: Readings, dwells: Sequence[DwellRow], bins: Sequence[BiasBin]
) -> Iterator[tuple[str, Figure]]:
    if len(telemetry.get("time_s", ())) or dwells:
        yield "temperature", temperature_figure(telemetry, dwells)
    if bins or any(not row.flags for row in dwells):
        for gyro in AXES:
            yield f"bias_{gyro}", bias_figure(gyro, dwells, bins)
    comparisons = compare_positions(bins)
    if comparisons:
        yield "position_differences", position_difference_figure(comparisons)
