import numpy as np
import pytest

from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.engine.preflight.bench_check import check_bench
from gyrobench.bench.foundations.clock import VirtualClock, WallClock
from gyrobench.bench.foundations.errors import ConnectionFailedError, DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.procedure.procedure_file import load_procedure
from gyrobench.bench.station.check_result import CheckVerdict
from gyrobench.bench.station.instruments import Emulation, Instruments
from gyrobench.bench.station.safe_state import make_safe
from gyrobench.bench.station.station import Station

SHIPPED = find_document("stations", "emulated")
NOISE = """  noise:
    angle_random_walk_deg_per_sqrt_h: 0.0006
    velocity_random_walk_ug_per_sqrt_hz: 5
"""


def test_the_shipped_station_reaches_all_six_positions_at_azimuth_zero_and_half_a_turn():
    limits = Station(SHIPPED).limits()
    for position in ("z_up", "z_down", "y_up", "y_down", "x_up", "x_down"):
        for azimuth_deg in (0.0, 180.0):
            assert limits.unreachable_reason(position, azimuth_deg, (180.0,)) is None


@pytest.mark.parametrize("name", ["emulated", "example_bench"])
def test_shipped_stations_are_right(name):
    Station(find_document("stations", name)).check_dbc()


def test_a_table_with_a_vertical_outer_axis_says_which_positions_it_can_not_reach(changed):
    path = changed(("outer_axis: east", "outer_axis: up"), ("inner_axis: up", "inner_axis: east"))
    limits = Station(path).limits()
    assert limits.unreachable_reason("z_up", 0.0, (90.0, 90.0)) is None
    assert "can't reach" in limits.unreachable_reason("x_up", 0.0, ())


@pytest.mark.parametrize(
    ("name", "key"),
    [("emulated", "chamber_event"), ("emulated_f4t", "chamber_output"), ("four_units", "chamber_event")],
)
def test_an_output_of_the_chamber_does_not_feed_the_unit_too(tmp_path, name, key):
    path = tmp_path / "station.yaml"
    path.write_text(find_document("stations", name).read_text().replace("power_event: 2", "power_event: 1"))
    with pytest.raises(DocumentError, match=rf"output 1 switches the chamber itself, by chamber\.{key}"):
        _ = Station(path).units


def test_one_port_for_table_and_chamber_is_an_error_with_its_place(changed):
    path = changed(("port: emulator://chamber", "port: emulator://table"))
    with pytest.raises(
        DocumentError, match=r"station\.yaml:\d+:\d+: the rate table has the port emulator://table"
    ):
        Station(path)


def test_a_left_handed_mounting_is_an_error_with_its_place(changed):
    path = changed(("y: north, z: up", "y: south, z: up"))
    with pytest.raises(DocumentError, match=r"station\.yaml:\d+:\d+: .*right-handed"):
        Station(path)


@pytest.mark.parametrize(
    ("value", "put", "message"),
    [
        ("chamber_c: 23", "chamber_c: 90", "safe_state.chamber_c (90) is outside the chamber's limits"),
        (
            "safe_state:",
            "interlocks:\n  chamber_air: {high_c: 30}\nsafe_state:",
            "interlocks.chamber_air trips",
        ),
    ],
)
def test_a_value_that_contradicts_another_is_reported_at_its_own_place(changed, value, put, message):
    text = changed((value, put)).read_text()
    at = text.index("chamber_air" if "air" in put else put)
    line, column = text[:at].count("\n") + 1, at - text.rindex("\n", 0, at)
    with pytest.raises(DocumentError) as raised:
        Station(changed((value, put)))
    assert f"station.yaml:{line}:{column}: {message}" in str(raised.value)
    assert "; found" not in str(raised.value)


@pytest.mark.parametrize(
    ("found", "put", "message"),
    [
        (
            "port: emulator://chamber",
            "port: socket://anna:word@192.168.0.7:4001",
            "can't hold a user or password",
        ),
        ("port: emulator://chamber", "port: rfc2217://anna@host:4001", "can't hold a user or password"),
        ("channel: ins", "channel: http://anna:word@host", "can't hold a user or password"),
        ("channel: ins", "channel: ins\n  options: {password: word}", "looks like a secret"),
        ("dbc: gyrobench_ins.dbc", "dbc: ../secret.dbc", "must be NAME.dbc, without a folder"),
        ("dbc: gyrobench_ins.dbc", "dbc: procedure.yaml", "must be NAME.dbc, without a folder"),
        ("inner_deg: [-380, 380]", "inner_deg: [380, -380]", "the lower end comes first"),
    ],
)
def test_what_must_not_be_in_a_station_file_is_refused_with_its_place(changed, found, put, message):
    path = changed((found, put))
    with pytest.raises(DocumentError, match=rf"station\.yaml:\d+:\d+: .*{message}"):
        Station(path)


def test_outer_and_inner_follow_the_controllers_axis_numbers(changed):
    path = changed(
        ("outer_axis_number: 1", "outer_axis_number: 2"), ("inner_axis_number: 2", "inner_axis_number: 1")
    )
    station = Station(path)
    assert station.by_axis_number((10.0, 20.0)) == {2: 10.0, 1: 20.0}
    assert station.table_axes_of((20.0, 10.0)) == (10.0, 20.0)


