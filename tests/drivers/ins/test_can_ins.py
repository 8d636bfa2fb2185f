import re
import zlib

import can
import numpy as np
import pytest
from cantools.database import Database

from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.errors import (
    ConnectionFailedError,
    DocumentError,
    FaultError,
    NoReplyError,
    RefusedError,
    ReplyError,
)
from gyrobench.drivers.frames import ERROR_FRAME, FrameBlock, concatenate
from gyrobench.drivers.ins.attitude import EulerSequence
from gyrobench.drivers.ins.can_bus import open_bus
from gyrobench.drivers.ins.can_ins import CanIns
from gyrobench.drivers.ins.command_map import CommandMap, TermIndices
from gyrobench.drivers.ins.compensation import TERMS, Compensation
from gyrobench.drivers.ins.dbc_codec import DbcCodec, load_dbc
from gyrobench.drivers.ins.ins_status import STALE_S, InsStatus, NewestFrames
from gyrobench.drivers.ins.navigation_data import decode_navigation
from gyrobench.drivers.ins.readout import InsMode
from gyrobench.drivers.ins.signal_map import bind_signals
from tests.drivers.ins.test_dbc_codec import MULTIPLEXED

POLYNOMIAL = Compensation(
    np.array([[0.0, 0.0], [0.5, -0.25], [0.0, 0.0]]), np.full(3, -20.0), np.full(3, 70.0)
)
EVERY_TERM = Compensation(
    polynomial_dph=np.array([[0.01], [0.02], [0.03]]),
    low_c=np.full(3, -20.0),
    high_c=np.full(3, 70.0),
    rate_dph_per_c_per_h=np.full(3, 0.1),
    rate_limit_c_per_h=np.full(3, 30.0),
    gradient_dph_per_k=np.full(3, 0.2),
    difference_low_k=np.full(3, 5.0),
    difference_high_k=np.full(3, 25.0),
    saturating_dph_per_k=np.arange(1.0, 10.0).reshape(3, 3),
    growing_dph_per_k=np.arange(10.0, 19.0).reshape(3, 3),
    onset_c=np.full(3, 50.0),
    onset_width_c=np.full(3, 2.0),
    gravity_dph_per_g=np.arange(19.0, 28.0).reshape(3, 3),
    warm_up_dph=np.full(3, 0.04),
    warm_up_s=np.full(3, 900.0),
    hysteresis_dph_per_k=np.full(3, 0.05),
    half_width_k=np.full(3, 3.0),
)


class ScriptedIns:
    """An INS at the other end of a virtual bus: executes commands, sends its status once a second."""

    def __init__(self, bus, codec, frames_of, to_messages):
        self.bus, self.codec = bus, codec
        self._frames_of, self._to_messages = frames_of, to_messages
        self.state = {"MODE": 1, "EULER_SEQUENCE": 0, "COMPENSATION": 0}
        self.executes = True
        self.silent = False
        self.fails = False
        self.coefficients = {}
        self.loses = None

    def checksum(self):
        numbers = [value for _, value in sorted(self.coefficients.items())]
        return zlib.crc32(np.array(numbers, "<f4").tobytes())

    def tick(self, before_s, now_s):
        while (message := self.bus.recv(0.0)) is not None:
            self._receive(message)
        for second in range(int(np.floor(before_s)) + 1, int(np.floor(now_s)) + 1):
            if not self.silent:
                self.send("INS_STATUS", second, **self.state)
                self.send("INS_IDENTITY", second, SERIAL_NUMBER=17, FIRMWARE=103)
                in_use = self.checksum() if self.state["COMPENSATION"] else 0
                self.send("COMPENSATION_STATUS", second, IN_USE=in_use, LOADED=self.checksum())

    def send(self, name, time_s, **values):
        for message in self._to_messages(self._frames_of(name, time_s, values)):
            self.bus.send(message)

    def _receive(self, message):
        decoded = self.codec.database.decode_message(
            message.arbitration_id, message.data, decode_choices=False
        )
        if message.arbitration_id == 0x201:
            number = decoded["AXIS"], decoded["INDEX"]
            if number != self.loses:
                self.coefficients[number] = decoded["VALUE"]
        elif self.fails:
            self.state["MODE"] = 4
        elif self.executes:
            self._execute(decoded["COMMAND"], decoded["ARGUMENT"])

    def _execute(self, command, argument):
        if command <= 3:
            self.state["MODE"] = command
        elif command == 4:
            self.state["EULER_SEQUENCE"] = argument
        else:
            self.state["COMPENSATION"] = command - 5


