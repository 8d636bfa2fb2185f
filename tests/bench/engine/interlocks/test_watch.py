import math
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.engine.bench_state import ExpectedState
from gyrobench.bench.engine.interlocks.watch import text_of_trips
from gyrobench.bench.station.station import Station
from gyrobench.drivers.ins.readout import InsMode
from tests.bench.engine.interlocks.watched_bench import ALL_WELL, WatchedBench, air, at


@pytest.fixture
def bench(watched):
    return watched()


def set_values(thing, **values):
    for name, value in values.items():
        setattr(thing, name, value)


def optics(axis, value_c):
    values = np.full(3, 30.0)
    values[axis] = value_c
    return values


def _bench(**values):
    return lambda bench: set_values(bench, **values)


def _chamber(*values, **alarms):
    return _bench(chamber=air(*values, **alarms))


def _table(*values, **faults):
    return _bench(table=at(*values, **faults))


def _ins(**values):
    return lambda bench: set_values(bench.ins, **values)


WRONG = {
    "air too warm": (_chamber(80.2, 20.0, True), "chamber_air", ["80.2", "80 degC"]),
    "air too cold": (_chamber(-55.3, 20.0, True), "chamber_air", ["-55.3", "-55 degC"]),
    "air not a number": (_chamber(math.nan, 20.0, True), "chamber_air", ["unknown", "-55 and 80"]),
    "case too warm": (_ins(case_c=95.5), "case_temperature", ["95.5", "95 degC"]),
    "gyro too cold": (_ins(optics_c=optics(1, -61.0)), "gyro_temperature", ["gyro y", "-61.0", "-60"]),
    "board too warm": (_ins(electronics_c=optics(2, 120.0)), "gyro_temperature", ["gyro z", "120.0", "95"]),
    "outer angle": (_table((201.5, 0.0), (0.0, 0.0)), "outer_angle", ["201.5", "201 deg"]),
    "inner angle": (_table((0.0, -390.0), (0.0, 0.0)), "inner_angle", ["-390.0", "-381 deg"]),
    "angle not a number": (_table((math.nan, 0.0), (0.0, 0.0)), "outer_angle", ["unknown", "201"]),
    "rate": (_table((0.0, 0.0), (0.0, -34.0)), "table_rate", ["-34.0", "-33.5"]),
    "fault": (_table((0.0, 0.0), (0.0, 0.0), faults=("axis 1: rate trip",)), "table_fault", ["rate trip"]),
    "servos open": (_table((0.0, 0.0), (0.0, 0.0), False), "table_fault", ["servo control"]),
    "alarm": (_chamber(20.0, 20.0, True, alarms=("alarm 1",)), "chamber_alarm", ["alarm 1"]),
    "switched off": (_chamber(20.0, 20.0, False), "chamber_command", ["is off", "switched it on"]),
    "other set point": (_chamber(20.0, 25.0, True), "chamber_command", ["25 degC", "20 degC", "0.6 K"]),
    "fault of the INS": (_ins(mode=InsMode.FAULT), "ins_fault", ["reports a fault"]),
    "silent INS": (_ins(age_s=5.5), "ins_silence", ["6 s; the limit is 5 s"]),
    "INS that never spoke": (_ins(age_s=math.inf), "ins_silence", ["10 s; the limit is 5 s"]),
}


@pytest.mark.parametrize(("make_wrong", "name", "words"), WRONG.values(), ids=WRONG)
def test_each_interlock_trips_alone_and_names_value_and_limit_until_it_is_good_again(
    bench, make_wrong, name, words
):
    assert bench.poll() == {}
    good = {key: getattr(bench, key) for key in ("table", "chamber")}
    good["ins"] = replace(bench.ins)
    make_wrong(bench)
    trips = bench.poll()
    assert list(trips) == [name]
    assert all(word in trips[name].text for word in words), trips[name].text
    assert list(bench.trips()) == [name], "it trips at every tick"
    set_values(bench, **good)
    assert bench.poll() == {}


@pytest.mark.parametrize("case", [case for case in WRONG if WRONG[case][1] != "ins_silence"])
def test_what_is_wrong_before_the_first_step_trips_at_once(watched, case):
    make_wrong, name, _ = WRONG[case]
    bench = watched()
    bench.expected = replace(bench.expected, chamber_set_c=None, chamber_on=None, table_prepared=False)
    make_wrong(bench)
    of_command = name in ("chamber_command", "table_fault")
    assert list(bench.poll(0.0)) == ([] if of_command else [name])
    bench.expected = ALL_WELL
    bench.poll(1.0)
    assert list(bench.poll(1.0)) == [name]


