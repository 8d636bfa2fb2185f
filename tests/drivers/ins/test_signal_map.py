"""The map of signals, and its binding to a DBC file."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.drivers import ins
from gyrobench.drivers.ins.dbc_codec import DbcCodec, load_dbc
from gyrobench.drivers.ins.readout import BlockReadout
from gyrobench.drivers.ins.signal_map import SignalMap, SignalSource, bind_signals, check_signals
from gyrobench.drivers.ins.units import Dimension


def test_every_mapped_quantity_has_its_path_and_dimension(signal_map):
    quantities = signal_map.quantities()
    assert quantities["velocity_up"].source.sign == -1
    assert quantities["attitude.euler.yaw"].dimension is Dimension.ANGLE
    assert quantities["gyro_optics_temperature.z"].source.signal == "GYRO_OPTICS_TEMPERATURE.Z"
    assert quantities["identity.serial_number"].location == ("identity", "serial_number")
    assert len(quantities) == 25


def test_a_key_without_a_dimension_is_an_error_not_an_unknown_quantity(signal_map):
    class LargerMap(SignalMap):
        supply: SignalSource

    larger = LargerMap.model_validate({**dict(signal_map), "supply": {"signal": "SUPPLY.CURRENT"}})
    with pytest.raises(TypeError, match="supply is annotated with no Dimension"):
        larger.quantities()


def test_an_epoch_is_complete_with_velocity_attitude_and_counter(signal_map, make_signal_map):
    assert signal_map.messages_of_epoch() == {"VELOCITY_NE", "ROLL_PITCH", "HEADING"}
    without_counter = make_signal_map({"epoch_counter: HEADING.EPOCH_COUNTER\n": ""})
    assert without_counter.messages_of_epoch() == {"VELOCITY_NE", "ROLL_PITCH", "HEADING", "SYSTEM_TIME"}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "yaw_positive: down",
            "yaw_positve: down",
            r"unknown key 'yaw_positve' \(did you mean 'yaw_positive'\?\)",
        ),
        ("yaw_positive: down", "yaw_positive: north", "'up' or 'down'"),
        ("    yaw_positive: down\n", "", "the key 'yaw_positive' is missing"),
        ("sequence: INS_STATUS.EULER_SEQUENCE", "sequence: 321", "must have keys and values; found 321"),
        ("sequence: INS_STATUS.EULER_SEQUENCE", "sequence: rpy", "expected MESSAGE.SIGNAL"),
        ("sequence: INS_STATUS.EULER_SEQUENCE", "sequence: {rpy_321: 4}", "the signal of the sequence"),
        ("VELOCITY_NE.VELOCITY_EAST", "A.B.C", "expected MESSAGE.SIGNAL"),
        ("VELOCITY_NE.VELOCITY_EAST", "-A.B", r"the opposite sign is written \{signal: A\.B, sign: -1\}"),
        ("sign: -1", "sign: 0", "1 or -1"),
        ("epoch_period_s: 0.1", "epoch_period_s: 0", "above 0"),
        ("time_s: SYSTEM_TIME.TIME_S\n", "", "time_ns is added to time_s"),
        (
            "  valid:",
            "  quaternion: {w: A.B, x: A.B, y: A.B, z: A.B, frames: frd_to_ned}\n  valid:",
            "one of: euler",
        ),
    ],
)
def test_mistakes_of_a_map_are_named(make_signal_map, old, new, message):
    with pytest.raises(DocumentError, match=message):
        make_signal_map({old: new})


@pytest.mark.parametrize(
    ("path", "old", "new", "dbc_value", "expected"),
    [
        ("velocity_east", '"m/s"', '"kt"', 2.0, 2 * 1852 / 3600),
        ("velocity_east", '"m/s"', '"km/h"', 3.6, 1.0),
        ("velocity_east", '"m/s"', '"mm/s"', 2.0, 2e-3),
        ("velocity_up", '"m/s"', '"cm/s"', 2.0, -0.02),
        ("velocity_up", '"m/s"', '"m/s"', 2.0, -2.0),
        ("attitude.euler.roll", '"deg"', '"mrad"', 5.0, 5e-3),
        ("attitude.euler.roll", '"deg"', '"arcmin"', 60.0, np.pi / 180),
        ("attitude.euler.roll", '"deg"', '"rad"', 0.5, 0.5),
        ("attitude.euler.roll", '"deg"', '"deg"', 180.0, np.pi),
        ("attitude.euler.roll", '"deg"', '"degrees"', 180.0, np.pi),
        ("velocity_north", '"m/s"', '"m/sec"', 1.0, 1.0),
        ("gyro_optics_temperature.x", '"degC"', '"°C"', 30.0, 30.0),
        ("gyro_optics_temperature.x", '"degC"', '"K"', 300.0, 26.85),
        ("gyro_optics_temperature.x", '"degC"', '"degF"', 212.0, 100.0),
        ("time_ns", '"ns"', '"us"', 2e6, 2.0),
        ("time_ns", '"ns"', '"ms"', 2e3, 2.0),
    ],
)
def test_units_of_the_dbc_are_converted_to_si(codec_with, signal_map, path, old, new, dbc_value, expected):
    bound = bind_signals(signal_map, codec_with({old: new}))[path]
    assert dbc_value * bound.gain + bound.offset == pytest.approx(expected)


def test_a_unit_that_is_unknown_or_of_another_kind_is_an_error_with_the_allowed_ones(codec_with, signal_map):
    codec = codec_with({'"degC"': '""', '"m/s"': '"deg"'})
    with pytest.raises(DocumentError) as error:
        bind_signals(signal_map, codec)
    text = str(error.value)
    assert "VELOCITY_NE.VELOCITY_EAST has the unit 'deg', not a unit of speed (m/s" in text
    assert "GYRO_OPTICS_TEMPERATURE.X has the unit ''" in text
    assert len(text.splitlines()) == 3 + 7


def test_a_unit_given_in_the_map_replaces_that_of_the_dbc(codec_with, make_signal_map):
    codec = codec_with({'"m/s" BENCH\n SG_ VELOCITY_EAST': '"" BENCH\n SG_ VELOCITY_EAST'})
    source = "{signal: VELOCITY_NE.VELOCITY_NORTH, unit: km/h, scale: 2}"
    signal_map = make_signal_map({"velocity_north: VELOCITY_NE.VELOCITY_NORTH": f"velocity_north: {source}"})
    assert bind_signals(signal_map, codec)["velocity_north"].gain == pytest.approx(2 / 3.6)


def test_epoch_messages_that_are_missing_are_reported_with_the_other_mistakes(codec, make_signal_map):
    signal_map = make_signal_map(
        {
            "epoch_period_s: 0.1": "epoch_period_s: 0.1\nepoch_messages: [HEADING]",
            "HEADING.HEADING": "HEADNG.HEADING",
        }
    )
    problems = {each.location: each.message for each in check_signals(signal_map, codec)}
    assert problems["epoch_messages",] == "epoch_messages lacks ROLL_PITCH, VELOCITY_NE"
    assert "no message 'HEADNG' (did you mean HEADING?)" in problems["attitude", "euler", "yaw"]


def test_names_that_the_dbc_lacks_are_reported_at_their_place(codec, make_signal_map):
    signal_map = make_signal_map(
        {"HEADING.HEADING": "HEADINGS.HEADING", "ROLL_PITCH.ROLL\n": "ROLL_PITCH.ROL\n"}
    )
    problems = check_signals(signal_map, codec, ("ins", "signals"))
    assert [problem.location for problem in problems] == [
        ("ins", "signals", "attitude", "euler", "roll"),
        ("ins", "signals", "attitude", "euler", "yaw"),
    ]
    assert "did you mean ROLL" in problems[0].message
    assert "did you mean HEADING" in problems[1].message


def test_unknown_messages_of_an_epoch_are_reported(codec, make_signal_map):
    names = "[SYSTEM_TIME, VELOCITY_NE, ROLL_PITCH, HEADING, SPEED]"
    signal_map = make_signal_map({"epoch_period_s: 0.1": f"epoch_period_s: 0.1\nepoch_messages: {names}"})
    assert [problem.location for problem in check_signals(signal_map, codec)] == [("epoch_messages", 4)]


def test_a_held_value_is_the_last_that_arrived(codec, signal_map, frames_of):
    block = frames_of("INS_STATUS", [0.0, 1.0, 2.0], {"MODE": [1, 2, 3]})
    block.arbitration_id[0] = 0x7FF
    held = BlockReadout(block, signal_map, codec).value("mode", np.array([0, 1, 2, 100]))
    assert np.isnan(held[0])
    assert held[1:].tolist() == [2, 3, 3]


@pytest.mark.parametrize("raw", [32767, -32768])
def test_a_temperature_at_the_end_of_its_field_is_no_value(codec, signal_map, raw):
    bound = bind_signals(signal_map, codec)["gyro_optics_temperature.x"]
    values = bound.to_si(np.array([0.01 * raw, 25.0]))
    assert np.isnan(values[0])
    assert values[1] == pytest.approx(25.0)


@pytest.mark.parametrize(
    ("value_c", "is_valid"), [(84.99, True), (85.0, False), (90.0, False), (-40.0, False)]
)
def test_a_temperature_at_the_limit_of_the_dbc_or_beyond_is_no_value(
    codec_with, signal_map, value_c, is_valid
):
    codec = codec_with({"X : 0|16@1- (0.01,0) [-327.68|327.67]": "X : 0|16@1- (0.01,0) [-40|85]"})
    bound = bind_signals(signal_map, codec)["gyro_optics_temperature.x"]
    assert np.isfinite(bound.to_si(np.array([value_c]))).tolist() == [is_valid]


def test_an_angle_at_the_limit_of_the_dbc_is_an_angle(codec, signal_map):
    bound = bind_signals(signal_map, codec)["attitude.euler.roll"]
    assert bound.to_si(np.array([180.0, -180.0])) == pytest.approx([np.pi, -np.pi])


@pytest.mark.parametrize(
    ("old", "new", "first"),
    [
        ("VELOCITY_NE.VELOCITY_NORTH", "VELOCITY_NE.VELOCITY_EAST", "velocity_"),
        ("pitch: ROLL_PITCH.PITCH", "pitch: ROLL_PITCH.ROLL", "attitude.euler.roll"),
        ("x: GYRO_ELECTRONICS_TEMPERATURE.X", "x: GYRO_OPTICS_TEMPERATURE.X", "gyro_optics_temperature.x"),
        ("y: GYRO_OPTICS_TEMPERATURE.Y", "y: GYRO_OPTICS_TEMPERATURE.X", "gyro_optics_temperature.x"),
    ],
)
def test_a_signal_in_two_roles_is_refused(codec, make_signal_map, old, new, first):
    (problem,) = check_signals(make_signal_map({old: new}), codec)
    assert f"already mapped to {first}" in problem.message


def test_a_multiplexed_quantity_of_every_epoch_is_refused(codec_with, signal_map):
    pages = {"ATTITUDE_VALID :": "ATTITUDE_VALID M :", "EPOCH_COUNTER :": "EPOCH_COUNTER m1 :"}
    (problem,) = check_signals(signal_map, codec_with(pages))
    assert problem.location == ("epoch_counter",)
    assert problem.message == "the signal HEADING.EPOCH_COUNTER is multiplexed. Map one that is not"


def test_one_temperature_sensor_stands_for_all_gyros(codec, make_signal_map):
    names = {f"GYRO_OPTICS_TEMPERATURE.{axis}": "GYRO_OPTICS_TEMPERATURE.X" for axis in "YZ"}
    assert check_signals(make_signal_map(names), codec) == []


def test_one_temperature_sensor_of_the_unit_stands_for_case_and_gyros(codec, make_signal_map):
    names = {
        f"GYRO_{where}_TEMPERATURE.{axis}": "GYRO_ELECTRONICS_TEMPERATURE.CASE"
        for where in ("OPTICS", "ELECTRONICS")
        for axis in "XYZ"
    }
    assert check_signals(make_signal_map(names), codec) == []


@pytest.mark.parametrize(("bits", "is_refused"), [("", True), ("7", True), ("[8, 15]", False)])
def test_roles_that_share_bits_of_a_signal_are_refused(codec, make_signal_map, bits, is_refused):
    of_the_first = "{signal: VELOCITY_NE.VELOCITY_EAST, unit: m/s, bits: [0, 7]}"
    of_the_second = "{signal: VELOCITY_NE.VELOCITY_EAST, unit: m/s" + (f", bits: {bits}}}" if bits else "}")
    names = {"VELOCITY_NE.VELOCITY_EAST": of_the_first, "VELOCITY_NE.VELOCITY_NORTH": of_the_second}
    problems = check_signals(make_signal_map(names), codec)
    assert ["already mapped" in each.message for each in problems] == [True] * is_refused


SBG_STATUS = """BO_ 258 SBG_STATUS_03: 6 INS
 SG_ SOLUTION_STATUS : 0|32@1+ (1,0) [0|4294967295] "" BENCH
 SG_ HEAVE_STATUS : 32|16@1+ (1,0) [0|65535] "" BENCH