class ScriptedClock(VirtualClock):
    """Virtual time in which the scripted INS lives."""

    ins = None

    def sleep(self, duration_s):
        before_s = self.now()
        super().sleep(duration_s)
        if self.ins is not None:
            self.ins.tick(before_s, self.now())


@pytest.fixture
def clock():
    return ScriptedClock()


@pytest.fixture
def buses(request, clock):
    bench = open_bus("virtual", request.node.name, clock)
    far = can.Bus(request.node.name, interface="virtual", ignore_config=True, preserve_timestamps=True)
    yield bench, far
    bench.shutdown()
    far.shutdown()


@pytest.fixture
def unit(buses, clock, codec, frames_of, to_messages):
    clock.ins = ScriptedIns(buses[1], codec, frames_of, to_messages)
    return clock.ins


@pytest.fixture
def batches():
    return []


@pytest.fixture
def driver(buses, signal_map, codec, clock, command_map, batches):
    driver = CanIns(buses[0], signal_map, codec.database, clock, command_map)
    driver.on_frames = batches.append
    return driver


def test_every_frame_is_polled_once_in_order_and_given_to_the_sink(
    driver, buses, recording, to_messages, batches
):
    block = recording(0, 100)
    for message in to_messages(block):
        buses[1].send(message)
    polled = driver.poll()
    assert len(driver.poll()) == 0
    assert batches == [polled]
    assert np.array_equal(polled.rows, block.rows)
    assert driver.frames == len(block)


def test_polled_frames_decode_to_what_was_sent(driver, buses, recording, to_messages, signal_map, codec):
    block = recording(0, 100)
    for message in to_messages(block):
        buses[1].send(message)
    live = decode_navigation(driver.poll(), signal_map, codec)
    logged = decode_navigation(block, signal_map, codec)
    assert np.array_equal(live.ins_time_s, logged.ins_time_s)
    assert np.array_equal(live.velocity_enu_mps, logged.velocity_enu_mps)


def test_the_status_holds_the_newest_values(driver, buses, recording, to_messages, clock):
    for message in to_messages(recording(0, 11, heading=90.0, sequence=np.array([0, 1]))):
        buses[1].send(message)
    driver.poll()
    clock.sleep(0.5)
    status = driver.status()
    assert status.age_s == pytest.approx(0.5)
    assert status.mode is InsMode.NAVIGATE
    assert status.euler_sequence is EulerSequence.PRY_231
    assert status.compensation is False
    assert status.velocity_enu_mps == pytest.approx([-0.001, 0.01, -0.5])
    assert status.attitude @ [0, 1, 0] == pytest.approx([1, 0, 0], abs=1e-9)
    assert status.optics_c == pytest.approx([20.1, 21, 22])
    assert status.electronics_c == pytest.approx([30, 31, 32])
    assert status.case_c == 18
    assert status.identity == {}


@pytest.mark.parametrize("others", [0, 1, 500])
def test_the_newest_frame_of_a_message_counts_wherever_in_its_block_it_is(codec, others):
    times_s = np.arange(3.0 + others)
    identifiers = np.r_[5, 6, 5, np.full(others, 7)]
    data = np.zeros((3 + others, 8), np.uint8)
    data[:, 0] = np.arange(3 + others) % 256
    newest = NewestFrames(codec)
    newest.take(FrameBlock.from_columns(times_s, identifiers, 8, data), 0.0)
    newest.take(FrameBlock.from_columns([1000.0], [8], 8, np.zeros((1, 8))), 1.0)
    found = newest.rows
    assert [found[each][0] for each in (5, 6, 8)] == [2.0, 1.0, 1000.0]
    assert found.get(7, [None])[0] == (2.0 + others if others else None)
    assert 9 not in found


