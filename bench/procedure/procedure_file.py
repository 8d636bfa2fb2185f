"""Reads a procedure's YAML file, checks it step by step and unrolls its loops.

The file has loops (``repeat``) and variables (``$name``), which :func:`resolve` replaces. A step is checked
with the values in the file; a value that is a variable is checked when the loops are unrolled.
"""

from __future__ import annotations

import difflib
import itertools
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, PlainValidator, ValidationError
from pydantic_core import ErrorDetails, InitErrorDetails, PydanticCustomError

from gyrobench.bench.bias.verdicts import AcceptanceLimits
from gyrobench.bench.characteristics.requested_tests import CharacteristicTests
from gyrobench.bench.foundations.documents import (
    Document,
    DocumentProblem,
    StrictModel,
    problems_of,
    read_document,
    validate,
)
from gyrobench.bench.foundations.text import did_you_mean
from gyrobench.bench.foundations.yaml_nodes import KeyPath
from gyrobench.bench.procedure.rotation_steps import Rotate, Spin
from gyrobench.bench.procedure.steps import (
    Align,
    AskOperator,
    Celsius,
    ChamberOff,
    GoTo,
    Navigate,
    PowerOff,
    PowerOn,
    SetChamber,
    Soak,
    Step,
    Turn,
    Until,
    Wait,
)

#: A value that a loop variable can take.
Value = float | int | str

#: Every kind of step by its name in procedure files.
STEP_KINDS: Mapping[str, type[Step]] = {
    kind.name: kind
    for kind in (
        PowerOn, PowerOff, SetChamber, ChamberOff, Soak, GoTo, Align, Navigate, Turn, Rotate, Spin, Wait,
        AskOperator,
    )
}  # fmt: skip

#: Pattern of a reference to a loop variable.
VARIABLE_PATTERN = r"\$([a-z][a-z0-9_]*)"

_VARIABLE = re.compile(VARIABLE_PATTERN)
_ALLOWED_STEPS = (*STEP_KINDS, "repeat")
#: Similarity (difflib) above which the name of an unused variable counts as mistyped.
_MISTYPED_SIMILARITY = 0.8
_MODELS: tuple[type[StrictModel], ...] = (*STEP_KINDS.values(), Until)
_STEP_KEYS = frozenset(key for model in _MODELS for key in model.model_fields)


@dataclass(frozen=True)
class StepTemplate:
    """A step as written: its kind and its keys, with variables not yet replaced."""

    kind: type[Step]
    values: Mapping[str, Any]

    def variables(self) -> dict[KeyPath, str]:
        """Names of the variables by key path, such as ``("until", "bias_sigma_below_dph")``."""
        return dict(_variables_in(self.values, ()))


def _checked_value(value: Any) -> Value:
    if variable_in(value) is not None:
        raise ValueError("a loop needs values, not other variables")
    if isinstance(value, str) or (isinstance(value, int) and not isinstance(value, bool)):
        return value
    if isinstance(value, float) and math.isfinite(value):
        return value
    raise ValueError("expected a number or text")


def _checked_variable(name: Any) -> Any:
    """Return the name; raises ValueError if a variable can't have it."""
    if isinstance(name, str) and re.fullmatch("[a-z][a-z0-9_]*", name):
        return name
    raise ValueError("the name of a variable has lower-case letters, digits and underscores")


class Repeat(StrictModel):
    """Steps performed once for each combination of values; the first variable is the outermost loop."""

    over: dict[
        Annotated[str, Field(pattern="^[a-z][a-z0-9_]*$"), BeforeValidator(_checked_variable)],
        Annotated[list[Annotated[Value, PlainValidator(_checked_value)]], Field(min_length=1)],
    ] = Field(min_length=1, description="values of each loop variable")
    steps: list[_Entry] = Field(min_length=1, description="steps to repeat for each combination of values")


