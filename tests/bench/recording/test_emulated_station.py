from pathlib import Path

import pytest

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.recording import emulated_station
from gyrobench.bench.recording.emulated_station import (
    EmulationSettings,
    emulated_frames,
    guide,
    serve_options,
    write_station_file,
)
from gyrobench.bench.station.station import Station
from gyrobench.bench.station.station_file import load_station_file

TCP = {
    "table": "socket://127.0.0.1:39878",
    "chamber": "socket://127.0.0.1:44001",
    "ins": "socketcand://127.0.0.1:28600/can0",
}
TERMINALS = {"table": "/dev/pts/101", "chamber": "/dev/pts/102", "ins": "/dev/pts/103"}
LINKS = {name: f"/home/bench/ports/{name}" for name in TCP}


@pytest.mark.parametrize("name", ["emulated", "emulated_thermotron", "single_axis", "emulated_sbg"])
@pytest.mark.parametrize("urls", [TCP, TERMINALS])
def test_it_names_every_address_and_fits_the_terminal(name, urls):
    text = guide(urls, Station(find_document("stations", name)), 10.0, Path("mine.yaml"))
    assert "10 times as fast" in text
    assert all(url in text for url in urls.values())
    assert "gyrobench run ten_minute_check --station mine.yaml" in text
    assert max(map(len, text.splitlines())) <= 80


def test_it_says_how_other_programs_connect():
    station = Station(find_document("stations", "emulated"))
    text = guide(LINKS, station, 1.0, None)
    assert f"picocom --omap crcrlf {LINKS['table']}" in text
    assert f"mbpoll -m rtu -a 1 -b 9600 -P none -0 -r 100 -c 2 {LINKS['chamber']}" in text
    assert f"python -m can.viewer -i slcan -c {LINKS['ins']}" in text
    assert "event output 2" in text
    text = guide(TCP, station, 1.0, None)
    assert "nc -C 127.0.0.1 39878" in text
    command = " ".join(text[text.index("python -m can.viewer") :].replace("\\\n", " ").split()[:10])
    assert command == "python -m can.viewer -i socketcand -c can0 --bus-kwargs host=127.0.0.1 port=28600"
    assert "in real time" in text


def test_each_unit_has_its_address_and_its_supply():
    station = Station(find_document("stations", "four_units"))
    more = {f"ins-{number}": f"/dev/pts/20{number}" for number in (2, 3, 4)}
    text = guide(TERMINALS | more, station, 1.0, None)
    for number, event in ((2, 3), (3, 4), (4, 5)):
        assert f"INS {number}    /dev/pts/20{number}" in text
        assert f"event output {event} of the chamber" in text


def test_for_a_dbc_file_that_is_not_shipped_it_names_the_frames_that_are_sent(tmp_path):
    shipped = Station(find_document("stations", "emulated_sbg"))
    (tmp_path / "mine.dbc").write_bytes(shipped.dbc_path.read_bytes() + b"\n")
    path = tmp_path / "mine.yaml"
    path.write_text(shipped.path.read_text().replace("dbc: sbg.dbc", "dbc: mine.dbc"))
    text = guide(TERMINALS, Station(path), 1.0, None)
    assert f"INS      {TERMINALS['ins']}  gyrobench_ins.dbc\n" in text
    assert "No emulated INS sends the frames of mine.dbc: decode with gyrobench_ins.dbc." in text


@pytest.mark.parametrize("options", ["{frames: ours}", "{}"])
def test_the_frames_of_a_package_are_served_with_their_dbc_file(tmp_path, monkeypatch, options):
    monkeypatch.setattr(emulated_station, "installed", lambda group: ["mine", "ours"])
    source = shipped("emulated_sbg")
    (tmp_path / "mine.dbc").write_bytes(source.dbc_path.read_bytes() + b"\n")
    text = source.path.read_text().replace("dbc: sbg.dbc", "dbc: mine.dbc")
    (tmp_path / "mine.yaml").write_text(text.replace("{frames: sbg}", options))
    station = Station(tmp_path / "mine.yaml")
    assert f"--frames={'mine' if options == '{}' else 'ours'}" in serve_options(station, NOWHERE, False, None)
    assert "mine.dbc" in guide(TERMINALS, station, 1.0, None)
    assert "No emulated INS" not in guide(TERMINALS, station, 1.0, None)
    (tmp_path / "elsewhere").mkdir()
    write_station_file(tmp_path / "elsewhere" / "served.yaml", station, TERMINALS, 1.0)
    assert (
        Station(tmp_path / "elsewhere" / "served.yaml").dbc_path.read_bytes() == station.dbc_path.read_bytes()
    )


NOWHERE = {"table": "", "chamber": "", "ins": ""}


def shipped(name="emulated"):
    return Station(find_document("stations", name))


def served(tmp_path, urls, name="emulated", speed=1.0):
    path = tmp_path / "served.yaml"
    write_station_file(path, shipped(name), urls, speed)
    return Station(path)


@pytest.mark.parametrize(
    ("name", "spoken"),
    [
        ("emulated", ["acutrol3000", "watlow_f4", "gyrobench_ins"]),
        ("emulated_thermotron", ["acutrol3000", "thermotron_8800", "gyrobench_ins"]),
        ("emulated_f4t", ["acutrol3000", "watlow_f4t", "gyrobench_ins"]),
        ("single_axis", ["ideal_aerosmith", "watlow_f4", "gyrobench_ins"]),
        ("emulated_sbg", ["acutrol3000", "watlow_f4", "sbg"]),
        ("emulated_canaerospace", ["acutrol3000", "watlow_f4", "canaerospace"]),
    ],
)
def test_the_station_sets_the_dialects(name, spoken):
    table, chamber, frames = spoken
    assert serve_options(shipped(name), NOWHERE, tcp=False, can=None) == [
        f"--table-dialect={table}",
        f"--chamber-dialect={chamber}",
        f"--frames={frames}",
        "--can=slcan",
    ]


