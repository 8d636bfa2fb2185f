"""`gyrobench raw-rate`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from gyrobench.bench.cli.options import complete_import_map


def raw_rate(
    up: Annotated[Path, typer.Argument(help="Log at rest with the axis up.")],
    down: Annotated[Path, typer.Argument(help="Log at rest with the axis down.")],
    mapping: Annotated[
        str,
        typer.Option(
            "--map",
            help="Import map with the columns of the logs: file or shipped name.",
            autocompletion=complete_import_map,
        ),
    ],
    axis: Annotated[str, typer.Option(help="Body axis that points up and down: x, y or z.")] = "x",
) -> None:
    """Estimate a gyro's bias and the Earth rate from two logs of raw rates, without navigation.

    Example: gyrobench raw-rate x_LN100_up.ins x_LN100_down.ins --map ln100 --axis x
    """
    from gyrobench.bench.bias.raw_rate import up_down_pair
    from gyrobench.bench.exchange.import_map import load_log_map
    from gyrobench.bench.exchange.log_windows import read_rate_recording
    from gyrobench.bench.foundations.arrays import RADPS_TO_DPH
    from gyrobench.bench.foundations.shipped import find_document
    from gyrobench.bench.navigation.earth import EARTH_RATE

    log_map = load_log_map(find_document("imports", mapping))
    pair = up_down_pair(read_rate_recording(up, log_map), read_rate_recording(down, log_map), axis)
    sigma_dph = pair.bias_sigma_radps * RADPS_TO_DPH
    earth = f"Earth rate, vertical   {pair.earth_radps * RADPS_TO_DPH:.4f} ± {sigma_dph:.4f} deg/h"
    if log_map.earth_rate is None:
        latitude_deg, latitude_sigma_deg = map(math.degrees, pair.latitude_rad())
        earth += f", that of latitude {latitude_deg:.3f} ± {latitude_sigma_deg:.3f} deg"
    else:
        latitude_rad = math.radians(log_map.earth_rate.latitude_deg)
        earth += (
            f"; {EARTH_RATE * math.sin(latitude_rad) * RADPS_TO_DPH:.4f} deg/h at latitude "
            f"{log_map.earth_rate.latitude_deg:g} deg ({pair.sigmas_from(latitude_rad):+.1f} sigma)"
        )
    typer.echo(
        f"Bias of the {axis} gyro     {pair.bias_radps * RADPS_TO_DPH:.4f} ± {sigma_dph:.4f} deg/h\n{earth}"
    )