class Procedure(StrictModel):
    """A procedure file."""

    renamed_keys: ClassVar[Mapping[str, str]] = {
        "most_repeats": "max_repeats",
        "most_repeats_in_all": "max_repeats_total",
    }

    procedure: str = Field(
        pattern="^[A-Za-z0-9_-]{1,80}$", description="name: letters, digits, underscore, hyphen"
    )
    description: str = Field(default="", description="what it measures")
    assumptions: list[str] = Field(
        default=[], description="what the source does not state and was chosen here"
    )
    bin_width_c: float = Field(default=5.0, ge=0.1, le=100.0, description="width of a temperature bin, degC")
    marked_temperatures_c: list[Celsius] = Field(
        default=[],
        max_length=10,
        description="gyro temperatures that figures mark with a line, degC, such as the onset of an effect",
    )
    acceptance: AcceptanceLimits | None = Field(
        default=None, description="limits of the gyros; without them the unit is not judged"
    )
    tests: CharacteristicTests = Field(
        default=CharacteristicTests(),
        description="characteristics to determine from the dwells, beyond biases",
    )
    disturbed_dwell: Literal["repeat", "flag"] = Field(
        default="repeat", description="what to do with a dwell that a fault disturbed"
    )
    max_repeats: int = Field(
        default=2, ge=0, le=20, description="how often a disturbed dwell is repeated before it is flagged"
    )
    max_repeats_total: int = Field(
        default=12, ge=0, le=10_000, description="how many dwells are repeated in the whole run"
    )
    steps: list[_Entry] = Field(min_length=1, description="steps in order")


def _checked_entry(entry: Any) -> StepTemplate | Repeat:
    """Turn ``{name: {key: value}}`` or a bare name into a template or a loop."""
    if isinstance(entry, str):
        entry = {entry: None}
    if not isinstance(entry, dict) or len(entry) != 1:
        raise ValueError("expected one step, written as 'name: {key: value, ...}'")
    [(name, values)] = entry.items()
    if name not in _ALLOWED_STEPS:
        step = name.partition(" {")[0]
        if step in _ALLOWED_STEPS:  # align {duration_s: 300}
            raise PydanticCustomError(
                "unknown_key", f"no colon after '{step}'. Write '{step}: {{key: value, ...}}'"
            )
        allowed = ", ".join(_ALLOWED_STEPS)
        message = (
            f"unknown step {json.dumps(name)}{did_you_mean(name, _ALLOWED_STEPS)}; allowed here: {allowed}"
        )
        raise PydanticCustomError("unknown_key", message)
    if values is not None and not isinstance(values, dict):
        raise ValueError(f"expected the keys of '{name}', written as 'key: value'")
    if name != "repeat":
        return _parse_step(STEP_KINDS[name], values or {})
    try:
        return Repeat.model_validate(values or {})
    except ValidationError as error:
        raise _error_under_key("repeat", error.errors()) from error


def _parse_step(kind: type[Step], values: dict[str, Any]) -> StepTemplate:
    try:
        kind.model_validate(values)
    except ValidationError as error:
        details = [
            detail
            for detail in error.errors()
            if detail["type"] == "unknown_key" or variable_in(detail["input"]) is None
        ]
        if details:
            raise _error_under_key(kind.name, details) from error
    return StepTemplate(kind, values)


def _error_under_key(key: str, details: Sequence[ErrorDetails]) -> ValidationError:
    """Return the errors of a value with its key prepended to their locations."""
    lines = [
        InitErrorDetails(
            type=PydanticCustomError(detail["type"], detail["msg"]),
            loc=(key, *detail["loc"]),
            input=detail["input"],
        )
        for detail in details
    ]
    return ValidationError.from_exception_data(key, lines)


_Entry = Annotated[StepTemplate | Repeat, PlainValidator(_checked_entry)]
Repeat.model_rebuild()
Procedure.model_rebuild()


def load_procedure(path: Path) -> tuple[Document, Procedure]:
    """Read a procedure file and check it without unrolling its loops; a DocumentError lists all problems."""
    document = read_document(path)
    return document, checked_procedure(document)


def checked_procedure(document: Document) -> Procedure:
    """Turn a document into a procedure; see :func:`load_procedure`."""
    procedure = validate(document, Procedure)
    problems = [*_scope_problems(procedure.steps, ("steps",), ())]
    if problems:
        if _count_steps(procedure.steps) <= MAX_STEPS:
            further: list[DocumentProblem] = []
            list(_resolve(procedure.steps, ("steps",), {}, {}, further))
            problems += further
        raise document.error(problems)
    return procedure


def variable_in(value: Any) -> str | None:
    """Name of the variable that a value refers to, if any."""
    match = _VARIABLE.fullmatch(value) if isinstance(value, str) else None
    return match[1] if match else None


