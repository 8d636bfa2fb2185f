"""The steps of a procedure in order, with loops and variables taken out."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from gyrobench.bench.foundations.documents import Document, Location, Problem, problems_of
from gyrobench.bench.procedure.document import (
    Procedure,
    Repeat,
    StepTemplate,
    Value,
    entry_location,
    variable_in,
)
from gyrobench.bench.procedure.step import Step

MAX_STEPS = 100_000


@dataclass(frozen=True)
class _Bound:
    """The value of a loop variable, and where it stands."""

    value: Value
    place: Location


@dataclass(frozen=True)
class ResolvedStep:
    """A step without loops and variables.

    Attributes
    ----------
    location : Location
        Where the keys of the step stand in the procedure file.
    step : Step
        What to do.
    cycle : int or None
        Loop variable ``cycle``, where there is one.
    value_places : mapping
        Where the values stand that came from loop variables, by the keys that lead to them.
    """

    location: Location
    step: Step
    cycle: int | None
    value_places: Mapping[Location, Location]


def resolve(document: Document, procedure: Procedure) -> list[ResolvedStep]:
    """Unroll the loops of a procedure and put the values in place of the variables.

    Raises
    ------
    DocumentError
        The loops give too many steps, or a variable has a value that its step can't take.
    """
    _refuse_too_many(document, procedure.steps)
    problems: list[Problem] = []
    steps = list(_resolve(procedure.steps, ("steps",), {}, problems))
    if problems:
        raise document.error(problems)
    return steps


def _refuse_too_many(document: Document, entries: Sequence[StepTemplate | Repeat]) -> None:
    count = _count(entries)
    if count > MAX_STEPS:
        worst = max(range(len(entries)), key=lambda index: _count(entries[index : index + 1]))
        message = f"the loops make {count} steps of this procedure; at most {MAX_STEPS} are allowed"
        raise document.error([Problem(("steps", worst), message)])


def _count(entries: Sequence[StepTemplate | Repeat]) -> int:
    return sum(
        math.prod(map(len, entry.over.values())) * _count(entry.steps) if isinstance(entry, Repeat) else 1
        for entry in entries
    )


def _resolve(
    entries: Sequence[StepTemplate | Repeat],
    at: Location,
    scope: Mapping[str, _Bound],
    problems: list[Problem],
) -> Iterator[ResolvedStep]:
    for index, entry in enumerate(entries):
        here = entry_location(entry, (*at, index))
        if isinstance(entry, Repeat):
            for values in _combinations(entry, (*here, "over")):
                yield from _resolve(entry.steps, (*here, "steps"), {**scope, **values}, problems)
            continue
        try:
            yield _step(entry, here, scope)
        except ValidationError as error:
            problems += _traced(error, entry, here, scope)


def _combinations(loop: Repeat, at: Location) -> Iterator[dict[str, _Bound]]:
    bound = [
        [_Bound(value, (*at, name, index)) for index, value in enumerate(values)]
        for name, values in loop.over.items()
    ]
    for values in itertools.product(*bound):
        yield dict(zip(loop.over, values, strict=True))


def _step(entry: StepTemplate, at: Location, scope: Mapping[str, _Bound]) -> ResolvedStep:
    step = entry.kind.model_validate(_filled(entry.values, scope))
    cycle = int(scope["cycle"].value) if "cycle" in scope else None
    places = {keys: scope[name].place for keys, name in entry.variables().items()}
    return ResolvedStep(at, step, cycle, places)


def _filled(value: Any, scope: Mapping[str, _Bound]) -> Any:
    """Put the values in place of the variables."""
    if isinstance(value, Mapping):
        return {key: _filled(inner, scope) for key, inner in value.items()}
    name = variable_in(value)
    return value if name is None else scope[name].value


def _traced(
    error: ValidationError, entry: StepTemplate, at: Location, scope: Mapping[str, _Bound]
) -> Iterator[Problem]:
    """Put problems of a value that came from a loop where the value stands."""
    variables = entry.variables()
    for problem in problems_of(error):
        keys = next((keys for keys in variables if keys == problem.location[: len(keys)]), None)
        if keys:
            place = scope[variables[keys]].place
            yield Problem(place, f"{problem.message} (for {keys[-1]} of {entry.kind.name})")
        else:
            yield Problem((*at, *problem.location), problem.message)
