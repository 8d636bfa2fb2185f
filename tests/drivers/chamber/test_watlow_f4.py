import contextlib
import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from gyrobench.bench.foundations.clock import VirtualClock, WallClock
from gyrobench.bench.foundations.errors import (
    FaultError,
    InstrumentError,
    NoReplyError,
    RefusedError,
    ReplyError,
)
from gyrobench.drivers.chamber import Chamber, ChamberReading
from gyrobench.drivers.chamber.watlow_f4 import from_register, to_register
from gyrobench.drivers.modbus_rtu import append_crc

FRAMES = {
    "read PV, error and alarm 1": "01 03 00 64 00 03 44 14",
    "set point 85.0": "01 06 01 2C 03 52 C8 F2",
    "set point -40.0": "01 06 01 2C FE 70 08 7B",
    "ramp mode 2": "01 06 04 4C 00 02 C8 EC",
    "ramp rate 5.0": "01 06 04 4D 00 32 99 38",
    "ramp per minute": "01 06 04 4E 00 00 E8 ED",
    "event 1 on": "01 06 07 D0 00 01 48 87",
}


@pytest.fixture
def chamber(bench):
    return bench.driver()


def requests_of(bench, action) -> list[str]:
    bench.requests.clear()
    action()
    return [request.hex(" ").upper() for request in bench.requests]


def writes_of(bench, action) -> list[str]:
    return [request for request in requests_of(bench, action) if request.startswith("01 06")]


def test_the_air_and_the_state_of_the_sensor_are_read_in_one_exchange(bench):
    chamber: Chamber = bench.driver()
    bench.air.air_c = -40.04
    assert requests_of(bench, lambda: chamber.read())[0] == FRAMES["read PV, error and alarm 1"]
    assert chamber.read().temperature_c == -40.0


def test_a_reading_has_changes_at_the_panel(bench, chamber):
    chamber.set_temperature(60.0, 1.0)
    chamber.switch(True)
    assert chamber.read() == ChamberReading(23.0, set_point_c=60.0, is_on=True, alarms=())
    bench.air.set_point_c = 25.0
    assert chamber.read().set_point_c == 25.0
    chamber.switch(False)
    assert chamber.read().is_on is False


def test_a_ramp_to_a_temperature_is_sent_as_in_the_manual(bench, chamber):
    assert writes_of(bench, lambda: chamber.set_temperature(85.0, 5.0)) == [
        FRAMES["ramp rate 5.0"],
        FRAMES["ramp per minute"],
        FRAMES["ramp mode 2"],
        FRAMES["set point 85.0"],
    ]
    assert (bench.air.set_point_c, bench.air.ramp_rate_c_per_min) == (85.0, 5.0)
    assert chamber.set_point_c() == 85.0


def test_without_a_rate_the_ramp_is_switched_off(bench, chamber):
    chamber.set_temperature(60.0, 1.0)
    assert writes_of(bench, lambda: chamber.set_temperature(-40.0, None))[-1] == FRAMES["set point -40.0"]
    assert (bench.air.set_point_c, bench.air.ramp_rate_c_per_min) == (-40.0, None)


@pytest.mark.parametrize("rate_c_per_min", [0.3, 0.25, 1 / 6, 0.05, 12.0])
def test_slow_ramps_use_the_scale_that_fits_better(bench, rate_c_per_min):
    bench.driver().set_temperature(60.0, rate_c_per_min)
    assert bench.air.ramp_rate_c_per_min == pytest.approx(rate_c_per_min, rel=1e-9)


def test_the_chamber_and_its_events_are_switched(bench, chamber):
    assert writes_of(bench, lambda: chamber.switch(True)) == [FRAMES["event 1 on"]]
    chamber.switch_event(2, True)
    chamber.switch(False)
    assert bench.events == [(1, True), (2, True), (1, False)]
    assert not bench.air.running
    with pytest.raises(RefusedError, match="event output 9"):
        chamber.switch_event(9, True)


def test_another_event_may_switch_the_chamber(bench):
    bench.driver(chamber_event=3).switch(True)
    assert bench.events == [(3, True)]


def test_identity(make_bench):
    assert make_bench().driver().identify() == (
        "Watlow F4, model number 5270, Modbus address 1, ramps to set points"
    )
    assert make_bench(model="F4S").driver().identify().endswith("ramps by profiles only")


def test_limits_are_read_with_the_implied_decimals(make_bench):
    assert make_bench(decimals=1).driver().limits_c() == (-60.0, 100.0)
    assert make_bench(decimals=2).driver().limits_c() == (-60.0, 100.0)


def test_two_decimals_give_hundredths(make_bench):
    bench = make_bench(decimals=2)
    chamber = bench.driver()
    bench.air.air_c = 25.678
    assert chamber.read().temperature_c == 25.68
    chamber.set_temperature(-12.34, 0.25)
    assert (bench.air.set_point_c, bench.air.ramp_rate_c_per_min) == (-12.34, 0.25)


