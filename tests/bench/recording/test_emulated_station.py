from pathlib import Path

import pytest

from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.recording.emulated_station import guide
from gyrobench.bench.station.station import Station

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