def test_the_newest_frame_of_each_page_of_a_multiplexed_message_counts(in_pages, signal_map):
    codec, block = in_pages
    newest = NewestFrames(codec)
    newest.take(block, 0.0)
    status = InsStatus(newest, 0.0, signal_map, bind_signals(signal_map, codec))
    assert status.optics_c == pytest.approx([20.9, 21, 22])
    late = InsStatus(newest, STALE_S + 1.0, signal_map, bind_signals(signal_map, codec))
    assert np.isnan(late.optics_c).all()
    newest.forget("GYRO_OPTICS_TEMPERATURE")
    forgotten = InsStatus(newest, 0.0, signal_map, bind_signals(signal_map, codec))
    assert np.isnan(forgotten.optics_c).all()


def test_data_where_other_pages_have_a_second_multiplexer_do_not_add_pages_for_ever(tmp_path):
    (tmp_path / "mux.dbc").write_text(MULTIPLEXED)
    codec = DbcCodec(load_dbc(tmp_path / "mux.dbc"))
    newest, identifier = NewestFrames(codec), codec.arbitration_id("MUX")
    for number in range(200):
        frame = FrameBlock.from_columns([0.1 * number], [identifier], 8, [[1, number, 0, 0, 0, 0, 0, 0]])
        newest.take(frame, 0.1 * number)
    assert len(newest.pages[identifier]) <= STALE_S / 0.1 + 1


def test_nothing_is_known_before_the_first_frame_and_after_a_silence(
    driver, buses, recording, to_messages, clock
):
    status = driver.status()
    assert (status.age_s, status.mode, status.compensation) == (np.inf, InsMode.UNKNOWN, None)
    for message in to_messages(recording(0, 1)):
        buses[1].send(message)
    driver.poll()
    clock.sleep(STALE_S + 0.1)
    status = driver.status()
    assert status.age_s == pytest.approx(STALE_S + 0.1)
    assert (status.mode, status.euler_sequence) == (InsMode.UNKNOWN, None)
    assert np.isnan([*status.velocity_enu_mps, *status.optics_c, status.case_c]).all()


def test_a_kind_of_frame_that_stopped_alone_is_not_known_either(driver, buses, frames_of, to_messages):
    stopped = frames_of("INS_STATUS", 0.0, {"MODE": 3})
    for block in (stopped, frames_of("VELOCITY_NE", STALE_S + 1.0, {"VELOCITY_EAST": 1.0})):
        buses[1].send(to_messages(block)[0])
    driver.poll()
    assert driver.status().mode is InsMode.UNKNOWN
    assert driver.status().velocity_enu_mps[0] == pytest.approx(1.0)


def test_error_frames_and_foreign_identifiers_change_no_value(driver, buses, frames_of, to_messages):
    own = to_messages(frames_of("INS_STATUS", 1.0, {"MODE": 3}))[0]
    error = can.Message(
        timestamp=1.0, arbitration_id=0x10, is_extended_id=False, is_error_frame=True, data=bytes(8)
    )
    foreign = can.Message(timestamp=1.0, arbitration_id=0x10, is_extended_id=True, data=bytes(8))
    for message in (own, error, foreign):
        buses[1].send(message)
    driver.poll()
    assert driver.status().mode is InsMode.NAVIGATE
    assert driver.frames == 1


def test_an_ins_that_sends_nothing_is_waited_for(driver, buses, clock, frames_of, to_messages):
    begin_s = clock.now()
    assert not driver.sends_frames(2.0)
    assert clock.now() - begin_s == pytest.approx(2.0, abs=0.1)
    buses[1].send(to_messages(frames_of("INS_STATUS", 1.0, {"MODE": 3}))[0])
    assert driver.sends_frames(2.0)
    assert clock.now() - begin_s == pytest.approx(2.0, abs=0.2)


def test_commands_wait_until_the_status_confirms_them(driver, unit, clock):
    driver.enter(InsMode.ALIGN)
    assert driver.status().mode is InsMode.ALIGN
    driver.enter(InsMode.NAVIGATE)
    assert driver.status().mode is InsMode.NAVIGATE
    driver._complete(driver.set_euler_sequence_stepwise(EulerSequence.PRY_231))
    assert driver.status().euler_sequence is EulerSequence.PRY_231
    driver.apply_compensation()
    assert driver.status().compensation is True
    driver.clear_compensation()
    assert driver.status().compensation is False
    driver.enter(InsMode.STANDBY)
    assert unit.state == {"MODE": 1, "EULER_SEQUENCE": 1, "COMPENSATION": 0}
    assert clock.now() == pytest.approx(6.0, abs=0.1)