def test_site_is_that_of_the_bench():
    site = Station(SHIPPED).site
    assert (np.degrees(site.latitude), site.height) == (pytest.approx(36.4), 60.0)
    assert site.gravity == pytest.approx(9.79835, abs=1e-4)


@pytest.mark.parametrize("latitude_deg", ["85", "-85", "0"])
def test_a_bench_may_stand_wherever_an_ins_can_gyrocompass(changed, latitude_deg):
    station = Station(changed(("latitude_deg: 36.4", f"latitude_deg: {latitude_deg}")))
    assert np.degrees(station.site.latitude) == pytest.approx(float(latitude_deg))


def test_declared_noise_adds_to_that_of_the_resolution(changed):
    output = (
        "{angle_random_walk_deg_per_sqrt_h: 0.003, velocity_output_mps: 0.004, heading_output_deg: 0.001}"
    )
    noise = Station(changed((NOISE, f"  noise: {output}\n"))).noise(0.003 * 12**0.5, 0.0)
    assert noise.angle_random_walk == pytest.approx(np.radians(0.003) / 60.0)
    assert noise.velocity_random_walk == 0.0
    assert noise.velocity_white == pytest.approx(0.005)
    assert noise.heading_white == pytest.approx(np.radians(0.001))


def test_noise_may_be_left_to_the_dwells(changed):
    path = changed((NOISE, "  noise: estimated\n"))
    assert Station(path).noise(1e-4, 1e-7) is None


@pytest.mark.parametrize("procedure", ["turn_on_repeatability", "warm_up"])
def test_power_cycles_are_not_tested_with_an_ins_that_is_always_on(changed, procedure):
    station = Station(changed(("power: chamber_event", "power: always_on")))
    with pytest.raises(DocumentError, match=r"stays on \(unit.power: always_on\)"):
        station.plan(*load_procedure(find_document("procedures", procedure)))


def test_what_is_known_beforehand_comes_from_location_and_ins(changed):
    uncertainty = (
        "{accelerometer_bias_ug: 50, accelerometer_misalignment_arcsec: 4, gyro_scale_factor_ppm: 1, "
        "gyro_misalignment_arcsec: 3, tilt_step_arcsec: 0, bias_slope_dph_per_c: 0.002}"
    )
    path = changed(
        ("latitude_uncertainty_arcmin: 0.02", "latitude_uncertainty_arcmin: 1.5"),
        (NOISE, f"{NOISE}  uncertainty: {uncertainty}\n"),
    )
    assert Station(path).prior() == PriorKnowledge.from_datasheet(
        accelerometer_bias_ug=50.0,
        gyro_scale_factor_ppm=1.0,
        gyro_misalignment_arcsec=3.0,
        tilt_step_arcsec=0.0,
        latitude_arcmin=1.5,
        bias_slope_dph_per_c=0.002,
        accelerometer_misalignment_arcsec=4.0,
    )


def test_without_a_word_on_uncertainty_the_usual_sizes_hold(changed):
    assert (
        Station(changed((", latitude_uncertainty_arcmin: 0.02", ""))).prior()
        == PriorKnowledge.from_datasheet()
    )


def test_instruments_are_opened_on_the_runs_clock_and_name_themselves():
    clock = VirtualClock()
    with Instruments(Station(SHIPPED), clock, Emulation("ideal", 0)) as instruments:
        assert "Acutr" in instruments.table.identify()
        assert "5270" in instruments.chamber.identify()
        instruments.power_unit(True)
        clock.sleep(20.0)
        assert instruments.ins.identity()["serial_number"] == 1000
        np.testing.assert_allclose(instruments.chamber.read().temperature_c, 23.0, atol=0.1)


def test_a_port_that_can_not_be_opened_names_instrument_and_port(changed):
    path = changed(("port: emulator://table", "port: /dev/does-not-exist"), ("clock: virtual", "clock: wall"))
    with pytest.raises(ConnectionFailedError, match=r"rate table: can't open /dev/does-not-exist"):
        Instruments(Station(path), WallClock(), Emulation())


def test_an_absent_world_lists_the_shipped_ones():
    with pytest.raises(DocumentError, match="gyro_a"):
        Instruments(Station(SHIPPED), VirtualClock(), Emulation("absent", 0))


def test_a_station_in_virtual_time_has_a_clock_that_jumps():
    assert isinstance(Station(SHIPPED).new_clock(), VirtualClock)


@pytest.mark.parametrize(("clock", "speed"), [("clock: wall", 1.0), ("clock: wall\nspeed: 20", 20.0)])
def test_a_station_in_real_time_has_a_clock_of_its_speed(changed, clock, speed):
    made = Station(changed(("clock: virtual", clock))).new_clock()
    assert isinstance(made, WallClock)
    assert made.speed == speed


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("gyrobench_ins.dbc", "canaerospace.dbc", r"'canaerospace.dbc' has none of the messages in"),
        ("GYRO_OPTICS_TEMPERATURE", "GYRO_TEMPERATURE", "no message 'GYRO_TEMPERATURE'"),
    ],
)
def test_what_the_dbc_file_lacks_is_reported_once(tmp_path, old, new, message):
    text = find_document("stations", "emulated").read_text()
    path = tmp_path / "mine.yaml"
    path.write_text(text.replace(old, new))
    with pytest.raises(DocumentError, match=message) as wrong:
        Station(path).check_dbc()
    assert len(str(wrong.value).splitlines()) == 1


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
