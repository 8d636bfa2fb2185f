"""The list of faults as a file: checked like a procedure, read by the emulators alone."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from gyrobench.bench.foundations.documents import Problem, StrictModel, read_document, validate
from gyrobench.drivers.emulators.faults.can_faults import CanFault
from gyrobench.drivers.emulators.faults.chamber_faults import ChamberFault
from gyrobench.drivers.emulators.faults.fault import BenchParts, UnsupportedFaultError
from gyrobench.drivers.emulators.faults.ins_faults import InsFault
from gyrobench.drivers.emulators.faults.serial_faults import SerialFault
from gyrobench.drivers.emulators.faults.table_faults import TableFault

#: One entry; the key ``fault`` names its kind.
AnyFault = Annotated[
    SerialFault | CanFault | InsFault | TableFault | ChamberFault, Field(discriminator="fault")
]


class FaultList(StrictModel):
    """What fails, and when."""

    description: str = Field(default="", description="purpose of the list")
    log: Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$")] | None = Field(
        None, description="name of a file beside this one; each injection appends a line of JSON to it"
    )
    faults: list[AnyFault] = Field(description="what fails, and when")


def load_faults(path: Path) -> FaultList:
    """Read a list of faults.

    Raises
    ------
    DocumentError
        The file can't be read, or is wrong; the message lists all problems.
    """
    return validate(read_document(path), FaultList)


def check_faults(path: Path, listed: FaultList, bench: BenchParts) -> None:
    """Refuse faults that the dialects of this bench do not support.

    Raises
    ------
    DocumentError
        Lists them, each with its place in the file.
    """
    problems = []
    for index, fault in enumerate(listed.faults):
        try:
            fault.check(bench)
        except UnsupportedFaultError as error:
            problems.append(Problem(("faults", index), f"the fault {fault.kind!r}: {error}"))
    if problems:
        raise read_document(path).error(problems)
