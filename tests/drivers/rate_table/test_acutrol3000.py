"""The driver of the Acutrol 3000 and the framing of its replies."""

import struct
import threading
import time
from contextlib import suppress
from itertools import cycle, islice

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.errors import (
    FaultError,
    InstrumentError,
    NoReplyError,
    RefusedError,
    ReplyError,
)
from gyrobench.drivers.emulators.acl_axis import SoftwareFault
from gyrobench.drivers.emulators.acutrol3000 import Acutrol3000Emulator
from gyrobench.drivers.emulators.bench import BenchAddress, bench_at
from gyrobench.drivers.emulators.world.table_axis import AxisParameters, TableAxis
from gyrobench.drivers.rate_table import RateTable, TableReading
from gyrobench.drivers.rate_table.acutrol3000 import SOFTWARE_FAULTS, Acutrol3000, ReplyFraming, set_bits
from gyrobench.drivers.serial_line import SerialLine
from tests.drivers.conftest import Echoing, Scripted

FAST = AxisParameters(
    rate_limit_dps=2000.0, acceleration_limit_dps2=2e4, jerk_limit_dps3=2e6, settling_time_constant_s=0.001
)


def reply(text, code=0, order="<"):
    return struct.pack(order + "II", code, len(text)) + text.encode()


def emulator(**options):
    return Acutrol3000Emulator({1: TableAxis(FAST), 2: TableAxis(FAST)}, **options)


@pytest.fixture
def controller():
    return emulator()


@pytest.fixture
def table(controller, serve):
    with serve(controller) as line:
        yield Acutrol3000(line)


def wait_until(condition, limit_s=120.0):
    end = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


# on the emulator


def test_it_is_a_rate_table(table):
    as_interface: RateTable = table
    assert as_interface.identify().startswith("Acutronic R&D USA,Acutrol3000,")


@pytest.mark.parametrize("word_order", ["little", "big"])
def test_the_byte_order_of_the_prefix_is_detected(serve, word_order):
    with serve(emulator(word_order=word_order)) as line:
        table = Acutrol3000(line)
        table.prepare()
        assert table.read() == TableReading((0.0, 0.0), (0.0, 0.0), True, faults=())


def test_preparing_closes_the_servos_and_locks_the_panel_out(table, controller):
    table.prepare()
    assert controller.axes[1].closed
    assert controller.axes[2].closed
    assert controller.feed(b":utility:lockout?\n", 1e6)[8:] == b"ON"


def test_a_move_brings_every_axis_to_its_angle_in_the_direction_of_the_difference(table, controller):
    table.prepare()
    table.move_to({1: 190.0, 2: -370.5}, rate_dps=1500.0)
    seen = []
    wait_until(lambda: seen.append(table.read()) or table.in_position())
    assert table.read().position_deg == pytest.approx((190.0, -370.5), abs=0.006)
    assert all(reading.position_deg[0] >= 0.0 >= reading.position_deg[1] for reading in seen)
    starts_s = {axis.physics._motions[-1].start_s for axis in controller.axes.values()}
    assert len(starts_s) == 1


def test_a_move_of_one_axis_does_not_wait_for_the_other(table):
    table.prepare()
    for angle in (90.0, -90.0, 0.0):
        table.move_to({2: angle}, rate_dps=500.0)
        assert not table.in_position()
        wait_until(table.in_position)
        assert table.read().position_deg == pytest.approx((0.0, angle), abs=0.006)


def test_a_move_keeps_to_the_rate_asked_for(table, controller):
    table.prepare()
    table.move_to({1: 20.0, 2: 5.0}, rate_dps=100.0)
    rates = []
    wait_until(lambda: rates.append(table.read().rate_dps[0]) or table.in_position())
    assert max(rates) == pytest.approx(100.0, rel=1e-3)


def test_limits_bound_the_acceleration_and_survive_a_new_preparation(table, controller):
    table.set_limits(1000.0, 400.0, 1e5)
    controller.axes[1].limits = dict.fromkeys(controller.axes[1].limits, controller.axes[1].absolute_limits)
    table.prepare()
    began_s = time.monotonic()
    table.turn_at(1, 100.0)
    time.sleep(0.05)
    rate_dps = table.read().rate_dps[0]
    assert 0.0 < rate_dps <= 400.0 * (time.monotonic() - began_s)


