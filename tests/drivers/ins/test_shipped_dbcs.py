"""The shipped DBC files give the bytes that were published for these protocols."""

from pathlib import Path

import cantools
import pytest

import gyrobench.drivers.ins

PUBLISHED = [
    ("sbg", "EKF_VEL_NED", {"VELOCITY_N": 0.01, "VELOCITY_E": -0.02, "VELOCITY_D": 1.0}, "01 00 FE FF 64 00"),
    ("sbg", "EKF_EULER", {"ROLL": 1e-4, "PITCH": -1e-4, "YAW": 3.1416}, "01 00 FF FF B8 7A"),
    (
        "sbg",
        "IMU_INFO",
        {"TIME_STAMP": 1_000_000, "IMU_STATUS": 0x3FF, "TEMPERATURE": 25.0},
        "40 42 0F 00 FF 03 C4 09",
    ),
    (
        "canaerospace",
        "TRUE_NORTH_VELOCITY",
        {"NODE": 1, "DATA_TYPE": 2, "SERVICE": 0, "MESSAGE_CODE": 7, "VELOCITY_NORTH": 0.0123},
        "01 02 00 07 3C 49 85 F0",
    ),
]


@pytest.mark.parametrize(("dbc", "message", "values", "data"), PUBLISHED)
def test_the_published_bytes_stand_for_the_published_values(dbc, message, values, data):
    database = cantools.database.load_file(Path(gyrobench.drivers.ins.__file__).with_name(f"{dbc}.dbc"))
    assert database.encode_message(message, values) == bytes.fromhex(data)
    assert database.decode_message(message, bytes.fromhex(data)) == pytest.approx(values)
