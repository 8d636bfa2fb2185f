"""What effects look like in the dwells of a campaign."""

import numpy as np
import pytest

from gyrobench.bench.closure.effects.effect import Effect, Form, Parameter, fixed
from gyrobench.bench.closure.planned_campaign import UnitProperties, planned_campaign
from gyrobench.bench.closure.problem import declared_columns, declared_problem
from gyrobench.bench.closure.separability import alternative_fits, assumed_effects, basis_of, unit_components
from tests.bench.closure.plans import shipped


@pytest.fixture(scope="module")
def problem():
    _, plan = shipped("three_temperature_shift")
    campaign = planned_campaign(plan, UnitProperties())
    return declared_problem(campaign, campaign.all_dwells)


def decaying(campaign, values):
    hours = (campaign.start_s - campaign.start_s[0]) / 3600.0
    return np.repeat(np.exp(-hours / values[0])[:, None, None], 3, axis=1)


DECAY = Effect(
    "decay", "", "", (Form(("decay",), decaying, (Parameter("h", 0.1, 10.0, fixed(4.0, 1.0, 2.0)),)),)
)


def test_the_middle_value_comes_first_and_all_others_after_it(problem):
    shapes = assumed_effects(problem, DECAY)
    assert len(shapes) == 1 + 3
    np.testing.assert_allclose(shapes[0].components, shapes[2].components)


def test_nothing_of_a_shape_lies_along_the_declared_model(problem):
    campaign = problem.campaign
    for shape in assumed_effects(problem, DECAY):
        for gyro in range(3):
            declared = declared_columns(campaign, gyro) / campaign.sigma_dph[:, gyro, np.newaxis]
            declared /= np.linalg.norm(declared, axis=0)
            np.testing.assert_allclose(
                declared.T @ shape.components[gyro], 0.0, atol=1e-6 * np.abs(shape.components).max()
            )


def test_an_alternative_is_fitted_at_parameters_between_its_bounds(problem):
    fits = alternative_fits(problem, DECAY)
    assert len(fits) >= 80
    assert all(fit.parameter_count == 3 + 1 for fit in fits)
    shape = assumed_effects(problem, DECAY)[0]
    assert max(shape.explained_by(fit.basis) for fit in fits) == pytest.approx(shape.information)


def test_an_effect_with_a_missing_input_has_no_shape(problem):
    blind = Effect("blind", "", "", (Form(("x",), decaying, missing_input=lambda campaign: "a sensor"),))
    assert assumed_effects(problem, blind) == alternative_fits(problem, blind) == []


def test_directions_are_orthonormal_and_no_more_than_there_are():
    columns = np.random.default_rng(5).normal(size=(3, 12, 4))
    columns[:, :, 3] = 2.0 * columns[:, :, 0]
    basis = basis_of(columns)
    for gyro in range(3):
        np.testing.assert_allclose(basis[gyro].T @ basis[gyro], np.diag([1.0, 1.0, 1.0, 0.0]), atol=1e-12)
        np.testing.assert_allclose(basis[gyro] @ (basis[gyro].T @ columns[gyro]), columns[gyro], atol=1e-12)


def test_parts_of_an_effect_are_one_rms_with_any_signs():
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(20, 3, 4)) * [1.0, 10.0, 0.1, 1.0] + 5.0
    columns[:, :, 3] = columns[:, :, 0]  # says nothing new
    parts = unit_components(columns)
    assert parts.shape == (20, 3, 3)
    for signs in np.array([[1, 1, 1], [1, -1, 1], [-1, -1, 1]]):
        assert np.sqrt(np.mean((parts @ signs) ** 2)) == pytest.approx(1.0)
    np.testing.assert_allclose(parts.mean(axis=0), 0.0, atol=1e-12)