def test_turning_holds_the_rate_and_stop_ends_it(table):
    table.prepare()
    table.turn_at(2, -300.0)
    wait_until(lambda: table.read().rate_dps == pytest.approx((0.0, -300.0)))
    table.stop()
    wait_until(lambda: table.read().rate_dps == (0.0, 0.0))
    assert not table.in_position()


def test_a_turn_can_follow_a_move_and_a_move_a_turn(table):
    table.prepare()
    table.move_to({1: 10.0, 2: 0.0}, rate_dps=500.0)
    wait_until(table.in_position)
    table.turn_at(1, 200.0)
    wait_until(lambda: table.read().rate_dps[0] == pytest.approx(200.0))
    table.move_to({1: 10.0, 2: 0.0}, rate_dps=500.0)
    wait_until(table.in_position)
    assert table.read().position_deg[0] == pytest.approx(10.0, abs=0.006)


def test_releasing_stops_the_table_before_it_opens_the_servos(table, controller):
    table.prepare()
    table.turn_at(1, 500.0)
    table.release()
    assert not controller.axes[1].closed
    assert not controller.axes[1].physics.is_moving(1e6)
    assert table.read().faults == ()
    assert controller.feed(b":utility:lockout?\n", 1e6)[8:] == b"OFF"


def test_an_axis_that_does_not_come_to_rest_is_a_fault_after_the_servos_are_open(rig):
    controller = Acutrol3000Emulator(rig.bench.world.axes)
    line, _ = rig.line("table", controller)
    table = Acutrol3000(line)
    table.prepare()
    table.turn_at(2, 5.0)
    rig.wait(5.0)
    rig.axis.stop = lambda now_s: None
    with pytest.raises(FaultError, match=r"still turns at 5 deg/s 30 s after the stop; its servos were"):
        table.release()
    assert not controller.axes[2].closed
    assert controller.feed(b":utility:lockout?\n", 1e6)[8:] == b"OFF"


def test_a_table_that_was_never_prepared_can_be_released(table):
    table.release()
    assert table.read().faults == ()


def test_a_trip_is_reported_in_words_and_ends_the_wait_for_the_position(table, controller):
    table.prepare()
    table.move_to({1: 300.0, 2: 0.0}, rate_dps=100.0)
    controller.trip(2, SoftwareFault.FINE_FEEDBACK_LOSS, table._line.clock.now())
    assert table.read().faults == ("axis 2: fine feedback lost",)
    with pytest.raises(FaultError, match="axis 2: fine feedback lost"):
        table.in_position()
    table.prepare()
    assert table.read().faults == ()


def test_an_open_interlock_keeps_the_table_from_being_prepared(table, controller):
    controller.open_interlock(1, 0.0, bit=9)
    with pytest.raises(FaultError, match="axis 1: master interlock or front panel"):
        table.prepare()
    controller.close_interlock(1, bit=9)
    table.prepare()
    assert table.read().faults == ()


def test_what_the_controller_refuses_is_refused_by_name_and_the_line_stays_in_step(table):
    table.prepare()
    with pytest.raises(RefusedError, match=r"Position 1,500\.000000.*200 Parameter out of range"):
        table.move_to({1: 500.0}, rate_dps=10.0)
    with pytest.raises(RefusedError, match="Rate 3"):
        table.turn_at(3, 1.0)
    with pytest.raises(RefusedError, match="Rate 1,nan"):
        table.turn_at(1, float("nan"))
    assert table.read().rate_dps == (0.0, 0.0)


def test_a_reading_has_the_servo_state(table, controller):
    assert not table.read().is_servoed
    table.prepare()
    assert table.read().is_servoed
    controller.axes[2].open()
    assert not table.read().is_servoed


