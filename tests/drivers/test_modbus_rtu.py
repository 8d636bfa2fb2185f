import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.framer.rtu import FramerRTU

from drivers.modbus_rtu import crc16, framed

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
    assert framed(frame[:-2]) == frame
    assert crc16(frame) == 0


@given(st.binary(min_size=2, max_size=60))
def test_the_crc_is_that_of_another_implementation(content):
    assert framed(content)[-2:] == FramerRTU.compute_CRC(content).to_bytes(2, "big")


@given(content=st.binary(min_size=2, max_size=20), bit=st.integers(0, 15))
def test_a_wrong_bit_is_noticed(content, bit):
    frame = bytearray(framed(content))
    frame[bit // 8] ^= 1 << (bit % 8)
    assert crc16(bytes(frame)) != 0
