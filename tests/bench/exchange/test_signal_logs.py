"""Logs of named signals: what gyrobench writes itself, and what autopilots write."""

import struct

import numpy as np
import pytest

from gyrobench.bench.exchange.import_map import load_log_map
from gyrobench.bench.exchange.increments import read_increments
from gyrobench.bench.exchange.log_import import import_logs
from gyrobench.bench.foundations.errors import DocumentError, MeasurementError
from gyrobench.bench.runs.can_log import CanLog
from gyrobench.drivers.frames import FrameBlock
from gyrobench.drivers.ins.dbc_codec import DbcCodec, load_dbc

DBC = """VERSION ""
BU_: IMU
BO_ 16 RATES: 6 IMU
 SG_ X : 0|16@1- (0.00002,0) [0|0] "deg/s" IMU
 SG_ Y : 16|16@1- (0.00002,0) [0|0] "deg/s" IMU
 SG_ Z : 32|16@1- (0.00002,0) [0|0] "deg/s" IMU
BO_ 17 HEAT: 2 IMU
 SG_ T : 0|16@1- (0.01,0) [0|0] "degC" IMU
"""


@pytest.fixture
def expected(log):
    return import_logs([log.write()], log.mapping()).rows


def assert_same(rows, expected, tolerance_dph=0.2):
    assert len(rows) == len(expected)
    for row, other in zip(rows, expected, strict=True):
        assert row.bias_dph == pytest.approx(other.bias_dph, abs=tolerance_dph)
        assert row.gyro_c == pytest.approx(other.gyro_c, abs=0.05)
        assert row.start_s == pytest.approx(other.start_s, abs=0.3)


def write_parquet(log):
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table(log.columns), log.folder / "log.parquet")
    return {"signals": "{format: parquet}"}, "log.parquet"


def write_paged_blf(log):
    """Temperature on a page of a multiplexed message, whose other page follows it."""
    pages = ' SG_ PAGE M : 16|8@1+ (1,0) [0|0] "" IMU\n SG_ OTHER m1 : 0|16@1- (1,0) [0|0] "" IMU\n'
    dbc = DBC.replace("HEAT: 2", "HEAT: 3").replace(" SG_ T :", f"{pages} SG_ T m0 :")
    return write_blf(log, dbc)


def write_blf(log, dbc=DBC):
    (log.folder / "imu.dbc").write_text(dbc)
    codec = DbcCodec(load_dbc(log.folder / "imu.dbc"))
    _, x, y, z, heat = log.columns.values()
    n = len(x)
    rates = np.zeros((n, 8), np.uint8)
    heats = np.zeros((n, 8), np.uint8)
    rates[:, :6] = codec.encode("RATES", {"X": x, "Y": y, "Z": z})
    encoded = codec.encode("HEAT", {"T": heat})
    heats[:, : encoded.shape[1]] = encoded
    others = np.zeros((n, 8), np.uint8)
    others[:, 2] = 1  # its page
    kinds = [heats, others, rates] if dbc != DBC else [heats, rates]
    times_s = np.repeat(1.7e9 + log.time_s, len(kinds))
    size = encoded.shape[1]
    ids, lengths = np.tile([17, 17, 16][-len(kinds) :], n), np.tile([size, size, 6][-len(kinds) :], n)
    data = np.stack(kinds, axis=1).reshape(-1, 8)
    can_log = CanLog(log.folder / "can")
    can_log.write(FrameBlock.from_columns(times_s, ids, lengths, data))
    can_log.cut()
    return {
        "signals": "{format: blf, dbc: imu.dbc}",
        "time": "{column: time_s}",
        "gyro": "{unit: deg/s, x: RATES.X, y: RATES.Y, z: RATES.Z}",
        "temperatures": "{gyros: HEAT.T}",
    }, "can/part-00001.blf"


