import contextlib
import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gyrobench.bench.foundations.errors import (
    FaultError,
    InstrumentError,
    NoReplyError,
    RefusedError,
    ReplyError,
)
from gyrobench.drivers.emulators.ideal_aerosmith import IdealAerosmithEmulator
from gyrobench.drivers.rate_table import RateTable, TableReading
from gyrobench.drivers.rate_table.ideal_aerosmith import IdealAerosmith
from tests.drivers.conftest import Scripted, any_rig


class Bench:
    def __init__(self, rig, **options):
        self.rig, self.axis = rig, rig.axis
        self.controller = IdealAerosmithEmulator(rig.axis, **options)
        self._line, self.heard = rig.line("table", self.controller)

    def driver(self) -> RateTable:
        return IdealAerosmith(self._line, axis=2)

    def prepared(self):
        table = self.driver()
        table.set_limits(30.0, 20.0, 80.0)
        table.prepare()
        return table

    def requests_of(self, action):
        self.heard.requests.clear()
        action()
        return self.heard.requests

    def until_in_position(self, table, longest_s=60.0):
        for _ in range(round(longest_s)):
            if table.in_position():
                self.rig.wait(5.0)  # what is left of the overshoot
                return True
            self.rig.wait(1.0)
        return False


@pytest.fixture
def make_bench(rig):
    return lambda **options: Bench(rig, **options)


@pytest.fixture(params=["late", "at_once"])
def bench(request, make_bench):
    return make_bench(jog_prompt=request.param)


def test_it_is_prepared_with_its_motor_on_and_its_limits_set(bench):
    table = bench.driver()
    assert bench.requests_of(lambda: table.set_limits(30.0, 20.0, 80.0)) == [b"VEL30\r", b"ACL20\r"]
    assert bench.requests_of(table.prepare) == [b"SRV1\r", b"ACL20\r"]
    assert bench.controller.is_servoed(2)
    assert (bench.axis.limits.rate_dps, bench.axis.limits.acceleration_dps2) == (30.0, 20.0)


def test_it_moves_to_an_angle_and_says_when_it_is_there(bench):
    table = bench.prepared()
    assert bench.requests_of(lambda: table.move_to({2: -90.5}, 10.0)) == [b"VEL10\r", b"MOV-90.5\r"]
    assert not table.in_position()
    bench.rig.wait(4.0)
    assert table.read().rate_dps == (-10.0,)
    assert bench.until_in_position(table)
    assert bench.requests_of(table.in_position) == [b"PPO\r", b"PVE\r"]
    assert table.read() == TableReading((-90.5,), (pytest.approx(0.0, abs=1e-3),), faults=())


@pytest.mark.parametrize("done", [0, 1])
def test_a_motion_is_complete_regardless_of_what_the_controller_calls_complete(make_bench, done):
    bench = make_bench(done=done)
    table = bench.prepared()
    table.move_to({2: 30.0}, 10.0)
    assert not table.in_position()
    assert bench.controller.feed(b"MCO0.01\r", bench.rig.clock.now()) == b"%d\r>" % (1 - done)
    assert bench.until_in_position(table)
    assert bench.controller.feed(b"MCO0.01\r", bench.rig.clock.now()) == b"%d\r>" % done


def test_a_full_turn_is_a_full_turn(bench):
    table = bench.prepared()
    table.move_to({2: 360.0}, 30.0)
    assert bench.until_in_position(table)
    assert bench.axis.encoder(bench.rig.clock.now()).position_deg == pytest.approx(360.0, abs=1e-3)


def test_it_jogs_until_it_is_stopped(bench):
    table = bench.prepared()
    assert bench.requests_of(lambda: table.turn_at(2, 10.5)) == [b"JOG10.5\r"]
    bench.rig.wait(5.0)
    assert table.read().rate_dps == (10.5,)
    assert table.read().faults == ()
    assert bench.requests_of(table.stop) == [b"STO\r"]
    bench.rig.wait(5.0)
    assert table.read().rate_dps == (pytest.approx(0.0, abs=1e-3),)
    table.move_to({2: 0.0}, 30.0)
    assert bench.until_in_position(table)


def test_a_table_that_was_left_jogging_is_taken_over(bench):
    bench.controller.feed(b"SRV1\rJOG5\r", 0.0)
    table = bench.driver()
    table.stop()
    bench.rig.wait(5.0)
    assert table.read().rate_dps == (pytest.approx(0.0, abs=1e-3),)


