"""Stations to watch."""

import pytest

from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.station.station import Station
from tests.bench.engine.interlocks.watched_bench import WatchedBench


@pytest.fixture(scope="session")
def station_of(tmp_path_factory):
    """Make a shipped station, with more keys at its end."""
    made = {}

    def make(more="", name="emulated"):
        if (more, name) not in made:
            path = tmp_path_factory.mktemp("station") / f"{name}.yaml"
            path.write_text(find_document("stations", name).read_text() + more)
            made[more, name] = Station(path)
        return made[more, name]

    return make


@pytest.fixture
def watched(station_of):
    """Make a watched bench of a shipped station, with more keys at its end."""
    return lambda more="", name="emulated": WatchedBench(station_of(more, name))
