"""A log becomes the dwell table that its unit deserves, or a message that says what to do."""

import gzip
import json
import re
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.exchange.log_import import cycle_numbers, import_logs, write_import
from gyrobench.bench.foundations.errors import DocumentError, MeasurementError
from gyrobench.bench.navigation.positions import POSITIONS
from tests.bench.exchange.sample_log import NOISE_DPH, RATE_HZ, bias_dph

NO_TEMPERATURE = "no temperature from -273.15 to 1000 degC"


def imported(log, **changes):
    return import_logs([log.write()], log.mapping(**changes))


def biases(rows):
    return np.array([row.bias_dph for row in rows])


def test_each_window_becomes_a_row_with_its_mean_bias_temperature_and_slope(log):
    rows = imported(log).rows
    assert [row.dwell for row in rows] == list(range(1, 41))
    assert [(row.start_s, row.end_s) for row in rows[:2]] == [(0.0, 60.0), (60.0, 120.0)]
    middle_c = 40.0 - 30.0 * np.abs((np.array([row.start_s for row in rows]) + 29.9) / 1200.0 - 1.0)
    np.testing.assert_allclose([row.gyro_c[0] for row in rows], middle_c, atol=0.01)
    slopes = np.array([row.gyro_rate_c_per_h[2] for row in rows])
    np.testing.assert_allclose(slopes, np.repeat([90.0, -90.0], 20), atol=1.0)
    sigma = NOISE_DPH / np.sqrt(60.0 * RATE_HZ)
    assert np.abs(biases(rows) - bias_dph(middle_c)).max() < 4.5 * sigma


def test_the_uncertainty_is_that_of_a_windows_mean_and_holds_no_drift(log):
    sigma = np.array([row.sigma_dph for row in imported(log).rows])
    # The ramp moves the x bias by 90 standard uncertainties from one window to the next.
    np.testing.assert_allclose(sigma, NOISE_DPH / np.sqrt(60.0 * RATE_HZ), rtol=0.3)


def test_noise_that_is_white_in_the_angle_averages_out_faster_than_white_rates(log):
    angle = np.random.default_rng(2).standard_normal((len(log.time_s) + 1, 3))
    for name, rate in zip(("gx", "gy", "gz"), np.diff(angle, axis=0).T, strict=True):
        log.columns[name] = rate / 3600.0
    sigma = np.array([row.sigma_dph for row in imported(log).rows])
    assert sigma.max() < 0.5 * np.sqrt(2.0) / np.sqrt(60.0 * RATE_HZ)
    assert sigma.min() > 0.5 * np.sqrt(2.0) / (60.0 * RATE_HZ)


def test_a_rate_in_coarse_steps_is_not_known_better_than_its_steps_allow(log):
    log.columns["gz"] = np.where(np.arange(len(log.time_s)) % 100 < 60, 0.0, 0.1)
    [sigma] = {row.sigma_dph[2] for row in imported(log).rows}
    assert sigma >= 360.0 / np.sqrt(12.0) / np.sqrt(60.0 * RATE_HZ)


def test_axes_signs_and_units_are_those_of_the_import_map(log):
    plain = biases(imported(log).rows)
    mapped = biases(imported(log, gyro="{unit: deg/h, x: {column: gy, sign: -1}, y: gx, z: 4}").rows)
    np.testing.assert_allclose(mapped * 3600.0, plain[:, [1, 0, 2]] * [-1.0, 1.0, 1.0], rtol=1e-9)


def test_time_may_be_in_microseconds_from_any_origin_or_a_sample_rate(log):
    plain = imported(log).rows
    by_rate = imported(log, time=f"{{sample_rate_hz: {RATE_HZ}}}").rows
    assert repr(by_rate) == repr(plain)  # NaN does not equal itself
    log.columns["time"] = log.time_s * 1e6 + 256551281491968.0
    lines = log.lines()
    ticks = [f"{value:.0f}" for value in log.columns["time"]]
    lines[1:] = [f"{tick},{line.split(',', 1)[1]}" for tick, line in zip(ticks, lines[1:], strict=True)]
    rows = import_logs([log.write(lines)], log.mapping(time="{column: time, unit: us}")).rows
    np.testing.assert_allclose(biases(rows), biases(plain), rtol=1e-9)
    assert rows[-1].end_s == 2400.0