def test_a_status_from_before_the_command_confirms_nothing(driver, unit, clock):
    driver.enter(InsMode.ALIGN)
    sent_s = clock.now()
    driver.enter(InsMode.ALIGN)
    assert clock.now() > sent_s + 0.9


def test_frames_that_arrive_while_a_command_waits_reach_the_sink(
    driver, unit, batches, frames_of, to_messages
):
    unit.send("VELOCITY_NE", 0.1, VELOCITY_EAST=1.0)
    driver.enter(InsMode.ALIGN)
    unit.send("VELOCITY_NE", 1.1, VELOCITY_EAST=2.0)
    driver.poll()
    assert concatenate(batches).arbitration_id.tolist() == [0x004, 0x010, 0x011, 0x012, 0x004]


def test_a_command_that_is_not_confirmed_times_out(driver, unit, clock):
    unit.executes = False
    with pytest.raises(
        NoReplyError, match=r"INS: no confirmation of 'align' within 5 s.*mode standby\. Check its"
    ):
        driver.enter(InsMode.ALIGN)
    assert clock.now() == pytest.approx(5.0, abs=0.1)
    unit.silent = True
    with pytest.raises(NoReplyError, match="mode unknown"):
        driver.enter(InsMode.NAVIGATE)


def test_a_mode_that_is_refused_during_alignment_asks_to_wait(driver, unit):
    driver.enter(InsMode.ALIGN)
    unit.executes = False
    with pytest.raises(NoReplyError, match=r"mode align\. Wait until it is aligned, or check the DBC"):
        driver.enter(InsMode.NAVIGATE)


def test_an_ins_that_never_sent_a_frame_has_no_age_of_the_last_one(driver, unit):
    unit.silent = True
    with pytest.raises(NoReplyError, match="; no frame yet, mode unknown"):
        driver.enter(InsMode.ALIGN)


def test_a_mode_that_the_map_lacks_is_named_with_its_value(driver, unit):
    unit.executes, unit.state["MODE"] = False, 9
    with pytest.raises(
        NoReplyError, match=r"mode boot \(INS_STATUS\.MODE is 9, no value of ins\.signals\.mode\)"
    ):
        driver.enter(InsMode.ALIGN)


def test_a_fault_ends_the_wait(driver, unit):
    unit.fails = True
    with pytest.raises(FaultError, match="fault after 'align'"):
        driver.enter(InsMode.ALIGN)


def test_a_compensation_is_loaded_number_by_number(driver, unit, clock):
    loaded = driver.load_compensation(POLYNOMIAL)
    of_y = {index: value for (axis, index), value in unit.coefficients.items() if axis == 1}
    expected = {0: 0.5, 1: -0.25, 2: 0.0, 3: 0.0, 4: 0.0, 5: 0.0, 6: -20.0, 7: 70.0}
    assert of_y == dict.fromkeys(range(28), 0.0) | expected
    assert len(unit.coefficients) == 3 * 28
    assert driver.status().compensation_loaded == loaded == unit.checksum()


def test_every_term_is_sent_to_its_index(driver, unit):
    driver.load_compensation(EVERY_TERM)
    of_z = [unit.coefficients[2, index] for index in range(28)]
    polynomial, attitude = [0.03, 0, 0, 0, 0, 0, -20, 70, 0.1, 30, 0.2, 5, 25], [7, 8, 9, 16, 17, 18, 50, 2]
    assert of_z == pytest.approx([*polynomial, *attitude, 25, 26, 27, 0.04, 900, 0.05, 3])
    assert driver._commands.load_compensation.supported_terms() == list(TERMS)


def test_numbers_that_are_lost_on_the_way_are_noticed(driver, unit):
    unit.loses = (0, 3)
    with pytest.raises(NoReplyError, match=r"no checksum [0-9a-f]{8} of the loaded compensation within 5 s"):
        driver.load_compensation(POLYNOMIAL)


