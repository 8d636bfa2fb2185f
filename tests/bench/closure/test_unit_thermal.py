"""The course of temperatures, fitted to a campaign and predicted for a block, on the emulator's network."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.temperature_record import TemperatureRecord
from gyrobench.bench.closure.unit_thermal import Course, UnitThermal
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.procedure.estimate import ThermalEstimate
from gyrobench.drivers.emulators.world.thermal import ThermalNetwork
from gyrobench.drivers.emulators.world.world_file import Thermal

STEP_S, DWELL_S = 30.0, 1200.0
TYPICAL = UnitThermal.typical(ThermalEstimate(3600.0, 10.0))
PATHS = {"x": [0.0, -0.8, 0.6], "y": [0.6, 0.8, 0.0], "z": [0.8, 0.0, -0.6]}
#: Temperatures of the air, held for these hours after a ramp of 1 K/min.
CALIBRATION = ((60.0, 4.0), (20.0, 4.0), (-20.0, 4.0), (20.0, 4.0))
#: Largest rms error: one percent of the span of the air.
MAX_RMS_K = 0.8
#: What no dwell of the calibration was like: 45 min without power, another temperature, one position.
BLOCK = ((40.0, 5.0),)


class Bench:
    """The emulator's thermal network, stepped every two seconds; what it passes through is kept."""

    def __init__(self):
        self.network = ThermalNetwork(
            Thermal(**{axis: {"heat_path": path} for axis, path in PATHS.items()}), 20.0
        )
        self.network.powered = True
        self.air_c = 20.0
        self.seen = []

    def run(self, profile, positions, power=lambda since_s: 1.0):
        since_s = 0.0
        for to_c, hours in profile:
            ramp_s = 60.0 * abs(to_c - self.air_c)
            for _ in range(round((ramp_s + 3600.0 * hours) / STEP_S)):
                up = POSITIONS[positions[int(since_s // DWELL_S) % len(positions)]].C_nb()[2]
                self.network.powered = bool(power(since_s))
                self.air_c += float(np.clip(to_c - self.air_c, -STEP_S / 60.0, STEP_S / 60.0))
                for _ in range(round(STEP_S / 2.0)):
                    self.network.step(2.0, self.air_c, up)
                since_s += STEP_S
                self.seen.append((self.air_c, power(since_s), up, self.network.nodes_c.copy()))

    def course(self, first=0):
        air_c, power, up, nodes_c = (np.array(each) for each in zip(*self.seen[first:], strict=True))
        time_s = STEP_S * (1.0 + first + np.arange(len(air_c)))
        return Course(time_s, air_c, nodes_c[:, 0], nodes_c[:, 1:4], nodes_c[:, 4:]), power, up


@cache
def measured():
    """A bench after the calibration, and the rows of its dwells."""
    bench, order = Bench(), [*POSITIONS]
    bench.run(CALIBRATION, order)
    course, _, _ = bench.course()
    rows = []
    for number in range(int(course.time_s[-1] // DWELL_S)):
        inside = (course.time_s > number * DWELL_S) & (course.time_s <= (number + 1) * DWELL_S)
        optics_c = course.optics_c[inside]
        rows.append(
            DwellRow(
                unit="1", run="1", dwell=number + 1, cycle=1, position=order[number % 6],
                start_s=number * DWELL_S, end_s=(number + 1) * DWELL_S, since_power_on_s=number * DWELL_S,
                gyro_c=tuple(optics_c.mean(axis=0)),
                gyro_rate_c_per_h=tuple((optics_c[-1] - optics_c[0]) / (DWELL_S - STEP_S) * 3600.0),
                bias_dph=tuple(1e-3 * np.random.default_rng(number).standard_normal(3)),
                sigma_dph=(1e-3,) * 3, chamber_c=course.air_c[inside].mean(),
                case_c=course.case_c[inside].mean(),
                board_c=tuple(course.electronics_c[inside].mean(axis=0)),
            )
        )  # fmt: skip
    return bench, rows, course


def campaign(course=None, **changes):
    _, rows, _ = measured()
    record = None if course is None else TemperatureRecord(course.time_s, course.optics_c, air_c=course.air_c)
    return campaign_of([replace(row, **changes) for row in rows], record)


@cache
def fitted_to_all():
    return TYPICAL.fitted_to(campaign(measured()[2]))


def rms(off_k):
    return float(np.sqrt(np.mean(off_k**2)))


def test_what_is_fitted_describes_all_temperatures_of_the_campaign():
    _, _, truth = measured()
    fitted, course = fitted_to_all()
    assert fitted.rms_k < MAX_RMS_K
    for name in ("case_c", "optics_c", "electronics_c"):
        assert rms(getattr(course, name) - getattr(truth, name)) < MAX_RMS_K, name


def test_electronics_are_hotter_with_their_heat_path_down():
    fitted, _ = fitted_to_all()
    for found, path in zip(fitted.electronics_rise_k[:, 1:], PATHS.values(), strict=True):
        assert np.dot(found, path) / np.linalg.norm(found) < -0.95


@pytest.mark.parametrize("known", ["recorded", "of dwells"])
def test_a_block_that_was_not_measured_is_predicted_from_the_end(known):
    """Without power, then at another temperature in one position: nothing of it was in the campaign."""
    bench, _, _ = measured()
    fitted, course = fitted_to_all() if known == "recorded" else TYPICAL.fitted_to(campaign())
    again = Bench()
    again.network.nodes_c[:] = bench.network.nodes_c
    again.air_c = bench.air_c
    again.run(BLOCK, ["x_down"], power=lambda since_s: float(since_s > 2700.0))
    then, power, up = again.course()
    predicted = fitted.course(then.time_s, then.air_c, power, up, course)
    at_rest = fitted.course(then.time_s, then.air_c, power, up)
    typical = TYPICAL.course(then.time_s, then.air_c, power, up, course)
    off_k = [rms(each.optics_c - then.optics_c) for each in (predicted, at_rest, typical)]
    assert off_k[0] < MAX_RMS_K
    assert min(off_k[1:]) > 2.0 * off_k[0]
    above_k = [each.electronics_c - each.optics_c for each in (predicted, then)]
    powered = power > 0.0
    assert rms((above_k[0] - above_k[1])[powered]) < MAX_RMS_K
    assert np.abs(above_k[0][~powered][-1]).max() < 2.0 < 5.0 < above_k[0][-1].min()


def test_what_was_not_measured_stays_that_of_a_typical_unit():
    nothing = {"case_c": np.nan, "board_c": (np.nan,) * 3}
    fitted, _ = TYPICAL.fitted_to(campaign(measured()[2], **nothing))
    assert fitted.case_rise_k == TYPICAL.case_rise_k
    np.testing.assert_array_equal(fitted.electronics_rise_k, TYPICAL.electronics_rise_k)
    assert fitted.rms_k < MAX_RMS_K
    assert TYPICAL.fitted_to(campaign(chamber_c=np.nan)) == (TYPICAL, None)