def test_an_ins_that_was_off_may_have_been_silent_until_now(bench):
    bench.expected, bench.ins.age_s = replace(bench.expected, ins_on=False), math.inf
    assert bench.poll() == {}
    bench.expected = ALL_WELL
    bench.clock.sleep(8.0)
    assert bench.trips() == {}
    assert bench.poll(4.0) == {}
    assert list(bench.poll(2.0)) == ["ins_silence"]
    bench.ins.age_s = 0.1
    assert bench.poll(1.0) == {}


def test_what_was_not_commanded_yet_trips_nothing(bench):
    bench.expected = ExpectedState()
    bench.chamber = air(20.0, -40.0, False)
    bench.table = at((0, 0), (0, 0), False, faults=("axis 1: interlock 1",))
    bench.ins.age_s = math.inf
    assert bench.poll() == {}


def test_an_instrument_is_held_to_a_command_only_by_readings_that_came_after_it(bench):
    bench.poll()
    bench.expected = replace(bench.expected, chamber_set_c=60.0)
    assert bench.trips() == {}
    bench.clock.sleep(1.0)
    assert bench.trips() == {}
    assert "chamber_command" in bench.poll()
    bench.chamber = air(20.5, 60.0, True)
    assert bench.poll() == {}


@pytest.mark.parametrize("silent", ["table", "chamber"])
def test_values_that_are_too_old_trip(bench, silent):
    bench.poll()
    others = [name for name in ("table", "chamber") if name != silent]
    assert bench.poll(40.0, others) == {}
    trips = bench.poll(1.0, others)
    assert list(trips) == [f"{silent}_silence"]
    assert "silent for 41 s; the limit is 40 s" in trips[f"{silent}_silence"].text
    assert bench.poll(1.0) == {}


def test_a_chamber_that_reports_a_faulty_sensor_is_not_called_silent(bench):
    bench.poll()
    bench.chamber = replace(bench.chamber, alarms=("error of the sensor",))  # its last temperature
    assert list(bench.poll(100.0, ["table"])) == ["chamber_alarm"]


def test_everything_trips_without_polls(bench):
    bench.poll()
    bench.clock.sleep(60.0)
    assert list(bench.trips()) == ["table_silence", "chamber_silence", "ins_silence"]


def test_an_ins_that_is_off_trips_nothing(bench):
    bench.expected = replace(bench.expected, ins_on=False)
    bench.ins.age_s, bench.ins.case_c, bench.ins.optics_c = 1e4, math.nan, np.full(3, math.nan)
    assert bench.poll_for(300.0) == {}


def test_a_temperature_that_stays_unknown_trips_but_not_at_once_after_power_on(bench):
    bench.ins.case_c = math.nan
    assert bench.poll(1.0) == {}
    trips = bench.poll(10.0)
    assert list(trips) == ["case_temperature"]
    assert "unknown" in trips["case_temperature"].text
    assert "-60 and 95 degC" in trips["case_temperature"].text


def test_temperatures_that_come_after_the_first_reading_of_an_ins_trip_nothing_before_the_next(bench):
    bench.ins.case_c = math.nan
    assert bench.poll(1.0) == {}
    bench.clock.sleep(9.0)
    assert bench.trips() == {}
    bench.ins.case_c = 28.0
    assert bench.poll(1.0) == {}


def test_temperatures_that_the_signal_map_has_not_trip_nothing(watched):
    bench = watched(name="example_bench")
    bench.ins.electronics_c, bench.ins.case_c = np.full(3, math.nan), math.nan
    assert bench.poll_for(300.0) == {}


def test_an_opened_door_trips_and_is_good_again_a_window_after_the_air_is_steady(bench):
    bench.poll_for(120.0)
    bench.chamber = air(35.0, 20.0, True)
    trips = bench.poll()
    assert list(trips) == ["chamber_air_rate"]
    assert "15.0 degC/min; the limit is 8 degC/min" in trips["chamber_air_rate"].text
    assert trips["chamber_air_rate"].rule.resume == "automatic"
    assert bench.poll_for(70.0) == {}


