import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.framer.rtu import FramerRTU

from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.errors import NoReplyError, ReplyError
from gyrobench.drivers.modbus_rtu import PAUSE_AFTER_READ_S, ModbusRtu, append_crc, crc16
from gyrobench.drivers.serial_line import NEXT_REPLY_S, SerialLine

TIMEOUT_S = 1.0

WATLOW_F4_FRAMES = [
    "01 03 00 64 00 01 C5 D5",
    "01 03 02 00 FA 38 07",
    "01 03 02 FE 70 F9 C0",
    "01 03 00 64 00 02 85 D4",
    "01 06 01 2C 03 52 C8 F2",
    "01 06 01 2C FE 70 08 7B",
    "01 10 01 2C 00 01 02 03 52 30 31",
    "01 10 01 2C 00 01 C1 FC",
    "01 06 04 4C 00 02 C8 EC",
    "01 06 04 4D 00 32 99 38",
    "01 06 04 4E 00 00 E8 ED",
    "01 06 07 D0 00 01 48 87",
    "01 83 02 C0 F1",
    "01 86 03 02 61",
]


@pytest.mark.parametrize("text", WATLOW_F4_FRAMES)
def test_known_frames_have_their_crc(text):
    frame = bytes.fromhex(text)
    assert append_crc(frame[:-2]) == frame
    assert crc16(frame) == 0


@given(st.binary(min_size=2, max_size=60))
def test_the_crc_is_that_of_another_implementation(content):
    assert append_crc(content)[-2:] == FramerRTU.compute_CRC(content).to_bytes(2, "big")


