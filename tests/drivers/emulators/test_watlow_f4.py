import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.framer.rtu import FramerRTU

from gyrobench.drivers.emulators.watlow_f4 import WatlowF4Emulator
from gyrobench.drivers.emulators.world.thermal import ChamberAir, ChamberParameters

READ_PV = "01 03 00 64 00 01 C5 D5"
PV_25 = "01 03 02 00 FA 38 07"


def frame(content: str | bytes) -> bytes:
    data = bytes.fromhex(content) if isinstance(content, str) else content
    return data + FramerRTU.compute_CRC(data).to_bytes(2, "big")


class Line:
    """Spaced exchanges with an emulator."""

    def __init__(self, **options) -> None:
        self.air = ChamberAir(ChamberParameters(low_c=-70.0))
        self.events: list[tuple[int, bool]] = []
        self.chamber = WatlowF4Emulator(
            self.air, on_event=lambda number, on: self.events.append((number, on)), **options
        )
        self.now_s = 0.0

    def exchange(self, request: str | bytes) -> str:
        self.now_s += 1.0
        data = bytes.fromhex(request) if isinstance(request, str) else request
        return self.chamber.feed(data, self.now_s).hex(" ").upper()

    def read(self, register: int, count: int = 1) -> list[int]:
        reply = bytes.fromhex(self.exchange(frame(bytes((1, 3, *divmod(register, 256), 0, count)))))
        assert reply == frame(reply[:-2])
        assert reply[:3] == bytes((1, 3, 2 * count))
        return [int.from_bytes(reply[i : i + 2], "big", signed=True) for i in range(3, 3 + 2 * count, 2)]

    def write(self, register: int, value: int) -> int:
        """Returns the exception code, or zero."""
        request = bytes((1, 6, *divmod(register, 256))) + value.to_bytes(2, "big", signed=True)
        reply = bytes.fromhex(self.exchange(frame(request)))
        if reply == frame(request):
            return 0
        assert reply == frame(bytes((1, 0x86, reply[2])))
        return reply[2]


@pytest.fixture
def line() -> Line:
    return Line()


@pytest.mark.parametrize(("air_c", "reply"), [(25.0, PV_25), (-40.0, "01 03 02 FE 70 F9 C0")])
def test_the_process_value_is_read_as_in_the_manual(line, air_c, reply):
    line.air.air_c = air_c
    assert line.exchange(READ_PV) == reply


def test_process_value_and_error_come_in_one_read(line):
    line.air.air_c, line.chamber.sensor_error = 25.0, 1
    assert line.exchange("01 03 00 64 00 02 85 D4") == frame("01 03 04 00 FA 00 01").hex(" ").upper()


@pytest.mark.parametrize(
    ("request_", "attribute", "value"),
    [
        ("01 06 01 2C 03 52 C8 F2", "set_point_c", 85.0),
        ("01 06 01 2C FE 70 08 7B", "set_point_c", -40.0),
        ("01 06 07 D0 00 01 48 87", "running", True),
    ],
)
def test_single_writes_are_echoed_and_take_effect(line, request_, attribute, value):
    assert line.exchange(request_) == request_
    assert getattr(line.air, attribute) == value


def test_a_ramp_is_set_as_in_the_manual(line):
    for request in ("01 06 04 4C 00 02 C8 EC", "01 06 04 4D 00 32 99 38", "01 06 04 4E 00 00 E8 ED"):
        assert line.exchange(request) == request
    assert line.air.ramp_rate_c_per_min == 5.0


def test_several_registers_are_written_by_function_16(line):
    assert line.exchange("01 10 01 2C 00 01 02 03 52 30 31") == "01 10 01 2C 00 01 C1 FC"
    assert line.air.set_point_c == 85.0
    assert line.exchange(frame("01 10 04 4C 00 03 06 00 02 00 0F 00 01")) != ""
    assert line.air.ramp_rate_c_per_min == pytest.approx(1.5 / 60.0)


def test_unknown_registers_are_refused_with_exception_02(line):
    assert line.exchange(frame("01 03 0B B8 00 01")) == "01 83 02 C0 F1"
    assert line.exchange(frame("01 03 00 64 00 20")) == "01 83 02 C0 F1"
    assert line.write(3000, 0) == 2
    assert line.write(100, 0) == 2  # read only


