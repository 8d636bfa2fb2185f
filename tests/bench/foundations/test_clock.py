import time
from datetime import UTC, datetime, timedelta

import pytest

import gyrobench.bench.foundations.clock
from gyrobench.bench.foundations.clock import (
    RESUME_STEP_S,
    VIRTUAL_EPOCH,
    Deadline,
    VirtualClock,
    WallClock,
    find_clock,
    parse_utc,
)

TEN = datetime(2026, 3, 1, 10, tzinfo=UTC)


class Host:
    """Stands in for the host's calendar and its steady clocks."""

    def __init__(self):
        self.calendar = TEN
        self.steady_s = {time.CLOCK_MONOTONIC: 500.0, time.CLOCK_BOOTTIME: 800.0}
        self.slept_s = 0.0

    def now(self, zone):
        return self.calendar.astimezone(zone)

    def clock_gettime(self, kind):
        return self.steady_s[kind]

    def sleep(self, duration_s):
        self.slept_s += duration_s
        self.passes(duration_s)

    def passes(self, duration_s):
        self.calendar += timedelta(seconds=duration_s)
        for kind in self.steady_s:
            self.steady_s[kind] += duration_s

    def is_suspended(self, duration_s):
        self.calendar += timedelta(seconds=duration_s)
        self.steady_s[time.CLOCK_BOOTTIME] += duration_s


@pytest.fixture
def host(monkeypatch):
    host = Host()
    monkeypatch.setattr(gyrobench.bench.foundations.clock, "datetime", host)
    monkeypatch.setattr(gyrobench.bench.foundations.clock.time, "clock_gettime", host.clock_gettime)
    monkeypatch.setattr(gyrobench.bench.foundations.clock.time, "sleep", host.sleep)
    return host


def test_a_virtual_wait_takes_no_real_time():
    clock = VirtualClock()
    begin = time.perf_counter()
    clock.sleep(40 * 3600.0)
    assert clock.now() == 144_000.0
    assert time.perf_counter() - begin < 1.0


def test_a_virtual_clock_never_goes_back():
    clock = VirtualClock()
    clock.sleep_until(10.0)
    clock.sleep_until(3.0)
    clock.sleep(-5.0)
    assert clock.now() == 10.0


def test_virtual_calendar_time_is_the_same_for_every_run():
    clock = VirtualClock()
    clock.sleep(60.0)
    assert (clock.utc() - VIRTUAL_EPOCH).total_seconds() == 60.0
    assert VirtualClock().utc() == VIRTUAL_EPOCH


def test_a_wall_clock_waits_in_real_time():
    clock = WallClock()
    begin = time.monotonic()
    clock.sleep(0.05)
    assert time.monotonic() - begin >= 0.05
    assert clock.now() >= 0.05


def test_a_deadline_shares_one_budget_among_nested_waits():
    clock = VirtualClock()
    deadline = Deadline(clock, 10.0)
    clock.sleep(4.0)
    assert deadline.remaining_s() == 6.0
    assert not deadline.expired()
    clock.sleep(7.0)
    assert deadline.remaining_s() == 0.0
    assert deadline.expired()


def test_a_clock_is_found_by_its_name_while_it_is_in_use():
    clock = VirtualClock()
    name = clock.name
    assert find_clock(name) is clock
    del clock
    with pytest.raises(KeyError):
        find_clock(name)


def test_a_resumed_virtual_run_goes_on_where_it_was():
    clock = VirtualClock(start_s=7200.5)
    assert clock.now() == 7200.5
    clock.sleep(0.5)
    assert clock.utc() == VIRTUAL_EPOCH + timedelta(seconds=7201)
    assert clock.calendar_offset_s() == 0.0


def test_a_wall_clock_begins_at_the_calendars_time(host):
    clock = WallClock()
    assert (clock.now(), clock.epoch) == (0.0, TEN)
    host.passes(90.0)
    assert (clock.now(), clock.utc()) == (90.0, TEN + timedelta(seconds=90))


def test_a_wall_clock_can_begin_later_than_zero_at_the_calendars_time(host):
    clock = WallClock(start_s=30.0)
    assert (clock.now(), clock.utc()) == (30.0, TEN)


@pytest.mark.parametrize("step_s", [86400.0, -86400.0])
def test_setting_the_calendar_changes_no_wait_and_is_reported(host, step_s):
    clock = WallClock()
    deadline = Deadline(clock, 10.0)
    host.calendar += timedelta(seconds=step_s)
    assert deadline.remaining_s() == 10.0
    clock.sleep_until(4.0)
    assert host.slept_s == 4.0
    assert clock.utc() == TEN + timedelta(seconds=4)
    assert clock.calendar_offset_s() == step_s


def test_time_goes_on_while_the_host_is_suspended(host):
    clock = WallClock()
    host.is_suspended(3600.0)
    assert clock.now() == 3600.0
    assert clock.calendar_offset_s() == 0.0


def test_a_resumed_run_goes_on_at_the_calendars_time(host):
    host.passes(5400.0)
    clock = WallClock.resumed(TEN, last_s=1800.0)
    assert (clock.now(), clock.epoch) == (5400.0, TEN)
    assert clock.utc() == host.calendar


def test_the_time_of_a_resumed_run_never_goes_back_where_the_calendar_did(host):
    host.calendar -= timedelta(hours=3)
    clock = WallClock.resumed(TEN, last_s=1800.0)
    assert clock.now() == 1800.0 + RESUME_STEP_S
    assert clock.epoch == TEN
    host.passes(1.0)
    assert clock.utc() == TEN + timedelta(seconds=1801.0 + RESUME_STEP_S)
    assert clock.calendar_offset_s() == pytest.approx(-3 * 3600.0 - 1800.0 - RESUME_STEP_S)


def test_a_fast_clock_runs_so_many_times_as_fast_and_waits_accordingly(host):
    clock = WallClock(speed=10.0)
    assert clock.utc() == TEN
    host.passes(3.0)
    assert clock.now() == pytest.approx(30.0)
    assert clock.utc() == TEN + timedelta(seconds=30)
    clock.sleep(20.0)
    assert host.slept_s == pytest.approx(2.0)


def test_of_a_fast_clock_the_calendar_is_ahead_by_what_it_was_set(host):
    clock = WallClock(TEN - timedelta(seconds=40), start_s=60.0, speed=10.0)
    assert clock.calendar_offset_s() == pytest.approx(-20.0)
    host.passes(5.0)
    assert clock.calendar_offset_s() == pytest.approx(-20.0)
    host.calendar += timedelta(seconds=7)
    assert clock.calendar_offset_s() == pytest.approx(-13.0)


def test_a_fast_run_is_resumed_at_its_speed_after_its_last_record(host):
    clock = WallClock.resumed(TEN - timedelta(seconds=10), 400.0, speed=10.0)
    assert clock.now() == pytest.approx(400.0 + RESUME_STEP_S)
    host.passes(1.0)
    assert clock.now() == pytest.approx(410.0 + RESUME_STEP_S)


def test_a_time_without_its_zone_is_utc_and_what_is_no_time_is_none():
    assert parse_utc("2026-03-01T10:00:00") == TEN
    assert parse_utc("2026-03-01T12:00:00+02:00") == TEN
    assert parse_utc("yesterday") is parse_utc(None) is None