def test_the_begin_can_be_skipped(log):
    rows = imported(log, skip_s=90).rows
    assert rows[0].start_s == 90.0
    assert len(rows) == 38


def test_samples_of_a_bad_status_are_left_out_and_reported(log):
    log.columns["status"] = np.zeros(len(log.time_s))
    log.columns["status"][10:20] = 3.0
    log.columns["gx"][10:20] = 100.0
    result = imported(log, status="{column: status, good: [0]}")
    assert np.abs(biases(result.rows)).max() < 200.0
    assert any("10 samples left out for their status" in each for each in result.warnings)


def test_a_status_may_be_words_and_numbers_however_they_are_written(log):
    lines = [
        f"{line},{'state' if index == 0 else ' ok' if index % 2 else '0.0'}"
        for index, line in enumerate(log.lines())
    ]
    lines[7] = lines[7].replace(" ok", "warming")
    result = import_logs([log.write(lines)], log.mapping(status="{column: state, good: [0, ok]}"))
    assert any("1 samples left out for their status" in each for each in result.warnings)


def test_a_clock_that_ticks_more_slowly_than_the_samples_come_is_used(log):
    plain = biases(imported(log).rows)
    log.columns["time"] = np.floor(log.time_s)
    result = imported(log, max_gap_s=1.5)
    np.testing.assert_allclose(biases(result.rows), plain, rtol=1e-9)


def test_what_is_no_number_is_left_out_and_a_window_with_much_of_it_too(log):
    log.columns["gy"][5:10] = np.nan
    log.columns["gz"][2000:2100] = np.inf
    result = imported(log)
    assert result.left_out == {"too many samples without a valid rate": 1}
    assert any("105 samples without a valid rate left out" in each for each in result.warnings)
    assert np.isfinite(biases(result.rows)).all()


@pytest.mark.parametrize("value", [1e16, -1e300, 1.7e308])
def test_what_nothing_measures_counts_as_no_number(log, value):
    plain = imported(log)
    log.columns["gy"][5] = value
    log.columns["temp"][700:710] = value
    log.columns["time"][1203] = value
    result = imported(log)
    assert len(result.rows) == len(plain.rows)
    assert any("1 samples without a valid rate left out" in each for each in result.warnings)
    assert any("1 samples without a time left out" in each for each in result.warnings)
    np.testing.assert_allclose(biases(result.rows), biases(plain.rows), atol=NOISE_DPH / 10.0)
    np.testing.assert_allclose(
        [row.gyro_c for row in result.rows], [row.gyro_c for row in plain.rows], atol=0.1
    )


@pytest.mark.parametrize("value_c", [-300.0, 1200.0])
def test_a_temperature_that_no_gyro_reaches_is_none(log, value_c):
    log.columns["temp"][600:900] = value_c
    assert imported(log).left_out == {NO_TEMPERATURE: 1}


def test_a_gyro_whose_rate_never_changes_is_shown_with_its_log(log):
    log.columns["gx"] = np.where(np.arange(len(log.time_s)) % 100 < 60, 0.0, 1e-200)
    with pytest.raises(MeasurementError, match=r"log\.csv: a gyro's rate never changes"):
        imported(log)


def test_windows_over_a_gap_are_left_out(log):
    for name, values in log.columns.items():
        log.columns[name] = np.delete(values, slice(950, 990))
    result = imported(log)
    assert result.left_out == {"over a gap of more than 1 s": 1}
    assert 180.0 not in {row.start_s for row in result.rows}


def test_whole_windows_that_are_missing_are_counted(log):
    for name, values in log.columns.items():
        log.columns[name] = np.delete(values, slice(3000, 4500))
    assert imported(log).left_out == {"over a gap of more than 1 s": 1, "no sample at all": 5}


def test_an_unfinished_last_window_is_left_out(log):
    for name, values in log.columns.items():
        log.columns[name] = values[:-150]
    assert imported(log).left_out == {"not recorded to the end": 1}


def test_a_rate_that_is_stuck_is_left_out(log):
    log.columns["gx"][3000:3600] = log.columns["gx"][3000]
    assert imported(log).left_out == {"rate of gyro x stuck": 2}


@pytest.mark.parametrize("gyro", ["{unit: deg/s, x: gx, y: gy, z: gz}",
                                  "{unit: deg/s, x: gx, y: gy, z: gz, full_scale: 0.028}"])  # fmt: skip
