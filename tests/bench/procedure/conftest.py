from collections.abc import Callable
from itertools import accumulate
from pathlib import Path

import pytest

from gyrobench.bench.foundations.documents import Document, parse_document
from gyrobench.bench.navigation.table_axes import TurnOrMove
from gyrobench.bench.procedure.checks import StationLimits
from gyrobench.bench.procedure.plan import Plan, expand
from gyrobench.bench.procedure.procedure_file import checked_procedure

HEADER = "procedure: test\nsteps:\n"


@pytest.fixture
def planned() -> Callable[[str], tuple[Document, Plan]]:
    """Plan the steps given as YAML; the first of them stands in line 3 of test.yaml."""

    def plan_of(steps: str) -> tuple[Document, Plan]:
        document = parse_document(HEADER + steps, Path("test.yaml"))
        return document, expand(document, checked_procedure(document))

    return plan_of


@pytest.fixture
def limits() -> StationLimits:
    """A station with a chamber from -40 to 70 degC whose table can't stand in x_down or at 90 deg."""

    def unreachable_reason(
        position: str, azimuth_deg: float, turns_deg: tuple[TurnOrMove, ...]
    ) -> str | None:
        if position == "x_down":
            return "the mount is in the way"
        about_up_deg = [each for each in turns_deg if not isinstance(each, tuple)]
        azimuths_deg = accumulate(about_up_deg, initial=azimuth_deg)
        return "outer axis level" if any(each % 180.0 for each in azimuths_deg) else None

    return StationLimits(-40.0, 70.0, 5.0, 60.0, unreachable_reason)


@pytest.fixture
def shipped() -> Path:
    """Folder of the shipped procedures."""
    return Path(__file__).parents[3] / "procedures"