@pytest.mark.parametrize("what", ["case", "gyro"])
def test_a_unit_that_warms_too_fast_trips(watched, what):
    bench = watched(f"\ninterlocks:\n  {what}_rate: {{limit_c_per_min: 2}}\n")
    trips = {}
    for minute in range(5):
        bench.ins.case_c, bench.ins.optics_c = 28.0 + 2.5 * minute, np.full(3, 30.0 + 2.5 * minute)
        trips = bench.poll_for(60.0, 60.0)
    assert list(trips) == [f"{what}_rate"]
    assert "limit is 2 degC/min" in trips[f"{what}_rate"].text


def test_resolution_and_noise_of_the_sensors_trip_nothing(watched):
    bench = watched(
        "\ninterlocks:\n  chamber_air_rate: {limit_c_per_min: 5}\n  gyro_rate: {limit_c_per_min: 0.5}\n"
    )
    generator = np.random.default_rng(5)
    for index in range(500):
        bench.chamber = air(20.0 + 0.1 * (index % 2), 20.0, True)
        bench.ins.optics_c = 30.0 + 0.003 * generator.standard_normal(3)
        assert bench.poll(1.0) == {}


def test_a_table_that_is_torn_from_its_rate_trips(bench):
    bench.table = at((0.0, 0.0), (30.0, 0.0))
    bench.poll(1.0)
    bench.table = at((0.0, 0.0), (-30.0, 0.0))
    trips = bench.poll(1.0)
    assert list(trips) == ["table_acceleration"]
    assert "-60.0 deg/s2, below the limit of -45 deg/s2" in trips["table_acceleration"].text


def test_a_stopped_table_trips_as_soon_as_it_moves_after_its_rest(bench):
    at_rest, turning = bench.table, replace(bench.table, rate_dps=(0.0, 0.3))
    bench.expected = replace(bench.expected, table_prepared=False, table_stopped=True)
    assert bench.poll() == {}
    bench.table = turning
    assert bench.poll(2.0) == {}, "it may still come to rest"
    bench.table = at_rest
    assert bench.poll(2.0) == {}
    bench.table = turning
    trips = bench.poll(2.0)
    assert list(trips) == ["table_fault"]
    assert "turns at 0.30 deg/s although the table was stopped" in trips["table_fault"].text


def test_a_stopped_table_that_does_not_come_to_rest_in_its_time_trips(bench):
    bench.expected = replace(bench.expected, table_prepared=False, table_stopped=True)
    assert bench.poll() == {}
    bench.table = replace(bench.table, rate_dps=(0.0, 0.3))
    assert bench.poll_for(30.0) == {}
    assert list(bench.poll(2.0)) == ["table_fault"]


def test_the_axes_are_distinguished_by_the_controllers_numbers(station_of, tmp_path):
    straight = station_of()
    text = straight.path.read_text()
    for axis, number in (("outer", 2), ("inner", 1)):
        text = text.replace(f"{axis}_axis_number: {3 - number}", f"{axis}_axis_number: {number}")
    (tmp_path / "crossed.yaml").write_text(text)
    for station, tripped in ((straight, ["outer_angle"]), (Station(tmp_path / "crossed.yaml"), [])):
        bench = WatchedBench(station)
        bench.table = at((300.0, 0.0), (0.0, 0.0))
        assert list(bench.poll()) == tripped


def test_the_time_since_an_interlock_is_good_is_known(bench):
    bench.poll(10.0)
    assert bench.watch.untripped_since_s("chamber_alarm") == 10.0
    bench.chamber = air(20.0, 20.0, True, alarms=("alarm 1",))
    bench.poll(10.0)
    assert bench.watch.untripped_since_s("chamber_alarm") is None
    bench.chamber = air(20.0, 20.0, True)
    bench.poll(10.0)
    bench.poll(10.0)
    assert bench.watch.untripped_since_s("chamber_alarm") == 30.0


def test_the_station_file_sets_the_rules(watched):
    bench = watched(
        "\ninterlocks:\n  chamber_alarm: {resume: automatic, resume_after_s: 900, max_resumes: 2}\n"
        "  chamber_air: {high_c: 76}\n"
    )
    bench.chamber = air(76.5, 20.0, True, alarms=("alarm 1",))
    trips = bench.poll()
    rule = trips["chamber_alarm"].rule
    assert (rule.resume, rule.resume_after_s, rule.max_resumes) == ("automatic", 900.0, 2)
    assert "above the limit of 76 degC" in trips["chamber_air"].text
    assert trips["chamber_air"].rule.resume == "person"


def test_air_that_leaves_a_set_point_that_it_had_reached_trips(bench):
    bench.poll()
    bench.chamber = air(26.0, 20.0, True)
    assert "chamber_deviation" not in bench.poll()  # on its way
    bench.expected = replace(bench.expected, chamber_reached=True)
    trip = bench.poll()["chamber_deviation"]
    assert all(word in trip.text for word in ("26.0", "+6.0 K", "5 K"))