def test_a_rate_that_is_clipped_is_left_out(log, gyro):
    log.columns["gx"] = np.clip(log.columns["gx"], -0.028, 0.028)
    log.columns["gz"] *= 0.5
    result = imported(log, gyro=gyro)
    assert set(result.left_out) == {"rate of gyro x saturated"}
    assert max(row.bias_dph[0] for row in result.rows) < 0.028 * 3600.0


def test_a_temperature_that_stands_still_to_the_last_digit_is_left_out(log):
    log.columns["temp"][3000:6000] = log.columns["temp"][3000]
    assert imported(log).left_out == {"temperature stuck": 10}


def test_windows_without_a_temperature_are_left_out(log):
    log.columns["temp"][3000:3600] = np.nan
    assert imported(log).left_out == {NO_TEMPERATURE: 2}


def test_a_temperature_that_is_logged_less_often_than_the_rates_is_used(log):
    plain = np.array([row.gyro_c for row in imported(log).rows])
    log.columns["temp"][np.arange(len(log.time_s)) % 10 > 0] = np.nan
    assert np.abs(np.array([row.gyro_c for row in imported(log).rows]) - plain).max() < 0.05


def test_whole_degrees_are_shown_with_what_they_cost(log):
    log.columns["temp"] = np.round(log.columns["temp"])
    result = imported(log)
    warning = next(each for each in result.warnings if "gyro x" in each)
    assert "in steps of 1 K" in warning
    cost = float(re.search(r"off its curve by ([0-9.e+-]+) deg/h", warning)[1])
    assert cost == pytest.approx(2.0 / np.sqrt(12.0), rel=0.1)


def test_temperatures_in_kelvin_are_shown(log):
    log.columns["temp"] += 273.15
    (warning,) = (each for each in imported(log).warnings if "offset_c" in each)
    assert "283.9 to 312.4 degC. If they are in kelvin" in warning
    in_celsius = imported(log, temperatures="{gyros: temp, offset_c: -273.15}")
    assert not any("kelvin" in each for each in in_celsius.warnings)


def test_temperatures_in_degrees_fahrenheit_are_shown_where_no_gyro_is_so_hot(log):
    log.columns["temp"] = 1.8 * (log.columns["temp"] + 10.0) + 32.0
    (warning,) = (each for each in imported(log).warnings if "offset_c" in each)
    assert "to 120" in warning
    assert "If they are in degF" in warning


def test_too_few_steps_of_temperature_are_refused(log):
    log.columns["temp"] = 5.0 * np.round(log.columns["temp"] / 5.0)
    with pytest.raises(
        MeasurementError, match=r"swings by 3\d\.\d\d K in steps of 5 K: too few.*0\.1 K or finer"
    ):
        imported(log)


def test_a_small_swing_is_refused_unless_it_is_allowed(log):
    log.columns["temp"] = 20.0 + 0.1 * log.columns["temp"]
    with pytest.raises(MeasurementError, match=r"a swing of 2\.8\d K; a curve needs 10 K.*min_swing_c"):
        imported(log)
    assert imported(log, temperatures="{gyros: temp, min_swing_c: 2}").rows


def test_time_that_goes_back_is_shown_with_its_place(log):
    log.columns["time"][500:] -= 10.0
    with pytest.raises(
        MeasurementError, match=r"goes back by 9\.8 s, from 99\.800 to 90\.000 s after .*sample_rate_hz"
    ):
        imported(log)
    log.columns["time"] = (log.time_s + 86400.0 - 100.0) % 86400.0
    with pytest.raises(MeasurementError, match=r"from 99\.800 to -86300\.000 .* restarts each day"):
        imported(log)


def test_no_valid_window_is_an_error_with_the_reasons(log):
    log.columns["gz"][:] = 1.0
    with pytest.raises(MeasurementError, match=r"no window of 60 s is valid. 40: rate of gyro z stuck"):
        imported(log)


def test_a_log_shorter_than_a_window_is_an_error(log):
    with pytest.raises(MeasurementError, match="not recorded to the end"):
        imported(log, window_s=7200)
    with pytest.raises(MeasurementError, match="is shorter than skip_s and one window"):
        imported(log, skip_s=7200)


