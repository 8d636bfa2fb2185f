"""The driver's compensation against what the emulated INS does with it, over the real frames."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.foundations.arrays import DPH_TO_RADPS
from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.station.instruments import Emulation, Instruments
from gyrobench.bench.station.station import Station
from gyrobench.drivers.emulators.bench import BenchAddress, bench_at
from gyrobench.drivers.ins.compensation import Compensation, Correction
from gyrobench.drivers.ins.readout import InsMode
from tests.drivers.ins.compensation_reference import TERM_NUMBERS, Conditions, compensated_dph

_STEP_S = 10.0
ARCSEC = np.radians(1.0) / 3600.0


def compensation(name, **changes):
    numbers = {"polynomial_dph": np.zeros((3, 1)), "low_c": np.full(3, -30.0), "high_c": np.full(3, 75.0)}
    return Compensation(**{**numbers, **TERM_NUMBERS[name], **changes})


class EmulatedIns:
    """An INS without noise on its tilted table, in a chamber that has cooled for a while."""

    def __init__(self):
        self.clock = VirtualClock()
        station = Station(find_document("stations", "emulated"))
        self.instruments = Instruments(station, self.clock, Emulation("ideal"))
        self.ins = self.instruments.ins
        address = BenchAddress(self.clock.name, str(find_document("worlds", "ideal")), 0)
        self.world = bench_at(address).world
        self._courses = []
        self._measured, self._forces = [], []
        self._feel_increments()
        self.instruments.power_unit(True)
        self._on_s = self.clock.now()
        self._keep_temperatures()
        self.instruments.table.prepare()
        self.instruments.table.move_to(station.by_axis_number((35.0, 50.0)), 10.0)
        self.run(600.0)
        self.instruments.chamber.set_temperature(-10.0, 1.0)
        self.instruments.chamber.switch(True)
        self.run(2400.0)
        self.ins.enter(InsMode.ALIGN)

    def _feel_increments(self):
        advance = self.world.unit.advance

        def advance_and_keep(first, rotation, velocity):
            self._measured.append(rotation.copy())
            self._forces.append(velocity.copy())
            return advance(first, rotation, velocity)

        self.world.unit.advance = advance_and_keep

    def run(self, duration_s):
        for _ in range(round(duration_s / _STEP_S)):
            self.clock.sleep(_STEP_S)
            self.ins.poll()
            self._keep_temperatures()

    def _keep_temperatures(self):
        optics_c, electronics_c = self.world.thermal.optics_c.copy(), self.world.thermal.electronics_c.copy()
        self._courses.append((self.clock.now() - self._on_s, optics_c, electronics_c))

    def rate_dph(self):
        """Mean rate that the gyros measure in ten seconds."""
        self._measured.clear()
        self.run(_STEP_S)
        return np.concatenate(self._measured).mean(axis=0) * 100.0 / DPH_TO_RADPS

    def increments(self):
        """Mean increments of ten seconds, as navigated with."""
        self._measured.clear()
        self._forces.clear()
        self.run(_STEP_S)
        return tuple(np.concatenate(each).mean(axis=0) for each in (self._measured, self._forces))

    def expected_dph(self, compensation):
        """What the driver's own model says, for true temperatures and attitude, of the last ten seconds."""
        t, optics_c, board_c = map(np.array, zip(*self._courses, strict=True))
        up_body = np.tile(self.world.attitude()[2], (len(t), 1))
        rate_c_per_h = np.gradient(optics_c, t, axis=0) * 3600.0
        return compensated_dph(compensation, Conditions(optics_c, board_c, rate_c_per_h, up_body, t))[
            -2:
        ].mean(axis=0)


@pytest.fixture
def emulated():
    bench = EmulatedIns()
    with bench.instruments:
        yield bench


