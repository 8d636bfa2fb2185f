"""Accelerometers that drift differently in each dwell, in dwells of an independent strapdown."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.dwells.run_results import evaluate
from gyrobench.bench.navigation.positions import AXES, POSITIONS
from tests.adversarial.harness import ALL, Case, any_unit, measured_dwells, setup_of, true_bias_dph
from tests.adversarial.strapdown import Place

DRIFT_UG_PER_H = 100.0
STATION = {"ins.uncertainty.accelerometer_drift_ug_per_h": DRIFT_UG_PER_H}
CYCLES = 4


def level_errors_of_bins(seed):
    """Errors over standard uncertainties of the level gyros in bins with one dwell of each cycle."""
    random = np.random.default_rng(seed)
    case, dwells = Case(any_unit(random), Place(36.4), station=STATION), []
    for number, (cycle, position) in enumerate(itertools.product(range(1, CYCLES + 1), ALL), 1):
        drift = tuple(random.normal(0.0, DRIFT_UG_PER_H, 3))
        drifting = replace(
            case, unit=replace(case.unit, accelerometer_drift_ug_per_h=drift), positions=(position,)
        )
        [dwell] = measured_dwells(drifting, random)
        dwells.append(replace(dwell, row=replace(dwell.row, dwell=number, cycle=cycle)))
    return [
        (each.bias_dph - true_bias_dph(case)[AXES.index(each.gyro)]) / each.sigma_dph
        for each in evaluate(dwells, setup_of(case), bin_width_c=50.0).bins
        if each.count == CYCLES and AXES[POSITIONS[each.position].up_axis] != each.gyro
    ]


@pytest.mark.parametrize("seeds", [1, pytest.param(3, marks=pytest.mark.long)])
def test_the_drift_averages_out_in_a_bin_as_its_uncertainty_states(seeds):
    errors = [each for seed in range(seeds) for each in level_errors_of_bins(seed)]
    assert len(errors) == seeds * 12
    # 0.5 would be the ratio if the uncertainty took the drift as the same in all four dwells.
    assert 0.67 < np.sqrt(np.mean(np.square(errors))) < 1.35
