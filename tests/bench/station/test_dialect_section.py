import pytest
from pydantic import Field

from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.errors import ConnectionFailedError, DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.station import instrument_sections as dialect_section
from gyrobench.bench.station import instruments
from gyrobench.bench.station.instrument_sections import ChamberSection
from gyrobench.bench.station.instruments import Emulation, open_chamber, open_table
from gyrobench.bench.station.station import Station
from gyrobench.bench.station.station_file import StationFile
from gyrobench.drivers.chamber import ChamberDialect

ADDRESS = "  address: 1\n"


def test_a_dialect_has_keys_of_its_own(changed):
    section = Station(changed((ADDRESS, "  address: 7\n  chamber_event: 3\n"))).file.chamber
    assert isinstance(section, ChamberSection)
    assert (section.address, section.chamber_event) == (7, 3)


@pytest.mark.parametrize(
    ("found", "put", "message"),
    [
        (
            ADDRESS, "  adress: 1\n",
            r"unknown key 'adress' \(did you mean 'address'\?\); allowed here: dialect, .*address",
        ),
        (ADDRESS, "  channel: 1\n", "unknown key 'channel'"),
        (ADDRESS, "  address: 0\n", "'address' must be at least 1; found 0"),
        (ADDRESS, "  parity: X\n", "'parity' must be 'N', 'E' or 'O'"),
        ("dialect: watlow_f4\n", "dialect: thermotron_8800\n", "unknown key 'address'"),
        ("dialect: watlow_f4\n", "dialect: watlow_f5\n", r"did you mean 'watlow_f4'\?\); installed: .*f4t"),
        ("dialect: watlow_f4\n", "dialect: 4\n", "a dialect is a name; installed: thermotron_8800, "),
        ("  dialect: watlow_f4\n", "", "the key 'dialect' is missing; installed: thermotron_8800, "),
        ("dialect: acutrol3000", "dialect: watlow_f4", "no dialect 'watlow_f4' of a rate table is installed"),
        ("dialect: acutrol3000", "dialect: ideal_aerosmith", "has a single axis: leave out outer_axis"),
        ("  outer_axis: east\n", "", "outer_axis is missing; a table with a single axis"),
        ("    outer_deg: [-200, 200]\n", "", "limits.outer_deg is missing"),
    ],
)  # fmt: skip
def test_a_mistake_is_reported_in_one_line_with_its_place(changed, found, put, message):
    with pytest.raises(DocumentError, match=rf"station\.yaml:\d+:\d+: .*{message}") as caught:
        Station(changed((found, put)))
    assert len(str(caught.value).splitlines()) == 1


class PortTwice(StrictModel):
    port: str = Field(default="", description="taken already")


def test_a_dialect_can_not_take_a_key_that_every_section_has(changed, monkeypatch):
    dialect = ChamberDialect(lambda line, options: None, PortTwice)
    monkeypatch.setattr(dialect_section, "load", lambda *wanted: dialect)
    with pytest.raises(
        DocumentError, match=r"the dialect 'acme' has keys that every such section has \(port\)"
    ):
        dialect_section.section_of(ChamberSection, "acme")


@pytest.mark.parametrize(
    ("station", "usual"), [("emulated", 9600), ("emulated_thermotron", 9600), ("emulated_f4t", 38400)]
)
def test_a_line_has_the_dialects_usual_settings_unless_others_are_given(
    tmp_path, monkeypatch, station, usual
):
    opened = []

    class Line:
        def __init__(self, *settings):
            opened.append(settings)
            raise ConnectionFailedError("chamber", "not now")

    monkeypatch.setattr(instruments, "SerialLine", Line)
    text = find_document("stations", station).read_text()
    for given in ("", "\n  baudrate: 57600\n  parity: E"):
        path = tmp_path / "station.yaml"
        path.write_text(text.replace("port: emulator://chamber", f"port: emulator://chamber{given}", 1))
        with pytest.raises(ConnectionFailedError, match="not now"):
            open_chamber(Station(path), VirtualClock(), Emulation("ideal"))
    assert [settings[3:] for settings in opened] == [(usual, "N"), (57600, "E")]


@pytest.mark.parametrize(
    ("port", "found"),
    [
        ("socket://10.0.0.7", "socket://10.0.0.7:8888"),
        ("socket://10.0.0.7:4001", "socket://10.0.0.7:4001"),
        ("socket://chamber/", "socket://chamber:8888/"),
        ("rfc2217://10.0.0.7:4001", "rfc2217://10.0.0.7:4001"),
        ("/dev/ttyUSB0", "/dev/ttyUSB0"),
    ],
)
def test_a_socket_without_a_port_has_that_of_the_dialect(tmp_path, monkeypatch, port, found):
    opened = []
    monkeypatch.setattr(instruments, "SerialLine", lambda *settings: opened.append(settings[1]))
    path = tmp_path / "station.yaml"
    text = find_document("stations", "emulated_thermotron").read_text()
    path.write_text(text.replace("port: emulator://chamber", f"port: {port}").replace("virtual", "wall"))
    with pytest.raises(AttributeError):  # there is no line to go on with
        open_chamber(Station(path), VirtualClock(), Emulation("ideal"))
    assert opened == [found]


def test_the_schema_for_editors_has_the_keys_of_every_dialect():
    definitions = StationFile.model_json_schema()["$defs"]
    keys = {
        section["properties"]["dialect"]["const"]: set(section["properties"])
        for section in definitions["ChamberSection"]["oneOf"]
    }
    assert {"address", "chamber_event"} < keys["watlow_f4"]
    assert {"channel", "line_ending"} < keys["thermotron_8800"]
    assert {"loop", "chamber_output"} < keys["watlow_f4t"]


@pytest.mark.parametrize("name", ["emulated_thermotron", "emulated_f4t", "single_axis"])
def test_shipped_stations_of_other_dialects_open_their_emulators(name):
    station, clock = Station(find_document("stations", name)), VirtualClock()
    station.check_dbc()
    table, chamber = (open_it(station, clock, Emulation("ideal")) for open_it in (open_table, open_chamber))
    assert len(table.read().position_deg) == len(station.file.rate_table.axis_numbers)
    assert chamber.read().temperature_c == pytest.approx(23.0, abs=0.1)


def test_a_bench_is_of_the_dialects_that_were_asked_for_first():
    clock = VirtualClock()
    open_chamber(Station(find_document("stations", "emulated_f4t")), clock, Emulation("ideal"))
    with pytest.raises(
        ConnectionFailedError, match="the chamber of this bench is a watlow_f4t, not a watlow_f4"
    ):
        open_chamber(Station(find_document("stations", "emulated")), clock, Emulation("ideal"))
