"""Plans on shipped stations, without a bench."""

from pathlib import Path

from gyrobench.bench.foundations.documents import parse_document
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.procedure.procedure_file import load_procedure
from gyrobench.bench.station.station import Station


def station(name="emulated"):
    return Station(find_document("stations", name))


def shipped(procedure, on="emulated"):
    """A shipped procedure and its plan."""
    document, _ = load_procedure(find_document("procedures", procedure))
    return document, station(on).plan_document(document)


def planned(steps, on="emulated"):
    """Steps in YAML and their plan."""
    document = parse_document(f"procedure: test\nsteps:\n{steps}", Path("test.yaml"))
    return document, station(on).plan_document(document)


#: A dwell of 20 min of navigation in a position.
DWELL = """\
  - go_to: {position: POSITION}
  - align: {duration_s: 300}
  - navigate: {duration_s: 600}
  - turn: {angle_deg: 180}
  - navigate: {duration_s: 600}
"""


def dwell(position):
    return DWELL.replace("POSITION", position)