def test_an_ins_without_checksums_is_not_waited_for(buses, make_signal_map, codec, clock, command_map, unit):
    signal_map = make_signal_map(
        {
            "compensation_in_use: COMPENSATION_STATUS.IN_USE\n": "",
            "compensation_loaded: COMPENSATION_STATUS.LOADED\n": "",
        }
    )
    driver = CanIns(buses[0], signal_map, codec.database, clock, command_map)
    driver.load_compensation(POLYNOMIAL)
    assert clock.now() == 0.0
    driver.apply_compensation()
    assert driver.status().compensation is True
    assert driver.status().compensation_in_use is None


def test_terms_that_the_ins_does_not_take_are_refused_and_nothing_is_sent(
    buses, signal_map, codec, clock, command_map, unit
):
    polynomial_alone = command_map.load_compensation.model_copy(
        update={"terms": TermIndices(), "coefficients": 2}
    )
    commands = command_map.model_copy(update={"load_compensation": polynomial_alone})
    driver = CanIns(buses[0], signal_map, codec.database, clock, commands)
    assert driver._commands.load_compensation.supported_terms() == []
    cubic = Compensation(np.ones((3, 4)), np.full(3, -20.0), np.full(3, 70.0), gravity_dph_per_g=np.eye(3))
    with pytest.raises(
        RefusedError,
        match=r"can't compensate a polynomial of degree 3, g_sensitivity\. It supports .* of degree 1",
    ):
        driver.load_compensation(cubic)
    clock.sleep(1.0)
    assert unit.coefficients == {}


@pytest.mark.parametrize(
    ("scale", "numbers", "refused"),
    [
        (1e-4, [0.5, -0.25], "the polynomial of the x gyro"),
        (1e-7, [0.5, -0.25, 3e-6], "the polynomial of the x gyro"),
        (1e-9, [0.5, -0.25, 3e-6], ""),
        (1e-9, [50.0], "the polynomial of the x gyro"),
    ],
)
def test_numbers_that_the_signal_rounds_or_clips_are_refused_and_nothing_is_sent(
    buses, signal_map, codec, clock, command_map, unit, scale, numbers, refused
):
    """A whole number of 32 bits in steps of a scale, in place of a floating-point number."""
    text = codec.database.as_dbc_string()
    text = text.replace("VALUE : 32|32@1- (1,0)", f"VALUE : 32|32@1- ({scale:.9f},0)")
    text = re.sub(r"SIG_VALTYPE_ 513 VALUE ?: 1;", "", text)
    database = Database()
    database.add_dbc_string(text)
    unit.codec = DbcCodec(database)
    without = {"terms": TermIndices(), "coefficients": 3, "lowest_index": None, "highest_index": None}
    load = command_map.load_compensation.model_copy(update=without | {"others": None})
    driver = CanIns(
        buses[0], signal_map, database, clock, command_map.model_copy(update={"load_compensation": load})
    )
    polynomial = np.tile([*numbers, *[0.0] * (3 - len(numbers))], (3, 1)) / 7.0
    compensation = Compensation(polynomial, np.full(3, -20.0), np.full(3, 70.0))
    if refused:
        with pytest.raises(RefusedError, match=refused):
            driver.load_compensation(compensation)
        assert unit.coefficients == {}
    else:
        assert load.altered_numbers(driver.codec, compensation) == []


def test_another_compensation_in_use_than_the_one_loaded_confirms_nothing(
    buses, make_signal_map, codec, clock, command_map, unit
):
    signal_map = make_signal_map({"compensation_loaded: COMPENSATION_STATUS.LOADED\n": ""})
    driver = CanIns(buses[0], signal_map, codec.database, clock, command_map)
    unit.loses = (0, 0)
    loaded = driver.load_compensation(POLYNOMIAL)
    with pytest.raises(
        NoReplyError, match=r"applies a compensation with the checksum .* rounds, limits or ign"
    ):
        driver.apply_compensation(loaded)


def test_a_compensation_in_use_is_reported_with_its_checksum(driver, unit, clock):
    clock.sleep(1.0)
    driver.poll()
    assert (driver.status().compensation, driver.status().compensation_in_use) == (False, 0)
    loaded = driver.load_compensation(EVERY_TERM)
    driver.apply_compensation()
    clock.sleep(1.0)
    driver.poll()
    assert (driver.status().compensation, driver.status().compensation_in_use) == (True, loaded)


