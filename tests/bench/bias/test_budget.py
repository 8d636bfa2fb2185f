import math
from dataclasses import replace

import numpy as np
import pytest
from GTC import dof, reporting, uncertainty, ureal

from gyrobench.bench.bias.bias_filter import estimate_state_space
from gyrobench.bench.bias.bins import bin_biases
from gyrobench.bench.bias.budget import (
    BudgetedDwell,
    BudgetInputs,
    CombinedUncertainty,
    Contribution,
    bin_budgets,
    coverage_factor,
    dwell_budgets,
    with_budgets,
)
from gyrobench.bench.bias.error_split import ErrorPart
from gyrobench.bench.bias.parameters import ErrorModel
from gyrobench.bench.foundations.arrays import DPH_TO_RADPS, RAD_TO_ARCMIN
from tests.bench.bias.dwell_rows import dwell_row
from tests.bench.bias.emulated_dwells import emulate, noise_model, sensors, site

NOTHING_DECLARED = BudgetInputs()
MEASURED_DOF = (12.5, 7.0, math.inf, math.inf)


def part(sigma_dph, dof=math.inf):
    """The same error of all gyros by a source with one component."""
    return ErrorPart(np.full((3, 1), sigma_dph * DPH_TO_RADPS), 1.0, dof)


def dwells_of(parts, **rows):
    """Dwells in one position, each with these parts and the uncertainty that they add up to."""
    sigma_dph = math.sqrt(sum(each.columns[0] @ each.columns[0] for each in parts.values())) / DPH_TO_RADPS
    count = len(next(iter(rows.values()))) if rows else 2
    return [
        BudgetedDwell(
            dwell_row(
                number,
                "z_up",
                sigma_dph=sigma_dph,
                **{"gyro_c": 20.5} | {k: v[number] for k, v in rows.items()},
            ),
            parts,
        )
        for number in range(count)
    ]


def budgets(dwells, inputs=NOTHING_DECLARED):
    bins = bin_biases(each.row for each in dwells)
    return [*dwell_budgets(dwells, inputs), *bin_budgets(dwells, bins, inputs)]


def bin_budget(dwells, inputs=NOTHING_DECLARED):
    """That of the x gyro's only bin."""
    [found] = [each.budget for each in budgets(dwells, inputs) if each.dwell is None and each.gyro == "x"]
    return found


def contribution(budget, source):
    [found] = [each for each in budget.contributions if each.source == source]
    return found


def measured(position):
    """Budgets of a simulated dwell whose random walks count as estimated."""
    noise = replace(noise_model(0.0006), dof=MEASURED_DOF)
    found = estimate_state_space(emulate(position, sensors((0.05, 0.0, 0.0))), ErrorModel(site(), noise))
    row = replace(dwell_row(1, position, 20.5), sigma_dph=tuple(found.sigma_dph.tolist()))
    return found, budgets([BudgetedDwell(row, found.parts)])


@pytest.mark.parametrize("position", ["z_up", "y_down"])
def test_gtc_combines_the_contributions_of_a_dwell_alike(position):
    found, all_budgets = measured(position)
    of_dwell = [each for each in all_budgets if each.dwell == 1]
    assert [each.gyro for each in of_dwell] == ["x", "y", "z"]
    for each, sigma_dph in zip(of_dwell, found.sigma_dph, strict=True):
        inputs = [
            (item.sensitivity, ureal(0.0, item.input_sigma, item.dof))
            for item in each.budget.contributions
            if item.is_within and item.sensitivity > 0.0
        ]
        judge = sum(sensitivity * value for sensitivity, value in inputs)
        stated = each.budget.stated
        assert stated.sigma == pytest.approx(uncertainty(judge), rel=1e-6)
        assert stated.sigma == pytest.approx(sigma_dph, rel=1e-6)
        assert stated.dof == pytest.approx(dof(judge), rel=1e-6)
        assert stated.k == pytest.approx(reporting.k_factor(dof(judge)), rel=1e-6)
        assert stated.expanded == pytest.approx(reporting.k_factor(dof(judge)) * uncertainty(judge), rel=1e-6)


def test_only_what_was_estimated_is_of_type_a():
    [of_x, *_] = measured("z_up")[1]
    types = {each.source: each.evaluation for each in of_x.budget.contributions}
    assert types.pop("angle_random_walk") == types.pop("velocity_random_walk") == "A"
    assert set(types.values()) == {"B"}