def test_a_broken_sensor_is_a_fault(bench, chamber):
    bench.chamber.sensor_error = 2
    with pytest.raises(FaultError, match=r"error 2 of input 1 \(register 101\); check"):
        chamber.read()
    bench.chamber.alarm_2 = 1
    with pytest.raises(FaultError, match=r"register 101\), alarm 2 \(register 106 reads 1\); check"):
        chamber.read()


def test_alarms_are_listed_and_cleared(bench, chamber):
    assert chamber.read().alarms == ()
    bench.chamber.alarm_1, bench.chamber.alarm_2 = 2, 1
    assert chamber.read().alarms == ("alarm 1 (register 102 reads 2)", "alarm 2 (register 106 reads 1)")
    chamber.clear_alarms()
    assert chamber.read().alarms == ()


@pytest.mark.parametrize("temperature_c", [math.nan, math.inf, -math.inf, 3276.8, -3276.9, 1e308])
def test_a_set_point_that_is_no_register_value_is_refused_before_anything_is_sent(
    bench, chamber, temperature_c
):
    bench.requests.clear()
    with pytest.raises(RefusedError, match="set point"):
        chamber.set_temperature(temperature_c, None)
    assert bench.requests == []


@pytest.mark.parametrize("rate_c_per_min", [math.nan, math.inf, 0.0, -1.0, 1e-4, 1e6])
def test_a_rate_that_is_no_register_value_is_refused_before_anything_is_sent(bench, chamber, rate_c_per_min):
    bench.requests.clear()
    with pytest.raises(RefusedError, match="ramp"):
        chamber.set_temperature(20.0, rate_c_per_min)
    assert bench.requests == []


@pytest.mark.parametrize("temperature_c", [-60.1, 100.1])
def test_a_set_point_outside_the_controllers_limits_is_not_written(bench, chamber, temperature_c):
    with pytest.raises(RefusedError, match=r"-60.0 to 100.0 °C"):
        chamber.set_temperature(temperature_c, 1.0)
    assert bench.air.set_point_c == 23.0
    assert bench.air.ramp_rate_c_per_min is None


def test_an_f4s_takes_set_points_but_no_ramps(make_bench):
    bench = make_bench(model="F4S")
    chamber = bench.driver()
    bench.requests.clear()
    with pytest.raises(RefusedError, match="ramps by profiles only"):
        chamber.set_temperature(50.0, 2.0)
    assert bench.requests == []
    chamber.set_temperature(50.0, None)
    assert bench.air.set_point_c == 50.0


def test_an_exception_names_register_and_value(bench, chamber):
    bench.respond = lambda _: append_crc(bytes((1, 0x86, 3)))
    with pytest.raises(RefusedError, match=r"write 1 to register 2010 \(event 2\): exception 03, illegal"):
        chamber.switch_event(2, True)
    bench.respond = lambda _: append_crc(bytes((1, 0x83, 2)))
    with pytest.raises(RefusedError, match=r"read register 100 \(process value 1\): exception 02, illegal"):
        chamber.read()


def test_a_value_that_is_not_kept_is_noticed(bench, chamber):
    replying = bench.respond

    def forgetful(request: bytes) -> bytes:
        return request if request[1] == 6 else replying(request)

    bench.respond = forgetful
    with pytest.raises(RefusedError, match="register 300 holds 230 although 400 was written"):
        chamber.set_temperature(40.0, None)


@pytest.mark.parametrize(
    ("reply", "problem"),
    [
        (bytes.fromhex("01 03 06 00 FA 00 00 00 00 00 00"), "CRC"),
        (append_crc(bytes.fromhex("02 03 06 00 FA 00 00 00 00")), "another device"),
        (append_crc(bytes.fromhex("01 04 06 00 FA 00 00 00 00")), "another device"),
        (append_crc(bytes.fromhex("01 03 04 00 FA 00 00 00 00")), "another device"),
        (append_crc(bytes.fromhex("01 86 02")), "another device"),
    ],
    ids=["CRC", "address", "function", "length", "exception of another function"],
)
def test_a_reply_to_something_else_is_an_error(bench, chamber, reply, problem):
    bench.respond = lambda _: reply
    with pytest.raises(ReplyError, match=problem):
        chamber.read()


def test_an_echo_of_another_value_is_an_error(bench, chamber):
    bench.respond = lambda _: append_crc(bytes.fromhex("01 06 07 D0 00 00"))
    with pytest.raises(ReplyError, match="another device"):
        chamber.switch_event(1, True)


def test_after_a_missing_reply_the_line_must_be_silent(bench):
    clock = WallClock()
    chamber = bench.driver(clock)
    chamber._modbus._reply_timeout_s = 1.0
    replying, bench.respond = bench.respond, lambda _: b""
    with pytest.raises(NoReplyError):
        chamber.read()
    silent_s = clock.now()
    bench.air.air_c, bench.respond = 31.0, replying
    assert chamber.read().temperature_c == 31.0
    assert clock.now() - silent_s >= 1.0 - 1e-3


