"""The calls of a recording, checked: somebody may have written them by hand."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, get_type_hints

from pydantic import TypeAdapter, ValidationError

from gyrobench.bench.foundations.documents import Problem
from gyrobench.bench.foundations.text import did_you_mean
from gyrobench.drivers.chamber import Chamber
from gyrobench.drivers.rate_table import RateTable
from gyrobench.drivers.recording.document import Call, Recording

#: Where a recording names none.
USUAL_AXES = (1, 2)
#: Nothing can be asked after it.
_ENDS = "close"


def calls_of(recording: Recording) -> list[Call]:
    """Calls with arguments as the driver's methods take them.

    Raises
    ------
    DocumentError
        A call can't be made; lists all of them, with their places.
    """
    header = recording.header
    if header.instrument == "ins":
        return []  # nothing is asked of it over a line
    instrument: type[RateTable | Chamber] = RateTable if header.instrument == "table" else Chamber
    calls, problems = [], []
    for index, call in enumerate(header.calls):
        found = _understood(instrument, call.ask, call.arguments, header.axes or USUAL_AXES)
        if isinstance(found, Problem):
            message = f"call {index + 1} of {len(header.calls)}: {found.message}"
            problems.append(Problem(("calls", index, *found.location), message))
        else:
            calls.append(call.model_copy(update={"arguments": found}))
    if problems:
        raise recording.document.error(problems)
    return calls


def _understood(
    instrument: type[RateTable | Chamber], ask: str, arguments: Mapping[str, Any], axes: Sequence[int]
) -> dict[str, Any] | Problem:
    """Arguments of a call as its method takes them, or what is wrong; its location is within the call."""
    methods = dict(_methods(instrument))
    if ask not in methods:
        what = instrument.__name__
        return Problem(("ask",), f"a {what} has no method '{ask}'{did_you_mean(ask, methods)}")
    try:
        inspect.signature(methods[ask]).bind(None, **arguments)
    except TypeError as error:
        return Problem(("arguments",), f"{ask}: {error}")
    hints, taken = get_type_hints(methods[ask]), {}
    for name, value in arguments.items():
        try:
            taken[name] = TypeAdapter(hints[name]).validate_python(value)
        except ValidationError as error:
            return Problem(("arguments", name), f"{ask}: '{name}': {error.errors()[0]['msg']}")
    if taken.get("angles_deg") == {}:
        return Problem(("arguments", "angles_deg"), f"{ask}: names no axis")
    strange = (set(taken.get("angles_deg", axes)) | {taken.get("axis", axes[0])}) - set(axes)
    if strange:
        return Problem(("arguments",), f"{ask}: there is no axis {min(strange)}, only {list(axes)}")
    return taken


def _methods(instrument: type[RateTable | Chamber]) -> Iterator[tuple[str, Callable[..., object]]]:
    for name, method in vars(instrument).items():
        if inspect.isfunction(method) and not name.startswith("_") and name != _ENDS:
            yield name, method