def test_bad_values_are_refused_with_exception_03(line):
    assert line.exchange(frame("01 06 01 2C 7F FF")) == "01 86 03 02 61"
    assert line.air.set_point_c == 23.0
    assert line.exchange(frame("01 03 00 64 00 00")) == frame("01 83 03").hex(" ").upper()
    for content in ("01 10 01 2C 00 02 02 03 52", "01 10 01 2C 00 01 03 03 52 00", "01 10 01 2C 00 00 00"):
        assert line.exchange(frame(content)) == frame("01 90 03").hex(" ").upper()
    assert line.air.set_point_c == 23.0


@pytest.mark.parametrize("content", ["01 01 00 64 00 01", "01 04 00 64 00 01", "01 41", "01 2B 0E 01 00"])
def test_other_functions_are_refused_with_exception_01(line, content):
    function = bytes.fromhex(content)[1]
    assert line.exchange(frame(content)) == frame(bytes((1, function | 0x80, 1))).hex(" ").upper()


def test_damaged_frames_and_other_addresses_get_no_reply(line):
    assert line.exchange("01 03 00 64 00 01 C5 D4") == ""
    assert line.exchange(frame("02 03 00 64 00 01")) == ""
    assert line.exchange(frame("01 83 02")) == ""


def test_a_broadcast_is_executed_without_an_answer(line):
    assert line.exchange(frame("00 06 01 2C 03 52")) == ""
    assert line.air.set_point_c == 85.0
    assert line.exchange(frame("00 03 00 64 00 01")) == ""


def test_another_address_can_be_set():
    line = Line(address=7)
    assert line.exchange(READ_PV) == ""
    line.air.air_c = 25.0
    assert line.exchange(frame("07 03 00 64 00 01")) == frame("07 03 02 00 FA").hex(" ").upper()


def test_a_frame_may_come_in_pieces_without_a_gap(line):
    line.air.air_c = 25.0
    data = bytes.fromhex(READ_PV)
    replies = [line.chamber.feed(data[i : i + 1], i * 0.001) for i in range(len(data))]
    assert b"".join(replies) == replies[-1] == bytes.fromhex(PV_25)


def test_a_gap_ends_a_frame(line):
    line.air.air_c = 25.0
    data = bytes.fromhex(READ_PV)
    assert line.chamber.feed(data[:5], 10.0) == b""
    assert line.chamber.feed(data[5:], 10.1) == b""
    assert line.chamber.feed(data, 10.2) == bytes.fromhex(PV_25)


@given(st.lists(st.tuples(st.binary(max_size=40), st.floats(0.0, 0.1)), max_size=8))
def test_no_bytes_crash_it_and_after_a_silence_it_answers(pieces):
    line = Line()
    now_s = 0.0
    for data, gap_s in pieces:
        now_s += gap_s
        line.chamber.feed(data, now_s)
    line.air.air_c = 25.0
    assert line.chamber.feed(bytes.fromhex(READ_PV), now_s + 0.1) == bytes.fromhex(PV_25)


@given(address=st.integers(0, 2), function=st.integers(0, 255), content=st.binary(max_size=20))
def test_any_intact_frame_is_answered_or_ignored(address, function, content):
    reply = Line().chamber.feed(frame(bytes((address, function)) + content), 1.0)
    assert not reply or (address == 1 and reply == frame(reply[:-2]))


@given(number=st.integers(-32768, 32767), decimals=st.integers(0, 3))
def test_what_is_written_as_a_limit_is_read_back(number, decimals):
    line = Line(decimals=decimals)
    assert line.write(302, number) == 0
    assert line.read(302) == [number]


def test_temperatures_have_the_resolution_of_the_implied_decimals():
    line = Line(decimals=2)
    line.air.air_c = 25.0678
    assert line.read(100) == [2507]
    assert line.read(606) == [2]
    assert line.write(606, 0) == 0
    assert line.read(100) == [25]
    assert line.write(606, 4) == 3


def test_values_beyond_16_bits_are_shown_as_the_last_that_fits():
    line = Line(decimals=3)
    line.air.air_c = 85.0
    assert line.read(100) == [32767]


def test_set_points_are_held_within_their_limits(line):
    assert line.read(602, 2) == [-700, 1000]
    assert line.write(603, 800) == 0
    assert line.write(300, 801) == 3
    assert line.write(300, 800) == 0
    assert line.read(300) == [800]


