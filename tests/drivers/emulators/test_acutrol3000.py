import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.drivers.emulators.acl_axis import ErrorCode, SoftwareFault
from gyrobench.drivers.emulators.acutrol3000 import Acutrol3000Emulator
from gyrobench.drivers.emulators.world.table_axis import AxisParameters, TableAxis

PARAMETERS = AxisParameters(settling_amplitude_arcsec=0.0)


def make(position_deg=0.0, **options):
    return Acutrol3000Emulator({1: TableAxis(PARAMETERS, position_deg), 2: TableAxis(PARAMETERS)}, **options)


@pytest.fixture
def controller():
    return make()


class Dialogue:
    """Sends messages at its own time and parses the replies."""

    def __init__(self, controller):
        self.controller = controller
        self.now_s = 0.0

    def __call__(self, message, after_s=0.0):
        self.now_s += after_s
        reply = self.controller.feed(message.encode() + b"\r\n", self.now_s)
        code, length = struct.unpack("<II", reply[:8])
        assert len(reply) == 8 + length
        self.code = ErrorCode(code)
        return reply[8:].decode()

    def refused(self, message):
        self(message)
        assert self.code is not ErrorCode.NONE
        return self.code

    def register(self, name):
        return int(self(f":status:csr? {name}"))


@pytest.fixture
def say(controller):
    return Dialogue(controller)


@pytest.fixture
def servoed(say):
    assert say(":Interlock:Close ALL") == "OK"
    return say


# framing


def test_the_documented_reading_of_a_position():
    controller = make(position_deg=10.0001, decimals=4)
    reply = controller.feed(bytes.fromhex("3A 72 65 61 64 3A 70 6F 73 3F 20 31 0D 0A"), 0.0)
    assert reply == bytes.fromhex("00 00 00 00 07 00 00 00 31 30 2E 30 30 30 31")


def test_the_documented_reading_of_three_values_in_one_frame():
    controller = make(position_deg=10.0001, decimals=4)
    assert Dialogue(controller)(":read:pos? 1;rate? 1;acc? 1") == "10.0001;0.0000;0.0000"


def test_the_documented_answer_to_a_command(controller):
    assert controller.feed(b":interlock:close 1\r\n", 0.0) == b"\0\0\0\0\x02\0\0\0OK"


def test_the_prefix_may_be_big_endian():
    assert make(word_order="big").feed(b":i:c 1\n", 0.0) == b"\0\0\0\0\0\0\0\x02OK"


def test_messages_may_come_in_pieces_or_together(controller):
    assert controller.feed(b":read:p", 0.0) == b""
    assert controller.feed(b"os? 1\r", 0.0) == b""
    one = controller.feed(b"\n", 0.0)
    assert controller.feed(b":read:pos? 1\n:read:pos? 1\r\n", 0.0) == one + one


def test_an_empty_line_is_no_message(controller):
    assert controller.feed(b"\r\n\n", 0.0) == b""


def test_a_message_that_is_too_long_is_refused_once_and_forgotten(say, controller):
    assert controller.feed(b"*" * 40000, 0.0) == b""
    assert controller.feed(b"*" * 40000, 0.0) == b""
    assert say("*IDN?").startswith("Message")
    assert say.code is ErrorCode.MESSAGE_TOO_LONG
    assert say("*IDN?").startswith("Acutronic R&D USA,Acutrol3000,")


def test_an_answer_that_would_be_too_long_is_refused(say):
    assert say.refused(";".join(["*IDN?"] * 4000)) is ErrorCode.MESSAGE_TOO_LONG


@given(st.lists(st.binary(max_size=60), max_size=8))
def test_any_bytes_are_answered_by_whole_replies(chunks):
    controller = make()
    for chunk in [*chunks, b"\n"]:
        replies = controller.feed(chunk, 0.0)
        while replies:
            _, length = struct.unpack("<II", replies[:8])
            assert len(replies) >= 8 + length
            replies = replies[8 + length :]
    assert Dialogue(controller)(":read:pos? 1") == "0.000000"


headers = st.sampled_from(
    [
        (name[0] if name[0].startswith("*") else ":" + ":".join(name)) + "?" * is_query
        for name, is_query in make()._handlers
    ]
)
arguments = st.lists(
    st.one_of(
        st.sampled_from(
            ["1", "2", "3", "ALL", "P", "R", "A", "A1DYN", "A2STATE", "A9DYN", "SI", "ON", "QERROR", "1082"]
        ),
        st.floats(-1e3, 1e3).map(str),
        st.integers(-(10**20), 10**20).map(str),
    ),
    max_size=5,
)


@given(st.lists(st.tuples(headers, arguments, st.floats(0.0, 5.0)), max_size=12))
def test_any_commands_with_any_arguments_are_answered(messages):
    say = Dialogue(make())
    for header, values, pause_s in messages:
        assert say(f"{header} {','.join(values)}" if values else header, after_s=pause_s)