@given(content=st.binary(min_size=2, max_size=20), bit=st.integers(0, 15))
def test_a_wrong_bit_is_noticed(content, bit):
    frame = bytearray(append_crc(content))
    frame[bit // 8] ^= 1 << (bit % 8)
    assert crc16(bytes(frame)) != 0


class LatePort:
    """A port with a device whose register n holds n + ``offset``; each reply comes when a script says.

    The script has an entry for each request: when copies of the reply come, in seconds after it, and
    whether each is damaged.
    """

    def __init__(self, clock):
        self.clock = clock
        self.script = []
        self.timeout = 0.0
        self.adapter_echoes = False
        self.offset = 0
        self._due = []

    def write(self, request):
        if self.adapter_echoes:
            self._due += [(self.clock.now(), byte) for byte in request]
        register, count = int.from_bytes(request[2:4]), int.from_bytes(request[4:6])
        values = b"".join((register + i + self.offset).to_bytes(2) for i in range(count))
        reply = append_crc(bytes((1, 3, len(values))) + values)
        for delay_s, is_damaged in self.script.pop(0):
            arrives_s = self.clock.now() + delay_s
            self._due += [(arrives_s, byte ^ is_damaged) for byte in reply]
        self._due.sort(key=lambda arrival: arrival[0])

    def read(self, count):
        end_s, data = self.clock.now() + self.timeout, bytearray()
        while len(data) < count and self._due and self._due[0][0] <= end_s:
            arrives_s, byte = self._due.pop(0)
            self.clock.sleep_until(arrives_s)
            data.append(byte)
        if len(data) < count:
            self.clock.sleep_until(end_s)
        return bytes(data)

    def reset_input_buffer(self):
        self._due = [arrival for arrival in self._due if arrival[0] > self.clock.now()]

    def flush(self):
        pass

    def close(self):
        pass


@pytest.fixture
def port(monkeypatch):
    port = LatePort(VirtualClock())
    monkeypatch.setattr(serial, "serial_for_url", lambda *_, **__: port)
    return port


@pytest.fixture
def modbus(port):
    return ModbusRtu(SerialLine("chamber", "late", port.clock), 1, TIMEOUT_S)


SOON = st.floats(0.0, 0.9 * TIMEOUT_S)
LATE = st.floats(1.001 * TIMEOUT_S, 1.999 * TIMEOUT_S)
EVER = st.floats(0.0, 1.999 * TIMEOUT_S)
GOOD, DAMAGED = st.just(0), st.just(1)
#: In time, perhaps twice before the next question; or too late, perhaps several times; or damaged, and
#: then anything; or lost.
REPLIES = st.one_of(
    st.tuples(SOON, st.lists(st.floats(0.0, 0.9 * PAUSE_AFTER_READ_S), max_size=2)).map(
        lambda reply: [(reply[0], 0), *((reply[0] + more_s, 0) for more_s in reply[1])]
    ),
    st.lists(st.tuples(LATE, GOOD), min_size=1, max_size=3),
    st.tuples(SOON, st.lists(st.tuples(EVER, GOOD), max_size=2)).map(
        lambda reply: [(reply[0], 1), *((max(reply[0], at_s), bad) for at_s, bad in reply[1])]
    ),
    st.just([]),
)
QUESTIONS = st.lists(st.tuples(st.integers(0, 5), st.integers(1, 2), REPLIES), min_size=2, max_size=12)


@given(questions=QUESTIONS)
def test_no_late_lost_or_repeated_reply_gives_the_value_of_another_register(port, modbus, questions):
    for register, count, replies in questions:
        port.script = [replies]
        try:
            values = modbus.read(register, count)
        except (NoReplyError, ReplyError):
            continue
        assert values == tuple(range(register, register + count))
    port.script = [[(0.01, 0)]]
    assert modbus.read(3) == (3,)


def test_a_reply_that_came_too_late_passes_before_the_next_question(port, modbus):
    port.script = [[(1.9, 0)], [(0.01, 0)]]
    with pytest.raises(NoReplyError):
        modbus.read(7)
    assert modbus.read(8) == (8,)
    assert port.clock.now() == pytest.approx(1.9 + TIMEOUT_S + 0.01 + NEXT_REPLY_S)


def test_a_good_reply_costs_no_wait_for_silence(port, modbus):
    port.script = [[(0.01, 0)], [(0.01, 0)]]
    assert modbus.read(7) + modbus.read(8) == (7, 8)
    assert port.clock.now() == pytest.approx(0.02 + PAUSE_AFTER_READ_S)


@pytest.mark.parametrize(("register", "count"), [(7, 1), (0x0203, 1), (0x0605, 3), (0x0400, 2)])
def test_the_echo_of_a_two_wire_adapter_is_no_reply(port, modbus, register, count):
    """Whatever the register: the byte count of its reply may equal the first byte of its number."""
    port.adapter_echoes = True
    for _ in range(3):
        port.script = [[(0.01, 0)]]
        assert modbus.read(register, count) == tuple(range(register, register + count))


def test_a_reply_that_begins_as_its_request_is_no_echo(port, modbus):
    port.offset = 0x0300 - 0x0203
    port.script = [[(0.01, 0)], [(0.01, 0)]]
    for _ in range(2):  # both begin with 01 03 02 03 00
        assert modbus.read(0x0203) == (0x0300,)


def test_the_echo_of_a_write_does_not_pass_for_the_reply_of_a_device_that_is_off(port, modbus):
    port.adapter_echoes = True
    port.script = [[(0.01, 0)], []]
    modbus.read(7)
    with pytest.raises(NoReplyError, match="0 of 5 bytes"):
        modbus.write(7, 1)


def test_a_device_that_is_off_is_no_wrong_checksum_behind_an_adapter_that_echoes(port, modbus):
    port.adapter_echoes = True
    port.script = [[], [(0.01, 0)]]
    with pytest.raises(NoReplyError, match="0 of 5 bytes"):
        modbus.read(7)
    assert modbus.read(8) == (8,)


def test_an_echo_that_differs_from_the_request_is_refused(port, modbus):
    port.adapter_echoes = True
    port.script = [[(0.01, 0)], [(0.01, 0)]]
    modbus.read(7, 2)
    port.adapter_echoes = False
    with pytest.raises(ReplyError, match="the adapter echoed other bytes"):
        modbus.read(7, 2)