def _entry_location(entry: StepTemplate | Repeat, path: KeyPath) -> KeyPath:
    """Path of the keys of the entry at ``path``."""
    return (*path, "repeat" if isinstance(entry, Repeat) else entry.kind.name)


def _scope_problems(
    entries: Sequence[StepTemplate | Repeat], path: KeyPath, scope: tuple[str, ...]
) -> Iterator[DocumentProblem]:
    for index, entry in enumerate(entries):
        entry_path = _entry_location(entry, (*path, index))
        if isinstance(entry, Repeat):
            yield from _loop_problems(entry, (*entry_path, "over"), scope)
            yield from _scope_problems(entry.steps, (*entry_path, "steps"), (*scope, *entry.over))
            continue
        for keys, name in entry.variables().items():
            if name not in scope:
                defined = ", ".join(f"${known}" for known in scope) or "none"
                yield DocumentProblem(
                    (*entry_path, *keys),
                    f"no variable ${name}{did_you_mean(name, scope)}; defined here: {defined}",
                )


def _loop_problems(loop: Repeat, path: KeyPath, scope: tuple[str, ...]) -> Iterator[DocumentProblem]:
    used = _free_variables(loop.steps)
    # An undefined variable is reported at its step; it may be a mistyped name of the one unused here.
    uses_undefined = not used <= {*scope, *loop.over}
    for name, values in loop.over.items():
        if name in scope:
            yield DocumentProblem(
                (*path, name), f"{name} is a variable of an enclosing repeat already. Use another name"
            )
        # Other variables may only number repetitions; ``cycle`` also selects the cycles held out.
        likely_names = difflib.get_close_matches(name, ["cycle"], cutoff=_MISTYPED_SIMILARITY)
        must_be_used = name in _STEP_KEYS or not _are_repetition_numbers(values) or bool(likely_names)
        if name not in (*used, *scope, "cycle") and must_be_used and not uses_undefined:
            yield DocumentProblem(
                (*path, name),
                f"no step in the loop uses its variable ${name}{did_you_mean(name, likely_names)}. Use it in "
                "a step, or leave it out; to repeat the steps, number the passes: repetition: [1, 2, 3]",
            )
        for index, value in enumerate(values):
            if name == "cycle" and (not isinstance(value, int) or value < 1):
                yield DocumentProblem(
                    (*path, name, index), f"a cycle is a whole number from 1; found {json.dumps(value)}"
                )
            if name == "cycle" and value in values[:index]:
                numbers = ", ".join(map(str, range(1, len(values) + 1)))
                yield DocumentProblem(
                    (*path, name, index),
                    f"the cycle {json.dumps(value)} is given twice, and both passes would count as one. Give "
                    f"each pass its own number: cycle: [{numbers}]",
                )
            if name == "position" and index and value == values[index - 1]:
                yield DocumentProblem(
                    (*path, name, index), f"the position {value} is given twice in succession"
                )


def _are_repetition_numbers(values: Sequence[Value]) -> bool:
    """Whether the values number repetitions, as 1, 2, 3 or 1, 1, 1."""
    are_steps_of_one = all(
        isinstance(low, int) and isinstance(high, int) and 0 <= high - low <= 1
        for low, high in itertools.pairwise(values)
    )
    return are_steps_of_one and (len(values) > 1 or values[0] in (0, 1))


def _variables_in(values: Mapping[str, Any], path: KeyPath) -> Iterator[tuple[KeyPath, str]]:
    for key, value in values.items():
        name = variable_in(value)
        if name is not None:
            yield (*path, key), name
        elif isinstance(value, dict):
            yield from _variables_in(value, (*path, key))


def _free_variables(entries: Sequence[StepTemplate | Repeat]) -> set[str]:
    """Names of variables that the entries use but do not define."""
    names: set[str] = set()
    for entry in entries:
        if isinstance(entry, Repeat):
            names |= _free_variables(entry.steps) - entry.over.keys()
        else:
            names |= {*entry.variables().values()}
    return names


MAX_STEPS = 100_000


@dataclass(frozen=True)
class _LoopValue:
    """The value of a loop variable and its place in the procedure file."""

    value: Value
    place: KeyPath


