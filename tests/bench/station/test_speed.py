import pytest

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.station.station_file import load_station_file

TABLE, CHAMBER = "emulator://table", "emulator://chamber"
INS = "interface: emulator\n  channel: ins"


@pytest.fixture
def station(tmp_path):
    """Write the shipped station with other addresses, ten times as fast."""

    def write(
        table="/dev/pts/3", chamber="/home/bench/chamber", ins="interface: slcan\n  channel: /dev/pts/5"
    ):
        text = find_document("stations", "emulated").read_text()
        for old, new in {
            "clock: virtual": "clock: wall\nspeed: 10",
            TABLE: table,
            CHAMBER: chamber,
            INS: ins,
        }.items():
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "station.yaml"
        path.write_text(text)
        return path

    return write


@pytest.mark.parametrize(
    "addresses",
    [
        {},
        {"table": "socket://127.0.0.1:9878", "chamber": "socket://localhost:4000"},
        {"ins": "interface: socketcand\n  channel: can0\n  options: {host: 127.0.0.1, port: 28600}"},
        {"table": TABLE, "chamber": CHAMBER, "ins": INS},
        {"table": "replay:///tmp/table.rec"},
    ],
)
def test_an_emulated_bench_may_be_fast(station, addresses):
    _, file = load_station_file(station(**addresses))
    assert file.speed == 10.0


@pytest.mark.parametrize(
    ("addresses", "message"),
    [
        ({"table": "/dev/ttyUSB0"}, "/dev/ttyUSB0 is a real port"),
        ({"chamber": "/dev/serial/by-id/usb-adapter"}, "is a real port"),
        ({"table": "socket://192.168.53.1:9878"}, "not an address of this computer"),
        ({"chamber": "rfc2217://chamber.lab:4000"}, "not an address of this computer"),
        ({"ins": "interface: socketcan\n  channel: can0"}, "ins.interface: socketcan reaches a real bus"),
        ({"ins": "interface: slcan\n  channel: /dev/ttyACM0"}, "/dev/ttyACM0 is a real port"),
        (
            {"ins": "interface: socketcand\n  channel: can0\n  options: {host: lab, port: 28600}"},
            "lab is another computer",
        ),
    ],
)
def test_a_real_bench_may_not(station, addresses, message):
    with pytest.raises(
        DocumentError, match=f"speed: 10 is for an emulated bench on this computer; .*{message}"
    ):
        load_station_file(station(**addresses))


def test_virtual_time_has_no_speed(station):
    path = station(table=TABLE, chamber=CHAMBER, ins=INS)
    path.write_text(path.read_text().replace("clock: wall", "clock: virtual"))
    with pytest.raises(DocumentError, match="virtual is as fast as possible"):
        load_station_file(path)


@pytest.mark.parametrize("speed", ["0.5", "101", "-1", "fast"])
def test_a_speed_below_one_or_beyond_all_measure_is_refused(station, speed):
    path = station()
    path.write_text(path.read_text().replace("speed: 10", f"speed: {speed}"))
    with pytest.raises(DocumentError, match="'speed' must be"):
        load_station_file(path)
