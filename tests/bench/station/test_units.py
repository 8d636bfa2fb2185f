"""The section `units` of a station file: what is refused, and the bench with each unit alone."""

import pytest

from gyrobench.bench.engine.preflight.bench_check import check_bench
from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.station.check_result import CheckVerdict
from gyrobench.bench.station.instruments import Emulation, Instruments
from gyrobench.bench.station.safe_state import make_safe
from gyrobench.bench.station.station import Station


@pytest.fixture
def station_of(tmp_path):
    """``station_of(old, new)``: the station four_units with one text in place of another."""

    def make(old="", new=""):
        text = find_document("stations", "four_units").read_text()
        assert old in text
        path = tmp_path / "several.yaml"
        path.write_text(text.replace(old, new) if old else text)
        return Station(path)

    return make


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("number: 1102", "number: 1101", "two have the same number"),
        ("channel: ins-3", "channel: ins-2", "1102 and 1103 are at the same place of one bus"),
        ("number: 1102", "number: ../1102", "must match the pattern"),
        ("power: chamber_event", "power: always_on", "power_event is not possible"),
        ("    channel: ins-2", "    channels: ins-2", "channels"),
    ],
)
def test_units_with_equal_places_or_numbers_are_refused(station_of, old, new, problem):
    with pytest.raises(DocumentError, match=problem):
        station_of(old, new)


def test_identifiers_that_overlap_on_one_bus_are_refused(station_of):
    with pytest.raises(DocumentError, match="share a bus and both use the identifier"):
        station_of("channel: ins-2", "identifier_offset: 3").check_dbc()
    with pytest.raises(DocumentError, match="identifier 2512 with the offset 2000"):
        station_of("channel: ins-2", "identifier_offset: 2000").check_dbc()
    station_of("channel: ins-2", "identifier_offset: 64").check_dbc()


def test_each_unit_alone_is_a_station_file_of_one_unit(station_of, tmp_path):
    for number, channel, event in (("1101", "ins", 2), ("1103", "ins-3", 4)):
        (unit,) = (each for each in station_of().units if each.number == number)
        alone = tmp_path / "alone.yaml"
        alone.write_text(unit.text)
        read = Station(alone)
        assert (read.file.ins.channel, read.file.unit.power_event) == (channel, event)
        assert not read.file.units
        assert read.file == unit.file


def test_a_unit_is_in_the_position_that_its_mounting_gives(station_of):
    station = station_of()
    for unit in station.units:
        for name, position in POSITIONS.items():
            angles = station.table.angles(position.C_nb(0.0))
            own, azimuth_deg = unit.position_of_unit(name, 0.0)
            expected = POSITIONS[own].C_nb(azimuth_deg * 3.141592653589793 / 180.0)
            assert unit.table.attitude(*angles) == pytest.approx(expected, abs=1e-6)


def test_the_safe_state_switches_off_all_units(station_of):
    station, clock = station_of("unit: keep", "unit: off"), VirtualClock()
    with Instruments(station, clock, Emulation("four_units")) as instruments:
        instruments.power_unit(True)
        assert [instruments.chamber.is_event_on(event) for event in (2, 3, 4, 5)] == [True] * 4
        assert not any(action.problem for action in make_safe(station, instruments))
        assert [instruments.chamber.is_event_on(event) for event in (2, 3, 4, 5)] == [False] * 4


def test_the_preflight_check_covers_each_unit(tmp_path):
    checks = check_bench("four_units", None, Emulation("four_units"), tmp_path)
    answers = {check.subject: check.verdict for check in checks if check.what == "answers"}
    units = {name: verdict for name, verdict in answers.items() if name.startswith("INS")}
    assert units == {f"INS {number}": CheckVerdict.PASS for number in (1101, 1102, 1103, 1104)}
