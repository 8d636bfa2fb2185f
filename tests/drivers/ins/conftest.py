from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import can
import numpy as np
import pytest
from numpy.typing import ArrayLike

import gyrobench.drivers.ins
from gyrobench.bench.foundations.documents import parse_document, validate
from gyrobench.drivers.frames import FrameBlock, concatenate
from gyrobench.drivers.ins.command_map import CommandMap
from gyrobench.drivers.ins.dbc_codec import DbcCodec, load_dbc
from gyrobench.drivers.ins.signal_map import SignalMap

DBC = Path(gyrobench.drivers.ins.__file__).with_name("gyrobench_ins.dbc")

SIGNALS = """
time_s: SYSTEM_TIME.TIME_S
time_ns: SYSTEM_TIME.TIME_NS
epoch_counter: HEADING.EPOCH_COUNTER
epoch_period_s: 0.1
velocity_east: VELOCITY_NE.VELOCITY_EAST
velocity_north: VELOCITY_NE.VELOCITY_NORTH
velocity_up: {signal: HEIGHT_VELOCITY_D.VELOCITY_DOWN, sign: -1}
attitude:
  euler:
    roll: ROLL_PITCH.ROLL
    pitch: ROLL_PITCH.PITCH
    yaw: HEADING.HEADING
    sequence: INS_STATUS.EULER_SEQUENCE
    yaw_positive: down
  valid: HEADING.ATTITUDE_VALID
gyro_optics_temperature:
  x: GYRO_OPTICS_TEMPERATURE.X
  y: GYRO_OPTICS_TEMPERATURE.Y
  z: GYRO_OPTICS_TEMPERATURE.Z
gyro_electronics_temperature:
  x: GYRO_ELECTRONICS_TEMPERATURE.X
  y: GYRO_ELECTRONICS_TEMPERATURE.Y
  z: GYRO_ELECTRONICS_TEMPERATURE.Z
case_temperature: GYRO_ELECTRONICS_TEMPERATURE.CASE
mode: {signal: INS_STATUS.MODE, standby: 1, align: 2, navigate: 3, fault: 4}
alignment: {signal: HEADING.ALIGNMENT, coarse: 1, fine: 2}
compensation: INS_STATUS.COMPENSATION
compensation_in_use: COMPENSATION_STATUS.IN_USE
compensation_loaded: COMPENSATION_STATUS.LOADED
identity:
  serial_number: INS_IDENTITY.SERIAL_NUMBER
  firmware: INS_IDENTITY.FIRMWARE
"""

COMMANDS = """
standby: {message: INS_COMMAND, values: {COMMAND: 1}}
align: {message: INS_COMMAND, values: {COMMAND: 2}}
navigate: {message: INS_COMMAND, values: {COMMAND: 3}}
set_euler_sequence: {message: INS_COMMAND, values: {COMMAND: 4, ARGUMENT: $sequence}}
clear_compensation: {message: INS_COMMAND, values: {COMMAND: 5}}
apply_compensation: {message: INS_COMMAND, values: {COMMAND: 6}}
load_compensation:
  message: COMPENSATION_COEFFICIENT
  values: {AXIS: $axis, INDEX: $index, VALUE: $value}
  coefficients: 6
  lowest_index: 6
  highest_index: 7
  terms:
    rate_dph_per_c_per_h: 8
    rate_limit_c_per_h: 9
    gradient_dph_per_k: 10
    difference_low_k: 11
    difference_high_k: 12
    saturating_dph_per_k: [13, 14, 15]
    growing_dph_per_k: [16, 17, 18]
    onset_c: 19
    onset_width_c: 20
    gravity_dph_per_g: [21, 22, 23]
    warm_up_dph: 24
    warm_up_s: 25
    hysteresis_dph_per_k: 26
    half_width_k: 27
"""


@pytest.fixture(scope="session")
def dbc_path() -> Path:
    return DBC


@pytest.fixture(scope="session")
def codec() -> DbcCodec:
    return DbcCodec(load_dbc(DBC))


@pytest.fixture(scope="session")
def make_signal_map() -> Callable[[Mapping[str, str]], SignalMap]:
    """The project's map, with lines of its YAML replaced."""

    def make(changes: Mapping[str, str]) -> SignalMap:
        text = SIGNALS
        for old, new in changes.items():
            assert old in text
            text = text.replace(old, new)
        return validate(parse_document(text, Path("station.yaml")), SignalMap)

    return make


@pytest.fixture(scope="session")
def signal_map(make_signal_map) -> SignalMap:
    return make_signal_map({})


@pytest.fixture(scope="session")
def command_map() -> CommandMap:
    return validate(parse_document(COMMANDS, Path("station.yaml")), CommandMap)


