"""The noise estimate of a run as ``noise.json``: a summary, and the data that it is computed from."""

from __future__ import annotations

import json
import re
from collections.abc import Sized
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field, model_validator

from gyrobench.bench.bias.allan import AllanVariance, RateNoise
from gyrobench.bench.bias.noise_estimate import ChannelNoise, NoiseEstimate, NoiseParameter
from gyrobench.bench.foundations.arrays import DEG_PER_SQRT_H_TO_SI, UG_PER_SQRT_HZ_TO_SI
from gyrobench.bench.foundations.csv_tables import read_text, write_text
from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.files import parse_json
from gyrobench.bench.navigation.positions import AXES

_UNITS = "SI (rad, m/s, s), but for the summary, whose names say the unit; below: limit with 95 % confidence"
_TermValues = Annotated[list[float], Field(min_length=3, max_length=3)]
#: Key in the file of :attr:`gyrobench.bench.bias.allan.RateNoise.excess`.
_EXCESS_KEY = "misfit"
#: An array of plain numbers, which is written in one line.
_ARRAY = re.compile(r"\[[^][{}]*\]")


def write_noise(path: Path, noise: NoiseEstimate) -> None:
    """Write a noise estimate. Raises RunFolderError if the file can't be written."""
    data = {"units": _UNITS, "summary": _summary(noise), **asdict(noise, dict_factory=_rename_excess)}
    text = json.dumps(data, indent=1, default=lambda array: array.tolist())
    write_text(path, _ARRAY.sub(lambda array: " ".join(array[0].split()), text) + "\n")


def read_noise(path: Path) -> NoiseEstimate:
    """Read a noise estimate. Raises DocumentError if the file can't be read or holds something else."""
    text = read_text(path)
    try:
        data = _NoiseFile.model_validate(parse_json(text))
    except ValueError as error:
        raise DocumentError(f"{path}: holds no noise estimate: {error}") from error
    x, y, z = map(_channel, data.gyros)
    return NoiseEstimate(
        gyros=(x, y, z),
        all_gyros=_channel(data.all_gyros),
        heading=_channel(data.heading),
        acceleration=_channel(data.acceleration),
        gravity=data.gravity,
        duration_s=data.duration_s,
    )


def _rename_excess(items: list[tuple[str, Any]]) -> dict[str, Any]:
    return {_EXCESS_KEY if name == "excess" else name: value for name, value in items}


class _NoiseRecord(StrictModel):
    """Part of the file; measured numbers may be infinite or NaN."""

    model_config = ConfigDict(allow_inf_nan=True)


def _positive(value: float) -> float:
    if value <= 0.0:
        raise ValueError("must be above zero")
    return value


def _not_negative(value: float) -> float:
    if value < 0.0:
        raise ValueError("must not be below zero")
    return value


#: As pydantic's own limits, but NaN is valid.
_Positive = Annotated[float, AfterValidator(_positive)]
_NotNegative = Annotated[float, AfterValidator(_not_negative)]


class _Allan(_NoiseRecord):
    interval_s: float = Field(gt=0.0)
    factors: list[Annotated[int, Field(ge=1, lt=2**53)]]
    variance: list[_NotNegative]
    counts: list[Annotated[int, Field(ge=0, lt=2**53)]]
    lengths: list[Annotated[int, Field(ge=0, lt=2**53)]]


class _Fit(_NoiseRecord):
    terms: _TermValues
    unbounded: _TermValues
    covariance: Annotated[list[_TermValues], Field(min_length=3, max_length=3)]
    expected: list[_NotNegative]
    used: list[bool]
    edf: list[_Positive]
    excess: float = Field(validation_alias=_EXCESS_KEY)

    @model_validator(mode="after")
    def _check_variances(self) -> Self:
        for index, row in enumerate(self.covariance):
            _not_negative(row[index])
        return self


class _Channel(_NoiseRecord):
    allan: _Allan
    step: _NotNegative
    fit: _Fit | None

    @model_validator(mode="after")
    def _check_lengths(self) -> Self:
        lists: list[Sized] = [self.allan.variance, self.allan.counts]
        if self.fit is not None:
            lists += [self.fit.expected, self.fit.used, self.fit.edf]
        if any(len(each) != len(self.allan.factors) for each in lists):
            raise ValueError("every averaging time needs one value of each kind")
        return self


class _NoiseFile(_NoiseRecord):
    units: str
    summary: dict[str, Any]
    gyros: Annotated[list[_Channel], Field(min_length=3, max_length=3)]
    all_gyros: _Channel
    heading: _Channel
    acceleration: _Channel
    gravity: float
    duration_s: float


def _summary(noise: NoiseEstimate) -> dict[str, dict[str, float | bool | None]]:
    arw, arw_si = "angle_random_walk{}_deg_per_sqrt_h", DEG_PER_SQRT_H_TO_SI
    rows = [
        *(
            (arw.format(f"_{axis}"), arw_si, each)
            for axis, each in zip(AXES, noise.angle_random_walks, strict=True)
        ),
        (arw.format(""), arw_si, noise.angle_random_walk),
        (arw.format("_by_velocities"), arw_si, noise.angle_random_walk_of_tilt),
        ("velocity_random_walk_ug_per_sqrt_hz", UG_PER_SQRT_HZ_TO_SI, noise.velocity_random_walk),
        ("velocity_output_mps", 1.0, noise.velocity_white),
        ("heading_output_urad", 1e-6, noise.heading_white),
    ]
    return {name: _summary_entry(parameter, unit_si) for name, unit_si, parameter in rows}


def _summary_entry(parameter: NoiseParameter, unit_si: float) -> dict[str, float | bool | None]:
    """Value and sigma, or the upper limit if the value is not significant or hidden by the resolution."""
    if parameter.value is not None and parameter.sigma is not None:
        return {"value": _rounded(parameter.value / unit_si), "sigma": _rounded(parameter.sigma / unit_si)}
    limit = None if parameter.limit is None else _rounded(parameter.limit / unit_si)
    return {"below": limit, "hidden_by_resolution": parameter.square is None}


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")


def _channel(data: _Channel) -> ChannelNoise:
    fit = None if data.fit is None else RateNoise(**_arrays(data.fit))
    allan = {**_arrays(data.allan), "lengths": tuple(data.allan.lengths)}
    return ChannelNoise(AllanVariance(**allan), data.step, fit)


def _arrays(data: _NoiseRecord) -> dict[str, Any]:
    return {name: np.array(value) if isinstance(value, list) else value for name, value in data}