@dataclass(frozen=True, slots=True)
class ResolvedStep:
    """A step with values in place of variables."""

    location: KeyPath  #: Place of the step's keys in the procedure file.
    step: Step
    cycle: int | None  #: Loop variable ``cycle``, if there is one.
    #: Places of the values that came from loop variables, by key path in the step.
    value_places: Mapping[KeyPath, KeyPath]


def resolve(document: Document, procedure: Procedure) -> list[ResolvedStep]:
    """Unroll the loops of a procedure and replace the variables with their values.

    Raises DocumentError if the loops give too many steps, or a variable has a value that its step can't take.
    """
    count = _count_steps(procedure.steps)
    if count > MAX_STEPS:
        largest = max(range(len(procedure.steps)), key=lambda i: _count_steps(procedure.steps[i : i + 1]))
        message = f"the loops give {count} steps; allowed: at most {MAX_STEPS}"
        raise document.error([DocumentProblem(("steps", largest), message)])
    problems: list[DocumentProblem] = []
    steps = list(_resolve(procedure.steps, ("steps",), {}, {}, problems))
    if problems:
        raise document.error(problems)
    return steps


def _count_steps(entries: Sequence[StepTemplate | Repeat]) -> int:
    return sum(
        math.prod(map(len, entry.over.values())) * _count_steps(entry.steps)
        if isinstance(entry, Repeat)
        else 1
        for entry in entries
    )


def _resolve(
    entries: Sequence[StepTemplate | Repeat],
    path: KeyPath,
    scope: Mapping[str, _LoopValue],
    validated: dict[tuple[type[Step], str], Step],
    problems: list[DocumentProblem],
) -> Iterator[ResolvedStep]:
    """Resolved steps of the entries; ``validated`` caches steps by kind and values: many are equal."""
    for index, entry in enumerate(entries):
        entry_path = _entry_location(entry, (*path, index))
        if isinstance(entry, Repeat):
            for values in _combinations(entry, (*entry_path, "over")):
                yield from _resolve(
                    entry.steps, (*entry_path, "steps"), {**scope, **values}, validated, problems
                )
            continue
        if not scope.keys() >= {*entry.variables().values()}:
            continue  # undefined variables are reported by _scope_problems
        try:
            yield _resolve_step(entry, entry_path, scope, validated)
        except ValidationError as error:
            problems += _problems_at_loop_values(error, entry, entry_path, scope)


def _combinations(loop: Repeat, path: KeyPath) -> Iterator[dict[str, _LoopValue]]:
    loop_values = [
        [_LoopValue(value, (*path, name, index)) for index, value in enumerate(values)]
        for name, values in loop.over.items()
    ]
    for values in itertools.product(*loop_values):
        yield dict(zip(loop.over, values, strict=True))


def _resolve_step(
    entry: StepTemplate,
    path: KeyPath,
    scope: Mapping[str, _LoopValue],
    validated: dict[tuple[type[Step], str], Step],
) -> ResolvedStep:
    values = _substitute(entry.values, scope)
    key = entry.kind, repr(values)
    step = validated.get(key) or validated.setdefault(key, entry.kind.model_validate(values))
    cycle = scope["cycle"].value if "cycle" in scope else None
    places = {keys: scope[name].place for keys, name in entry.variables().items()}
    return ResolvedStep(path, step, cycle if isinstance(cycle, int) else None, places)


def _substitute(value: Any, scope: Mapping[str, _LoopValue]) -> Any:
    if isinstance(value, Mapping):
        return {key: _substitute(item, scope) for key, item in value.items()}
    name = variable_in(value)
    return value if name is None else scope[name].value


def _problems_at_loop_values(
    error: ValidationError, entry: StepTemplate, path: KeyPath, scope: Mapping[str, _LoopValue]
) -> Iterator[DocumentProblem]:
    """Problems of a step; one with a value from a loop is placed at that value."""
    variables = entry.variables()
    for problem in problems_of(error):
        keys = next((keys for keys in variables if keys == problem.location[: len(keys)]), None)
        if keys:
            place = scope[variables[keys]].place
            yield DocumentProblem(place, f"{problem.message} (for {keys[-1]} of {entry.kind.name})")
        else:
            yield DocumentProblem((*path, *problem.location), problem.message)