def test_commands_that_the_station_lacks_are_refused(buses, signal_map, codec, clock):
    driver = CanIns(buses[0], signal_map, codec.database, clock)
    assert not driver.supports("align")
    for command in (
        lambda: driver.enter(InsMode.ALIGN),
        lambda: next(driver.set_euler_sequence_stepwise(EulerSequence.RPY_321)),
        lambda: driver.load_compensation(POLYNOMIAL),
    ):
        with pytest.raises(RefusedError, match="has no command"):
            command()


def test_commands_that_do_not_fit_the_dbc_are_mistakes(buses, signal_map, codec, clock):
    commands = CommandMap.model_validate({"align": {"message": "INS_COMMAND", "values": {"VERB": 2}}})
    with pytest.raises(DocumentError, match=r"ins\.commands\.align\.values\.VERB: "):
        CanIns(buses[0], signal_map, codec.database, clock, commands)


def test_the_ins_says_who_it_is(driver, unit):
    assert driver.identity() == {"serial_number": 17, "firmware": 103}
    assert driver.identify() == "serial number 17, firmware 103"


def test_an_ins_that_sends_no_identity_gives_none_in_time(driver, unit, clock):
    unit.silent = True
    with pytest.raises(NoReplyError, match="identity"):
        driver.identify()
    assert clock.now() == pytest.approx(5.0, abs=0.1)


def test_an_ins_without_identity_is_named_by_bus_and_dbc(buses, make_signal_map, codec, clock):
    signal_map = make_signal_map(
        {"identity:\n  serial_number: INS_IDENTITY.SERIAL_NUMBER\n  firmware: INS_IDENTITY.FIRMWARE\n": ""}
    )
    driver = CanIns(buses[0], signal_map, codec.database, clock)
    assert driver.identify() == f"INS on {buses[0].channel_info}, DBC version '1.0'"


class BreakingBus(can.BusABC):
    """A bus that delivers two frames and then fails."""

    def __init__(self, error):
        super().__init__("breaking")
        self.channel_info = "breaking bus"
        self._events = iter([can.Message(data=bytes(8)), can.Message(data=bytes(8)), error])

    def _recv_internal(self, timeout):
        event = next(self._events)
        if isinstance(event, Exception):
            raise event
        return event, True

    def send(self, msg, timeout=None):
        raise can.CanOperationError("no room in the queue")


@pytest.mark.parametrize(
    ("error", "raised"),
    [
        (can.CanOperationError("network is down"), ConnectionFailedError),
        (OSError("unplugged"), ConnectionFailedError),
        (ValueError("t12x"), ReplyError),
    ],
)
def test_frames_before_a_failure_of_the_bus_are_not_lost(error, raised, signal_map, codec, clock, batches):
    driver = CanIns(BreakingBus(error), signal_map, codec.database, clock)
    driver.on_frames = batches.append
    assert len(driver.poll()) == 2
    with pytest.raises(raised, match=str(error)):
        driver.poll()
    assert [len(batch) for batch in batches] == [2]
    driver.close()


def test_a_command_that_cannot_be_sent_is_a_failed_connection(signal_map, codec, clock, command_map):
    driver = CanIns(BreakingBus(ValueError()), signal_map, codec.database, clock, command_map)
    with pytest.raises(ConnectionFailedError, match="no room"):
        driver.load_compensation(POLYNOMIAL)
    driver.close()


@pytest.mark.parametrize(
    ("interface", "channel", "options"),
    [("no_such_interface", "x", {}), ("slcan", "/dev/no-such-port", {}), ("slcan", None, {})],
)
def test_a_bus_that_cannot_be_opened_is_a_failed_connection(interface, channel, options, clock):
    with pytest.raises(ConnectionFailedError, match=f"INS 7: can't open the CAN interface '{interface}'"):
        open_bus(interface, channel, clock, bitrate=500_000, instrument="INS 7", **options)


def test_for_a_pseudo_terminal_that_is_gone_the_message_names_what_serves_it(clock):
    with pytest.raises(ConnectionFailedError, match=r"Start the program that served it.*`gyrobench emulate`"):
        open_bus("slcan", "/dev/pts/99999", clock)


def test_closing_twice_is_harmless(driver, buses):
    driver.close()
    driver.close()
    with pytest.raises(ConnectionFailedError, match="closed"):
        driver.poll()


