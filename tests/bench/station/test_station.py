from pathlib import Path

import numpy as np
import pytest

from bench.clock import VirtualClock, WallClock
from bench.documents import find_document
from bench.errors import ConnectionFailedError, DocumentError
from bench.station.instruments import Emulation, Instruments
from bench.station.station import Station

SHIPPED = find_document("stations", "emulated")


def changed(tmp_path, *pairs):
    text = SHIPPED.read_text()
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "station.yaml"
    path.write_text(text)
    return path


def test_the_shipped_station_reaches_all_six_positions_at_azimuth_zero_and_half_a_turn():
    limits = Station(SHIPPED).limits()
    for position in ("z_up", "z_down", "y_up", "y_down", "x_up", "x_down"):
        for azimuth_deg in (0.0, 180.0):
            assert limits.reachable(position, azimuth_deg, (180.0,)) is None


def test_a_table_with_a_vertical_outer_axis_says_which_positions_it_can_not_reach(tmp_path):
    path = changed(tmp_path, ("outer_axis: east", "outer_axis: up"), ("inner_axis: up", "inner_axis: east"))
    limits = Station(path).limits()
    assert limits.reachable("z_up", 0.0, (90.0, 90.0)) is None
    assert "can't reach" in limits.reachable("x_up", 0.0, ())


def test_a_left_handed_mounting_is_an_error_with_its_place(tmp_path):
    path = changed(tmp_path, ("y: north, z: up", "y: south, z: up"))
    with pytest.raises(DocumentError, match=r"station\.yaml:\d+:\d+: .*right-handed"):
        Station(path)


def test_virtual_time_needs_every_instrument_emulated(tmp_path):
    path = changed(tmp_path, ("port: emulator://chamber", "port: /dev/ttyUSB0"))
    with pytest.raises(DocumentError, match="clock: virtual needs every instrument emulated"):
        Station(path)


def test_every_mistake_is_listed_with_its_place(tmp_path):
    path = changed(
        tmp_path, ("latitude_deg: 36.4", "latitude_deg: 96.4"), ("dialect: watlow_f4", "dialect: watlow_f5")
    )
    with pytest.raises(DocumentError) as caught:
        Station(path)
    lines = str(caught.value).splitlines()
    assert len(lines) == 2
    assert "latitude_deg" in Path(path).read_text().splitlines()[int(lines[0].split(":")[1]) - 1]
    assert "watlow_f4" in lines[1]


def test_an_absent_dbc_file_is_named(tmp_path):
    path = changed(tmp_path, ("dbc: gyrobench_ins.dbc", "dbc: absent.dbc"))
    with pytest.raises(DocumentError, match=r"absent\.dbc"):
        Station(path).dbc_path  # noqa: B018


def test_outer_and_inner_follow_the_controllers_axis_numbers(tmp_path):
    path = changed(
        tmp_path,
        ("outer_axis_number: 1", "outer_axis_number: 2"),
        ("inner_axis_number: 2", "inner_axis_number: 1"),
    )
    station = Station(path)
    assert station.by_axis_number((10.0, 20.0)) == {2: 10.0, 1: 20.0}
    assert station.table_axes_of((20.0, 10.0)) == (10.0, 20.0)


def test_gravity_is_that_of_the_bench():
    assert Station(SHIPPED).gravity == pytest.approx(9.79835, abs=1e-4)


def test_instruments_are_opened_on_the_runs_clock_and_name_themselves():
    clock = VirtualClock()
    with Instruments(Station(SHIPPED), clock, Emulation("ideal", 0)) as instruments:
        assert "Acutr" in instruments.table.identify()
        assert "5270" in instruments.chamber.identify()
        instruments.power_unit(True)
        clock.sleep(20.0)
        assert instruments.ins.identity()["serial_number"] == 1000
        np.testing.assert_allclose(instruments.chamber.read().temperature_c, 23.0, atol=0.1)


def test_a_port_that_can_not_be_opened_names_instrument_and_port(tmp_path):
    path = changed(
        tmp_path, ("port: emulator://table", "port: /dev/does-not-exist"), ("clock: virtual", "clock: wall")
    )
    with pytest.raises(ConnectionFailedError, match=r"rate table: can't open /dev/does-not-exist"):
        Instruments(Station(path), WallClock(), Emulation())


def test_an_absent_world_lists_the_shipped_ones():
    with pytest.raises(DocumentError, match="gyro_a"):
        Instruments(Station(SHIPPED), VirtualClock(), Emulation("absent", 0))
