"""What the report says of the noise of the INS."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from gyrobench.bench.bias.noise_estimate import NoiseEstimate, compare_noise
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.report.figures.noise import noise_figure
from gyrobench.bench.report.page.sections import Section, SectionFigure, SectionTable

_TEXT = (
    "Allan deviation of the rates and accelerations at rest, from the output of the INS in all good dwells. "
    "The uncertainties of the biases stand on these noises: where one is larger than declared, they are too "
    "small."
)
_ESTIMATED = "The station declares no noise: each dwell was evaluated with the noise of its own windows."
_FIGURE = (
    "Allan deviation, with the random walk that was fitted and the one that the station declares. Thin lines "
    "are all that was fitted: the random walk, steeper at the left the noise of the output, rising at the "
    "right the tilt that the gyros' random walk makes."
)


def noise_section(noise: NoiseEstimate | None, station: Mapping[str, Any]) -> Section | None:
    """Set the measured noise beside that of the station's file; None where none was measured."""
    if noise is None:
        return None
    declared = _declared(station)
    tables = []
    if declared is not None:
        rows = [
            [each.name, each.sentence.removeprefix(each.name).strip()]
            for each in compare_noise(noise, declared)
            if each.declared > 0.0
        ]
        tables = [
            SectionTable("Measured and declared", ["parameter", "measured, declared: verdict"], rows, words=2)
        ]
    return Section(
        "Noise of the INS",
        [_TEXT if declared else f"{_TEXT} {_ESTIMATED}"],
        [SectionFigure("noise", _FIGURE, noise_figure(noise, declared))],
        tables,
    )


def _declared(station: Mapping[str, Any]) -> NoiseModel | None:
    noise = station.get("ins", {}).get("noise")
    if not isinstance(noise, Mapping):
        return None
    return NoiseModel.from_datasheet(
        noise["angle_random_walk_deg_per_sqrt_h"],
        noise.get("velocity_random_walk_ug_per_sqrt_hz", 0.0),
        velocity_output_mps=noise.get("velocity_output_mps", 0.0),
        heading_output_rad=math.radians(noise.get("heading_output_deg", 0.0)),
    )