def make_frames(
    codec: DbcCodec, message: str, times_s: ArrayLike, values: Mapping[str, ArrayLike]
) -> FrameBlock:
    """Frames of one message at given times with given values."""
    times_s = np.atleast_1d(np.asarray(times_s, float))
    payloads = codec.encode(message, {name: np.broadcast_to(v, times_s.shape) for name, v in values.items()})
    data = np.zeros((len(times_s), 8), np.uint8)
    data[:, : payloads.shape[1]] = payloads
    return FrameBlock.from_columns(
        times_s,
        np.full(len(times_s), codec.arbitration_id(message), np.uint32),
        np.full(len(times_s), payloads.shape[1], np.uint8),
        data,
    )


def make_recording(codec: DbcCodec, first: int, last: int, **values: ArrayLike) -> FrameBlock:
    """What an INS sends from one epoch to another (not included), its time beginning at 100 s."""
    frames_of = partial(make_frames, codec)
    epoch = np.arange(first, last)
    second = epoch[epoch % 10 == 0]
    sent_s, second_s = epoch * 0.1 + 0.002, second * 0.1
    blocks = [
        frames_of("SYSTEM_TIME", second_s, {"TIME_S": 100 + second // 10}),
        frames_of("HEIGHT_VELOCITY_D", second_s + 0.0002, {"VELOCITY_DOWN": 0.5}),
        frames_of("INS_STATUS", second_s + 0.0004, {"MODE": 3, "EULER_SEQUENCE": values.get("sequence", 0)}),
        frames_of("GYRO_OPTICS_TEMPERATURE", second_s + 0.0006, {"X": 20 + second * 0.01, "Y": 21, "Z": 22}),
        frames_of("GYRO_ELECTRONICS_TEMPERATURE", second_s + 0.0008, {"X": 30, "Y": 31, "Z": 32, "CASE": 18}),
        frames_of("VELOCITY_NE", sent_s, {"VELOCITY_NORTH": epoch * 1e-3, "VELOCITY_EAST": epoch * -1e-4}),
        frames_of(
            "ROLL_PITCH", sent_s + 0.0002, {"ROLL": values.get("roll", 0), "PITCH": values.get("pitch", 0)}
        ),
        frames_of(
            "HEADING",
            sent_s + 0.0004,
            {
                "HEADING": values.get("heading", 0),
                "EPOCH_COUNTER": (epoch + values.get("counter_offset", 0)) % 65536,
                "ALIGNMENT": 2,
                "ATTITUDE_VALID": values.get("valid", 1),
            },
        ),
    ]
    block = concatenate(blocks)
    return block.take(np.argsort(block.timestamp_s, kind="stable"))


@pytest.fixture(scope="session")
def frames_of(codec) -> Callable[[str, ArrayLike, Mapping[str, ArrayLike]], FrameBlock]:
    return partial(make_frames, codec)


@pytest.fixture(scope="session")
def recording(codec) -> Callable[..., FrameBlock]:
    return partial(make_recording, codec)


@pytest.fixture(scope="session")
def to_messages() -> Callable[[FrameBlock], list[can.Message]]:
    return FrameBlock.messages


@pytest.fixture
def codec_with(tmp_path, dbc_path):
    """``codec_with({old: new})``: the codec of the DBC file with texts replaced."""

    def make(changes):
        text = dbc_path.read_text()
        for old, new in changes.items():
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "changed.dbc").write_text(text)
        return DbcCodec(load_dbc(tmp_path / "changed.dbc"))

    return make


@pytest.fixture
def in_pages(codec_with, recording):
    """A codec whose message of the gyros' temperatures has two pages, and a recording with both a second."""
    lines = {f" SG_ {axis} : {bit}|16@1- (0.01,0)": axis for axis, bit in (("X", 0), ("Y", 16), ("Z", 32))}
    text = DBC.read_text()
    begin = text.index("BO_ 32 GYRO_OPTICS_TEMPERATURE")
    end = text.index("BO_ 33")
    message = text[begin:end].replace("TEMPERATURE_COUNTER :", "PAGE M :")
    for line, axis in lines.items():
        message = message.replace(line, line.replace(axis, f"{axis} m{1 + (axis == 'Z')}", 1))
    codec = codec_with({text[begin:end]: message, "SG_ 32 TEMPERATURE_COUNTER": "SG_ 32 PAGE"})
    whole = recording(0, 100)
    name = "GYRO_OPTICS_TEMPERATURE"
    is_replaced = whole.arbitration_id == codec.arbitration_id(name)
    times_s = whole.timestamp_s[is_replaced]
    first = make_frames(codec, name, times_s, {"PAGE": 1, "X": 20 + np.arange(10) * 0.1, "Y": 21})
    second = make_frames(codec, name, times_s + 1e-5, {"PAGE": 2, "Z": 22})
    return codec, concatenate([whole.take(~is_replaced), first, second]).in_order()