def write_ardupilot(log):
    """A DataFlash log as ArduPilot writes it: FMT messages describe the others."""

    def fmt(number, length, name, letters, columns):
        body = struct.pack("<BB4s16s64s", number, length, name, letters, columns)
        return b"\xa3\x95\x80" + body

    out = [
        fmt(128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns"),
        fmt(129, 3 + 8 + 12 + 4, b"IMU", b"Qffff", b"TimeUS,GyrX,GyrY,GyrZ,T"),
    ]
    _, x, y, z, heat = log.columns.values()
    for t, *values in zip(log.time_s, np.deg2rad(x), np.deg2rad(y), np.deg2rad(z), heat, strict=True):
        out.append(b"\xa3\x95\x81" + struct.pack("<Qffff", round(1e6 * t), *values))
    (log.folder / "log.bin").write_bytes(b"".join(out))
    return {
        "signals": "{format: ardupilot}",
        "time": "{column: IMU.TimeUS, unit: us}",
        "gyro": "{unit: rad/s, x: IMU.GyrX, y: IMU.GyrY, z: IMU.GyrZ}",
        "temperatures": "{gyros: IMU.T}",
    }, "log.bin"


def write_px4(log):
    """A ULog file as PX4 writes it, with the temperature in a slower topic."""

    def message(kind, body):
        return struct.pack("<HB", len(body), ord(kind)) + body

    out = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)]
    out.append(message("F", b"sensor_combined:uint64_t timestamp;float[3] gyro_rad;"))
    out.append(message("F", b"vehicle_air_data:uint64_t timestamp;float baro_temp_celcius;"))
    out.append(message("A", struct.pack("<BH", 0, 0) + b"sensor_combined"))
    out.append(message("A", struct.pack("<BH", 0, 1) + b"vehicle_air_data"))
    _, x, y, z, heat = log.columns.values()
    for index, (t, heat_c) in enumerate(zip(log.time_s, heat, strict=True)):
        stamp = round(1e6 * t) + 1000
        if index % 5 == 0:
            out.append(message("D", struct.pack("<HQf", 1, stamp - 10, heat_c)))
        rates = np.deg2rad([x[index], y[index], z[index]])
        out.append(message("D", struct.pack("<HQfff", 0, stamp, *rates)))
    (log.folder / "log.ulg").write_bytes(b"".join(out))
    return {
        "signals": "{format: px4}",
        "time": "{column: time_s}",
        "gyro": "{unit: rad/s, x: 'sensor_combined.gyro_rad[0]', y: 'sensor_combined.gyro_rad[1]', "
        "z: 'sensor_combined.gyro_rad[2]'}",
        "temperatures": "{gyros: vehicle_air_data.baro_temp_celcius}",
    }, "log.ulg"


def write_mf4(log):
    asammdf = pytest.importorskip("asammdf", reason="MDF4 needs: pip install 'gyrobench[mf4]'")
    _, x, y, z, heat = log.columns.values()
    with asammdf.MDF() as file:
        for name, values in {"gx": x, "gy": y, "gz": z, "temp": heat}.items():
            file.append(asammdf.Signal(values, log.time_s, name=name))
        file.save(log.folder / "log.mf4")
    return {"signals": "{format: mf4}", "time": "{column: time_s}"}, "log.mf4"


INCREMENTS = """VERSION ""
BU_: IMU
BO_ 16 ANGLE: 6 IMU
 SG_ X : 0|16@1- (1,0) [0|0] "rad" IMU
 SG_ Y : 16|16@1- (1,0) [0|0] "rad" IMU
 SG_ Z : 32|16@1- (1,0) [0|0] "rad" IMU
BO_ 17 VELOCITY: 6 IMU
 SG_ X : 0|16@1- (1,0) [0|0] "m/s" IMU
 SG_ Y : 16|16@1- (1,0) [0|0] "m/s" IMU
 SG_ Z : 32|16@1- (1,0) [0|0] "m/s" IMU
"""
INCREMENT_MAP = """
unit: "7"
signals: {format: blf, dbc: imu.dbc}
time: {column: time_s}
gyro: {unit: UNIT, x: ANGLE.X, y: ANGLE.Y, z: ANGLE.Z}
calibration:
  accelerometers: {unit: VUNIT, x: VELOCITY.X, y: VELOCITY.Y, z: VELOCITY.Z}
  latitude_deg: 45
"""


def read_numbered_samples(folder, delay_s=3e-4, time_step_s=0.0, lost=(), units=("rad", "m/s"), every=1):
    """What is read of 130 s at 50 Hz whose samples hold their number, each in two frames.

    ``lost``: rows of the frames; the velocity is in every second one, later than the angle by ``delay_s``,
    and once for ``every`` angles.
    """
    (folder / "imu.dbc").write_text(
        INCREMENTS.replace('"rad"', f'"{units[0]}"').replace('"m/s"', f'"{units[1]}"')
    )
    (folder / "map.yaml").write_text(INCREMENT_MAP.replace("VUNIT", units[1]).replace("UNIT", units[0]))
    number = np.arange(6500)
    data = np.zeros((2 * len(number), 8), np.uint8)
    values = DbcCodec(load_dbc(folder / "imu.dbc")).encode(
        "ANGLE", dict.fromkeys("XYZ", number.astype(float))
    )
    data[:, :6] = np.repeat(values, 2, axis=0)
    times_s = np.add.outer(0.02 * number, [0.0, delay_s]).ravel()
    if time_step_s:
        times_s = np.floor(times_s / time_step_s) * time_step_s
    ids = np.tile([16, 17], len(number))
    kept = ~np.isin(np.arange(len(ids)), lost) & ((ids == 16) | (np.repeat(number, 2) % every == 0))
    order = np.flatnonzero(kept)[np.argsort(times_s[kept], kind="stable")]
    log = CanLog(folder / "can")
    log.write(FrameBlock.from_columns(1.7e9 + times_s, ids, np.full(len(ids), 6), data).take(order))
    log.cut()
    log_map = load_log_map(folder / "map.yaml", for_calibration=True)
    return read_increments(folder / "can/part-00001.blf", log_map).recordings