# identity, status, errors


@pytest.mark.parametrize(
    ("message", "code"),
    [
        (":Demand:Posn 3,10.5", ErrorCode.UNKNOWN_COMMAND),
        (":Dem;Pos 3,10.5", ErrorCode.UNKNOWN_COMMAND),
        (":D:P,3,10.5", ErrorCode.SYNTAX),
        (":D:P 3,10.5", ErrorCode.PARAMETER_OUT_OF_RANGE),
        (":D:P 1.5,10.5", ErrorCode.PARAMETER_OUT_OF_RANGE),
        (":D:P 1,401", ErrorCode.PARAMETER_OUT_OF_RANGE),
        (":D:R 1,30.1", ErrorCode.PARAMETER_OUT_OF_RANGE),
        (":D:DeltaPosition 1,180.1", ErrorCode.PARAMETER_OUT_OF_RANGE),
        (":D:P 1", ErrorCode.WRONG_PARAMETER_COUNT),
        (":D:P 1,2,3", ErrorCode.WRONG_PARAMETER_COUNT),
        (":D:P 1,two", ErrorCode.WRONG_PARAMETER_TYPE),
        (":read:pos? ALL", ErrorCode.WRONG_PARAMETER_TYPE),
        (":read:variable? 1001", ErrorCode.PARAMETER_OUT_OF_RANGE),
        (":read:variable? 3082", ErrorCode.PARAMETER_OUT_OF_RANGE),
        (":status:csr? A3DYN", ErrorCode.PARAMETER_OUT_OF_RANGE),
        (":status:csr? A1DYN,32", ErrorCode.PARAMETER_OUT_OF_RANGE),
        (":status:ecp 1,3", ErrorCode.PARAMETER_OUT_OF_RANGE),
        (":limit:rate P,1,31", ErrorCode.PARAMETER_OUT_OF_RANGE),
        (":limit:highposition P,1,-401", ErrorCode.PARAMETER_OUT_OF_RANGE),
        (":mode:position 1", ErrorCode.NOT_SERVOED),
        (":mode 1,rate", ErrorCode.NOT_SERVOED),
        (":mode:home 1", ErrorCode.NOT_SERVOED),
        (":mode:synthesis 1", ErrorCode.NOT_AVAILABLE),
        (":mode 1,fast", ErrorCode.PARAMETER_OUT_OF_RANGE),
        (":utility:format BINARY", ErrorCode.NOT_AVAILABLE),
        ("*RST", ErrorCode.UNKNOWN_COMMAND),
        ("*ESE 256", ErrorCode.PARAMETER_OUT_OF_RANGE),
    ],
)
def test_what_is_wrong_is_refused_and_queued(say, message, code):
    assert say.refused(message) is code
    assert say(f":query:error? {int(code)}") == code.text
    assert say(":query:system?") == f"1,{int(code)}"
    assert say("*STB?") == "128"
    assert say(":status:msg? QERROR") == f"{int(code)},{code.text}"
    assert say(":status:msg? QERROR") == "0,No error"
    assert say("*STB?") == "0"


def test_a_message_with_a_wrong_word_does_nothing_at_all(servoed):
    servoed.refused(":demand:rate 1,10;:mode:rate 1;:nonsense 1")
    assert servoed(":mode? 1") == "Off"


def test_a_message_refused_by_an_axis_is_carried_out_up_to_there(servoed):
    servoed.refused(":demand:rate 1,10;:mode:rate 1;rate 7")
    assert servoed(":mode? 1") == "Rate"


def test_at_most_eight_variables_are_read_by_one_message(say):
    assert len(say(";".join([":read:variable? 1082"] * 8)).split(";")) == 8
    assert say.refused(";".join([":read:variable? 1082"] * 9)) is ErrorCode.PARAMETER_OUT_OF_RANGE


def test_standard_events_are_summed_up_when_enabled(say):
    assert say("*ESR?") == "128"
    assert say("*ESR?") == "0"
    say("*ESE 32")
    assert say("*ESE?") == "32"
    say.refused(":nonsense")
    assert int(say("*STB?")) == 128 | 32
    say("*SRE 32")
    assert say("*SRE?") == "32"
    assert int(say("*STB?")) == 128 | 64 | 32
    assert say("*ESR?") == "32"
    say.refused(":demand:position 5,1")
    assert say("*ESR?") == "16"
    say("*CLS")
    assert say("*STB?") == "0"


def test_lockout_is_remembered(say):
    assert say(":utility:lockout?") == "OFF"
    say(":utility:lockout on")
    assert say(":utility:lockout?") == "ON"


# interlock and faults