@pytest.mark.parametrize("free", [1.0, 2.5, 10.0, 300.0, math.inf])
def test_the_coverage_factor_is_that_of_gtc(free):
    judge = reporting.k_factor(free) if free > 1.0 else 12.7062
    assert coverage_factor(free) == pytest.approx(judge, rel=1e-6)


def test_declared_contributions_do_not_limit_the_degrees_of_freedom():
    combined = CombinedUncertainty.of(
        [Contribution("latitude", 1.0, 3.0), Contribution("angle_random_walk", 1.0, 4.0, 8.0)]
    )
    assert combined.sigma == pytest.approx(5.0)
    assert combined.dof == pytest.approx(5.0**4 / (4.0**4 / 8.0))


@pytest.mark.parametrize("count", [1, 2, 5])
def test_noise_averages_out_in_a_bin_and_what_dwells_share_does_not(count):
    dwells = dwells_of({"angle_random_walk": part(3e-3, 10.0), "latitude": part(4e-3)}, cycle=[1] * count)
    found = bin_budget(dwells)
    assert contribution(found, "angle_random_walk").sigma == pytest.approx(3e-3 / math.sqrt(count))
    assert contribution(found, "angle_random_walk").dof == pytest.approx(10.0 * count)
    assert contribution(found, "latitude").sigma == pytest.approx(4e-3)
    [of_x, *_] = with_budgets(bin_biases(each.row for each in dwells), budgets(dwells))
    assert of_x.sigma_dph == pytest.approx(math.hypot(3e-3 / math.sqrt(count), 4e-3))


def test_common_errors_of_opposite_sign_cancel_in_a_bin():
    up, down = dwells_of({"angle_random_walk": part(1e-3), "bias_slope": part(1e-3)})
    down = replace(down, parts={**down.parts, "bias_slope": part(-1e-3)})
    assert contribution(bin_budget([up, down]), "bias_slope").sigma == pytest.approx(0.0, abs=1e-12)


def test_flagged_dwells_have_a_budget_and_are_in_no_bin():
    good, flagged = dwells_of({"angle_random_walk": part(1e-3)})
    flagged = replace(flagged, row=replace(flagged.row, flags=("the table moved",)))
    found = budgets([good, flagged])
    assert [each.dwell for each in found if each.gyro == "x"] == [0, 1, None]
    assert contribution(found[-1].budget, "angle_random_walk").sigma == pytest.approx(1e-3)


def test_a_bias_corrected_for_the_latitude_has_the_budget_of_its_stated_uncertainty():
    [dwell] = dwells_of({"angle_random_walk": part(1e-3), "latitude": part(2e-3)}, cycle=[1])
    for stated_dph, latitude_dph in ((1.25e-3, 0.75e-3), (0.5e-3, 0.0)):
        changed = replace(dwell, row=replace(dwell.row, sigma_dph=(stated_dph,) * 3))
        [of_x, *_] = budgets([changed])
        assert of_x.budget.stated.sigma == pytest.approx(stated_dph)
        latitude = contribution(of_x.budget, "latitude")
        assert latitude.sigma == pytest.approx(latitude_dph)
        assert latitude.input_sigma == pytest.approx(latitude_dph / 2e-3 * RAD_TO_ARCMIN)


def test_only_the_resolution_of_an_output_is_rectangular():
    none = ErrorPart(np.zeros((3, 1)), 0.0)
    [of_x, *_] = budgets(
        dwells_of({"velocity_output": part(1e-3), "heading_output": part(1e-3), "accelerometer_slope": none}),
        BudgetInputs(1.0, 0.5),
    )
    assert contribution(of_x.budget, "accelerometer_slope").distribution == "normal"
    assert "resolution" not in contribution(of_x.budget, "accelerometer_slope").note
    assert contribution(of_x.budget, "velocity_output").distribution == "rectangular"
    assert contribution(of_x.budget, "heading_output").distribution == "normal"


def test_what_was_not_measured_is_not_evaluated_and_in_no_sum():
    [of_x, *_] = budgets(dwells_of({"angle_random_walk": part(1e-3)}))
    for source in ("temperature_sensor", "power_cycles", "accelerometer_settling"):
        assert math.isnan(contribution(of_x.budget, source).sigma)
    assert contribution(of_x.budget, "power_cycles").note.startswith("not evaluated")
    assert contribution(of_x.budget, "temperature_sensor").note.startswith("not evaluated")
    assert of_x.budget.any_power_cycle is None
    assert of_x.budget.stated.sigma == pytest.approx(1e-3)