def test_it_is_released_at_rest_with_its_motor_off(bench):
    table = bench.prepared()
    table.turn_at(2, 20.0)
    bench.rig.wait(5.0)
    sent = bench.requests_of(table.release)
    assert (sent[0], sent[-1]) == (b"STO\r", b"SRV0\r")
    assert not bench.controller.is_servoed(2)
    assert not bench.axis.is_moving(bench.rig.clock.now() + 5.0)


def test_an_axis_that_stands_short_of_its_target_is_a_fault(bench):
    table = bench.prepared()
    bench.axis.friction_deg = 0.5
    table.move_to({2: 30.0}, 10.0)
    with pytest.raises(FaultError, match=r"stands still at 29\.500 deg; 30\.000 deg was commanded"):
        bench.until_in_position(table)


def test_a_motion_without_the_motor_is_refused(bench):
    table = bench.driver()
    with pytest.raises(RefusedError, match="MOV30 was refused"):
        table.move_to({2: 30.0}, 10.0)
    with pytest.raises(RefusedError, match="JOG10 was refused"):
        table.turn_at(2, 10.0)


def test_a_motor_that_can_not_be_switched_on_is_a_fault(rig):
    line, _ = rig.line("table", Scripted(b"?\r>"))
    with pytest.raises(FaultError, match="motor can't be switched on"):
        IdealAerosmith(line).prepare()


def test_a_jog_too_fast_is_refused(bench):
    table = bench.prepared()
    with pytest.raises(RefusedError, match="JOG1900 was refused"):
        table.turn_at(2, 1900.0)


def test_limits_and_identity_can_not_be_read(bench):
    table = bench.driver()
    assert bench.requests_of(table.identify) == [b"STA\r"]
    assert table.identify() == "Ideal Aerosmith single-axis table; no serial number available"
    with pytest.raises(RefusedError, match="read them from its panel"):
        table.limits()


def test_the_position_is_read_as_in_the_field(rig):
    line, heard = rig.line(
        "table", Scripted(b"123.456\r>", b"\r\n123.456\r\n>", b">PPO\r123.456\r>", b"-1.5\r>")
    )
    table = IdealAerosmith(line)
    assert [table._value("PPO") for _ in range(4)] == [123.456, 123.456, 123.456, -1.5]
    assert heard.requests == 4 * [b"PPO\r"]


@pytest.mark.parametrize(
    ("reply", "error", "message"),
    [
        (b"", NoReplyError, "no reply to STA within 1 s"),
        (b"12.5\r", NoReplyError, r"only '12\.5\\r'"),
        (b"?\r>", RefusedError, "STA was refused"),
        (b"ready\r>", ReplyError, "STA was answered by 'ready'"),
        (b"nan\r>", ReplyError, "STA was answered by 'nan'"),
    ],
)
def test_an_unexpected_reply_is_an_error(rig, reply, error, message):
    line, _ = rig.line("table", Scripted(reply))
    with pytest.raises(error, match=message):
        IdealAerosmith(line).identify()


@given(replies=st.lists(st.binary(max_size=12) | st.sampled_from([b">", b"1.5\r>", b"?\r>", b"inf\r>"])))
@example(replies=[b"1.5\r>"] * 20)
def test_any_reply_gives_a_value_or_an_error_of_the_instrument(replies):
    line, _ = any_rig().line("table", Scripted(*replies))
    table = IdealAerosmith(line)
    for action in (
        table.identify,
        table.prepare,
        lambda: table.move_to({1: 10.0}, 5.0),
        table.in_position,
        lambda: table.turn_at(1, 5.0),
        table.read,
        table.stop,
    ):
        with contextlib.suppress(InstrumentError):
            result = action()
            if isinstance(result, TableReading):
                assert all(map(math.isfinite, result.position_deg + result.rate_dps))


def test_an_axis_that_does_not_come_to_rest_is_a_fault_after_its_motor_is_off(bench):
    table = bench.prepared()
    table.turn_at(2, 5.0)
    bench.rig.wait(5.0)
    bench.axis.stop = lambda now_s: None
    with pytest.raises(FaultError, match=r"still turns at 5 deg/s 30 s after the stop; its motor was"):
        table.release()
    assert bench.heard.requests[-1] == b"SRV0\r"


def test_an_axis_whose_rate_can_not_be_read_is_not_taken_for_one_at_rest(rig):
    line, heard = rig.line("table", NoRates())
    with pytest.raises(FaultError, match="its rate can't be read 30 s after the stop and it may still turn"):
        IdealAerosmith(line).release()
    assert heard.requests[-1] == b"SRV0\r"


class NoRates:
    latency_s = 0.01

    def feed(self, data, now_s):
        return b"" if data == b"PVE\r" else b">"