def test_the_servo_opens_and_closes(say):
    assert say(":interlock? 1") == "Open"
    assert say.register("A1STATE") == 1 << 5
    say(":I:C 1;C 2")
    assert (say(":interlock? 1"), say(":interlock? 2")) == ("Close", "Close")
    assert say(":status:csr? A1STATE,4") == "1"
    say(":interlock:open 1")
    assert (say(":interlock? 1"), say(":interlock? 2")) == ("Open", "Close")


def test_a_trip_latches_until_a_reset(servoed, controller):
    servoed(":demand:rate 1,20;:mode:rate 1")
    controller.trip(1, SoftwareFault.RATE_TRIP, servoed.now_s + 3.0)
    assert servoed(":interlock? 1", after_s=3.0) == "Fault"
    assert servoed.register("A1SWFLT") == 0b10
    assert servoed.register("A1STATE") == 1 << 6 | 1 << 8 | 1 << 9
    assert servoed.register("SI") == 0b01
    assert servoed("*STB?") == "65"
    assert servoed(":interlock? 2") == "Close"
    assert servoed(":status:ecp 1,2") == str(1 << 14)
    assert servoed.refused(":interlock:close 1") is ErrorCode.CANNOT_SERVO
    servoed(":interlock:reset")
    servoed(":interlock:close 1")
    assert servoed(":interlock? 1") == "Close"
    assert servoed.register("A1SWFLT") == 0


def test_a_tripped_axis_comes_to_rest(servoed, controller):
    servoed(":demand:rate 1,20;:mode:rate 1")
    controller.trip(1, SoftwareFault.COARSE_FEEDBACK_LOSS, servoed.now_s + 3.0)
    assert float(servoed(":read:rate? 1", after_s=3.1)) > 0.0
    assert servoed(":read:rate? 1", after_s=3.0) == "0.000000"


def test_an_open_interlock_stays_a_fault_until_closed_and_reset(servoed, controller):
    controller.open_interlock(2, servoed.now_s, bit=9)
    assert servoed(":interlock? 2") == "Fault"
    assert servoed.register("A2INTLK") == 1 << 9
    assert servoed(":status:csr? A2STATE,7") == "1"
    servoed(":interlock:reset")
    assert servoed(":interlock? 2") == "Fault"
    controller.close_interlock(2, bit=9)
    assert servoed(":interlock? 2") == "Fault"
    servoed(":interlock:reset 1")
    assert servoed(":interlock? 2") == "Open"


def test_a_rate_beyond_the_trip_rate_trips(servoed):
    servoed(":limit:vtrip R,2,10;:demand:rate 2,20;:mode:rate 2")
    assert servoed(":interlock? 2", after_s=5.0) == "Fault"
    assert servoed.register("A2SWFLT") == 1 << SoftwareFault.RATE_TRIP


def test_a_following_error_beyond_its_limit_trips():
    say = Dialogue(Acutrol3000Emulator({1: TableAxis(AxisParameters(settling_amplitude_arcsec=36.0))}))
    say(":interlock:close 1;:limit:global 1,-400,400,40,0.005")
    say(":demand:position 1,30;:mode:position 1")
    while say(":status:csr? A1SWFLT", after_s=0.1) == "0":
        assert say.now_s < 10.0
    assert say.register("A1SWFLT") == 1 << SoftwareFault.TRACKING_ERROR


# modes and demands


def test_a_demand_in_another_mode_waits_for_its_mode(servoed):
    servoed(":demand:position 1,30")
    assert servoed(":read:pos? 1", after_s=5.0) == "0.000000"
    servoed(":mode:position 1")
    assert servoed(":read:pos? 1", after_s=5.0) == "30.000000"


def test_a_demand_in_its_mode_is_carried_out_at_once(servoed):
    servoed(":mode:position 1")
    servoed(":demand:position 1,-400")
    assert not servoed.register("A1DYN") & 1 << 8
    assert servoed(":read:pos? 1", after_s=20.0) == "-400.000000"
    assert servoed.register("A1DYN") == 1 << 8 | 1 << 7
    assert servoed(":mode? 1") == "Position"
    assert servoed.register("A1STATE") == 1 << 4 | 1


def test_both_axes_of_one_message_start_in_the_same_frame(servoed):
    servoed(":d:p 1,30;p 2,-30;:m:p all")
    first, second = servoed(":read:pos? 1;pos? 2", after_s=1.1).split(";")
    assert float(first) == -float(second) > 0.0


def test_a_mode_is_entered_without_a_demand_by_stopping(servoed):
    servoed(":demand:rate 1,10;:mode:rate 1")
    servoed(":mode:position 1", after_s=5.0)
    rest = servoed(":read:pos? 1", after_s=5.0)
    assert servoed(":read:pos? 1", after_s=5.0) == rest == servoed(":demand:position? 1")