@pytest.mark.parametrize(
    ("identifiers", "expected"),
    [
        ([0x88, 0x04], "the adapter reports 2 bus errors, as with a wrong bit rate"),
        ([None, 0x88], "the adapter reports 1 bus error, as with a wrong bit rate"),
        ([0x88, None], ""),
        ([None, 0x04, 0x40], "the adapter is bus-off after too many errors, as with a wrong bit rate or"),
        ([0x40, 0x100], "the adapter reports 2 bus errors, as with a wrong bit rate"),
        ([0x40, 0x100, 0x40], "the adapter is bus-off after too many errors, as with a wrong bit rate or"),
        ([0x24], "no node acknowledges the adapter's frames, as with an INS that is off or disconnected"),
    ],
)
def test_errors_since_the_last_data_frame_are_stated(signal_map, codec, identifiers, expected):
    """Data frames, here None, of any node show that bit rate and bus are right."""
    clock = VirtualClock()
    driver = CanIns(open_bus("virtual", "errors", clock), signal_map, codec.database, clock)
    with can.Bus("errors", interface="virtual") as other:
        for each in identifiers:
            is_error = each is not None
            other.send(can.Message(arbitration_id=each or 0x700, data=bytes(8), is_error_frame=is_error))
        driver.poll()
    text = driver.describe_bus_errors()
    assert text.startswith(expected)
    assert bool(text) == bool(expected)
    assert driver.describe_foreign_frames().startswith(expected)
    assert driver.error_frames == len(identifiers) - identifiers.count(None)
    driver.close()


@pytest.mark.parametrize("identifier", [0x88, 0x24])
def test_errors_from_before_the_supply_was_switched_on_do_not_describe_an_ins_that_starts(
    signal_map, codec, identifier
):
    """Bus-off lasts: the adapter does not report it again."""
    clock = VirtualClock()
    driver = CanIns(open_bus("virtual", "errors", clock), signal_map, codec.database, clock)
    with can.Bus("errors", interface="virtual") as other:
        for each, expected in ((identifier, ""), (identifier | 0x40, "the adapter is bus-off")):
            other.send(can.Message(arbitration_id=each, data=bytes(8), is_error_frame=True))
            driver.poll()
            driver.forget()
            text = driver.describe_foreign_frames()
            assert text.startswith(expected)
            assert bool(text) == bool(expected)
    assert driver.error_frames == 2
    driver.close()


@pytest.mark.parametrize("is_own", [True, False])
def test_an_error_after_frames_in_the_other_format_does_not_hide_their_format(signal_map, codec, is_own):
    """After frames of another node it describes the bus."""
    clock = VirtualClock()
    driver = CanIns(open_bus("virtual", "errors", clock), signal_map, codec.database, clock)
    identifier = min(codec.arbitration_ids().tolist()) if is_own else 0x700
    with can.Bus("errors", interface="virtual") as other:
        other.send(can.Message(arbitration_id=identifier, data=bytes(8), is_extended_id=True))
        driver.poll()
        assert driver.has_foreign_frames
        other.send(can.Message(arbitration_id=0x88, data=bytes(8), is_error_frame=True))
        driver.poll()
    assert driver.has_other_format == driver.has_foreign_frames == is_own
    expected = "arrives as an identifier of 29 bits" if is_own else "the adapter reports 1 bus error"
    assert expected in driver.describe_foreign_frames()
    driver.close()


def test_errors_of_a_shared_bus_are_logged_for_each_unit(signal_map, codec, batches, frames_of, to_messages):
    clock = VirtualClock()
    bus = open_bus("virtual", "errors", clock)
    driver = CanIns(bus, signal_map, codec.database, clock, is_shared=True)
    driver.on_frames = batches.append
    own = to_messages(frames_of("INS_STATUS", 1.0, {"MODE": 3}))[0]
    with can.Bus("errors", interface="virtual") as other:
        other.send(own)
        other.send(can.Message(arbitration_id=0x700, data=bytes(8), is_extended_id=False))
        other.send(can.Message(arbitration_id=0x88, data=bytes(8), is_error_frame=True))
        driver.poll()
    flags = concatenate(batches).flags.tolist()
    assert flags == [0, ERROR_FRAME]
    assert (driver.frames, driver.error_frames) == (1, 1)
    driver.close()
