from pathlib import Path

import pytest

from gyrobench.bench.exchange.import_map import load_log_map
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document

SHIPPED = sorted(path.stem for path in (Path(__file__).parents[3] / "imports").glob("*.yaml"))


@pytest.mark.parametrize("name", SHIPPED)
def test_the_shipped_import_maps_are_valid(name):
    only_calibrates = name == "emulated_ins"
    assert load_log_map(find_document("imports", name), for_calibration=only_calibrates).unit


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gyro": "{unit: rpm, x: gx, y: gy, z: gz}"}, r"map\.yaml:4:8: .*'mrad/s', .* or 'arcsec'"),
        ({"gyro": "{unit: deg/s, x: gx, y: gy}"}, r"map\.yaml:4:1: the key 'z' is missing"),
        ({"gyro": "{unit: deg/s, x: {column: gx, sign: 2}, y: gy, z: gz}"}, r"4:37: 'sign' must be 1"),
        ({"time": "{column: t, sample_rate_hz: 5}"}, r"exactly one of 'column', 'sample_rate_hz'"),
        ({"text": "absent"}, r"exactly one of 'text', 'records', 'signals'; there is none"),
        ({"temperatures": "{gyro_x: t}"}, r"either 'gyros', or all of"),
        ({"temperatures": "{gyros: t, board_x: b}"}, r"either 'boards' or all of"),
        ({"position": "sideways"}, r"'z_up', 'z_down'"),
        ({"cycle": "{alternate: 2, turning_point_c: 5}"}, r"'alternate' deals out blocks; give 'block_s'"),
        ({"cycle": "{block_s: 5}"}, r"'cycle.block_s' is shorter than 'window_s' \(60 s\)"),
        ({"window_s": "1e-9"}, r"map\.yaml:7:1: 'window_s' must be at least 0.001"),
        ({"skip_s": "1e30"}, r"at most 1000000000000"),
        ({"temperatures": "{constant_c: 2000}"}, r"at most 1000"),
        ({"cycle": "{constant: 99999999999}"}, r"at most 1000000000"),
        ({"earth_rate": "{latitude_deg: 40, azimuth_deg: 1e30}"}, r"at most 360"),
        ({"window": "5"}, r"unknown key 'window' \(did you mean 'window_s'\?\)"),
        ({"text": "absent", "records": "{fields: [a, a]}"}, r"fields are named twice: a"),
        ({"text": "absent", "records": "{fields: [a], type: float}"}, r"<>"),
        (
            {
                "calibration": "{accelerometers: {unit: g, x: a, y: b, z: c}, latitude_deg: 36.4, "
                "gravity_mps2: 9.80665}"
            },
            r"9.80665 m/s\^2 is standard gravity, which defines the unit g; normal gravity at 36.4 deg",
        ),
    ],
)  # fmt: skip
def test_mistakes_are_shown_with_their_place(log, changes, message):
    with pytest.raises(DocumentError, match=message):
        load_log_map(Path(log.mapping(**changes)))


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("gyro", "{unit: rad/s, x: 'gx [deg/s]', y: gy, z: gz}", r"4:1: column 'gx \[deg/s\]' is in deg/s"),
        ("gyro", "{unit: rad/s, x: gx, y: 'gy (°/sec)', z: gz}", r"in deg/s by the log, and in rad/s by"),
        ("gyro", "{unit: deg/s, x: gx, y: gy, z: gyro_z_rad_s}", r"in rad/s by the log"),
        ("gyro", "{unit: deg/s, x: gx_mdps, y: gy, z: gz}", r"in mdeg/s by the log"),
        ("gyro", "{unit: deg/s, x: 'ax [m/s²]', y: gy, z: gz}", r"in m/s2 by the log"),
        ("time", "{column: time_ms}", r"3:1: column 'time_ms' is in ms by the log, and in s by the map"),
        ("time", "{column: 't [µs]', unit: ms}", r"in us by the log"),
        (
            "temperatures",
            "{gyros: 'temperature [K]'}",
            r"not in degC by its name.*offset_c: -273.15.*by its number",
        ),
        ("temperatures", "{gyros: 'temperature (°F)'}", r"not in degC by its name.*scale: 0.55556"),
    ],
)
def test_a_column_whose_name_states_another_unit_is_refused(log, key, value, message):
    with pytest.raises(DocumentError, match=message):
        load_log_map(Path(log.mapping(**{key: value})))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("gyro", "{unit: dps, x: 'gx [deg/s]', y: gy_dps, z: 'gyro_rad[0]'}"),
        ("gyro", "{unit: rad/s, x: {column: 'gx [deg/s]', scale: 0.0174532925}, y: 3, z: gyro_rad_per_s}"),
        ("gyro", "{unit: °/hr, x: 'gx [dph]', y: 'gy (deg/h)', z: gz}"),
        ("gyro", "{unit: degrees per second, x: 'gx [°/s]', y: gy_dps, z: gz}"),
        ("time", "{column: timestamp, unit: us}"),
        ("time", "{column: 't [us]', unit: µs}"),
        ("calibration", "{accelerometers: {unit: m/s², x: 'ax [m/s^2]', y: b, z: c}, latitude_deg: 36.4}"),
        ("calibration", "{accelerometers: {unit: µg, x: 'ax [ug]', y: b, z: c}, latitude_deg: 36.4}"),
        ("time", "{column: 't (sec)'}"),
        ("time", "{column: gps_ms, unit: s}"),
        ("temperatures", "{gyros: 'temperature [K]', offset_c: -273.15}"),
        ("temperatures", "{gyros: 'temperature [°C]'}"),
        ("temperatures", "{gyros: 5}"),
    ],
)
def test_a_column_whose_name_states_its_unit_or_none_is_accepted(log, key, value):
    assert load_log_map(Path(log.mapping(**{key: value}))).unit == "A7"


def test_the_former_key_of_the_temperature_swing_is_accepted(log, caplog):
    log_map = load_log_map(Path(log.mapping(temperatures="{gyros: t, least_swing_c: 3}")))
    assert log_map.temperatures.min_swing_c == 3.0
    assert "'least_swing_c' is an old name. Write 'min_swing_c'" in caplog.text