def test_a_served_station_is_served_again_at_its_ports(tmp_path):
    options = serve_options(served(tmp_path, TCP), NOWHERE, tcp=False, can=None)
    assert options[:3] == ["--table-port=39878", "--chamber-port=44001", "--ins-port=28600"]
    assert options[-1] == "--can=socketcand"
    links = {name: f"/home/bench/{name}" for name in NOWHERE}
    options = serve_options(served(tmp_path, links), NOWHERE, tcp=False, can=None)
    assert options[:3] == [f"--{name}-port={link}" for name, link in links.items()]


def test_the_emulators_receive_the_settings():
    settings = EmulationSettings("gyro_b", 0, 10.0, faults="every_kind", for_s=0.0)
    without = serve_options(shipped(), NOWHERE, tcp=False, can=None)
    options = serve_options(shipped(), NOWHERE, tcp=False, can=None, settings=settings)
    assert [option for option in options if option not in without] == [
        "--world=gyro_b",
        "--seed=0",
        "--speed=10.0",
        "--faults=every_kind",
        "--for-s=0.0",
    ]


def test_options_take_precedence_over_the_station(tmp_path):
    station = served(tmp_path, TCP)
    options = serve_options(station, NOWHERE | {"table": "/home/table"}, tcp=True, can="slcan")
    assert options[:2] == ["--table-port=/home/table", "--chamber-port=44001"]
    assert "--ins-port=28600" not in options
    assert options[-2:] == ["--can=slcan", "--tcp"]


@pytest.mark.parametrize("urls", [TERMINALS, TCP])
@pytest.mark.parametrize("name", ["emulated", "emulated_sbg", "emulated_thermotron", "single_axis"])
def test_the_station_file_written_is_the_station_with_other_addresses(tmp_path, urls, name):
    station, original = served(tmp_path, urls, name, speed=10.0), shipped(name)
    station.check_dbc()
    assert (station.file.clock, station.file.speed) == ("wall", 10.0)
    assert station.file.rate_table.port == urls["table"]
    assert station.file.chamber.port == urls["chamber"]
    assert station.file.rate_table.limits == original.file.rate_table.limits
    assert station.file.ins.signals == original.file.ins.signals
    assert station.file.ins.commands == original.file.ins.commands
    assert station.file.safe_state == original.file.safe_state
    assert emulated_frames(station) == emulated_frames(original)


def test_the_bus_has_python_cans_names(tmp_path):
    section = served(tmp_path, TERMINALS).file.ins
    assert (section.interface, section.channel, section.bitrate) == ("slcan", "/dev/pts/103", 500000)
    section = served(tmp_path, TCP).file.ins
    assert (section.interface, section.channel) == ("socketcand", "can0")
    assert section.options == {"host": "127.0.0.1", "port": 28600}


def test_a_station_whose_frames_no_emulated_ins_sends_is_not_written(tmp_path):
    for name in ("emulated.yaml", "gyrobench_ins.dbc"):
        source = find_document("stations", "emulated") if name.endswith("yaml") else shipped().dbc_path
        (tmp_path / name).write_text(source.read_text().replace('VERSION "', 'VERSION "other '))
    station = Station(tmp_path / "emulated.yaml")
    assert emulated_frames(station) is None
    assert not [o for o in serve_options(station, NOWHERE, False, None) if o.startswith("--frames")]
    with pytest.raises(DocumentError, match=r"no emulated INS sends the frames of gyrobench_ins\.dbc"):
        write_station_file(tmp_path / "out.yaml", station, TERMINALS, 1.0)
    assert not (tmp_path / "out.yaml").exists()


def test_the_file_names_its_origin(tmp_path):
    served(tmp_path, TERMINALS)
    text = (tmp_path / "served.yaml").read_text()
    assert text.startswith("# Written by `gyrobench emulate`")
    load_station_file(tmp_path / "served.yaml")


def test_the_gravity_of_the_emulated_bench_is_known(tmp_path):
    station = served(tmp_path, TERMINALS)
    assert not station.gravity_caution
    gravity, sigma = station.gravity_and_sigma
    assert gravity == pytest.approx(shipped().site.gravity, abs=0.1 * sigma)


@pytest.mark.parametrize("urls", [TERMINALS, TCP])
def test_each_unit_of_a_station_is_served(tmp_path, urls):
    options = serve_options(shipped("four_units"), NOWHERE, tcp=False, can=None)
    assert [each for each in options if "unit" in each or "event" in each] == [
        "--units=4",
        *(f"--power-event={event}" for event in (2, 3, 4, 5)),
    ]
    bus = "socketcand://127.0.0.1:2861{}/can0" if urls is TCP else "/dev/pts/20{}"
    more = {f"ins-{number}": bus.format(number) for number in (2, 3, 4)}
    station = served(tmp_path, urls | more, "four_units")
    assert len({unit.bus for unit in station.units}) == 4
    station.check_dbc()
    assert [unit.file.rate_table.mounting for unit in station.units] == [
        unit.file.rate_table.mounting for unit in shipped("four_units").units
    ]
