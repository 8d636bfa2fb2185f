import struct

import pytest
import serial

from gyrobench.drivers.emulators.modbus_rtu import FramerRTU

IDENTITY = b"*IDN?\n"


def framed(function, register, value):
    content = struct.pack(">BBHh", 1, function, register, value)
    return content + struct.pack(">H", FramerRTU.compute_CRC(content))


READ_AIR, READ_SET_POINT = framed(3, 100, 1), framed(3, 300, 1)


def intact(frame):
    return len(frame) > 4 and FramerRTU.compute_CRC(frame) == 0


def exchange(port, request, size=100):
    port.reset_input_buffer()
    port.write(request)
    return port.read(size)


def test_a_lost_reply_is_one_reply_and_the_request_was_carried_out(rig):
    bench = rig({"fault": "lost_reply", "target": "table", "at_s": 0})
    port = bench.port("table")
    assert exchange(port, b":Interlock:Close 1\n") == b""
    assert exchange(port, b":Interlock? 1\n")[8:] == b"Close"
    assert bench.kinds == ["lost_reply"]


def test_a_lost_request_was_not_carried_out(rig):
    port = rig({"fault": "lost_request", "target": "table", "at_s": 0}).port("table")
    assert exchange(port, b":Interlock:Close 1\n") == b""
    assert exchange(port, b":Interlock? 1\n")[8:] == b"Open"


def test_replies_are_lost_as_many_as_said_or_for_a_time(rig):
    bench = rig(
        {"fault": "lost_reply", "target": "chamber", "at_s": 0, "replies": 2},
        {"fault": "lost_reply", "target": "chamber", "at_s": 10, "for_s": 5},
    )
    port = bench.port("chamber")
    assert [bool(exchange(port, READ_AIR)) for _ in range(3)] == [False, False, True]
    bench.until(11.0)
    assert [bool(exchange(port, READ_AIR)) for _ in range(3)] == [False, False, False]
    bench.until(15.0)
    assert intact(exchange(port, READ_AIR))
    assert bench.kinds == ["lost_reply", "lost_reply"]


def test_a_late_reply_comes_as_the_answer_to_the_next_question(rig):
    bench = rig({"fault": "late_reply", "target": "chamber", "at_s": 0, "delay_s": 1.5})
    port = bench.port("chamber")
    assert exchange(port, READ_AIR) == b""
    assert bench.clock.now() == pytest.approx(1.0)
    right = exchange(port, READ_SET_POINT)
    assert bench.clock.now() == pytest.approx(2.0)
    assert len(right) == 14
    assert intact(right[:7])
    assert intact(right[7:])


def test_half_a_reply_comes(rig):
    port = rig({"fault": "half_reply", "target": "chamber", "at_s": 0}).port("chamber")
    half, whole = exchange(port, READ_AIR), exchange(port, READ_AIR)
    assert half == whole[:3]
    assert intact(whole)


def test_the_reply_to_an_earlier_question_comes_again(rig):
    bench = rig({"fault": "earlier_reply", "target": "table", "at_s": 5})
    port = bench.port("table")
    identity = exchange(port, IDENTITY)
    bench.until(6.0)
    assert exchange(port, b":Read:Position? 1\n") == identity
    assert exchange(port, b":Read:Position? 1\n")[8:] == b"0.000000"


@pytest.mark.parametrize("instead", [False, True])
def test_garbage_comes_before_or_instead_of_a_reply(rig, instead):
    bench = rig({"fault": "garbage", "target": "chamber", "at_s": 0, "bytes": 5, "instead": instead})
    port = bench.port("chamber")
    garbage, right = exchange(port, READ_AIR), exchange(port, READ_AIR)
    assert len(garbage) == 5 + (0 if instead else len(right))
    assert garbage.endswith(right) is not instead
    assert intact(right)


