import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.drivers.rate_table.acutrol3000 import SOFTWARE_FAULTS, ReplyFraming, set_bits

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
    ("register", "expected"),
    [(0, []), (0b10, ["rate trip"]), (0b10010, ["rate trip", "fault 4"])],
)
def test_bits_have_names_or_at_least_numbers(register, expected):
    assert set_bits(register, SOFTWARE_FAULTS, "fault") == expected
