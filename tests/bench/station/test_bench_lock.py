"""Locks between real processes."""

import json
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from gyrobench.bench.foundations.clock import VirtualClock, WallClock
from gyrobench.bench.foundations.errors import BenchInUseError, GyrobenchError, UnusablePathError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.runs.locks import Holder, RunLock, holder_of
from gyrobench.bench.station.bench_lock import BenchLock, bench_holders
from gyrobench.bench.station.station import Station
from tests.bench.station.lock_holder import held_elsewhere


@pytest.fixture(autouse=True)
def lock_folder(tmp_path, monkeypatch):
    folder = tmp_path / "locks"
    folder.mkdir()
    monkeypatch.setenv("GYROBENCH_LOCK_DIR", str(folder))
    return folder


@pytest.fixture
def make_station(tmp_path):
    """``make_station(name, table, chamber, interface, channel)``."""

    def make(
        name="a", table="/dev/table", chamber="/dev/chamber", interface="slcan", channel="/dev/can@9600"
    ):
        text = find_document("stations", "emulated").read_text()
        for old, new in {
            "clock: virtual": "clock: wall",
            "emulator://table": table,
            "emulator://chamber": chamber,
            "interface: emulator": f"interface: {interface}",
            "channel: ins": f"channel: {channel}",
        }.items():
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / f"{name}.yaml"
        path.write_text(text)
        return Station(path)

    return make


def test_a_second_run_is_refused_with_all_that_is_known_of_the_first(make_station, tmp_path):
    station = make_station()
    with held_elsewhere(station, tmp_path / "run one") as (process, _):
        with pytest.raises(BenchInUseError) as caught, BenchLock(station, tmp_path, WallClock()):
            pass
        message = str(caught.value)
        first = tmp_path / "run one"
        assert message.endswith(f"or end it with `gyrobench control '{first}' abort`.")
        for part in (
            str(process.pid),
            str(tmp_path / "run one"),
            "gyrobench run x",
            os.uname().nodename,
            "20",
        ):
            assert part in message
        (holder,) = bench_holders(station)
        assert holder.pid == holder_of(tmp_path / "run one").pid == process.pid


def test_a_run_folder_is_held_once_and_free_after_its_end(make_station, tmp_path):
    run = tmp_path / "run"
    assert holder_of(run) is None
    with (
        held_elsewhere(make_station(), run),
        pytest.raises(BenchInUseError, match="run folder"),
        RunLock(run, WallClock()),
    ):
        pass
    assert holder_of(run) is None


def test_a_lock_left_by_a_killed_process_is_taken_over_and_named(make_station, tmp_path):
    station, run = make_station(), tmp_path / "run"
    with held_elsewhere(station, run) as (process, _):
        process.kill()
        process.join()
        assert bench_holders(station) == []
        with BenchLock(station, run, WallClock()) as lock, RunLock(run, WallClock()) as run_lock:
            (note,), (run_note,) = lock.taken_over, run_lock.taken_over
            assert note.startswith("locks taken over: ")
            assert f"process {process.pid}" in note
            assert f"process {process.pid}" in run_note
            assert all(port in note for port in ("/dev/table", "/dev/chamber", "/dev/can"))


def test_a_lock_that_was_released_is_no_lock_left_behind(make_station, tmp_path):
    station = make_station()
    with BenchLock(station, tmp_path, WallClock()):
        assert [holder.pid for holder in bench_holders(station)] == [os.getpid()]
    with BenchLock(station, tmp_path, WallClock()) as lock:
        assert lock.taken_over == []


def test_two_names_of_one_device_are_one_lock(make_station, tmp_path):
    device, link = tmp_path / "ttyUSB0", tmp_path / "by-id"
    device.touch()
    link.symlink_to(device)
    one, other = (
        make_station("one", table=str(device)),
        make_station("other", str(link), "/dev/c2", "socketcan", "can7"),
    )
    with (
        held_elsewhere(one, tmp_path / "run"),
        pytest.raises(BenchInUseError, match="rate table's port"),
        BenchLock(other, tmp_path, WallClock()),
    ):
        pass


def test_a_link_stays_locked_when_its_device_comes_back_under_another_name(make_station, tmp_path):
    link = tmp_path / "by-id"
    link.symlink_to("ttyUSB0")
    station = make_station("bench", table=str(link))
    with held_elsewhere(station, tmp_path / "run"):
        link.unlink()
        link.symlink_to("ttyUSB1")
        other = make_station("other", str(link), "/dev/c2", "socketcan", "can7")
        assert [holder.run for holder in bench_holders(other)] == [str(tmp_path / "run")]
        with pytest.raises(BenchInUseError, match="rate table's port"):
            BenchLock(other, tmp_path, WallClock()).__enter__()


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("socket://localhost:9878", "socket://127.0.0.1:9878"),
        ("socket://localhost:9878", "socket://[::1]:9878"),
        ("socket://127.0.0.1", "socket://localhost:9878"),
        ("rfc2217://LOCALHOST:4000", "rfc2217://127.0.0.1:4000?logging=info"),
    ],
)
def test_two_names_of_one_address_are_one_lock(make_station, tmp_path, one, other):
    stations = make_station("one", one), make_station("other", other, "/dev/c2", "socketcan", "can7")
    with (
        held_elsewhere(stations[0], tmp_path / "run"),
        pytest.raises(BenchInUseError, match="rate table's port"),
        BenchLock(stations[1], tmp_path, WallClock()),
    ):
        pass


