"""The noise that a run showed, kept as ``noise.json``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from bench.bias.noise.allan import AllanVariance, RateNoise
from bench.bias.noise.estimate import ChannelNoise, NoiseEstimate
from bench.bias.tables.csv_text import read_text, write_text
from bench.errors import DocumentError


def write_noise(path: Path, noise: NoiseEstimate) -> None:
    """Write a noise estimate.

    Raises
    ------
    RunFolderError
        The file can't be written.
    """
    write_text(path, json.dumps(asdict(noise), default=lambda array: array.tolist()) + "\n")


def read_noise(path: Path) -> NoiseEstimate:
    """Read a noise estimate.

    Raises
    ------
    DocumentError
        The file can't be read or holds something else.
    """
    text = read_text(path)
    try:
        data = json.loads(text)
        x, y, z = (_channel(each) for each in data["gyros"])
        return NoiseEstimate(
            **{
                **data,
                "gyros": (x, y, z),
                "all_gyros": _channel(data["all_gyros"]),
                "acceleration": _channel(data["acceleration"]),
            }
        )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise DocumentError(f"{path}: holds no noise estimate: {error}") from error


def _channel(data: Mapping[str, Any]) -> ChannelNoise:
    fit = data["fit"] and RateNoise(**_arrays(data["fit"]))
    allan = {**_arrays(data["allan"]), "lengths": tuple(data["allan"]["lengths"])}
    return ChannelNoise(AllanVariance(**allan), data["step"], fit)


def _arrays(data: Mapping[str, Any]) -> dict[str, Any]:
    return {name: np.array(value) if isinstance(value, list) else value for name, value in data.items()}
