"""Coefficients of six positions from the joint solution of their navigation output."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2

from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.calibration.coefficients import (
    COEFFICIENTS,
    OPTIONAL_PARAMETERS,
    CoefficientEstimate,
    SensorErrors,
)
from gyrobench.bench.calibration.joint_coefficients import attitude_p_value, joint_coefficients
from gyrobench.bench.calibration.results import coefficient_rows
from gyrobench.bench.foundations.arrays import STANDARD_GRAVITY
from gyrobench.bench.navigation.positions import POSITIONS
from tests.bench.bias.emulated_dwells import DPH, UG
from tests.bench.bias.emulated_groups import any_unit, joint_solution_of, measure

# As the units of emulated_groups are: their mounts do not tilt and their accelerometers do not drift.
PRIOR = dataclasses.replace(
    PriorKnowledge.from_datasheet(latitude_arcmin=0.02), tilt_step=0.0, accelerometer_drift=0.0
)
NAMES = [f"{each.name}_{each.axis}" for each in COEFFICIENTS]


@pytest.fixture(scope="module")
def estimates():
    random = np.random.default_rng(33)
    found = []
    for _ in range(8):
        unit = any_unit(random)
        solution = joint_solution_of(measure(unit, random), PRIOR)
        truth = SensorErrors(
            unit.true_bias_dph().mean(axis=0) * DPH,
            unit.gyro_matrix,
            unit.accelerometer_ug * UG,
            unit.accelerometer_matrix,
        )
        found.append((joint_coefficients(solution, PRIOR), truth.vector()))
    return found


def test_misalignments_in_the_accelerometers_frame_are_those_of_the_unit(estimates):
    deviations = [
        ((each.values - truth) / each.sigmas)[each.is_observed & (np.arange(21) > 2)]
        for each, truth in estimates
    ]
    squares = np.concatenate(deviations) ** 2
    assert np.sqrt(squares.mean()) == pytest.approx(1.0, abs=0.25)
    for each, _ in estimates:
        seen = dict(zip(NAMES, each.is_observed, strict=True))
        assert sum(seen[name] for name in NAMES if "misalignment" in name) >= 6
        assert not any(seen[name] for name in NAMES if "accelerometer_scale_factor" in name)
        assert all(seen[name] for name in NAMES if "bias" in name)


def test_covariances_by_source_add_up(estimates):
    for each, _ in estimates:
        total = np.sum([np.diag(part) for part in each.parts.values()], axis=0)
        assert total == pytest.approx(np.diag(each.covariance), rel=1e-9)
        assert all((np.diag(part) > -1e-6 * total).all() for part in each.parts.values())
        seen = each.is_observed
        assert (np.diag(each.parts["assumed_size"])[seen] < 0.5 * total[seen]).all()


def test_the_rows_are_those_of_coefficients_csv(estimates):
    rows = coefficient_rows(estimates[0][0])
    assert [f"{row.coefficient}_{row.axis}" for row in rows] == NAMES
    sigmas = {f"{row.coefficient}_{row.axis}": row.sigma for row in rows if not row.finding}
    assert 0.3 < sigmas["accelerometer_bias_x"] < 20.0


def test_dwells_show_biases_that_follow_attitude_otherwise_than_in_the_rotations():
    random, p_values = np.random.default_rng(7), {False: [], True: []}
    start_s, gyro_c = 1600.0 * np.arange(6), 30.0 - 2.0 * np.exp(-0.5 * np.arange(6))
    g_names = [each for each in OPTIONAL_PARAMETERS if each.name == "gyro_g_sensitivity"]
    for _ in range(4):
        unit = any_unit(random, latitude_error_arcmin=1.0)  # a rate along Up, far beyond PRIOR
        sensitivities, constant = 0.01 * random.standard_normal((3, 3)), 0.01 * random.standard_normal(3)
        slope, drift = random.standard_normal((2, 3)) * [[0.001], [0.002 / 3600.0]]
        for name, at_c, at_s in zip(POSITIONS, gyro_c, start_s, strict=True):
            follows = sensitivities @ POSITIONS[name].C_nb()[2]
            unit.bias_dph[name] = constant + follows + slope * at_c + drift * at_s
        dwells = [
            dataclasses.replace(each, gyro_c=(at_c,) * 3)
            for each, at_c in zip(measure(unit, random), gyro_c, strict=True)
        ]
        errors = SensorErrors(
            np.zeros(3), unit.gyro_matrix, unit.accelerometer_ug * UG, unit.accelerometer_matrix
        )
        true = [*errors.vector(), *sensitivities.ravel() * DPH / STANDARD_GRAVITY]
        sigmas = np.array([1e-8] * 3 + [2e-6] * 9 + [1e-5] * 3 + [5e-6] * 6 + [1e-9] * 9)
        rotations = CoefficientEstimate(
            true + sigmas * random.standard_normal(30), np.diag(sigmas**2), np.ones(30, bool),
            coefficients=(*COEFFICIENTS, *g_names),
        )  # fmt: skip
        without = CoefficientEstimate(rotations.values[:21], np.diag(sigmas[:21] ** 2), np.ones(21, bool))
        solution = joint_solution_of(dwells, PRIOR)
        for has_sensitivities, estimate in ((True, rotations), (False, without)):
            p_values[has_sensitivities].append(attitude_p_value(solution, PRIOR, start_s, estimate))
    assert max(p_values[False]) < 1e-6
    assert 1e-3 < chi2.sf(chi2.isf(p_values[True], 9).sum(), 36) < 0.999
