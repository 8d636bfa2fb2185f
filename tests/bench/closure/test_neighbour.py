"""Two units in one chamber over bytes and frames: the heat of one acts on the biases of the other."""

import io

import pytest
import yaml
from rich.console import Console

from gyrobench.bench.closure.inputs import read_campaign
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.foundations.documents import read_document
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.monitor.terminal_view import LinesView
from gyrobench.bench.station.instruments import Emulation
from tests.bench.closure.campaigns import write_procedure

pytestmark = pytest.mark.long

UNITS = [{"number": 1201}, {"number": 1202, "channel": "ins-2", "power_event": 3}]
#: The second unit loses its supply in the second of three cycles.
FAULTS = "faults:\n  - {fault: ins_supply_lost, at_s: 7000, unit: 2}\n"


def first_unit(folder, heats):
    """Closure of the unit beside one that falls out, which heats it or not."""
    station = read_document(find_document("stations", "four_units")).data | {"units": UNITS}
    world = read_document(find_document("worlds", "heating_neighbour")).data
    if not heats:
        del world["neighbour_heating"]
    for name, data in (("station", station), ("world", world)):
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(data))
    (folder / "faults.yaml").write_text(FAULTS)
    emulation = Emulation(str(folder / "world.yaml"), 0, str(folder / "faults.yaml"))
    job = prepare_job(str(write_procedure(folder)), str(folder / "station.yaml"), emulation)
    watcher = LinesView(Console(file=io.StringIO(), width=80), job.plan)
    run, outcome = run_job(job, folder / "run", watcher, ConsentingOperator())
    assert outcome.ended == "finished", outcome.reason
    return close_loop(read_campaign(run.path / "units" / "1201"))


def test_the_neighbour_is_named_where_its_heat_acts(tmp_path):
    closure = first_unit(tmp_path, heats=True)
    on = closure.campaign.columns["neighbours_on"]
    assert (on[0], on[-1]) == (1.0, 0.0)
    assert closure.verdict == "explained"
    assert [each.candidate.effect.name for each in closure.effects] == ["neighbouring_unit"]
    assert closure.error_after_dph < 0.3 * closure.error_before_dph


def test_the_neighbour_is_not_named_where_it_only_stands_beside(tmp_path):
    closure = first_unit(tmp_path, heats=False)
    assert closure.verdict == "clean"
