from pathlib import Path

import pytest

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.station.station import Station
from gyrobench.bench.station.station_file import load_station_file

NOISE = """  noise:
    angle_random_walk_deg_per_sqrt_h: 0.0006
    velocity_random_walk_ug_per_sqrt_hz: 5
"""


def test_virtual_time_needs_every_instrument_emulated(changed):
    path = changed(("port: emulator://chamber", "port: /dev/ttyUSB0"))
    with pytest.raises(DocumentError, match="clock: virtual requires emulated instruments only"):
        Station(path)


def test_every_mistake_is_listed_with_its_place(changed):
    path = changed(("latitude_deg: 36.4", "latitude_deg: 96.4"), ("dialect: watlow_f4", "dialect: watlow_f5"))
    with pytest.raises(DocumentError) as caught:
        Station(path)
    lines = str(caught.value).splitlines()
    assert len(lines) == 2
    assert "latitude_deg" in Path(path).read_text().splitlines()[int(lines[0].split(":")[1]) - 1]
    assert "watlow_f4" in lines[1]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "inner_axis: up",
            "inner_axis: west",
            r"yaml:\d+:3: the inner axis must be perpendicular .* \(east\); fo",
        ),
        (
            "dbc: gyrobench_ins",
            "dbc: C:\\me\\ins",
            r"'dbc' must be NAME.dbc, without a folder \(name of a DBC f",
        ),
    ],
)
def test_a_wrong_axis_and_a_dbc_file_with_a_folder_are_reported_in_plain_words(changed, old, new, message):
    with pytest.raises(DocumentError, match=message):
        Station(changed((old, new)))


def test_a_missing_dbc_file_is_reported_with_the_mistakes_of_the_file(changed):
    path = changed(("low_c: -50", "low_c: 95"), ("dbc: gyrobench_ins.dbc", "dbc: none.dbc"))
    with pytest.raises(DocumentError) as caught:
        Station(path)
    limits, dbc = str(caught.value).splitlines()
    assert "must be below high_c" in limits
    assert "DBC file 'none.dbc': neither beside the station file nor shipped" in dbc


def test_a_procedure_in_place_of_a_station_is_named_with_how_to_check_it(tmp_path):
    path = tmp_path / "of three.yaml"
    path.write_text("description: mine\nprocedure: three\nsteps: [power_off]\n")
    with pytest.raises(DocumentError) as caught:
        Station(path)
    assert str(caught.value) == (
        f"{path}:2:1: this is a procedure file, not a station file. Run it with: gyrobench run '{path}' "
        f"--station STATION, or check it with its bench: gyrobench check STATION --procedure '{path}'"
    )


def test_standard_gravity_in_place_of_that_of_the_bench_is_refused(changed):
    path = changed(
        ("latitude_deg: 36.4", "latitude_deg: 36.4, gravity_mps2: 9.80665"),
        (", gravity_uncertainty_mps2: 1.0e-6", ""),
    )
    with pytest.raises(DocumentError, match=r"station\.yaml:7:\d+: .*9.80665 m/s\^2 is standard gravity"):
        Station(path)


@pytest.mark.parametrize("latitude_deg", ["85.01", "-90", "135"])
def test_near_a_pole_the_place_of_the_latitude_and_its_range_are_reported(changed, latitude_deg):
    path = changed(("latitude_deg: 36.4", f"latitude_deg: {latitude_deg}"))
    with pytest.raises(DocumentError, match=r"station\.yaml:7:\d+: gyrocompassing fails .* -85 to 85 deg"):
        Station(path)


@pytest.mark.parametrize(
    ("noise", "message"),
    [
        ("guessed", 'write `estimated` .* or give angle_random_walk_deg_per_sqrt_h, .*; found "guessed"'),
        ("5", "write `estimated` .* found 5"),
        ("{angle_random_walk_deg_per_sqrt_h: 0}", "'angle_random_walk_deg_per_sqrt_h' must be above 0"),
        (
            "{angle_random_walk_deg_per_sqrt_h: 0.001, velocity_output_mps: -1}",
            "'velocity_output_mps' must be at least 0; found -1",
        ),
        ("{velocity_output_mps: 0.001}", "'angle_random_walk_deg_per_sqrt_h' is missing"),
        ("{angle_random_walk_deg_per_sqrt_h: 0.001, heading_output: 1}", "unknown key 'heading_output'"),
    ],
)
def test_noise_that_can_not_be_is_refused_in_one_line(changed, noise, message):
    path = changed((NOISE, f"  noise: {noise}\n"))
    with pytest.raises(DocumentError, match=message) as caught:
        Station(path)
    assert len(str(caught.value).splitlines()) == 1
    assert f"noise: {noise}" in Path(path).read_text().splitlines()[int(str(caught.value).split(":")[1]) - 1]


def test_noise_that_is_missing_is_reported_with_what_to_write(changed):
    with pytest.raises(
        DocumentError, match=r"the key 'noise' is missing: write `estimated` .* or give angle"
    ):
        Station(changed((NOISE, "")))


@pytest.mark.parametrize(
    ("key", "message"),
    [
        ("tilt_step_arcsec: -1", r"station\.yaml:\d+:\d+: 'tilt_step_arcsec' must be at least 0"),
        ("acelerometer_bias_ug: 1", "did you mean 'accelerometer_bias_ug'"),
    ],
)
def test_uncertainties_that_can_not_be_are_refused(changed, key, message):
    with pytest.raises(DocumentError, match=message):
        Station(changed((NOISE, f"{NOISE}  uncertainty: {{{key}}}\n")))


TABLE, CHAMBER = "emulator://table", "emulator://chamber"
INS = "interface: emulator\n  channel: ins"


@pytest.fixture
def station(changed):
    """Write the shipped station with other addresses, ten times as fast."""

    def write(
        table="/dev/pts/3", chamber="/home/bench/chamber", ins="interface: slcan\n  channel: /dev/pts/5"
    ):
        on_wall_clock = ("clock: virtual", "clock: wall\nspeed: 10")
        return changed(on_wall_clock, (TABLE, table), (CHAMBER, chamber), (INS, ins))

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