def test_a_refused_run_holds_nothing(make_station, tmp_path):
    one = make_station("one")
    other = make_station(
        "other", table="/dev/other", chamber="/dev/chamber", interface="socketcan", channel="can7"
    )
    third = make_station(
        "third", table="/dev/other", chamber="/dev/c3", interface="socketcan", channel="can7"
    )
    with held_elsewhere(one, tmp_path / "run"):
        with pytest.raises(BenchInUseError, match="chamber's port"), BenchLock(other, tmp_path, WallClock()):
            pass
        with BenchLock(third, tmp_path, WallClock()):
            pass


@pytest.mark.parametrize(
    ("ports", "shared"),
    [
        ({"table": "socket://Host:9878", "chamber": "/dev/b"}, {"table": "socket://host:9878?logging=info"}),
        ({"interface": "socketcan", "channel": "can0"}, {"interface": "socketcan", "channel": "can0"}),
        ({"channel": "/dev/can"}, {"table": "/dev/can", "interface": "socketcan", "channel": "can0"}),
    ],
)
def test_ports_are_known_again_however_they_are_written(make_station, tmp_path, ports, shared):
    different = {"table": "/dev/t2", "chamber": "/dev/c2", "channel": "/dev/can2"}
    with BenchLock(make_station("one", **ports), tmp_path, WallClock()):
        with pytest.raises(BenchInUseError):
            BenchLock(make_station("two", **(different | shared)), tmp_path, WallClock()).__enter__()
        with BenchLock(make_station("three", **different), tmp_path, WallClock()):
            pass


def test_one_waits_for_a_holder_that_will_let_go(make_station, tmp_path):
    station = make_station()
    with held_elsewhere(station, tmp_path / "run") as (_, pipe):
        pipe.send("let go")
        with BenchLock(station, tmp_path, WallClock(), patience_s=20.0) as lock:
            assert lock.taken_over == []


def test_an_emulated_bench_needs_no_lock(tmp_path, lock_folder):
    station = Station(find_document("stations", "emulated"))
    with BenchLock(station, tmp_path, VirtualClock()), BenchLock(station, tmp_path, VirtualClock()):
        assert list(lock_folder.iterdir()) == []


def test_a_link_planted_in_place_of_a_lock_is_not_followed(make_station, tmp_path, lock_folder):
    station, victim = make_station(), tmp_path / "victim"
    victim.write_text("precious")
    with BenchLock(station, tmp_path, WallClock()):
        names = [path.name for path in lock_folder.iterdir()]
    assert len(names) == 3
    for name in names:
        (lock_folder / name).unlink()
        (lock_folder / name).symlink_to(victim)
    with pytest.raises(GyrobenchError, match="can't be used as a lock"):
        BenchLock(station, tmp_path, WallClock()).__enter__()
    assert victim.read_text() == "precious"


def test_a_run_folder_that_can_not_be_written_has_another_remedy_than_a_lock_of_the_bench():
    with pytest.raises(
        UnusablePathError, match=r"/proc/\.lock: can't be .* Check the permissions of the run"
    ):
        RunLock(Path("/proc"), WallClock()).__enter__()


@pytest.mark.parametrize("plant", [os.link, lambda victim, path: os.mkfifo(path)])
def test_what_else_is_planted_in_place_of_a_lock_is_left_alone(make_station, tmp_path, lock_folder, plant):
    station, victim = make_station(), tmp_path / "victim"
    victim.write_text("precious")
    with BenchLock(station, tmp_path, WallClock()):
        path = min(lock_folder.iterdir())
    path.unlink()
    plant(victim, path)
    with pytest.raises(GyrobenchError, match="not an ordinary file"):
        BenchLock(station, tmp_path, WallClock()).__enter__()
    assert victim.read_text() == "precious"


def test_what_anybody_may_have_written_into_a_lock_does_no_harm(make_station, tmp_path, lock_folder):
    station = make_station()
    holder = Holder(1, "me", "here", "\x1b[2Jrm", "run", "then")
    with BenchLock(station, tmp_path, WallClock()):
        names = sorted(path.name for path in lock_folder.iterdir())
    for name, text in zip(names, (json.dumps(vars(holder)), "[1, 2", '{"pid": "x"}'), strict=True):
        (lock_folder / name).write_text(text)
    with BenchLock(station, tmp_path, WallClock()) as lock:
        (note,) = lock.taken_over
        assert "?[2Jrm" in note
        assert "\x1b" not in note


def test_lock_files_are_for_every_user_of_the_machine(make_station, tmp_path, lock_folder):
    with BenchLock(make_station(), tmp_path, WallClock()):
        assert {path.stat().st_mode & 0o777 for path in lock_folder.iterdir()} == {0o666}


def test_checks_of_one_lock_by_many_threads_never_take_each_other_for_a_holder(make_station, tmp_path):
    run = tmp_path / "run"
    with held_elsewhere(make_station(), run) as (process, _):
        process.kill()  # its name stays in the file
        process.join()
        with ThreadPoolExecutor(8) as pool:
            assert set(pool.map(lambda _: holder_of(run), range(400))) == {None}