def test_a_wrong_unit_of_time_is_suspected_where_windows_hold_hardly_a_sample(log):
    log.columns = {name: values[:500] for name, values in log.columns.items()}
    log.columns["time"] *= 1e3
    with pytest.raises(MeasurementError, match=r"500: fewer than 10 samples .*unit of time"):
        imported(log)


@pytest.mark.parametrize(
    ("cycle", "expected"),
    [
        ("3", [3] * 40),
        ("{block_s: 600}", np.repeat([1, 2, 3, 4], 10)),
        ("{block_s: 600, alternate: 2}", np.repeat([1, 2, 1, 2], 10)),
        ("{each_log: true}", [1] * 40),
    ],
)
def test_cycles_follow_the_rule(log, cycle, expected):
    assert [row.cycle for row in imported(log, cycle=cycle).rows] == list(expected)


def test_a_cycle_may_be_a_leg_of_the_temperature(log):
    cycles = [row.cycle for row in imported(log, cycle="{turning_point_c: 5}").rows]
    # The two windows beside the peak differ by noise alone.
    assert cycles[:20] == [1] * 20
    assert cycles[21:] == [2] * 19


def test_cycle_and_position_may_be_columns_and_a_window_across_a_change_is_left_out(log):
    log.columns["pass"] = np.where(log.time_s < 600.0, 1.0, 2.0)
    log.columns["side"] = np.where(log.time_s < 1230.0, 1.0, 2.0)
    position = "{column: side, values: {'1': x_up, '2': x_down}}"
    result = imported(log, cycle="{column: pass}", position=position)
    assert [row.cycle for row in result.rows] == [1] * 10 + [2] * 29
    assert [row.position for row in result.rows] == ["x_up"] * 20 + ["x_down"] * 19
    assert result.left_out == {"position changed": 1}


def test_a_position_that_the_import_map_does_not_list_is_reported(log):
    log.columns["side"] = np.where(log.time_s < 1230.0, 1.0, 2.0)
    with pytest.raises(DocumentError, match=r"column side holds '2'.*position\.values"):
        imported(log, position="{column: side, values: {'1': x_up}}")


def test_the_position_is_the_one_nearest_to_the_accelerometers(log):
    log.columns |= {"ax": np.full(len(log.time_s), 0.3), "ay": np.full(len(log.time_s), -9.8)}
    log.columns["az"] = np.where(log.time_s < 600.0, 6.0, 0.1)
    accelerometers = "{accelerometers: {x: ax, y: ay, z: az}}"
    result = imported(log, position=accelerometers)
    assert {row.position for row in result.rows} == {"y_down"}
    assert result.left_out == {"over 10 deg from the nearest position": 10}


def test_the_earths_rotation_is_taken_from_the_rates(log):
    plain = biases(imported(log, position="x_down").rows)
    freed = biases(imported(log, position="x_down", earth_rate="{latitude_deg: 30, azimuth_deg: 0}").rows)
    # x down, y west, z north: the Earth turns them by -sin, 0 and cos of the latitude.
    expected = 15.041067 * np.array([-0.5, 0.0, np.sqrt(0.75)])
    np.testing.assert_allclose(plain - freed, np.tile(expected, (40, 1)), atol=1e-5)


@pytest.mark.parametrize(
    ("gyro", "force", "latitude_deg"), [(1, 1, 48), (-1, 1, 48), (1, -1, 48), (1, 1, -48)]
)
def test_the_earths_rotation_with_the_wrong_sign_is_shown(log, gyro, force, latitude_deg):
    """Turned upside down at half time; the z gyro senses the Earth at latitude 48 deg."""
    up = np.where(log.time_s < 1200.0, 1.0, -1.0)
    log.columns |= {"ax": 0.0 * up, "ay": 0.0 * up, "az": 9.8 * force * up}
    random = np.random.default_rng(5)
    earth_dph = 15.041067 * np.sin(np.radians(48.0))
    log.columns["gz"] = gyro * (3.0 + earth_dph * up + random.standard_normal(len(up))) / 3600.0
    accelerometers = "{accelerometers: {x: ax, y: ay, z: az}}"
    found = imported(log, position=accelerometers, earth_rate=f"{{latitude_deg: {latitude_deg}}}")
    warned = any(
        "the z gyro differs by 44.7 deg/h with its axis up and down" in each for each in found.warnings
    )
    assert warned == ((gyro, force, latitude_deg) != (1, 1, 48))


