from itertools import accumulate
from pathlib import Path

import pytest

from gyrobench.bench.foundations.documents import parse_document
from gyrobench.bench.procedure.checks import StationLimits
from gyrobench.bench.procedure.plan import expand
from gyrobench.bench.procedure.procedure_file import checked_procedure

HEADER = "procedure: test\nsteps:\n"


@pytest.fixture
def planned():
    """Plan the steps given as YAML; the first of them stands in line 3 of test.yaml."""

    def plan_of(steps):
        document = parse_document(HEADER + steps, Path("test.yaml"))
        return document, expand(document, checked_procedure(document))

    return plan_of


@pytest.fixture
def limits():
    """A station with a chamber from -40 to 70 degC whose table can't stand in x_down or at 90 deg."""

    def unreachable_reason(position, azimuth_deg, turns_deg):
        if position == "x_down":
            return "the mount is in the way"
        about_up_deg = [each for each in turns_deg if not isinstance(each, tuple)]
        azimuths_deg = accumulate(about_up_deg, initial=azimuth_deg)
        return "outer axis level" if any(each % 180.0 for each in azimuths_deg) else None

    return StationLimits(-40.0, 70.0, 5.0, 60.0, unreachable_reason)


@pytest.fixture
def shipped():
    """Folder of the shipped procedures."""
    return Path(__file__).parents[3] / "procedures"