def test_a_damaged_reply_has_as_many_wrong_bits_as_said(rig):
    port = rig({"fault": "damaged_reply", "target": "chamber", "at_s": 0, "bytes": 3}).port("chamber")
    damaged, right = exchange(port, READ_AIR), exchange(port, READ_AIR)
    wrong_bits = [(a ^ b).bit_count() for a, b in zip(damaged, right, strict=True)]
    assert sorted(wrong_bits, reverse=True) == [1, 1, 1, 0, 0, 0, 0]


def test_a_wrong_crc_leaves_the_content(rig):
    port = rig({"fault": "wrong_crc", "at_s": 0}).port("chamber")
    wrong, right = exchange(port, READ_AIR), exchange(port, READ_AIR)
    assert wrong[:-2] == right[:-2]
    assert not intact(wrong)


def test_an_exception_code_refuses_the_request(rig):
    port = rig({"fault": "exception_code", "at_s": 0, "code": 4}).port("chamber")
    write = framed(6, 300, 500)
    refusal = exchange(port, write)
    assert refusal[:3] == bytes.fromhex("01 86 04")
    assert intact(refusal)
    assert exchange(port, READ_SET_POINT)[3:5] == struct.pack(">h", 230)
    assert exchange(port, write) == write


def test_an_error_word_refuses_the_message(rig):
    port = rig({"fault": "error_word", "at_s": 0, "error": "not_available"}).port("table")
    code, length = struct.unpack("<II", (reply := exchange(port, b":Interlock:Close 1\n"))[:8])
    assert (code, reply[8:]) == (203, b"Not available")
    assert length == len(reply) - 8
    assert exchange(port, b":Interlock? 1\n")[8:] == b"Open"


def test_an_unplugged_port_must_be_reopened(rig):
    bench = rig({"fault": "port_gone", "target": "table", "at_s": 10, "for_s": 20})
    port, chamber = bench.port("table"), bench.port("chamber")
    assert exchange(port, IDENTITY)
    bench.until(11.0)
    for use in (lambda: port.write(IDENTITY), lambda: port.read(1), port.reset_input_buffer):
        with pytest.raises(serial.SerialException, match="gone"):
            use()
    with pytest.raises(serial.SerialException, match="No such file"):
        bench.port("table")
    assert intact(exchange(chamber, READ_AIR))
    bench.until(31.0)
    with pytest.raises(serial.SerialException, match="gone"):
        port.write(IDENTITY)
    port.close()
    assert exchange(bench.port("table"), IDENTITY)


def test_a_table_that_restarts_is_silent_and_comes_back_with_its_defaults(rig):
    bench = rig({"fault": "instrument_restarts", "target": "table", "at_s": 10, "for_s": 5})
    port = bench.port("table")
    for message in (b":Interlock:Close ALL\n", b":Limit:Rate R,1,2\n", b":Mode:Rate 1\n", b":D:R 1,1\n"):
        assert exchange(port, message)[8:] == b"OK"
    bench.until(11.0)
    assert exchange(port, IDENTITY) == b""
    assert bench.world.axes[1].encoder(bench.clock.now()).rate_dps == 0.0
    bench.until(15.0)
    assert exchange(port, b":Interlock? 1\n")[8:] == b"Open"
    assert exchange(port, b":Limit? 1,R\n")[8:].split(b";")[0] == b"60.0000"


def test_a_chamber_that_restarts_drops_its_outputs_and_forgets_what_was_not_saved(rig):
    bench = rig({"fault": "instrument_restarts", "target": "chamber", "at_s": 100, "for_s": 10})
    port = bench.port("chamber")

    def write(register, value):
        request = framed(6, register, value)
        assert exchange(port, request) == request

    write(300, 400)
    write(25, 0)
    write(300, 500)
    write(2000, 1)
    write(2010, 1)
    bench.until(50.0)
    assert bench.world.unit.powered
    bench.until(101.0)
    assert exchange(port, READ_AIR) == b""
    assert not bench.world.unit.powered
    assert not bench.world.air.running
    bench.until(111.0)
    assert exchange(port, READ_SET_POINT)[3:5] == struct.pack(">h", 400)
    assert not bench.world.air.running