@pytest.mark.parametrize("name", TERM_NUMBERS)
def test_the_gyros_measure_less_by_what_each_term_says(emulated, name):
    emulated.run(20.0)
    before_dph = emulated.rate_dph()
    loaded = compensation(name)
    emulated.ins.load_compensation(loaded)
    np.testing.assert_allclose(emulated.rate_dph(), before_dph, atol=1e-6)
    emulated.ins.apply_compensation()
    compensated_dph = before_dph - emulated.rate_dph()
    expected_dph = emulated.expected_dph(loaded)
    assert np.abs(expected_dph).min() > 0.005
    # The INS knows a rate of temperature minutes late, and single-precision numbers.
    np.testing.assert_allclose(
        compensated_dph, expected_dph, rtol=0.15 if name == "temperature_rate" else 0.01
    )


def test_an_ins_that_compensates_says_so_and_names_it_until_it_is_cleared(emulated):
    ins = emulated.ins
    emulated.run(10.0)
    assert (ins.status().compensation, ins.status().compensation_in_use) == (False, 0)
    checksum = ins.load_compensation(compensation("g_sensitivity"))
    ins.apply_compensation()
    emulated.run(10.0)
    assert (ins.status().compensation, ins.status().compensation_in_use) == (True, checksum)
    other = ins.load_compensation(compensation("warm_up"))
    emulated.run(10.0)
    assert checksum == ins.status().compensation_in_use != other == ins.status().compensation_loaded
    ins.clear_compensation()
    emulated.run(10.0)
    assert (ins.status().compensation, ins.status().compensation_in_use) == (False, 0)


def test_a_power_cycle_loses_the_compensation(emulated):
    emulated.run(20.0)
    before_dph = emulated.rate_dph()
    emulated.ins.load_compensation(compensation("g_sensitivity"))
    emulated.ins.apply_compensation()
    assert np.abs(emulated.rate_dph() - before_dph).max() > 0.1
    emulated.instruments.power_unit(False)
    emulated.run(10.0)
    emulated.instruments.power_unit(True)
    emulated.run(20.0)
    assert emulated.ins.status().compensation is False
    emulated.ins.enter(InsMode.ALIGN)
    emulated.run(20.0)
    np.testing.assert_allclose(emulated.rate_dph(), before_dph, atol=1e-6)


def test_outside_the_fitted_temperatures_nothing_is_extrapolated(emulated):
    coldest_c = math.ceil(emulated.world.thermal.optics_c.max()) + 5.0
    emulated.run(20.0)
    before_dph = emulated.rate_dph()
    emulated.ins.load_compensation(compensation("polynomial", low_c=np.full(3, coldest_c)))
    emulated.ins.apply_compensation()
    held_dph = np.polynomial.polynomial.polyval(coldest_c, TERM_NUMBERS["polynomial"]["polynomial_dph"].T)
    np.testing.assert_allclose(before_dph - emulated.rate_dph(), held_dph, rtol=1e-5)