def test_what_is_wrong_in_many_places_is_advised_once(station_of):
    bench = WatchedBench(station_of())
    bench.ins.optics_c = bench.ins.electronics_c = np.full(3, 200.0)
    bench.ins.case_c = 200.0
    text = text_of_trips(bench.poll().values())
    assert text.count("Check the sensor and the signal map; let the unit return") == 1
    assert text.count("above the limit") == 7
    assert ".;" not in text


@pytest.mark.parametrize("seed", [0, *(pytest.param(each, marks=pytest.mark.long) for each in range(1, 5))])
def test_ticks_between_readings_find_what_a_whole_evaluation_finds(watched, seed):
    random = np.random.default_rng(seed)
    bench, evaluated = watched(), watched()
    seen = set()
    for _ in range(300):
        answering = [name for name in ("table", "chamber") if random.random() < 0.7]
        ins_on, age_s = bool(random.random() < 0.9), float(random.choice([0.5, 0.5, 4.0, 7.0]))
        air_c = float(random.choice([20.0, 20.0, 20.0, 30.0]))
        reads, ticks = random.random() < 0.8, int(random.integers(1, 60))
        for each in (bench, evaluated):
            each.ins.age_s, each.chamber = age_s, air(air_c, 20.0, True)
            each.expected = replace(ALL_WELL, ins_on=ins_on)
            if reads:
                each.poll(1.0, answering)
        for _ in range(ticks):
            for each in (bench, evaluated):
                each.clock.sleep(1.0)
            evaluated.expected = replace(
                evaluated.expected
            )  # an unknown command: nothing is known to be good
            found = bench.trips()
            assert found == evaluated.trips()
            seen |= found.keys()
    assert {"table_silence", "chamber_silence", "ins_silence", "chamber_air_rate"} <= seen


@pytest.mark.parametrize(("first_c", "c_per_min", "is_tripped"), [
    (46.0, 1.0, True),  # 15 K of which may be the heat of the unit
    (52.0, -1.0, False),  # it cools, as after a ramp
    (36.0, 1.0, False),
    (9.0, -1.0, True),
    (5.0, 1.0, False),
    (46.0, 0.02, False),
])  # fmt: skip
def test_a_case_that_moves_away_from_the_air_that_the_chamber_reads_trips(
    bench, first_c, c_per_min, is_tripped
):
    bench.chamber = air(20.0, 20.0, True)
    for minutes in np.arange(0.0, 3.0, 1.0 / 6.0):
        set_values(bench.ins, case_c=first_c + c_per_min * minutes)
        trips = bench.poll()
    assert set(trips) == ({"chamber_sensor"} if is_tripped else set())


@pytest.mark.parametrize(("air_c", "is_in_fahrenheit"), [(73.4, True), (45.0, False)])
def test_air_that_is_near_the_unit_if_it_is_in_fahrenheit_asks_for_the_unit_of_the_controller(
    bench, air_c, is_in_fahrenheit
):
    bench.chamber = air(air_c, 20.0, True)
    for minutes in np.arange(0.0, 3.0, 1.0 / 6.0):
        set_values(bench.ins, case_c=23.0 - 0.2 * minutes)
        trips = bench.poll()
    text = trips["chamber_sensor"].text
    assert ("near the unit: check the unit of the controller" in text) is is_in_fahrenheit


@pytest.mark.parametrize(("for_min", "is_tripped"), [(9.0, False), (13.0, True)])
def test_gyros_without_a_case_temperature_may_continue_as_before_a_ramp_for_a_quarter_of_their_time_constant(
    watched, for_min, is_tripped
):
    bench = watched(name="emulated_canaerospace")
    bench.chamber = air(20.0, 20.0, True)
    for minutes in np.arange(0.0, for_min, 1.0 / 6.0):
        set_values(bench.ins, optics_c=np.full(3, 46.0 + 0.5 * minutes))
        trips = bench.poll()
    assert set(trips) == ({"chamber_sensor"} if is_tripped else set())


def test_a_unit_whose_temperatures_are_unknown_does_not_contradict_the_chamber(bench):
    bench.expected = replace(bench.expected, ins_on=False)
    set_values(bench.ins, case_c=math.nan, optics_c=np.full(3, math.nan), electronics_c=np.full(3, math.nan))
    assert bench.poll_for(300.0) == {}
