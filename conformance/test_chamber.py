"""Requirements for every dialect of a chamber, tested with its emulator."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from contextlib import suppress

import pytest

from gyrobench.bench.foundations.errors import FaultError, InstrumentError, NoReplyError, RefusedError
from gyrobench.conformance.instruments import ChamberUnderTest, Noise
from gyrobench.drivers.chamber import Chamber
from gyrobench.drivers.emulators.dialect import Restartable, WithAlarms, WithProfiles, WithTemperatureSensor

#: Two set points that every chamber can reach.
_WARM_C, _COOL_C = 40.0, 15.0
_RAMP_C_PER_MIN = 1.0
#: Tolerance of a set point: a controller may round it to whole degrees.
_RESOLUTION_C = 0.5
#: Longest duration of a call, with all repetitions.
_MAX_TIME_S = 30.0


def test_it_opens_and_names_its_controller_in_one_line(chamber: ChamberUnderTest) -> None:
    name = chamber.open().identify()
    assert name.strip(), "identify() must identify the controller, for the run's provenance"
    assert "\n" not in name, "identify() must return a single line"


def test_opening_and_closing_change_nothing(chamber: ChamberUnderTest) -> None:
    driver = chamber.open()
    driver.set_temperature(_WARM_C, _ramp(driver))
    driver.switch(True)
    chamber.wait(60.0)
    before = chamber.air.set_point_c, chamber.air.running, dict(chamber.events)
    driver.close()
    chamber.open()
    after = chamber.air.set_point_c, chamber.air.running, dict(chamber.events)
    assert after == before, "opening or closing a driver must not change the state of the chamber"


def test_a_set_point_arrives_at_the_controller_and_is_read_back(chamber: ChamberUnderTest) -> None:
    driver = chamber.open()
    for temperature_c in (_WARM_C, _COOL_C):
        driver.set_temperature(temperature_c, None)
        assert chamber.air.set_point_c == pytest.approx(temperature_c, abs=_RESOLUTION_C)
        assert driver.set_point_c() == pytest.approx(temperature_c, abs=_RESOLUTION_C)


def test_a_reading_is_that_of_the_air(chamber: ChamberUnderTest) -> None:
    driver = chamber.open()
    for air_c in (-30.0, 0.0, 23.4, 71.8):
        chamber.air.air_c = air_c
        assert driver.read().temperature_c == pytest.approx(air_c, abs=_RESOLUTION_C)


def test_a_reading_that_includes_set_point_and_state_reads_them_from_the_controller(
    chamber: ChamberUnderTest,
) -> None:
    driver = chamber.open()
    driver.set_temperature(_WARM_C, None)
    for on in (True, False):
        driver.switch(on)
        reading = driver.read()
        assert reading.is_on in (on, None), "is_on must be read back, or be None if it can't be"
        assert reading.set_point_c is None or reading.set_point_c == pytest.approx(_WARM_C, abs=_RESOLUTION_C)


def test_switched_on_the_air_reaches_the_set_point(chamber: ChamberUnderTest) -> None:
    driver = chamber.open()
    driver.set_temperature(_WARM_C, None)
    driver.switch(True)
    chamber.wait(3600.0)
    assert driver.read().temperature_c == pytest.approx(_WARM_C, abs=1.0)


def test_switched_off_the_air_is_not_controlled(chamber: ChamberUnderTest) -> None:
    driver = chamber.open()
    driver.set_temperature(_WARM_C, None)
    driver.switch(True)
    driver.switch(False)
    chamber.wait(3600.0)
    assert not chamber.air.running
    assert driver.read().temperature_c < _WARM_C - 5.0


def test_a_ramp_takes_its_time_or_is_not_offered(chamber: ChamberUnderTest) -> None:
    driver = chamber.open()
    if not getattr(driver, "can_ramp", True):
        with pytest.raises(RefusedError):
            driver.set_temperature(_WARM_C, _RAMP_C_PER_MIN)
        return
    driver.switch(True)
    start_c = driver.read().temperature_c
    driver.set_temperature(start_c + 20.0, _RAMP_C_PER_MIN)
    chamber.wait(600.0)
    assert 5.0 < driver.read().temperature_c - start_c < 12.0, (
        "after half of the time the air must be about half way"
    )
    chamber.wait(1800.0)
    assert driver.read().temperature_c == pytest.approx(start_c + 20.0, abs=1.0)


def test_without_a_rate_an_earlier_ramp_has_no_effect(chamber: ChamberUnderTest) -> None:
    driver = chamber.open()
    driver.switch(True)
    if getattr(driver, "can_ramp", True):
        driver.set_temperature(_COOL_C, 0.5)
    driver.set_temperature(_WARM_C, None)
    assert chamber.air.ramp_rate_c_per_min is None, "a rate of None must give the fastest approach"


def test_commands_can_be_repeated(chamber: ChamberUnderTest) -> None:
    driver = chamber.open()
    for _ in range(3):
        driver.set_temperature(_WARM_C, _ramp(driver))
        driver.switch(True)
        driver.switch_event(1, True)
        assert chamber.air.running
        assert driver.is_event_on(1), "a command must set a state, not toggle it"


@pytest.mark.parametrize("temperature_c", [math.nan, math.inf, -math.inf])
def test_a_temperature_that_is_no_number_is_refused_before_anything_is_sent(
    chamber: ChamberUnderTest, temperature_c: float
) -> None:
    driver = chamber.open()
    before = chamber.air.set_point_c
    with pytest.raises(RefusedError):
        driver.set_temperature(temperature_c, None)
    assert chamber.sent_by(lambda: driver.set_temperature(temperature_c, None)) == b""
    assert chamber.air.set_point_c == before


@pytest.mark.parametrize("rate_c_per_min", [math.nan, math.inf, 0.0, -1.0])
def test_a_rate_that_is_no_rate_is_refused(chamber: ChamberUnderTest, rate_c_per_min: float) -> None:
    driver = chamber.open()
    before = chamber.air.set_point_c
    with pytest.raises(RefusedError):
        driver.set_temperature(_WARM_C, rate_c_per_min)
    assert chamber.air.set_point_c == before


def test_a_set_point_outside_the_controllers_range_is_refused(chamber: ChamberUnderTest) -> None:
    driver = chamber.open()
    before = chamber.air.set_point_c
    for temperature_c in (-1000.0, 1000.0):
        with pytest.raises(RefusedError):
            driver.set_temperature(temperature_c, None)
    assert chamber.air.set_point_c == before


def test_limits_are_an_interval_or_refused(chamber: ChamberUnderTest) -> None:
    driver = chamber.open()
    with suppress(RefusedError):
        low_c, high_c = driver.limits_c()
        assert low_c < high_c


def test_event_outputs_are_switched_one_by_one_and_read_back(chamber: ChamberUnderTest) -> None:
    driver = chamber.open()
    driver.switch(True)
    for number in (1, 2):
        driver.switch_event(number, True)
    driver.switch_event(1, False)
    assert not driver.is_event_on(1)
    assert driver.is_event_on(2)
    assert chamber.events.get(2), "the emulator must report its event outputs to on_event"


def test_an_event_output_that_does_not_exist_is_refused(chamber: ChamberUnderTest) -> None:
    driver = chamber.open()
    for number in (0, 1000):
        with pytest.raises(RefusedError):
            driver.switch_event(number, True)


def test_it_has_no_alarm_to_begin_with_and_clearing_does_not_stop_it(chamber: ChamberUnderTest) -> None:
    driver = chamber.open()
    driver.switch(True)
    assert driver.read().alarms == ()
    driver.clear_alarms()
    assert chamber.air.running


def test_an_alarm_is_named_while_its_cause_is_present(chamber: ChamberUnderTest) -> None:
    alarm = chamber.require_capability(WithAlarms)
    driver = chamber.open()
    alarm.raise_alarm(1, True)
    assert any(text.strip() for text in driver.read().alarms), "a reading must describe the alarm"
    driver.clear_alarms()
    assert driver.read().alarms, "an alarm must stay active while its cause persists"
    alarm.end_alarm(1)
    driver.clear_alarms()
    assert driver.read().alarms == ()


def test_a_broken_sensor_is_a_fault_until_it_is_repaired(chamber: ChamberUnderTest) -> None:
    sensor = chamber.require_capability(WithTemperatureSensor)
    driver = chamber.open()
    sensor.break_sensor(1)
    with pytest.raises(FaultError):
        driver.read()
    sensor.repair_sensor()
    driver.clear_alarms()
    assert math.isfinite(driver.read().temperature_c)


def test_a_profile_of_its_own_is_reported_and_set_points_are_refused_meanwhile(
    chamber: ChamberUnderTest,
) -> None:
    panel = chamber.require_capability(WithProfiles)
    driver = chamber.open()
    assert not driver.running_profile()
    panel.start_profile(85.0)
    assert driver.running_profile(), "running_profile() must describe the profile"
    with pytest.raises(RefusedError):
        driver.set_temperature(_WARM_C, None)
    driver.end_profile()
    assert not driver.running_profile()


def test_after_a_loss_of_power_it_reads_the_state_that_the_controller_has(chamber: ChamberUnderTest) -> None:
    supply = chamber.require_capability(Restartable)
    driver = chamber.open()
    driver.set_temperature(_WARM_C, None)
    driver.switch(True)
    now_s = chamber.clock.now()
    supply.power_off(now_s)
    chamber.wait(5.0)
    supply.power_on(chamber.clock.now())
    chamber.wait(60.0)
    reading = driver.read()
    assert reading.is_on in (chamber.air.running, None)
    assert driver.set_point_c() == pytest.approx(chamber.air.set_point_c, abs=_RESOLUTION_C)


def test_silence_ends_in_no_reply_within_a_bounded_time(chamber: ChamberUnderTest) -> None:
    driver = chamber.open()
    chamber.wire.is_connected = False
    for action in _requests(driver):
        started_s = chamber.clock.now()
        with pytest.raises(NoReplyError):
            action()
        assert chamber.clock.now() - started_s < _MAX_TIME_S, "each request must have a time limit"


def test_it_answers_again_after_a_silence(chamber: ChamberUnderTest) -> None:
    driver = chamber.open()
    chamber.wire.is_connected = False
    with pytest.raises(NoReplyError):
        driver.read()
    chamber.wire.is_connected = True
    assert chamber.retry(driver.set_point_c) == pytest.approx(chamber.air.set_point_c, abs=_RESOLUTION_C)


@pytest.mark.parametrize("delay_s", [0.4, 1.0, 2.0, 4.0])
def test_a_late_reply_is_not_taken_for_that_of_another_request(
    chamber: ChamberUnderTest, delay_s: float
) -> None:
    driver = chamber.open()
    driver.set_temperature(_COOL_C, None)
    for pause_s in (0.0, 0.5, 2.0):
        chamber.air.air_c = 50.0
        chamber.wire.latency_s = delay_s
        with suppress(InstrumentError):
            driver.read()
        chamber.wire.latency_s = chamber.emulator.latency_s
        chamber.wait(pause_s)
        assert chamber.retry(driver.set_point_c) == pytest.approx(_COOL_C, abs=_RESOLUTION_C)


def test_disturbed_replies_give_values_or_errors_of_the_bench(
    chamber: ChamberUnderTest, noise: Callable[[], Noise]
) -> None:
    driver = chamber.open()
    chamber.wire.disturb = noise()
    for _ in range(20):
        for action in _requests(driver):
            with suppress(InstrumentError):
                action()
        with suppress(InstrumentError):
            reading = driver.read()
            assert math.isfinite(reading.temperature_c), "a reading must be a finite number, or an error"
            assert all(isinstance(text, str) for text in reading.alarms)


def test_another_device_on_the_line_is_an_error(chamber: ChamberUnderTest) -> None:
    chamber.wire.disturb = lambda _: b"\xff\x00hello\r\n"
    with pytest.raises(InstrumentError):
        chamber.open().read()


def test_the_emulator_accepts_any_bytes(chamber: ChamberUnderTest) -> None:
    draw = random.Random(1)  # noqa: S311 - not for secrets
    requests = [b"".join(chamber.wire.requests)]
    driver = chamber.open()
    requests += chamber.wire.requests
    for _ in range(300):
        data = draw.choice(requests)[: draw.randrange(12)] + draw.randbytes(draw.randrange(12))
        reply = chamber.emulator.feed(data, chamber.clock.now())
        assert isinstance(reply, bytes), "feed() must accept any bytes and return bytes"
    chamber.wait(30.0)
    assert math.isfinite(chamber.retry(driver.read).temperature_c), (
        "it must answer a valid request afterwards"
    )


def _ramp(driver: Chamber) -> float | None:
    return _RAMP_C_PER_MIN if getattr(driver, "can_ramp", True) else None


def _requests(driver: Chamber) -> list[Callable[[], object]]:
    return [
        driver.read,
        driver.set_point_c,
        lambda: driver.set_temperature(_WARM_C, None),
        lambda: driver.switch(True),
        lambda: driver.switch_event(1, True),
        lambda: driver.is_event_on(1),
    ]
