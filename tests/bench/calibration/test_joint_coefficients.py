"""Coefficients of six positions from the joint solution of their navigation output."""

import dataclasses

import numpy as np
import pytest

from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.calibration.coefficients import COEFFICIENTS, SensorErrors
from gyrobench.bench.calibration.joint_coefficients import joint_coefficients
from gyrobench.bench.calibration.results import coefficient_rows
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