"""


def test_a_signal_is_split_into_bit_fields_as_the_maker_s_own_dbc_needs(tmp_path):
    """SBG's file has one signal for all of the solution's status."""
    station = find_document("stations", "emulated_sbg").read_text()
    section = yaml.safe_load(station)["ins"]["signals"]
    status = "SBG_STATUS_03.SOLUTION_STATUS"
    section["attitude"]["valid"] = {"signal": status, "bits": 5}
    section["mode"] |= {"signal": status, "bits": [0, 3]}
    section["alignment"] |= {"signal": status, "bits": 27}
    text = (Path(ins.__file__).parent / "sbg.dbc").read_text()
    whole = text[text.index("BO_ 258") : text.index("BO_ 288")]
    (tmp_path / "own.dbc").write_text(re.sub(r"CM_ .*;\n", "", text.replace(whole, SBG_STATUS)))
    own = DbcCodec(load_dbc(tmp_path / "own.dbc"))
    shipped = DbcCodec(load_dbc(Path(ins.__file__).parent / "sbg.dbc"))
    signal_map, as_shipped = map(
        SignalMap.model_validate, (section, yaml.safe_load(station)["ins"]["signals"])
    )
    assert check_signals(signal_map, own) == []
    split, named = bind_signals(signal_map, own), bind_signals(as_shipped, shipped)
    payload = (1 << 27 | 1 << 5 | 1 << 4 | 3).to_bytes(4, "little") + b"\xff\xff"
    for path in ("mode", "alignment", "attitude.valid"):
        one, other = (bound[path].decode_si(payload) for bound in (split, named))
        assert one == other != 0.0
    values = split["mode"].to_si(np.array([3.0, 2.0**27 + 4.0, np.nan]))
    np.testing.assert_array_equal(values, [3.0, 4.0, np.nan])


@pytest.mark.parametrize("bits", ["40", "[3, 1]", "[0, 32]"])
def test_bits_that_the_signal_lacks_are_refused(codec, make_signal_map, bits):
    changed = {"mode: {signal": f"mode: {{bits: {bits}, signal"}
    signal_map = make_signal_map(changed)
    (problem,) = check_signals(signal_map, codec)
    assert "are no part of them" in problem.message
    assert problem.location == ("mode",)
