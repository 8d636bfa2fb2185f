import pytest

from bench.clock import VirtualClock
from bench.documents import find_document
from bench.engine.safe_state import make_safe
from bench.station.instruments import Emulation, Instruments
from bench.station.station import Station
from drivers.emulators.bench import BenchAddress, emulated_bench


@pytest.fixture
def opened(request, tmp_path):
    """A station whose safe state the test chooses, its instruments and the emulated bench behind them."""
    text = find_document("stations", "emulated").read_text()
    for old, new in getattr(request, "param", ()):
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "station.yaml"
    path.write_text(text)
    station, clock = Station(path), VirtualClock()
    with Instruments(station, clock, Emulation("ideal", 0)) as instruments:
        world = str(find_document("worlds", "ideal"))
        yield station, instruments, emulated_bench(BenchAddress(clock.name, world, 0))


def problems(actions):
    return {action.what: action.problem for action in actions}


def test_a_turning_table_is_stopped_and_opened_and_the_chamber_set(opened):
    station, instruments, bench = opened
    instruments.table.prepare()
    instruments.table.turn_at(2, 10.0)
    instruments.chamber.set_temperature(60.0, None)
    bench.clock.sleep(5.0)
    assert set(problems(make_safe(station, instruments)).values()) == {""}
    assert not any(axis.is_moving(bench.clock.now() + 1.0) for axis in bench.world.axes.values())
    assert bench.serial["table"].feed(b":Interlock? 2\r\n", bench.clock.now()).endswith(b"Open")
    assert instruments.chamber.set_point_c() == 23.0


def test_one_dead_instrument_does_not_keep_the_others_from_their_safe_state(opened):
    station, instruments, bench = opened
    instruments.chamber.set_temperature(60.0, None)
    instruments.table.close()
    found = problems(make_safe(station, instruments))
    assert found["rate table stopped"].startswith("rate table:")
    assert found["chamber's set point at 23 degC"] == ""
    assert bench.world.air.set_point_c == 23.0


@pytest.mark.parametrize(
    "opened", [[("chamber_c: 23", "chamber_c: off"), ("unit: keep", "unit: off")]], indirect=True
)
def test_a_station_may_switch_chamber_and_unit_off(opened):
    station, instruments, bench = opened
    instruments.power_unit(True)
    instruments.chamber.switch(True)
    assert set(problems(make_safe(station, instruments)).values()) == {""}
    assert not bench.world.air.running
    assert not bench.world.thermal.powered