def test_the_limits_are_those_that_no_command_goes_beyond(table, controller):
    table.set_limits(10.0, 20.0, 30.0)
    first, second = table.limits()
    widest = controller.axes[1].absolute_limits
    assert (first.rate_dps, first.acceleration_dps2, first.jerk_dps3) == (2000.0, 2e4, 2e6)
    assert (first.low_deg, first.high_deg) == (widest.low_deg, widest.high_deg)
    assert first.trip_dps >= first.rate_dps
    assert second == first


@pytest.mark.parametrize("left_behind", [b":Demand:Position 1,1", b"\x00\xff\x13", b";;;", b"*IDN?\r\n"])
def test_the_first_command_succeeds_after_leftovers_of_another_program(serve, controller, left_behind):
    with serve(controller) as line:
        line.write(left_behind)
        table = Acutrol3000(line, reply_timeout_s=1.0)
        table.set_limits(100.0, 100.0, 1000.0)
        table.prepare()
        assert table.read().position_deg == (0.0, 0.0)


def test_moving_without_servo_is_refused(table):
    with pytest.raises(RefusedError, match="Not servoed"):
        table.move_to({1: 5.0}, rate_dps=10.0)


def test_a_single_axis_table_reads_one_axis(serve):
    with serve(Acutrol3000Emulator({1: TableAxis(FAST, position_deg=10.0001)})) as line:
        assert Acutrol3000(line, axes=[1]).read() == TableReading((10.0001,), (0.0,), False, faults=())


# on replies that are wrong


def met(line, reply_timeout_s=120.0):
    """Return a driver that has had its first reply, and so sends nothing twice."""
    table = Acutrol3000(line, reply_timeout_s=120.0)
    table.identify()
    table._reply_timeout_s = reply_timeout_s
    return table


def test_silence_is_reported_with_the_command(serve, scripted):
    with serve(scripted()) as line, pytest.raises(NoReplyError, match=r"\*IDN\?.*0 of 8 bytes"):
        Acutrol3000(line, reply_timeout_s=0.02).identify()


@pytest.mark.parametrize(
    ("answer", "error", "message"),
    [
        (b"\x00\x00\x00", NoReplyError, "3 of 8 bytes"),
        (reply("10.0001")[:-2], NoReplyError, "5 of 7 bytes"),
        (b"\x00\x00\x00\x00\xff\xff\xff\xff", ReplyError, "ff ff"),
        (reply("", code=7), RefusedError, "error 7"),
    ],
    ids=["truncated prefix", "text shorter than its length", "absurd length", "error code without text"],
)
def test_a_damaged_reply_is_an_error(serve, scripted, answer, error, message):
    with serve(scripted(reply("A table"), answer)) as line, pytest.raises(error, match=message):
        met(line, reply_timeout_s=1.0).identify()


@pytest.mark.parametrize("text", ["", "OK", "1.0;2.0;3.0", "1.0;2.0;3.0;4.0;5.0", "1;2;3;nan", "1;2;3;x"])
def test_a_reading_that_is_not_two_numbers_an_axis_is_a_wrong_reply(serve, scripted, text):
    with serve(scripted(reply("A table"), reply(text))) as line, pytest.raises(ReplyError, match=":Read:"):
        met(line).read()


def test_numbers_without_a_decimal_point_are_a_reading(serve, scripted):
    with serve(scripted(reply("A table"), reply("0;1E-05;90;0;16;0;0;16;0;0"))) as line:
        assert met(line).read() == TableReading((0.0, 90.0), (1e-5, 0.0), True, faults=())


@pytest.mark.parametrize("text", ["", "OK", "16", "16;x", "16;256;16;-1", "16;256;16;" + "9" * 5000])
def test_registers_that_are_no_registers_are_a_wrong_reply(serve, scripted, text):
    with serve(scripted(reply("A table"), reply(text))) as line, pytest.raises(ReplyError, match=":Status:"):
        met(line).in_position()


def test_a_command_answered_by_a_number_is_a_wrong_reply(serve, scripted):
    replies = scripted(reply("A table"), reply("10.0"))
    with serve(replies) as line, pytest.raises(ReplyError, match=":Mode:Off 1;Off 2"):
        met(line).stop()


