import pytest

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.drivers.ins.signal_map import Dimension


def test_every_mapped_quantity_has_its_path_and_dimension(signal_map):
    quantities = signal_map.quantities()
    assert quantities["velocity_up"].source.sign == -1
    assert quantities["attitude.euler.yaw"].dimension is Dimension.ANGLE
    assert quantities["gyro_optics_temperature.z"].source.signal == "GYRO_OPTICS_TEMPERATURE.Z"
    assert quantities["identity.serial_number"].location == ("identity", "serial_number")
    assert len(quantities) == 25


def test_an_epoch_is_complete_with_velocity_attitude_and_counter(signal_map, make_signal_map):
    assert signal_map.messages_of_epoch() == {"VELOCITY_NE", "ROLL_PITCH", "HEADING"}
    untold = make_signal_map({"epoch_counter: HEADING.EPOCH_COUNTER\n": ""})
    assert untold.messages_of_epoch() == {"VELOCITY_NE", "ROLL_PITCH", "HEADING", "SYSTEM_TIME"}


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
        ("sequence: INS_STATUS.EULER_SEQUENCE", "sequence: 321", "SequenceMap"),
        ("sequence: INS_STATUS.EULER_SEQUENCE", "sequence: rpy", "expected MESSAGE.SIGNAL"),
        ("sequence: INS_STATUS.EULER_SEQUENCE", "sequence: {rpy_321: 4}", "the signal that tells"),
        ("VELOCITY_NE.VELOCITY_EAST", "A.B.C", "expected MESSAGE.SIGNAL"),
        ("sign: -1", "sign: 0", "1 or -1"),
        ("epoch_period_s: 0.1", "epoch_period_s: 0", "above 0"),
        ("time_s: SYSTEM_TIME.TIME_S\n", "", "time_ns is added to time_s"),
        (
            "epoch_period_s: 0.1",
            "epoch_period_s: 0.1\nepoch_messages: [HEADING]",
            "lacks ROLL_PITCH, VELOCITY_NE",
        ),
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