def test_identity_units_and_save(line):
    assert line.read(0) == [5270]
    assert line.read(608) == [0]
    assert line.read(901) == [1]
    assert line.read(200) == [0]
    assert line.write(901, 2) == 3
    assert line.write(901, 0) == 0
    assert (line.read(901), line.read(100)) == ([0], [734])
    assert line.write(25, 0) == 0


def test_heating_and_cooling_power_are_separate(line):
    line.air.power = 0.5
    assert (line.read(103), line.read(107)) == ([5000], [0])
    line.air.power = -0.25
    assert (line.read(103), line.read(107)) == ([0], [2500])


def test_every_change_of_an_event_output_is_reported(line):
    assert line.write(2000, 1) == line.write(2010, 1) == line.write(2010, 1) == line.write(2070, 1) == 0
    assert line.write(2010, 0) == 0
    assert line.events == [(1, True), (2, True), (8, True), (2, False)]
    assert line.air.running
    assert (line.read(2000), line.read(2010), line.read(2070)) == ([1], [0], [1])
    assert line.write(2000, 2) == 3
    assert line.write(2080, 1) == 2


def test_alarm_1_stays_until_it_is_cleared_and_its_cause_is_gone(line):
    assert line.read(302, 2) == [-750, 1050]
    line.air.air_c = 105.1
    assert line.read(102) == [2]
    line.air.air_c = 20.0
    assert line.read(102) == [2]
    assert line.write(312, 1) == 0
    assert line.read(102) == [0]
    line.air.air_c = -76.0
    assert line.write(312, 1) == 0
    assert line.read(102) == [1]


def test_alarm_2_and_sensor_errors_can_be_set(line):
    line.chamber.alarm_2 = 1
    line.chamber.break_sensor(3)
    assert (line.read(106), line.read(101)) == ([1], [3])
    assert line.write(311, 1) == line.write(313, 1) == line.write(312, 1) == 0
    assert (line.read(106), line.read(101)) == ([0], [3])  # the sensor is still broken


def test_an_f4s_has_no_ramp_registers():
    line = Line(model="F4S")
    assert line.write(1100, 2) == 2
    assert line.exchange(frame("01 03 04 4C 00 03")) == "01 83 02 C0 F1"


def test_ramp_modes(line):
    assert line.read(1100, 3) == [0, 1000, 0]
    assert line.write(1101, 20) == line.write(1100, 2) == 0
    assert line.air.ramp_rate_c_per_min == 2.0
    assert line.write(1100, 0) == 0
    assert line.air.ramp_rate_c_per_min is None
    assert line.write(1100, 3) == line.write(1101, 0) == line.write(1101, 9991) == line.write(1102, 2) == 3


def test_a_start_up_ramp_ends_with_the_next_set_point(line):
    line.write(1101, 20)
    line.write(1100, 1)
    line.write(300, 600)
    assert line.air.ramp_rate_c_per_min is None
    line.write(2000, 1)
    assert line.air.ramp_rate_c_per_min == 2.0
    line.write(300, 500)
    assert line.air.ramp_rate_c_per_min is None


def test_the_ramp_is_what_the_air_does(line):
    for register, value in ((1101, 15), (1102, 0), (1100, 2), (300, 800), (2000, 1)):
        assert line.write(register, value) == 0
    for _ in range(20 * 60):
        line.air.step(1.0)
    assert line.read(100)[0] == pytest.approx(10 * (23.0 + 1.5 * (20.0 - 1.5)), abs=1)


def test_a_profile_overrides_the_set_point_until_it_is_ended(line):
    assert line.write(300, 300) == 0
    line.chamber.start_profile(-40.0)
    assert (line.read(200), line.read(300), line.air.set_point_c) == ([2], [300], -40.0)
    assert line.write(1210, 1) == 0
    assert line.read(200) == [3]
    assert line.write(1209, 1) == 0
    assert line.read(200) == [2]
    assert line.write(1217, 1) == 0
    assert (line.read(200), line.air.set_point_c) == ([0], 30.0)


def test_the_clock_is_set_and_runs(line):
    fields = b"".join(value.to_bytes(2, "big") for value in (23, 59, 59, 2, 28, 2028))
    assert line.exchange(frame(bytes.fromhex("01 10 07 7C 00 06 0C") + fields)).startswith(
        "01 10 07 7C 00 06"
    )
    assert line.read(1916, 6) == [0, 0, 0, 2, 29, 2028]


def test_no_digital_input_is_active(line):
    for place in range(4):
        assert line.read(201 + 12 * place) != line.read(1061 + 2 * place)
