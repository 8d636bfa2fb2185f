"""The list of faults as a file: checked like a procedure, read by the emulators alone."""

from __future__ import annotations

import functools
import operator
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from gyrobench.bench.foundations.documents import Problem, StrictModel, read_document, validate
from gyrobench.drivers.emulators.faults import (
    can_faults,
    chamber_faults,
    ins_faults,
    serial_faults,
    table_faults,
)
from gyrobench.drivers.emulators.faults.fault import BenchParts, Fault, UnsupportedFaultError

_MODULES = (serial_faults, can_faults, ins_faults, table_faults, chamber_faults)
#: The kinds: each class of these modules with a key ``fault``.
_KINDS = [
    kind
    for module in _MODULES
    for kind in vars(module).values()
    if isinstance(kind, type) and issubclass(kind, Fault) and "fault" in kind.model_fields
]
if TYPE_CHECKING:
    AnyFault = Fault
else:
    AnyFault = Annotated[functools.reduce(operator.or_, _KINDS), Field(discriminator="fault")]


class FaultList(StrictModel):
    """What fails, and when."""

    description: str = Field("", description="purpose of the list")
    log: Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$")] | None = Field(
        None, description="name of a file beside this one; each injection appends a line of JSON to it"
    )
    faults: list[AnyFault] = Field(description="what fails, and when")


def load_faults(path: Path) -> FaultList:
    """Read a list of faults.

    Raises DocumentError if the file can't be read, or is wrong; the message lists all problems.
    """
    return validate(read_document(path), FaultList)


def check_faults(path: Path, listed: FaultList, benches: Sequence[BenchParts]) -> None:
    """Refuse faults that the dialects of this bench do not support, and of units that it lacks.

    ``benches``: the bench as seen with each of its units.

    Raises DocumentError, which lists them, each with its place in the file.
    """
    problems = []
    for index, fault in enumerate(listed.faults):
        try:
            if fault.unit > len(benches):
                raise UnsupportedFaultError(f"unit {fault.unit} is not on the bench; it has {len(benches)}")
            fault.check(benches[fault.unit - 1])
        except UnsupportedFaultError as error:
            problems.append(Problem(("faults", index), f"the fault {fault.kind!r}: {error}"))
    if problems:
        raise read_document(path).error(problems)