def test_repeatability_is_the_scatter_between_power_cycles_beyond_noise():
    random, runs, offset_dph, sigma_dph = np.random.default_rng(5), 60, 0.004, 0.001
    offsets = random.normal(0.0, offset_dph, runs)
    names = [f"{run}" for run in range(runs) for _ in range(3)]
    biases = np.repeat(offsets, 3) + random.normal(0.0, sigma_dph, 3 * runs)
    dwells = dwells_of({"angle_random_walk": part(sigma_dph)}, run=names, bias_dph=biases.tolist())
    of_dwell, of_bin = budgets(dwells)[0].budget, bin_budget(dwells)
    found = contribution(of_dwell, "power_cycles")
    assert found.sigma == pytest.approx(offset_dph, rel=0.25)
    assert (found.evaluation, found.dof) == ("A", runs - 1)
    assert contribution(of_bin, "power_cycles").sigma == pytest.approx(found.sigma / math.sqrt(runs))
    assert not found.is_within
    assert of_dwell.any_power_cycle.sigma == pytest.approx(math.hypot(found.sigma, sigma_dph))


def test_errors_that_all_power_cycles_share_are_not_subtracted_from_their_scatter():
    parts = {"angle_random_walk": part(3e-3), "accelerometer_drift": part(9e-3)}
    found = contribution(
        budgets(dwells_of(parts, run=["1", "2", "3"], bias_dph=[0.005, 0.01, 0.015]))[0].budget,
        "power_cycles",
    )
    assert found.sigma == pytest.approx(4e-3)  # the standard deviation of the biases is 5e-3


def test_common_errors_that_differ_between_power_cycles_are_noise_of_their_scatter():
    common = part(1e-3)
    first, second = dwells_of({"bias_slope": common}, run=["1", "2"], bias_dph=[0.0092, 0.0108])
    second = replace(second, parts={"bias_slope": part(-1e-3)})
    assert contribution(budgets([first, second])[0].budget, "power_cycles").sigma == 0.0


def test_power_cycles_on_both_sides_of_a_limit_of_a_bin_are_compared():
    dwells = dwells_of({"angle_random_walk": part(1e-4)}, run=["1", "2"], gyro_c=[24.9, 25.1])
    assert contribution(budgets(dwells)[0].budget, "power_cycles").note.startswith("2 power cycles")


def test_a_temperature_that_differs_between_power_cycles_is_no_repeatability():
    slope_dph_per_c, sigma_dph = 0.002, 1e-4
    gyro_c = [level_c + 0.6 * (-1) ** run for run in range(6) for level_c in (-13.0, 22.0, 57.0)]
    dwells = dwells_of(
        {"angle_random_walk": part(sigma_dph)},
        run=[str(number // 3) for number in range(18)],
        gyro_c=gyro_c,
        bias_dph=[slope_dph_per_c * each for each in gyro_c],
    )
    found = contribution(budgets(dwells)[0].budget, "power_cycles")
    assert found.note.startswith("6 power cycles")
    assert found.sigma < 0.1 * slope_dph_per_c


def test_power_cycles_that_differ_by_no_more_than_noise_are_said_to():
    dwells = dwells_of({"angle_random_walk": part(1e-3)}, run=["1", "2"], bias_dph=[0.01, 0.01])
    found = contribution(budgets(dwells)[0].budget, "power_cycles")
    assert found.sigma == 0.0
    assert found.note == "2 power cycles: no more than the noise"


def test_the_temperature_sensor_counts_by_the_slope_of_the_measured_biases():
    gyro_c = [-20.0, 0.0, 20.0, 40.0]
    dwells = dwells_of(
        {"angle_random_walk": part(1e-3)}, gyro_c=gyro_c, bias_dph=[1e-3 * t + 1e-5 * t**2 for t in gyro_c]
    )
    found = budgets(dwells, BudgetInputs(temperature_c=0.5))
    slopes = [contribution(each.budget, "temperature_sensor").sensitivity for each in found[:12:3]]
    assert slopes == pytest.approx([abs(1e-3 + 2e-5 * t) for t in gyro_c])
    assert found[0].budget.any_power_cycle.sigma == pytest.approx(math.hypot(1e-3, 0.5 * slopes[0]))
    [alone, *_] = budgets(dwells[:1], BudgetInputs(temperature_c=0.5))
    assert math.isnan(contribution(alone.budget, "temperature_sensor").sigma)