def test_the_rate_is_demanded_and_reported_complete(servoed):
    servoed(":demand:rate 2,-12.5")
    servoed(":mode 2,rate")
    assert servoed.register("A2DYN") == 0
    assert servoed(":read:rate? 2", after_s=3.0) == "-12.500000"
    assert servoed.register("A2DYN") == 1 << 9
    assert servoed(":demand:rate? 2") == "-12.500000"
    servoed(":mode:off 2")
    assert servoed(":read:rate? 2", after_s=3.0) == "0.000000"
    assert servoed(":mode? 2") == "Off"


def test_a_rate_beyond_the_limit_of_its_mode_is_limited_and_flagged(servoed):
    servoed(":limit:rate R,1,5;:demand:rate 1,20;:mode:rate 1")
    assert servoed(":read:rate? 1", after_s=3.0) == "5.000000"
    assert servoed(":status:csr? A1DYN,4") == "1"


def test_turning_ends_at_the_position_limit(servoed):
    servoed(":demand:rate 1,30;:mode:arate 1")
    assert servoed(":read:pos? 1;rate? 1", after_s=30.0) == "400.000000;0.000000"
    assert servoed.register("A1DYN") == 1 << 6


def test_a_delta_moves_the_demand_on(servoed):
    servoed(":mode:position 1;:demand:delta 1,20")
    servoed(":demand:delta 1,-5.5")
    assert servoed(":demand:position? 1") == "14.500000"
    assert servoed(":read:position 1", after_s=20.0) == "14.500000"


def test_vectors_demand_several_things_of_one_axis(servoed):
    servoed(":demand:shortvector 1,10,3")
    servoed(":demand:vector 2,20,4,5")
    assert servoed(":demand:position? 1;rate? 1") == "10.000000;3.000000"
    assert servoed(":demand:position? 2;rate? 2;acceleration? 2") == "20.000000;4.000000;5.000000"


def test_home_is_position_zero(servoed):
    servoed(":demand:position 1,30;:mode:position 1")
    servoed(":mode:home 1", after_s=10.0)
    assert servoed(":read:pos? 1", after_s=10.0) == "0.000000"


def test_a_demand_from_before_the_servo_closed_is_forgotten(say):
    say(":demand:position 1,30")
    say(":interlock:close 1;:mode:position 1")
    assert say(":read:pos? 1", after_s=10.0) == "0.000000"


def test_mode_off_is_accepted_without_servo(say):
    assert say(":mode:off ALL") == "OK"


# limits and readings


def test_limits_are_set_and_read_back(say):
    say(":limit ALL,P,20,10,40")
    assert say(":limit? 2,P") == "20.0000;10.0000;40.0000"
    assert say(":limit? 2,R") == "30.0000;30.0000;60.0000"
    say(":limit:rate P,1,12;acceleration P,1,5;highposition P,1,179;lowposition P,1,-179;vtrip P,1,33")
    assert say(":limit:rate? pos,1;acc? pos,1;high? P,1;low? P,1;vtrip? P,1") == (
        "12.0000;5.0000;179.0000;-179.0000;33.0000"
    )
    assert say(":limit:absolute? 1") == "30.0000;30.0000;60.0000;-400.0000;400.0000;36.0000"


def test_position_limits_bound_the_demand(say):
    say(":limit:global 1,-90,90,30,0.5")
    assert say.refused(":demand:position 1,91") is ErrorCode.PARAMETER_OUT_OF_RANGE
    assert say(":demand:position 1,-90") == "OK"


def test_limits_slow_the_next_motion(servoed):
    servoed(":limit:rate P,1,2;:demand:position 1,30;:mode:position 1")
    assert servoed(":read:rate? 1", after_s=5.0) == "2.000000"


def test_vectors_and_variables_read_the_same_motion(servoed):
    servoed(":demand:rate 2,10;:mode:rate 2")
    values = servoed(":read:vector? 2", after_s=0.3)
    assert values.startswith(servoed(":read:shortvector? 2"))
    position, _, acceleration = values.split(";")
    assert float(acceleration) == pytest.approx(18.0)
    assert servoed(":read:variable? 2082;variable 2083;variable 2176") == values
    assert servoed(":read:var? 2165;var? 2008;var? 2030") == f"{position};{position};0.000000"


def test_the_tracking_error_is_what_remains_to_settle():
    say = Dialogue(Acutrol3000Emulator({1: TableAxis(AxisParameters())}))
    say(":interlock:close 1;:demand:position 1,30;:mode:position 1")
    while say(":status:csr? A1DYN,8", after_s=0.1) == "0":
        assert say.now_s < 10.0
    command, error, read = map(float, say(":read:var? 1008;var? 1030;var? 1082", after_s=0.8).split(";"))
    assert command == 30.0
    assert error == pytest.approx(20.0 / 3600.0, rel=0.1)
    assert read == pytest.approx(command + error, abs=2e-6)