def test_an_empty_line_acknowledges_a_command(serve, scripted):
    with serve(scripted(reply("\r\n"))) as line:
        Acutrol3000(line).stop()


def test_unrequested_input_is_not_taken_for_a_reply(serve, scripted):
    table_replies = scripted(reply("stale") + reply("OK"), reply("OK"))
    with serve(table_replies) as line:
        table = Acutrol3000(line, reply_timeout_s=120.0)
        assert table.identify() == "stale"
        wait_until(lambda: line._port.in_waiting > 0)
        table.stop()


def test_a_late_reply_is_not_taken_for_the_next_one(serve):
    class Late:
        latency_s = 0.0
        count = 0
        timed_out = threading.Event()

        def feed(self, data, now_s):
            self.count += 1
            if self.count == 2:
                assert self.timed_out.wait(120.0)
            if data.startswith(b":Status:"):
                return reply(";".join(["16"] * data.count(b"CSR?")))
            return reply(f"answer {self.count}")

    with serve(Late()) as line:
        table = met(line, reply_timeout_s=1.0)
        with pytest.raises(NoReplyError):
            table.identify()
        Late.timed_out.set()
        # The third is to the line that ends an incomplete message in the controller, the fourth the mark.
        assert table.identify() == "answer 5"


def test_replies_that_come_far_too_late_end_in_no_reply_and_never_in_wrong_readings():
    clock = VirtualClock()
    bench = bench_at(BenchAddress(clock.name, "ideal"))
    line = SerialLine("rate table", f"emulator://table?clock={clock.name}&world=ideal", clock)
    table, emulator = Acutrol3000(line), bench.table
    table.prepare()
    for late_s in (1.0, 2.5, 4.5, 6.5, 9.0):
        for late in (1, 2, 3, 5):
            emulator.latency_s = late_s
            for number in range(late + 6):
                emulator.latency_s = late_s if number < late else 0.005
                for ask in (table.in_position, table.read):
                    with suppress(NoReplyError):
                        answer = ask()
                        assert answer in (True, False) or (answer.is_servoed and not answer.faults)
            assert table.read().is_servoed


@pytest.fixture
def flooded(rig):
    """A driver out of step, and what its controller heard, which answers a mark without end."""
    line, heard = rig.line("table", Scripted(reply("A table")))
    table, read, flood = Acutrol3000(line), line.read, cycle(reply("16"))

    def read_flood(count, deadline):
        if not heard.requests[-1].startswith(b":Status:"):
            return read(count, deadline)
        rig.clock.sleep(0.1)
        assert rig.clock.now() < 1000.0, "reads without end"
        return bytes(islice(flood, count))

    table.identify()
    with pytest.raises(NoReplyError):
        table.identify()
    heard.requests.clear()
    line.read = read_flood
    return table, heard.requests


def test_replies_without_end_to_earlier_requests_end_in_no_reply(flooded, rig):
    began_s = rig.clock.now()
    with pytest.raises(NoReplyError, match=r"was sent, .*: other replies arrive for more than 12 s"):
        flooded[0].read()
    assert rig.clock.now() - began_s < 15.0  # beyond 20 s the bench takes the port for dead


def test_a_stop_is_sent_before_late_replies_are_skipped(flooded):
    table, heard = flooded
    with pytest.raises(NoReplyError):
        table.stop()
    stops = [number for number, data in enumerate(heard) if b":Mode:Off 1;Off 2\r\n" in data]
    assert stops == [0, len(heard) - 1]


def test_a_change_of_byte_order_is_noticed_and_then_accepted(serve, scripted):
    of_no_message = reply("Syntax", code=100, order=">")
    mark = reply(";".join(["16"] * 31), order=">")
    replies = scripted(reply("OK"), reply("OK", order=">"), of_no_message, mark, reply("OK", order=">"))
    with serve(replies) as line:
        table = Acutrol3000(line, reply_timeout_s=1.0)
        table.stop()
        with pytest.raises(ReplyError):
            table.stop()
        assert table.identify() == "OK"