@pytest.mark.parametrize(("unit", "is_warned"), [("rad/s", False), ("deg/s", True)])
def test_rates_in_too_large_a_unit_lack_the_earths_rotation(log, unit, is_warned):
    random = np.random.default_rng(5)
    earth_dph = 15.041067 * np.sin(np.radians(48.0))
    log.columns["gz"] = np.radians(0.3 + earth_dph + random.standard_normal(len(log.time_s))) / 3600.0
    found = imported(
        log, position="z_up", gyro=f"{{unit: {unit}, x: gx, y: gy, z: gz}}", earth_rate="{latitude_deg: 48}"
    )
    assert any("seems to lack the Earth's rotation" in each for each in found.warnings) == is_warned


@pytest.mark.parametrize("azimuth_deg", [0, 180])
def test_rates_in_which_the_earths_rotation_fits_another_azimuth_are_shown(log, azimuth_deg):
    """Every minute in the next of six positions, at azimuth 0 and latitude 48 deg."""
    names = np.array(list(POSITIONS))[(log.time_s // 60.0).astype(int) % 6]
    latitude = np.radians(48.0)
    earth_dph = 15.041067 * np.array([0.0, np.cos(latitude), np.sin(latitude)])
    C_nb = np.array([POSITIONS[name].C_nb() for name in names])
    random = np.random.default_rng(5)
    rates = np.einsum("nij,i->nj", C_nb, earth_dph) + random.standard_normal((len(names), 3))
    log.columns |= dict(zip(("gx", "gy", "gz"), rates.T / 3600.0, strict=True))
    log.columns |= dict(zip(("ax", "ay", "az"), 9.8 * C_nb[:, 2].T, strict=True))
    found = imported(
        log,
        position="{accelerometers: {x: ax, y: ay, z: az}}",
        earth_rate=f"{{latitude_deg: 48, azimuth_deg: {azimuth_deg}}}",
    )
    warned = any("fits an azimuth_deg of" in each for each in found.warnings)
    assert warned == (azimuth_deg == 180), found.warnings


def test_without_azimuth_the_vertical_gyro_alone_is_freed_and_that_is_reported(log):
    plain = biases(imported(log, position="x_down").rows)
    result = imported(log, position="x_down", earth_rate="{latitude_deg: 30}")
    np.testing.assert_allclose((plain - biases(result.rows))[0], [-7.5205, 0.0, 0.0], atol=1e-4)
    assert any("horizontal gyros, up to 13.0 deg/h" in each for each in result.warnings)


def test_logs_on_one_clock_keep_it_and_logs_of_several_power_ons_are_laid_end_to_end(log):
    first = log.write(name="first.csv")
    log.columns["time"] = log.time_s + 5000.0
    second = log.write(name="second.csv")
    rows = import_logs([first, second], log.mapping(cycle="{each_log: true}")).rows
    assert [(row.start_s, row.since_power_on_s, row.run, row.cycle) for row in rows[39:41]] == [
        (2340.0, 2340.0, "1", 1), (5000.0, 5000.0, "1", 2)]  # fmt: skip
    rows = import_logs([second, first], log.mapping(each_log_is_a_run="true")).rows
    assert [(row.start_s, row.since_power_on_s, row.run) for row in rows[39:41]] == [
        (2340.0, 2340.0, "1"), (2400.0, 0.0, "2")]  # fmt: skip
    with pytest.raises(MeasurementError, match="each_log_is_a_run: true"):
        import_logs([second, first], log.mapping())


def test_the_table_can_be_read_back_and_the_record_beside_it_reports_its_origin(log, tmp_path):
    log.columns["gy"][5:10] = np.nan
    result = imported(log)
    out = tmp_path / "dwells.csv"
    record = json.loads(write_import(out, result).read_text())
    assert len(read_dwells(out)) == 40
    assert record["logs"][0]["samples"] == 11995
    assert record["logs"][0]["dropped"] == 5
    assert len(record["logs"][0]["sha256"]) == 64
    assert record["map"]["gyro"]["unit"] == "deg/s"
    assert record["warnings"] == result.warnings


def test_the_summary_reports_what_was_left_out(log):
    log.columns["gx"][3000:3600] = log.columns["gx"][3000]
    text = imported(log).summary()
    assert "38 dwells of 60 s, gyros at 10.7 to 39.3 degC" in text
    assert "Left out: rate of gyro x stuck: 2 of 40 windows" in text
    assert "Warning: all rows belong to one cycle" in text


def test_a_packed_log_is_the_same(log):
    plain = log.write()
    packed = log.folder / "log.csv.gz"
    packed.write_bytes(gzip.compress(plain.read_bytes()))
    mapping = log.mapping()
    rows = import_logs([packed], mapping).rows
    assert repr(rows) == repr(import_logs([plain], mapping).rows)  # NaN does not equal itself
    packed.write_bytes(packed.read_bytes()[:1000])
    with pytest.raises(DocumentError, match="can't be read"):
        import_logs([packed], mapping)


@pytest.mark.parametrize(
    ("layout", "rule"),
    [
        ("%Y-%m-%dT%H:%M:%S.%f+00:00", "unit: iso8601"),
        ("%d.%m.%Y %H:%M:%S.%f", "format: '%d.%m.%Y %H:%M:%S.%f'"),
    ],
)
def test_units_with_prefixes_factors_and_calendar_times_mean_the_same(log, layout, rule):
    expected = import_logs([log.write()], log.mapping()).rows
    begin = datetime(2026, 3, 1, 12, tzinfo=UTC)
    time, x, y, z, heat = log.columns.values()
    log.columns = {
        "when": [(begin + timedelta(seconds=each)).strftime(layout) for each in time],
        "gx": 1e3 * np.deg2rad(x),
        "gy": 2e3 * np.deg2rad(y),
        "gz": 1e3 * np.deg2rad(z),
        "temp": heat + 273.15,
    }
    rows = zip(*([str(each) for each in column] for column in log.columns.values()), strict=True)
    path = log.write([",".join(log.columns), *(",".join(row) for row in rows)])
    mapping = log.mapping(
        time=f"{{column: when, {rule}}}",
        gyro="{unit: mrad/s, x: gx, y: {column: gy, scale: 0.5}, z: gz}",
        temperatures="{gyros: {column: temp, offset_c: -273.15}}",
    )
    for row, other in zip(import_logs([path], mapping).rows, expected, strict=True):
        assert row.bias_dph == pytest.approx(other.bias_dph, abs=1e-3)
        assert row.gyro_c == pytest.approx(other.gyro_c, abs=1e-6)
        assert (row.start_s, row.end_s) == pytest.approx((other.start_s, other.end_s), abs=1e-3)


def test_a_calendar_time_of_another_form_is_reported_with_the_key_that_gives_it(log):
    header, *lines = log.lines()
    path = log.write([header, *("1.3.2026 12:00:00," + line.partition(",")[2] for line in lines)])
    with pytest.raises(
        DocumentError, match=r"expected a number; .* \(a calendar time: .* or 'time.format'\)"
    ):
        import_logs([path], log.mapping())
    column = header.partition(",")[0]
    for rule, form in (("unit: iso8601", "by ISO 8601"), ("format: '%d/%m/%Y'", "of the form '%d/%m/%Y'")):
        with pytest.raises(DocumentError, match=rf"which is no time {form}. Give its form in 'time.format'"):
            import_logs([path], log.mapping(time=f"{{column: {column}, {rule}}}"))


def test_one_problem_of_a_column_is_reported_once(log):
    lines = log.lines()
    path = log.write([lines[0], *(line.replace(",", ",x", 1) for line in lines[1:])])
    with pytest.raises(DocumentError, match=r"log\.csv:2: column gx: expected a number; found 'x") as error:
        import_logs([path], log.mapping())
    assert str(error.value).count("column gx") == 1
    assert f"(and in {len(lines) - 2} more lines)" in str(error.value)


@pytest.mark.parametrize(
    ("temperatures_c", "expected"),
    [
        ([20, 10, 0, 10, 20, 10, 0], [1, 1, 1, 2, 2, 3, 3]),
        ([0, 10, 20, 18, 20, 30], [1, 1, 1, 1, 1, 1]),
        ([5, 8, 5, 2, -10, 10], [1, 1, 1, 1, 1, 2]),
        ([20, 20, 20], [1, 1, 1]),
        ([], []),
    ],
)
def test_a_leg_ends_where_the_temperature_turned_by_enough(temperatures_c, expected):
    assert cycle_numbers(temperatures_c, 5.0) == expected
