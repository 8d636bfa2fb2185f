"""DBC files: decoding and encoding in bulk, and what is refused."""

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from cantools.database import Database
from cantools.database.can import Message, Signal
from cantools.database.conversion import BaseConversion
from hypothesis import given
from hypothesis import strategies as st

import gyrobench.drivers.ins
from gyrobench.bench.foundations.errors import DocumentError, MeasurementError
from gyrobench.drivers.frames import EXTENDED_ID, FrameBlock
from gyrobench.drivers.ins.dbc_codec import MAX_DBC_BYTES, BitField, DbcCodec, Payloads, load_dbc


def block_of(codec, message_name, payloads):
    data = np.zeros((len(payloads), 8), np.uint8)
    for row, payload in zip(data, payloads, strict=True):
        row[: len(payload)] = list(payload)
    lengths = np.array([len(payload) for payload in payloads], np.uint8)
    identifiers = np.full(len(payloads), codec.arbitration_id(message_name), np.uint32)
    return FrameBlock.from_columns(np.arange(len(payloads), dtype=float), identifiers, lengths, data)


def assert_equals_cantools(codec, message, payloads):
    decoded = codec.decode(block_of(codec, message.name, payloads), message.name)
    assert decoded.keys() == {signal.name for signal in message.signals}
    for row, payload in enumerate(payloads):
        expected = message.decode(payload, decode_choices=False)
        for name, values in decoded.items():
            one = codec.decoder(message.name, name)(payload)
            if name not in expected:
                assert math.isnan(values[row])
                assert math.isnan(one)
            else:
                assert one == pytest.approx(values[row], rel=1e-15, abs=0, nan_ok=True)
                assert values[row] == pytest.approx(float(expected[name]), rel=1e-15, abs=0, nan_ok=True)


PROJECT_DBC = Path(gyrobench.drivers.ins.__file__).with_name("gyrobench_ins.dbc")


@pytest.mark.parametrize("message_name", [message.name for message in load_dbc(PROJECT_DBC).messages])
def test_every_signal_of_the_projects_dbc_decodes_as_by_cantools(codec, message_name):
    message = codec.database.get_message_by_name(message_name)
    rng = np.random.default_rng(1)
    payloads = [bytes(row) for row in rng.integers(0, 256, (200, message.length), dtype=np.uint8)]
    assert_equals_cantools(codec, message, [*payloads, bytes(message.length), b"\xff" * message.length])


@st.composite
def layouts(draw):
    """A message whose signals fill random parts of its bytes in both byte orders."""
    length = draw(st.integers(1, 8))
    cuts = sorted({0, length, *draw(st.lists(st.integers(0, length), max_size=3))})
    signals = []
    for first, last in pairwise(cuts):
        big = draw(st.booleans())
        position = 8 * first
        while position < 8 * last:
            width = draw(st.integers(1, 8 * last - position))
            if draw(st.booleans()):
                signals.append(draw(fields(f"S{len(signals)}", position, width, big)))
            position += width
    return Message(0x123, "M", length, signals, is_extended_frame=draw(st.booleans()), strict=True)