def test_closing_closes_the_line(serve, scripted):
    with serve(scripted()) as line:
        Acutrol3000(line).close()
        with pytest.raises(InstrumentError):
            Acutrol3000(line).identify()


replies = st.one_of(
    st.binary(max_size=40),
    st.text(alphabet="0123456789.;-+eOKnaif \r\n", max_size=40).map(reply),
    st.builds(
        lambda body, code: struct.pack("<II", code, len(body)) + body,
        st.binary(max_size=20),
        st.integers(0, 2**32 - 1),
    ),
)
requests = {
    "identify": lambda table: table.identify(),
    "prepare": lambda table: table.prepare(),
    "move": lambda table: table.move_to({1: 1.0, 2: 2.0}, 5.0),
    "done": lambda table: table.in_position(),
    "read": lambda table: table.read(),
    "stop": lambda table: table.stop(),
}


def test_no_reply_makes_the_driver_raise_anything_but_instrument_errors(serve, scripted):
    instrument = scripted()
    with serve(instrument) as line:
        table = Acutrol3000(line, reply_timeout_s=0.01)

        @given(st.lists(replies, max_size=3), st.sampled_from(sorted(requests)))
        def check(answers, request):
            instrument.replies = list(answers)
            with suppress(InstrumentError):
                requests[request](table)

        check()


words = {"little": "<II", "big": ">II"}


@given(st.sampled_from(["little", "big"]), st.integers(0, 2**32 - 1), st.integers(1, 32768))
def test_any_reply_with_text_shows_its_byte_order(order, code, length):
    assert ReplyFraming().decode(struct.pack(words[order], code, length)) == (code, length)


def test_a_reply_without_text_leaves_the_byte_order_open():
    framing = ReplyFraming()
    assert framing.decode(bytes(8)) == (0, 0)
    assert framing.decode(struct.pack(">II", 0, 7)) == (0, 7)


def test_an_error_without_text_is_read_in_the_known_byte_order():
    framing = ReplyFraming()
    framing.decode(struct.pack(">II", 0, 2))
    assert framing.decode(struct.pack(">II", 200, 0)) == (200, 0)


def test_an_error_without_text_in_an_unknown_byte_order_is_still_an_error():
    assert ReplyFraming().decode(struct.pack(">II", 200, 0)) == (200, 0)


def test_a_length_that_no_message_has_is_no_reply():
    assert ReplyFraming().decode(b"\x00\x00\x00\x00\x31\x30\x2e\x30") is None


def test_a_reply_in_the_other_byte_order_is_no_reply_but_the_next_one_is():
    framing = ReplyFraming()
    framing.decode(struct.pack("<II", 0, 2))
    assert framing.decode(struct.pack(">II", 0, 2)) is None
    assert framing.decode(struct.pack(">II", 0, 2)) == (0, 2)


@given(st.lists(st.binary(min_size=8, max_size=8), max_size=5))
def test_no_prefix_gives_a_length_beyond_the_longest_message(prefixes):
    framing = ReplyFraming()
    for prefix in prefixes:
        decoded = framing.decode(prefix)
        assert decoded is None or 0 <= decoded[1] <= 32768


@pytest.mark.parametrize(
    ("register", "expected"), [(0, []), (0b10, ["rate trip"]), (0b10010, ["rate trip", "fault 4"])]
)
def test_bits_have_names_or_at_least_numbers(register, expected):
    assert set_bits(register, SOFTWARE_FAULTS, "fault") == expected


@pytest.mark.parametrize("late", [False, True])
def test_the_echo_of_an_adapter_is_no_reply(rig, late):
    controller = Echoing(emulator())
    line, heard = rig.line("table", controller)
    table = Acutrol3000(line)
    assert "Acutrol3000" in table.identify()
    table.set_limits(30.0, 60.0, 600.0)
    if late:
        heard.instrument = Echoing(Scripted())
        with pytest.raises(NoReplyError, match="no complete reply to :Mode:"):
            table.stop()
        heard.instrument = controller
    assert table.read().rate_dps == (0.0, 0.0)
    table.stop()
