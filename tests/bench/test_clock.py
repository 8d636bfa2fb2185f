import gc
import time

import pytest

from bench.clock import VIRTUAL_EPOCH, Deadline, VirtualClock, WallClock, clock_named


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
    assert clock_named(name) is clock
    del clock
    gc.collect()
    with pytest.raises(KeyError):
        clock_named(name)
