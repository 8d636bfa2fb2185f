"""Sections of a station file: dialects of table and chamber, laboratory and traceability."""

from datetime import UTC, date, datetime, timedelta

import pytest
from pydantic import Field

from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.preflight.bench_check import calibration_checks
from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.errors import ConnectionFailedError, DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.station import instrument_sections as dialect_section
from gyrobench.bench.station import instruments
from gyrobench.bench.station.check_result import CheckVerdict
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


SECTIONS = """
laboratory: {name: Example Laboratory, street: Long Road 1, city: Sampletown, country: DE}
traceability:
  rate_table:
    serial_number: RT-17
    certificate: 2026-0815
    calibrated: 2020-01-15
    due: %s
    uncertainty: {value: 0.5, unit: arcsec}
"""


@pytest.fixture
def station_file(tmp_path):
    def write(due):
        path = tmp_path / "station.yaml"
        path.write_text(find_document("stations", "emulated").read_text() + SECTIONS % due)
        return path

    return write


def today():
    return datetime.now(UTC).date()


def test_the_laboratory_and_the_calibrations_are_read(station_file):
    file = Station(station_file("2030-12-31")).file
    assert file.laboratory.address == "Long Road 1, Sampletown, DE"
    ((name, table),) = file.traceability.instruments()
    assert (name, table.due, table.uncertainty.text) == (
        "rate_table",
        date(2030, 12, 31),
        "0.5 arcsec (k = 2)",
    )


def test_an_instrument_is_past_due_the_day_after(station_file):
    traceability = Station(station_file("2026-05-01")).file.traceability
    assert traceability.past_due(date(2026, 5, 1)) == {}
    assert traceability.past_due(date(2026, 5, 3)) == {
        "rate_table": "calibration of the rate table RT-17 was due on 2026-05-01, 2 days ago"
    }


def test_a_run_with_an_instrument_past_due_needs_the_operators_acknowledgement(station_file, monkeypatch):
    monkeypatch.setenv("GYROBENCH_OPERATOR", "A. Smith")
    station = station_file(today() - timedelta(days=9))
    with pytest.raises(DocumentError, match=r"9 days ago.*run with --acknowledge rate_table"):
        prepare_job("ten_minute_check", str(station)).check_calibrations()
    prepare_job("ten_minute_check", str(station), acknowledged=["rate_table"]).check_calibrations()
    (check,) = calibration_checks(Station(station), [])
    assert check.verdict is CheckVerdict.FAIL
    (check,) = calibration_checks(Station(station), ["rate_table"])
    assert check.verdict is CheckVerdict.PASS
    assert check.found.endswith("acknowledged by A. Smith")


@pytest.mark.parametrize(
    ("due", "message"), [("31.12.2030", "is not a date; write it as 2026-01-31"), ("", "is not a date")]
)
def test_what_is_no_date_is_refused_with_its_place(station_file, due, message):
    with pytest.raises(DocumentError, match=message):
        Station(station_file(f'"{due}"'))