@st.composite
def fields(draw, name, position, width, big):
    is_float = width in (16, 32, 64) and draw(st.booleans())
    return Signal(
        name,
        8 * (position // 8) + 7 - position % 8 if big else position,
        width,
        byte_order="big_endian" if big else "little_endian",
        is_signed=not is_float and draw(st.booleans()),
        conversion=BaseConversion.factory(
            scale=draw(st.sampled_from([1, 2, 0.01, -0.5, 1e-6, 1 / 3])),
            offset=draw(st.sampled_from([0, -40, 273.15])),
            is_float=is_float,
        ),
    )


@given(message=layouts(), data=st.data())
def test_any_layout_decodes_as_by_cantools(message, data):
    payloads = data.draw(
        st.lists(st.binary(min_size=message.length, max_size=message.length), min_size=1, max_size=5)
    )
    with np.errstate(over="ignore", invalid="ignore"):
        assert_equals_cantools(DbcCodec(Database([message])), message, payloads)


@given(message=layouts(), data=st.data())
def test_any_layout_encodes_as_by_cantools(message, data):
    codec = DbcCodec(Database([message]))
    values = {}
    for signal in message.signals:
        if signal.conversion.is_float:
            raw = data.draw(st.floats(-1000, 1000, width=16))
        else:
            low = -(2 ** (signal.length - 1)) if signal.is_signed else 0
            bits = min(signal.length, 48)
            raw = data.draw(st.integers(max(low, -(2 ** (bits - 1))), 2 ** (bits - signal.is_signed) - 1))
        values[signal.name] = float(signal.conversion.raw_to_scaled(raw))
    expected = message.encode(values, strict=False)
    assert codec.encode("M", values)[0].tobytes() == expected


MULTIPLEXED = """VERSION ""
NS_ :
BS_:
BU_: A
BO_ 2147484160 MUX: 8 A
 SG_ ROOT M : 7|8@0+ (1,0) [0|0] "" A
 SG_ WHEN_1 m1 : 15|16@0- (0.5,0) [0|0] "" A
 SG_ WHEN_2 m2M : 15|8@0+ (1,0) [0|0] "" A
 SG_ DEEP_3 m3 : 23|16@0+ (1,-5) [0|0] "" A
 SG_ WHEN_5_TO_7 m5 : 15|32@0+ (1,0) [0|0] "" A
 SG_ ALWAYS : 56|8@1- (1,0) [0|0] "" A
SG_MUL_VAL_ 2147484160 WHEN_1 ROOT 1-1 ;
SG_MUL_VAL_ 2147484160 WHEN_2 ROOT 2-2 ;
SG_MUL_VAL_ 2147484160 DEEP_3 WHEN_2 3-3 ;
SG_MUL_VAL_ 2147484160 WHEN_5_TO_7 ROOT 5-7 ;
"""


@pytest.fixture
def multiplexed(tmp_path):
    path = tmp_path / "mux.dbc"
    path.write_text(MULTIPLEXED)
    return DbcCodec(load_dbc(path))


def test_multiplexed_signals_are_nan_where_another_is_sent(multiplexed):
    message = multiplexed.database.get_message_by_name("MUX")
    payloads = [bytes([root, sub, *range(1, 7)]) for root in (1, 2, 5, 6, 7) for sub in (3,)]
    assert_equals_cantools(multiplexed, message, payloads)
    unknown = multiplexed.decode(
        block_of(multiplexed, "MUX", [bytes([9, *range(7)]), bytes([2, 9, *range(6)])]), "MUX"
    )
    assert unknown["ALWAYS"].tolist() == [6, 5]
    assert np.isnan(unknown["WHEN_1"]).all()
    assert np.isnan(unknown["DEEP_3"]).all()


def test_multiplexed_signals_are_encoded_only_where_they_are_selected(multiplexed):
    message = multiplexed.database.get_message_by_name("MUX")
    payloads = multiplexed.encode("MUX", {"ROOT": [1, 5], "WHEN_1": -3.5, "WHEN_5_TO_7": 77, "ALWAYS": -1})
    assert message.decode(payloads[0].tobytes()) == {"ROOT": 1, "WHEN_1": -3.5, "ALWAYS": -1}
    assert message.decode(payloads[1].tobytes()) == {"ROOT": 5, "WHEN_5_TO_7": 77, "ALWAYS": -1}


def test_an_identifier_of_29_bits_is_not_one_of_11(multiplexed):
    assert multiplexed.arbitration_id("MUX") == 512 | EXTENDED_ID
    block = block_of(multiplexed, "MUX", [bytes(8)] * 2)
    block.arbitration_id[1] = 512
    assert len(multiplexed.rows(block, "MUX")) == 1


def test_velocity_of_the_example_has_the_bytes_of_the_ins1000_layout(codec):
    payload = codec.encode("VELOCITY_NE", {"VELOCITY_NORTH": 0.0123, "VELOCITY_EAST": -0.0001})
    assert payload[0].tobytes() == bytes.fromhex("7B 00 00 00 FF FF FF FF")
    decoded = codec.decode(block_of(codec, "VELOCITY_NE", [payload[0].tobytes()]), "VELOCITY_NE")
    assert decoded["VELOCITY_NORTH"][0] == pytest.approx(0.0123)
    assert decoded["VELOCITY_EAST"][0] == pytest.approx(-0.0001)


def test_values_beyond_the_field_are_limited_to_it(codec):
    payloads = codec.encode(
        "GYRO_OPTICS_TEMPERATURE", {"X": [1e9, -1e9, np.inf], "TEMPERATURE_COUNTER": [-1, 1e9, 5]}
    )
    decoded = codec.decode(block_of(codec, "GYRO_OPTICS_TEMPERATURE", [p.tobytes() for p in payloads]),
                           "GYRO_OPTICS_TEMPERATURE")  # fmt: skip
    assert decoded["X"].tolist() == pytest.approx([327.67, -327.68, 327.67])
    assert decoded["TEMPERATURE_COUNTER"].tolist() == [0, 65535, 5]
    assert decoded["Y"].tolist() == [0, 0, 0]


@pytest.mark.parametrize(("signed", "low", "high"), [(True, -(2**63), 2**63 - 1), (False, 0, 2**64 - 1)])
def test_fields_of_64_bits_hold_their_extremes(signed, low, high):
    message = Message(1, "M", 8, [Signal("S", 0, 64, is_signed=signed)], strict=True)
    codec = DbcCodec(Database([message]))
    payloads = [row.tobytes() for row in codec.encode("M", {"S": [-1e30, 1e30]})]
    words = Payloads(np.frombuffer(b"".join(payloads), np.uint8).reshape(-1, 8))
    assert BitField(codec.signal("M", "S")).raw(words).tolist() == [low, high]


def test_not_a_number_fits_no_integer_field(codec):
    with pytest.raises(MeasurementError, match="TIME_S"):
        codec.encode("SYSTEM_TIME", {"TIME_S": np.nan})
    assert codec.encode("COMPENSATION_COEFFICIENT", {"VALUE": np.nan}).shape == (1, 8)


def test_frames_that_are_too_short_are_left_out_and_counted(codec):
    block = block_of(codec, "VELOCITY_NE", [bytes(8), bytes(7), bytes(8), b""])
    assert codec.decode(block, "VELOCITY_NE")["VELOCITY_EAST"].shape == (2,)
    assert block.take(codec.rows(block, "VELOCITY_NE")).timestamp_s.tolist() == [0.0, 2.0]
    assert codec.count_short(block, "VELOCITY_NE") == 2
    assert math.isnan(codec.decoder("VELOCITY_NE", "VELOCITY_EAST")(bytes(7)))


def test_unknown_names_are_answered_with_those_that_look_alike(codec):
    with pytest.raises(DocumentError, match="VELOCITY_NE"):
        codec.decode(block_of(codec, "HEADING", []), "VELOCITY")
    with pytest.raises(DocumentError, match="did you mean EPOCH_COUNTER"):
        codec.signal("HEADING", "EPOCH_COUNT")
    with pytest.raises(DocumentError, match="no signal 'ROLL'"):
        codec.encode("HEADING", {"ROLL": 1.0})


def test_messages_longer_than_a_classic_frame_are_unknown():
    codec = DbcCodec(Database([Message(1, "LONG", 16, [Signal("S", 0, 8)], strict=True)]))
    assert codec.message_names == []


def test_a_dbc_in_windows_1252_is_read(tmp_path, dbc_path):
    text = dbc_path.read_text(encoding="utf-8").replace('"degC"', '"°C"')
    (tmp_path / "cp1252.dbc").write_bytes(text.encode("cp1252"))
    (tmp_path / "utf8.dbc").write_bytes(text.encode("utf-8-sig"))
    for name in ("cp1252.dbc", "utf8.dbc"):
        codec = DbcCodec(load_dbc(tmp_path / name))
        assert codec.signal("GYRO_OPTICS_TEMPERATURE", "X").unit == "°C"


def test_a_dbc_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(DocumentError, match=r"absent\.dbc: can't be read"):
        load_dbc(tmp_path / "absent.dbc")
    (tmp_path / "huge.dbc").write_bytes(b" " * (MAX_DBC_BYTES + 1))
    with pytest.raises(DocumentError, match="at most"):
        load_dbc(tmp_path / "huge.dbc")
    (tmp_path / "bytes.dbc").write_bytes(b"\x81\x8d\xff")
    with pytest.raises(DocumentError, match="not a valid DBC"):
        load_dbc(tmp_path / "bytes.dbc")


@given(data=st.data())
def test_a_damaged_dbc_is_an_error_of_the_document(tmp_path, dbc_path, data):
    content = bytearray(dbc_path.read_bytes()[:3000])
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(content)))
        stop = data.draw(st.integers(start, min(len(content), start + 30)))
        content[start:stop] = data.draw(
            st.binary(max_size=8) | st.sampled_from([b"|", b"99999", b"@0-", b" m1 ", b"M"])
        )
    path = tmp_path / "damaged.dbc"
    path.write_bytes(content)
    try:
        codec = DbcCodec(load_dbc(path))
    except DocumentError:
        return
    for name in codec.message_names:
        codec.decode(block_of(codec, name, [b"\xa5" * 8]), name)


