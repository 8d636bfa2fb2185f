"""Ramps of a chamber whose controller has none, on the emulated F4S."""

from itertools import pairwise

import pytest

from gyrobench.bench.foundations.errors import InstrumentError, RefusedError
from gyrobench.drivers.chamber.software_ramp import SoftwareRamp
from gyrobench.drivers.chamber.watlow_f4 import WatlowF4
from gyrobench.drivers.emulators.watlow_f4 import WatlowF4Emulator


class Bench:
    def __init__(self, rig):
        self.clock, self.air = rig.clock, rig.air
        self.emulator = WatlowF4Emulator(rig.air, model="F4S")
        line, self.heard = rig.line("chamber", self.emulator)
        self.driver = WatlowF4(line)
        self.chamber = SoftwareRamp(self.driver, rig.clock)

    def advance(self, duration_s, period_s=1.0):
        """Return the controller's set points meanwhile."""
        found = []
        for _ in range(round(duration_s / period_s)):
            self.clock.sleep(period_s)
            self.chamber.advance()
            found.append(self.air.set_point_c)
        return found


@pytest.fixture
def bench(rig):
    return Bench(rig)


def test_the_set_point_moves_in_small_steps_at_the_rate(bench):
    assert not bench.driver.can_ramp
    bench.chamber.set_temperature(33.0, 2.0)
    start_s = bench.clock.now()
    steps = bench.advance(150.0)
    assert all(-0.01 < after - before < 0.25 for before, after in pairwise(steps))
    assert steps[-1] == pytest.approx(23.0 + 2.0 * (bench.clock.now() - start_s) / 60.0, abs=0.3)
    assert bench.chamber.is_ramping
    assert (bench.chamber.set_point_c(), bench.chamber.read().set_point_c) == (33.0, 33.0)
    assert bench.advance(180.0)[-1] == 33.0
    assert not bench.chamber.is_ramping


def test_most_calls_between_steps_send_nothing(bench):
    bench.chamber.set_temperature(33.0, 2.0)
    bench.heard.requests.clear()
    bench.advance(30.0)
    assert len(bench.heard.requests) < 100  # ten steps


def test_a_pause_does_not_become_a_jump(bench):
    bench.chamber.set_temperature(33.0, 2.0)
    (after,) = bench.advance(240.0, period_s=240.0)
    assert after <= 24.1


def test_a_ramp_ends_where_the_set_point_is_changed_at_the_panel(bench):
    bench.chamber.set_temperature(33.0, 2.0)
    bench.advance(60.0)
    bench.air.set_point_c = 40.0
    assert bench.chamber.read().set_point_c == 40.0
    with pytest.raises(RefusedError, match=r"changed from .* to 40\.0"):
        bench.advance(60.0)
    assert not bench.chamber.is_ramping
    assert bench.air.set_point_c == 40.0


def test_a_step_whose_reply_was_lost_is_repeated_and_no_change_at_the_panel(bench):
    bench.chamber.set_temperature(33.0, 2.0)
    feed = bench.heard.instrument.feed
    silent = []

    def lossy(data, now_s):
        reply = feed(data, now_s)
        return b"" if silent and data[1] == 6 else reply

    bench.heard.instrument = type("Lossy", (), {"feed": staticmethod(lossy), "latency_s": 0.02})()
    silent.append(True)
    with pytest.raises(InstrumentError):
        bench.advance(10.0)
    silent.clear()
    assert bench.advance(400.0)[-1] == 33.0


def test_another_driver_of_the_line_continues(bench):
    bench.chamber.set_temperature(33.0, 2.0)
    bench.advance(60.0)
    other = SoftwareRamp(bench.driver, bench.clock)
    other.continue_from(bench.chamber)
    bench.chamber = other
    assert bench.advance(300.0)[-1] == 33.0


@pytest.mark.parametrize(
    ("temperature_c", "rate"), [(200.0, 2.0), (33.0, 0.0), (33.0, -1.0), (float("nan"), 2.0)]
)
def test_what_can_not_be_reached_is_refused_before_anything_moves(bench, temperature_c, rate):
    with pytest.raises(RefusedError):
        bench.chamber.set_temperature(temperature_c, rate)
    assert (bench.air.set_point_c, bench.chamber.is_ramping) == (23.0, False)


def test_off_ends_a_ramp(bench):
    bench.chamber.set_temperature(33.0, 2.0)
    bench.chamber.switch(True)
    bench.chamber.switch(False)
    assert not bench.chamber.is_ramping
    assert bench.advance(60.0)[-1] < 23.1