def test_stale_input_is_not_taken_for_the_answer(bench):
    chamber = bench.driver(WallClock())
    replying = bench.respond
    bench.respond = lambda request: replying(request) + append_crc(bytes.fromhex("01 03 04 03 E7 00 00"))
    bench.air.air_c = 31.0
    assert [chamber.read().temperature_c for _ in range(3)] == [31.0] * 3


def test_the_line_is_silent_after_each_exchange(bench):
    clock = VirtualClock()
    chamber = bench.driver(clock)
    chamber.read()
    before_s = clock.now()
    chamber.read()
    assert clock.now() - before_s >= 0.004
    chamber.clear_alarms()
    before_s = clock.now()
    chamber.read()
    assert clock.now() - before_s >= 0.03 - 1e-9


def test_a_controller_in_fahrenheit_is_refused(bench):
    replying = bench.respond

    def american(request: bytes) -> bytes:
        unit = append_crc(bytes.fromhex("01 03 02 00 00"))
        return unit if request[2:4] == (901).to_bytes(2, "big") else replying(request)

    bench.respond = american
    with pytest.raises(RefusedError, match="°F"):
        bench.driver()


def test_a_device_with_impossible_decimals_is_no_f4(bench):
    bench.respond = lambda _: append_crc(bytes.fromhex("01 03 02 00 09"))
    with pytest.raises(ReplyError, match="9 decimals"):
        bench.driver()


def test_a_late_reply_is_not_taken_for_the_decimals_when_the_line_is_opened(bench):
    """That of an alarm register from before; then every temperature would be read ten times as large."""
    late, answer = [append_crc(bytes((1, 3, 2, 0, 0)))], bench.respond
    bench.respond = lambda request: late.pop() if late else answer(request)
    with pytest.raises(ReplyError, match="reads 0, then 1 decimals"):
        bench.driver()
    assert bench.driver().read().temperature_c == 23.0


@given(number=st.integers(-32768, 32767), decimals=st.integers(0, 3))
def test_every_register_value_survives_decoding_and_encoding(number, decimals):
    assert to_register(from_register(number, decimals), decimals) == number


@given(value=st.floats(), decimals=st.integers(0, 3))
def test_any_number_is_encoded_to_half_a_digit_or_not_at_all(value, decimals):
    number = to_register(value, decimals)
    assume(number is not None)
    assert -32768 <= number <= 32767
    assert abs(from_register(number, decimals) - value) <= 0.5000001 * 10.0**-decimals


@given(
    reply=st.binary(max_size=12)
    | st.binary(min_size=1, max_size=8).map(lambda tail: append_crc(b"\x01" + tail))
)
def test_no_reply_raises_anything_but_an_instrument_error(bench, reply):
    replying = bench.respond
    chamber = bench.drivers[0] if bench.drivers else bench.driver()
    chamber._modbus._reply_timeout_s = 0.02
    bench.respond = lambda _: reply
    for action in (chamber.read, chamber.limits_c, lambda: chamber.set_temperature(40.0, 1.0)):
        with contextlib.suppress(InstrumentError):
            action()
    bench.respond = replying


def change_decimals(bench):
    bench.chamber.decimals = 2


def change_unit(bench):
    bench.chamber.use_fahrenheit(True)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (change_decimals, r"decimals .register 606. were changed from 1 to 2"),
        (change_unit, r"unit .register 901. was changed from °C to °F"),
    ],
)
def test_after_a_change_of_its_numbers_at_the_panel_nothing_is_commanded_and_the_chamber_is_off(
    bench, chamber, change, message
):
    chamber.set_temperature(60.0, 1.0)
    chamber.switch(True)
    change(bench)
    with pytest.raises(RefusedError, match=message):
        chamber.set_temperature(23.0, 1.0)
    assert bench.air.set_point_c == 60.0
    assert not bench.air.running


def test_a_profile_is_refused_although_the_set_point_reads_back_right(bench, chamber):
    chamber.set_temperature(23.0, None)
    assert chamber.running_profile() == ""
    bench.chamber.start_profile(85.0)
    assert (chamber.set_point_c(), bench.air.set_point_c) == (23.0, 85.0)
    assert chamber.running_profile() == "a profile (register 200 reads 2)"
    for command in (lambda: chamber.set_temperature(23.0, None), lambda: chamber.switch(True)):
        with pytest.raises(RefusedError, match=r"runs a profile .register 200 reads 2., which overrides"):
            command()
    with pytest.raises(RefusedError, match=r"runs a profile"):
        chamber.switch(False)
    assert not bench.air.running


def test_a_profile_is_ended_where_the_station_file_says_so(bench):
    chamber = bench.driver(end_profiles=True)
    bench.chamber.start_profile(85.0)
    chamber.set_temperature(40.0, 2.0)
    assert chamber.running_profile() == ""
    assert bench.air.set_point_c == 40.0


def test_a_controller_that_is_busy_when_it_is_opened_is_not_taken_for_one_without_ramps(bench):
    answer = bench.respond

    def busy(request: bytes) -> bytes:
        return append_crc(bytes((1, 0x83, 6))) if request[2:4] == b"\x04\x4c" else answer(request)

    bench.respond = busy
    with pytest.raises(RefusedError, match="exception 06"):
        bench.driver()