def test_every_signal_of_the_projects_dbc_is_documented(codec):
    for message in codec.database.messages:
        assert message.comment
        assert message.cycle_time in (10, 100, 1000) or message.send_type == "OnEvent"
        for signal in message.signals:
            assert signal.unit
            assert signal.comment
            assert signal.minimum < signal.maximum


_MESSAGE = "BO_ 1 M: 8 X\n"
_SIGNAL = ' SG_ S{} {}: 8|8@1+ (1,0) [0|0] "" X\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("(" * 1_000_000, "line 1: a line of 1000000 characters"),
        ("SG_ " * 250_000, "line 1: a line of 1000000 characters"),
        (
            "\n" + _MESSAGE + "".join(_SIGNAL.format(i, "") for i in range(20_000)),
            "line 2: a message of 20000",
        ),
        (_MESSAGE + "SG_MUL_VAL_ 1 S T 0-60000;\n" * 20_000, "line 3: 120002 multiplexer values"),
        ("\n" * 2_000_001, "at most 2000000 are allowed"),
        (_MESSAGE + _SIGNAL.format(0, "") + _MESSAGE, "a second message called M"),
    ],
)
def test_a_file_that_would_take_minutes_or_is_ambiguous_is_refused(tmp_path, text, message):
    path = tmp_path / "hostile.dbc"
    path.write_text(text)
    with pytest.raises(DocumentError, match=message):
        load_dbc(path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("TIME_S : 0|32", "TIME_S : 99999999|32", r"line 16: a signal of 32 bits at bit 99999999"),
        ("SYSTEM_TIME: 8", "SYSTEM_TIME: 99999999", r"line 15: a message of 99999999 bytes"),
        (
            "SIG_VALTYPE_",
            "SG_MUL_VAL_ 1 TIME_S TIME_NS 0-4294967295 ;\nSIG_VALTYPE_",
            "line 182: 4294967296 multiplexer values",
        ),
        (
            "SIG_VALTYPE_ 513 VALUE",
            "SIG_VALTYPE_ 512 COMMAND",
            r"INS_COMMAND\.COMMAND: a floating-point number of 8 bits",
        ),
        ("(0.0001,0)", "(0,0)", r"VELOCITY_NE\.VELOCITY_NORTH: scale 0 "),
        ("(0.0001,0)", "(1,1e999)", r"VELOCITY_NE\.VELOCITY_NORTH: scale 1 and offset inf"),
    ],
)
def test_numbers_that_no_can_message_has_are_refused(tmp_path, dbc_path, old, new, message):
    # The key word also stands in the file's list of symbols, so the last place is meant there.
    head, found, tail = (
        dbc_path.read_text().rpartition(old) if old.startswith("SIG") else dbc_path.read_text().partition(old)
    )
    assert found
    path = tmp_path / "changed.dbc"
    path.write_text(head + new + tail)
    with pytest.raises(DocumentError, match=message) as error:
        load_dbc(path)
    assert str(error.value).startswith(str(path))