@pytest.mark.parametrize(
    "log", [{}, {"delay_s": -3e-4}, {"time_step_s": 1e-3}, {"time_step_s": 0.04}, {"delay_s": 0.008}]
)
def test_increments_of_one_sample_belong_together_whichever_is_logged_first(tmp_path, log):
    (recording,) = read_numbered_samples(tmp_path, **log)
    assert len(recording.angle) > 6000  # coarse time stamps take some for a gap
    assert (recording.angle == recording.velocity).all()


@pytest.mark.parametrize("lost", [6400, 6401])
def test_a_sample_without_one_of_its_increments_is_missing(tmp_path, lost):
    before, after = read_numbered_samples(tmp_path, lost=[lost])
    assert (len(before.angle), len(after.angle)) == (3200, 3299)
    for recording in (before, after):
        assert (recording.angle == recording.velocity).all()


def test_of_rates_the_last_force_counts_where_a_sample_has_none_of_its_own(tmp_path):
    (recording,) = read_numbered_samples(tmp_path, lost=[6001], units=("rad/s", "m/s2"))
    away = np.flatnonzero(recording.angle[:, 0] != recording.velocity[:, 0])
    assert away.tolist() == [3000]


def test_of_slower_forces_the_last_one_counts(tmp_path):
    (recording,) = read_numbered_samples(tmp_path, units=("rad/s", "m/s2"), delay_s=-3e-4, every=2)
    number = np.arange(6500)
    assert recording.velocity[:, 0] / recording.interval_s == pytest.approx(number // 2 * 2)


@pytest.mark.parametrize(
    "write", [write_parquet, write_blf, write_paged_blf, write_ardupilot, write_px4, write_mf4]
)
def test_every_format_gives_the_rows_of_the_text_log(log, expected, write):
    changes, name = write(log)
    rows = import_logs([log.folder / name], log.mapping(text="absent", **changes)).rows
    assert_same(rows, expected)


def test_a_signal_in_another_unit_than_the_map_states_is_refused(log):
    changes, name = write_blf(log)
    changes["gyro"] = changes["gyro"].replace("deg/s", "rad/s")
    with pytest.raises(
        DocumentError, match=r"blf: column 'RATES.X \[deg/s\]' is in deg/s by the log, and in rad/s"
    ):
        import_logs([log.folder / name], log.mapping(text="absent", **changes))


def test_a_parquet_column_in_another_unit_than_the_map_states_is_refused(log):
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table(log.columns)
    fields = [each.with_metadata({"unit": "deg/h"}) if each.name == "gy" else each for each in table.schema]
    pq.write_table(table.cast(pa.schema(fields)), log.folder / "log.parquet")
    with pytest.raises(DocumentError, match=r"parquet: column 'gy \[deg/h\]' is in deg/h by the log"):
        import_logs([log.folder / "log.parquet"], log.mapping(text="absent", signals="{format: parquet}"))


@pytest.mark.parametrize(
    ("write", "message"), [(write_parquet, "parquet"), (write_ardupilot, "signal"), (write_px4, "px4")]
)
def test_a_damaged_log_is_reported_once(log, write, message):
    changes, name = write(log)
    (log.folder / name).write_bytes(b"\x00\x01" * 500)
    with pytest.raises(DocumentError, match=message) as error:
        import_logs([log.folder / name], log.mapping(text="absent", **changes))
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize("cut", [0, 30])
def test_a_blf_log_that_is_cut_off_gives_what_there_is_and_a_warning(log, expected, cut):
    changes, name = write_blf(log)
    path = log.folder / name
    path.write_bytes(path.read_bytes()[: path.stat().st_size - cut])
    imported = import_logs([path], log.mapping(text="absent", **changes))
    assert 0 < len(imported.rows) <= len(expected)
    assert any("cut off" in warning for warning in imported.warnings) == bool(cut)


def test_text_in_place_of_numbers_is_reported_with_its_column(log):
    import pyarrow as pa
    import pyarrow.parquet as pq

    changes, name = write_parquet(log)
    columns = {**log.columns, "gy": np.full(len(log.time_s), "fast")}
    pq.write_table(pa.table(columns), log.folder / name)
    with pytest.raises((DocumentError, MeasurementError), match=r"signal 'gy' is no number.*'fast'"):
        import_logs([log.folder / name], log.mapping(text="absent", **changes))


def test_a_missing_signal_is_reported_with_those_that_there_are(log):
    changes, name = write_parquet(log)
    mapping = log.mapping(text="absent", gyro="{unit: deg/s, x: gxx, y: gy, z: gz}", **changes)
    with pytest.raises((DocumentError, MeasurementError), match=r"no signal 'gxx' \(did you mean 'gx'\?\)"):
        import_logs([log.folder / name], mapping)