def test_errors_of_all_other_coefficients_are_taken_out(emulated):
    emulated.run(20.0)
    true = emulated.increments()
    gyro = 1e-6 * np.diag([300.0, -200.0, 100.0]) + ARCSEC * np.array(
        [[0, 20, -30], [10, 0, 40], [-50, 15, 0]]
    )
    force = 1e-6 * np.diag([-150.0, 80.0, 60.0]) + ARCSEC * np.array([[0, 0, 0], [25, 0, 0], [-35, 45, 0]])
    bias_ug = np.array([120.0, -90.0, 60.0])
    optics_c = emulated.world.thermal.optics_c

    def name(sensor, i, j):
        return f"{sensor}_scale_factor_{AXES[i]}" if i == j else f"{sensor}_misalignment_{AXES[i]}{AXES[j]}"

    corrections = {
        name(sensor, i, j): Correction(
            np.array([matrix[i, j] / (1e-6 if i == j else ARCSEC) - 0.5 * optics_c[i], 0.5])
        )
        for sensor, matrix in (("gyro", gyro), ("accelerometer", force))
        for i in range(3)
        for j in range(3)
        if matrix[i, j]
    }
    up = emulated.world.attitude()[2]
    for axis, bias in zip(AXES, bias_ug, strict=True):
        along = np.array([0.0, 50.0, 0.0])
        corrections[f"accelerometer_bias_{axis}"] = Correction(np.array([bias - along @ up]), 0.0, along)
    checksum = emulated.ins.load_compensation(
        compensation("polynomial", polynomial_dph=np.zeros((3, 1)), coefficients=corrections)
    )
    emulated.ins.apply_compensation()
    emulated.run(10.0)
    assert emulated.ins.status().compensation_in_use == checksum
    rotation, velocity = emulated.increments()
    np.testing.assert_allclose(rotation @ (np.eye(3) + gyro).T, true[0], atol=1e-11)
    # In between the temperature changes by half a kelvin.
    np.testing.assert_allclose(
        velocity @ (np.eye(3) + force).T + bias_ug * 9.80665e-6 * 0.01, true[1], atol=5e-8
    )


def test_an_ins_without_other_coefficients_refuses_them_by_name(emulated):
    command = emulated.ins._commands.load_compensation
    old = command.model_copy(update={"others": None})
    loaded = compensation("polynomial", coefficients={"gyro_scale_factor_x": Correction(np.array([3.0]))})
    assert old.unsupported(loaded) == ["gyro_scale_factor_x"]
    assert command.unsupported(loaded) == []
    assert max(old.numbers(loaded)[0]) == 27
    assert max(command.numbers(loaded)[0]) == 83


def test_a_coefficient_holds_its_value_outside_the_temperatures_at_which_it_was_measured(emulated):
    emulated.run(20.0)
    true = emulated.increments()
    optics_c = emulated.world.thermal.optics_c
    hotter_c = float(optics_c[0]) + 10.0
    # 0 at the lower end of its range; 100 ppm less at the temperature of the gyro.
    measured = Correction(np.array([-10.0 * hotter_c, 10.0]), range_c=(hotter_c, hotter_c + 40.0))
    extrapolated = replace(measured, range_c=None)
    gains = []
    for each in (measured, extrapolated):
        emulated.ins.clear_compensation()
        loaded = compensation(
            "polynomial", polynomial_dph=np.zeros((3, 1)), coefficients={"accelerometer_scale_factor_x": each}
        )
        checksum = emulated.ins.load_compensation(loaded)
        emulated.ins.apply_compensation()
        emulated.run(5.0)
        assert emulated.ins.status().compensation_in_use == checksum
        gains.append(emulated.increments()[1][0] / true[1][0])
    assert gains[0] == pytest.approx(1.0, abs=1e-6)
    assert gains[1] == pytest.approx(1.0 + 1e-4, abs=1e-5)


def test_an_ins_without_limits_of_coefficients_refuses_those_far_narrower_than_the_biases(emulated):
    command = emulated.ins._commands.load_compensation
    old = command.model_copy(update={"others": command.others.model_copy(update={"limits": None})})
    curve = np.array([3.0, 0.1])
    for range_c, polynomial, unsupported in (
        ((33.0, 75.0), curve, ["temperature limits of gyro_scale_factor_x"]),
        ((-22.0, 68.0), curve, []),
        ((33.0, 75.0), curve[:1], []),
        (None, curve, []),
    ):
        loaded = compensation(
            "polynomial",
            low_c=np.full(3, -25.0),
            high_c=np.full(3, 70.0),
            coefficients={"gyro_scale_factor_x": Correction(polynomial, range_c=range_c)},
        )
        assert old.unsupported(loaded) == unsupported
        assert command.unsupported(loaded) == []
        assert max(old.numbers(loaded)[0]) == 83
        assert max(command.numbers(loaded)[0]) == (83 if range_c is None else 97)
