"""Effects of the user: YAML files in folders ``effects``, each a law of the grammar with texts and bounds."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from gyrobench.bench.closure.effects.effect import Effect, Parameter, fixed
from gyrobench.bench.closure.effects.grammar import DRIVERS, EVENTS, SHAPES, Law, form_of, ins_terms
from gyrobench.bench.foundations.documents import StrictModel, read_document, validate
from gyrobench.bench.foundations.text import listed

#: Name of folders with effect files: beside a table, in a run or beside it, and in the working directory.
_FOLDER = "effects"
_STARTS = {0: 1, 1: 6, 2: 4}
#: If the ratio of the bounds is larger than this, starting values are spaced geometrically.
_WIDE = 8.0
#: Parameters that are positions on the driver's axis, not scales.
_PLACES = ("onset", "centre")

_Bounds = Annotated[list[float], Field(min_length=2, max_length=2)]


class EffectFile(StrictModel):
    """An effect that the search includes: the bias follows factor x shape(memory(driver))."""

    effect: str = Field(pattern="^[a-z0-9_]{1,60}$", description="name in closure.json")
    statement: str = Field(description="what the bias does: 'the bias follows ...', without a period")
    experiment: str = Field(description="measurement that separates it from other effects, without a period")
    label: str = Field("", description="name on pages; default: the name with spaces")
    driver: str = Field(
        description=f"what the bias follows: {listed([*DRIVERS, *EVENTS])}, or a column of the dwell table; "
        "{axis} in its name stands for the gyro"
    )
    unit: str = Field("", description="unit of a column, as in 'mA'", pattern="^[A-Za-z0-9%/]*$")
    shape: Literal["linear", "polynomial", "onset", "saturation", "resonance"] = Field(
        "linear", description="how the bias follows it"
    )
    degree: int = Field(2, ge=2, le=6, description="degree of a polynomial")
    memory: Literal["none", "lag", "play", "decay"] = Field(
        "none", description="how the past of the driver acts"
    )
    factor: Literal["none", "up", "up_x", "up_y", "up_z"] = Field(
        "none", description="component of Up in body axes that multiplies it; up: all three"
    )
    bounds: dict[str, _Bounds] = Field(
        {},
        description="lowest and highest value of each parameter, in the driver's unit: onset and width; "
        "centre and width of a saturation; centre and half_width of a resonance; play; tau_s of a lag or "
        "decay, s",
    )
    imitated_by: list[str] = Field(
        [], description="effects that may be present in its place where they can't be fitted"
    )
    contains: list[str] = Field(
        [], description="effects that are special cases of it in any campaign: it is no rival of them"
    )
    composed_from: list[str] = Field([], description="runs that the law was composed from")
    composed_from_dwells: list[str] = Field(
        [],
        description="fingerprints of the dwells that the law was composed from: it is confirmed by other "
        "held-out dwells; without them by dwells of other runs",
    )

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        names = _parameters(self.shape, self.memory)
        if set(self.bounds) != set(names):
            raise ValueError(
                f"bounds must have {listed(names) if names else 'no entry'} for {self.shape} and memory "
                f"{self.memory}; found {listed(list(self.bounds)) if self.bounds else 'none'}"
            )
        for name, (low, high) in self.bounds.items():
            if low >= high or (name not in _PLACES and low <= 0.0):
                raise ValueError(
                    f"bounds of {name}: the lowest value must be above zero and below the highest"
                )
        if self.driver in EVENTS and (self.memory, self.shape) != ("decay", "linear"):
            raise ValueError(f"{self.driver} is an event: it needs memory decay and shape linear")
        if self.driver == "constant" and self.factor == "none":
            raise ValueError("constant needs a factor: the declared model has a constant")
        return self

    def laws(self) -> dict[str, Law]:
        """Laws by the names of their forms; an onset has one form above it and one below."""
        driver = DRIVERS.get(self.driver)
        unit = driver.unit if driver else self.unit or "units"
        start_count = _STARTS.get(len(self.bounds), 3)
        parameters = tuple(
            Parameter(
                name if name == "tau_s" else f"{name}_{unit}",
                low,
                high,
                fixed(*_spaced(low, high, start_count)),
                is_place=name in _PLACES,
            )
            for name in _parameters(self.shape, self.memory)
            for low, high in [self.bounds[name]]
        )
        shapes = {"onset": ("onset above", "onset below")}.get(self.shape, (self.shape,))
        return {
            shape if len(shapes) > 1 else "": Law(
                self.driver, shape, self.memory, self.factor, self.degree, parameters
            )
            for shape in shapes
        }

    def build(self) -> Effect:
        """The effect for the search."""
        laws = self.laws()
        return Effect(
            self.effect,
            self.statement,
            self.experiment,
            tuple(form_of(law, name=name) for name, law in laws.items()),
            tuple(self.imitated_by),
            partial(ins_terms, laws),
            self.label,
            tuple(self.contains),
            composed_from=tuple(self.composed_from),
            composed_from_dwells=tuple(self.composed_from_dwells),
        )


def _parameters(shape: str, memory: str) -> tuple[str, ...]:
    shape_parameters = SHAPES["onset above" if shape == "onset" else shape].parameters
    return (*shape_parameters, *{"none": (), "play": ("play",)}.get(memory, ("tau_s",)))


def _spaced(low: float, high: float, count: int) -> list[float]:
    """Values between bounds: spaced geometrically if the bounds are far apart, otherwise linearly."""
    fractions = (np.arange(count) + 0.5) / count
    if low > 0.0 and high / low > _WIDE:
        return [float(each) for each in low * (high / low) ** fractions]
    return [float(each) for each in low + (high - low) * fractions]


def effect_folders(sources: Iterable[Path]) -> list[Path]:
    """Existing folders of effect files for tables and runs, without duplicates."""
    parents = [
        parent
        for source in sources
        for parent in ((source, source.parent) if source.is_dir() else (source.parent,))
    ]
    folders = [(parent / _FOLDER).resolve() for parent in (*parents, Path())]
    return [folder for folder in dict.fromkeys(folders) if folder.is_dir()]


def read_effects(folders: Iterable[Path]) -> list[tuple[Path, Effect]]:
    """Effects of all files in folders, with the paths of the files.

    Raises DocumentError, which lists all problems of a file with line and column.
    """
    paths = [path for folder in folders for path in sorted(folder.glob("*.yaml"))]
    return [(path, validate(read_document(path), EffectFile).build()) for path in paths]
