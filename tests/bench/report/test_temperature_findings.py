"""Which temperatures of a run contradict one another."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from gyrobench.bench.report.run_findings import run_findings
from gyrobench.bench.report.run_report import write_report
from gyrobench.bench.report.temperature_findings import sensors_sentence, temperatures_sentence
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.telemetry import Telemetry
from gyrobench.drivers.emulators.world.thermal import ThermalNetwork
from gyrobench.drivers.emulators.world.world_file import GyroThermal, Thermal


@pytest.mark.parametrize(
    ("factor", "offset_c", "named"),
    [
        (1.0, 0.0, ""),
        (0.5, 0.0, "temperature signals"),
        (1.8, 32.0, "temperature signals"),
        (
            1.0,
            15.0,
            "23.0 to 23.0 K above the chamber's air; unit.thermal.self_heating_c of the station is 9 K",
        ),
        (1.0, -15.0, "-7.0 to -7.0 K above the chamber's air"),
        (1.0, 5.0, ""),
    ],
)
def test_temperatures_in_a_wrong_scale_or_with_an_offset_are_named(dwells, factor, offset_c, named):
    station = {"unit": {"thermal": {"self_heating_c": 9}}}
    settled = [
        replace(
            row,
            chamber_c=10.0 * number,
            gyro_c=(factor * (10.0 * number + 8.0) + offset_c,) * 3,
            gyro_rate_c_per_h=(1.0,) * 3,
            board_c=(math.nan,) * 3,
        )
        for number, row in enumerate(dwells)
    ]
    assert named in temperatures_sentence(settled, station)
    assert bool(named) == bool(temperatures_sentence(settled, station))
    assert temperatures_sentence(settled[:3], station) == ""
    moving = [replace(row, gyro_rate_c_per_h=(60.0,) * 3) for row in settled]
    assert temperatures_sentence(moving, station) == ""


def test_exchanged_temperatures_of_optics_and_electronics_are_named(dwells):
    def settled(board_c):
        still = {"chamber_c": 25.0, "gyro_c": (35.0,) * 3, "gyro_rate_c_per_h": (1.0,) * 3}
        return [replace(row, board_c=board_c, **still) for row in dwells]

    assert temperatures_sentence(settled((42.0, math.nan, 36.0)), {}) == ""
    found = temperatures_sentence(settled((28.0, math.nan, 36.0)), {})
    assert "optics are warmer than the electronics, by 7.0 K or more (gyro x)" in found
    assert "exchanged in signal map or DBC file" in found
    one_warmer = [*settled((28.0,) * 3)[1:], settled((42.0,) * 3)[0]]
    assert temperatures_sentence(one_warmer, {}) == ""


_STEP_S = 10.0
_NODES = ["case_c", "gyro_x_c", "gyro_y_c", "gyro_z_c", "board_x_c", "board_y_c", "board_z_c"]


def _readings(scatter=0.0, seed=0, off_s=0.0):
    """Telemetry of a run that takes the emulated unit from 23 to 62, 20 and -36 degC; it is cold at first.

    ``scatter``: of the logarithms of the gyros' heat capacities, powers and conductances.
    """
    random = np.random.default_rng(seed)
    paths = {"x": [0.0, -0.8, 0.6], "y": [0.6, 0.8, 0.0], "z": [0.8, 0.0, -0.6]}
    names = [name for name in GyroThermal.model_fields if name.endswith(("_k", "_w"))]
    gyros = {
        axis: GyroThermal(
            heat_path=path,
            **{name: GyroThermal.model_fields[name].default * np.exp(scatter * random.standard_normal())
               for name in names},
        )
        for axis, path in paths.items()
    }  # fmt: skip
    times_h = np.cumsum([0.0, off_s / 3600.0, 0.3, 0.65, 5.0, 0.7, 5.0, 0.95, 5.0])
    time_s = np.arange(0.0, 3600.0 * times_h[-1], _STEP_S)
    air_c = np.interp(time_s / 3600.0, times_h, [23.0, 23.0, 23.0, 62.0, 62.0, 20.0, 20.0, -36.0, -36.0])
    up = np.repeat(np.vstack([np.eye(3), -np.eye(3)]), 150, axis=0)
    network = ThermalNetwork(Thermal(**gyros), 23.0)
    network.powered = True
    nodes_c = np.full((len(time_s), 7), 23.0)
    is_on = time_s >= off_s
    air_each_second_c = np.repeat(air_c[is_on], int(_STEP_S))
    network.step(1.0, air_each_second_c, np.resize(np.repeat(up, 10, axis=0), (len(air_each_second_c), 3)))
    nodes_c[is_on] = network.course.nodes_c[:: int(_STEP_S)]
    nodes_c[~is_on] = math.nan
    return {"time_s": time_s, "chamber_c": air_c, **dict(zip(_NODES, nodes_c.T, strict=True))}


def _lagging(values_c, time_constant_s):
    share = 1.0 - np.exp(-_STEP_S / time_constant_s)
    return np.asarray(lfilter([share], [1.0, share - 1.0], values_c - 23.0)) + 23.0


def test_sensors_of_a_cold_unit_must_agree_with_one_another_and_with_the_air():
    readings = _readings(scatter=0.1)
    assert sensors_sentence(readings) == ""
    found = sensors_sentence(readings | {"gyro_x_c": readings["gyro_x_c"] + 5.0})
    assert "the sensor of the x gyro read 28.0 degC: it seems to be off by +5.0 K" in found
    no_case = readings | {"case_c": np.full_like(readings["case_c"], math.nan)}
    assert "y gyro read 18.0 degC" in sensors_sentence(no_case | {"gyro_y_c": readings["gyro_y_c"] - 5.0})
    warm = {name: values + 12.0 for name, values in readings.items() if name.startswith("gyro")}
    warm["gyro_z_c"] = warm["gyro_z_c"] + 3.0  # as after a power cycle
    assert sensors_sentence(readings | warm) == ""
    assert sensors_sentence({}) == ""
    assert sensors_sentence({name: values[:0] for name, values in readings.items()}) == ""


def test_an_offset_of_all_gyros_shows_after_the_unit_was_off_in_steady_air():
    for off_s, text in ((3600.0, ""), (9000.0, "off for more than 2 h in air of 23.0 degC")):
        readings = _readings(off_s=off_s)
        assert sensors_sentence(readings) == ""
        gyros = {name: values + 5.0 for name, values in readings.items() if name.startswith("gyro")}
        found = sensors_sentence(readings | gyros)
        assert text in found
        assert bool(found) == bool(text)


@pytest.mark.parametrize("scatter", [0.0, 0.1])
def test_a_sensor_that_lags_or_has_another_scale_is_named(scatter):
    readings = _readings(scatter, seed=3)
    assert sensors_sentence(readings) == ""
    lagging = sensors_sentence(readings | {"gyro_y_c": _lagging(readings["gyro_y_c"], 1800.0)})
    assert "The temperature of the y gyro follows that of the other two about" in lagging
    scaled = sensors_sentence(readings | {"gyro_z_c": 23.0 + 0.85 * (readings["gyro_z_c"] - 23.0)})
    assert "The temperature of the z gyro changes by 0.8" in scaled
    assert "Temperatures of the gyros." in run_findings([], {}, None, [], sensors=lagging)


@pytest.mark.parametrize("part", ["gyro", "board"])
def test_exchanged_gyros_show_in_the_heat_that_their_electronics_lose_to_their_optics(part):
    readings = _readings(scatter=0.1, seed=3)
    noise = np.random.default_rng(1)
    readings |= {name: readings[name] + 0.003 * noise.standard_normal(len(readings[name])) for name in _NODES}

    def exchanged(order):
        return sensors_sentence(
            readings
            | {f"{part}_{to}_c": readings[f"{part}_{own}_c"] for to, own in zip("xyz", order, strict=True)}
        )

    assert exchanged("xyz") == ""
    assert "at the optics of another gyro: of y at x and of x at y." in exchanged("yxz")
    assert "seem to be exchanged: check signal map" in exchanged("yzx")
    readings["case_c"] = np.full_like(readings["case_c"], math.nan)
    assert exchanged("yxz") == ""


def test_the_sensors_of_a_run_folder_are_tested_by_its_telemetry(tmp_path):
    folder = RunFolder(tmp_path)
    telemetry = Telemetry(folder.telemetry)
    readings = _readings()
    for index in range(3):
        telemetry.add({name: values[index] for name, values in readings.items()} | {"gyro_z_c": 35.0})
    telemetry.flush()
    doubts = write_report(folder).content.doubts
    assert "the sensor of the z gyro read 35.0 degC" in doubts["Temperatures of the gyros."]
    next(folder.telemetry.iterdir()).write_bytes(b"damaged")
    assert write_report(folder).content.doubts == {}


@pytest.mark.long
def test_hardly_any_sound_unit_whose_gyros_follow_the_chamber_unequally_is_doubted():
    doubted = [seed for seed in range(500) if sensors_sentence(_readings(scatter=0.1, seed=seed))]
    assert len(doubted) <= 1, doubted


@pytest.mark.long
def test_exchanged_gyros_show_in_almost_all_units_whose_electronics_heat_their_own_optics():
    found = 0
    for seed in range(100):
        readings = _readings(scatter=0.3, seed=seed)
        swapped = {"gyro_y_c": readings["gyro_z_c"], "gyro_z_c": readings["gyro_y_c"]}
        found += "of z at y and of y at z" in sensors_sentence(readings | swapped)
    assert found >= 97
