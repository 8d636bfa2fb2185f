"""Units that stand out are named, those that don't are not, and the spread is right."""

from datetime import datetime

import numpy as np
import pytest

from gyrobench.bench.fleet.batch import EffectSize, fit_batch, outliers, read_batch
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.runs.index.run_biases import LEVEL, BiasQuantity, RunBias
from gyrobench.bench.runs.index.run_index import RunIndex, Selection, find_runs
from gyrobench.bench.runs.index.store import open_store
from tests.bench.runs.index.sample_runs import copy_run, write_verdict

SPREAD_DPH, BETWEEN_RUNS_DPH = 0.003, 0.001
POSITIONS = ("z_up", "y_up", "x_up")


def batch(rng, units=10, names=(LEVEL,), outlier=("", "", 0.0), spread_dph=SPREAD_DPH):
    """Simulated units with one to five runs each, whose noise differs from unit to unit threefold."""
    runs = rng.integers(1, 6, units)
    sigmas = rng.uniform(0.0005, 0.0015, units)
    values = {}
    for gyro in "xyz":
        for name in names:
            own = rng.normal(0.0, spread_dph, units)
            own[0] += outlier[2] if (gyro, name) == outlier[:2] else 0.0
            values[BiasQuantity(gyro, 20.0, 25.0, name, POSITIONS)] = [
                RunBias(
                    f"{unit}",
                    datetime(2026, 1, 1),
                    0.004 + own[unit] + rng.normal(0.0, np.hypot(BETWEEN_RUNS_DPH, sigmas[unit])),
                    sigmas[unit],
                )
                for unit in range(units)
                for _ in range(runs[unit])
            ]
    return values


@pytest.mark.long
@pytest.mark.parametrize("units", [5, 10])
def test_without_outlier_a_unit_stands_out_no_oftener_than_stated(units):
    rng = np.random.default_rng(1)
    alarms = sum(bool(outliers(fit_batch(batch(rng, units)))) for _ in range(60))
    assert alarms <= 4  # 1 % is stated; more than 4 of 60 has a chance of 0.0004


@pytest.mark.parametrize("count", [10, pytest.param(30, marks=pytest.mark.long)])
def test_an_outlier_is_named_with_its_gyro(count):
    rng = np.random.default_rng(2)
    found = 0
    for _ in range(count):
        out = outliers(fit_batch(batch(rng, outlier=("y", LEVEL, 0.02))))
        found += {(unit.unit, stats.quantity.gyro) for stats, unit in out} == {("0", "y")}
    assert found >= 0.8 * count


def test_a_difference_between_positions_is_named_with_its_position():
    values = batch(np.random.default_rng(3), names=(LEVEL, *POSITIONS), outlier=("z", "x_up", 0.03))
    (stats, unit), *more = outliers(fit_batch(values))
    assert (unit.unit, stats.quantity.label) == ("0", "Z gyro at 20 to 25 °C, X-Up minus the mean")
    assert not more


def test_the_spread_of_units_and_runs_is_recovered_within_its_uncertainty():
    rng = np.random.default_rng(4)
    fitted = [stats for _ in range(20) for stats in fit_batch(batch(rng))]
    held = np.mean([stats.between_units.low <= SPREAD_DPH <= stats.between_units.high for stats in fitted])
    assert held >= 0.85
    assert np.median([stats.between_units.value for stats in fitted]) == pytest.approx(SPREAD_DPH, rel=0.15)
    assert np.median([stats.between_runs_dph for stats in fitted]) == pytest.approx(
        BETWEEN_RUNS_DPH, rel=0.25
    )


def test_a_unit_that_its_runs_show_badly_is_drawn_to_the_batch():
    values = batch(np.random.default_rng(5))
    quantity, runs = next(iter(values.items()))
    values[quantity] = [*runs, RunBias("noisy", datetime(2026, 1, 1), 0.014, 0.01)]
    stats = next(each for each in fit_batch(values) if each.quantity == quantity)
    units = {unit.unit: unit for unit in stats.units}
    assert abs(units["noisy"].shrunken_dph - stats.mean_dph) < 0.2 * abs(0.014 - stats.mean_dph)
    assert units["noisy"].shrunken_sigma_dph < units["noisy"].sigma_dph
    best = min(stats.units, key=lambda unit: unit.sigma_dph)
    assert best.shrunken_dph == pytest.approx(best.bias_dph, abs=0.0005)


def test_without_repeated_runs_there_is_no_scatter_between_them_to_show():
    values = {
        key: list({run.unit: run for run in runs}.values())
        for key, runs in batch(np.random.default_rng(6)).items()
    }
    assert all(stats.between_runs_dph is None for stats in fit_batch(values))


def test_the_size_of_an_effect_that_one_unit_alone_has_stands_out():
    sizes = [0.0] * 9 + [0.005]
    runs = [RunBias(f"{number}", datetime(2026, 1, 1), size, 0.0003) for number, size in enumerate(sizes)]
    ((stats, unit),) = outliers(fit_batch({EffectSize("thermal_lag"): runs}))
    assert (unit.unit, stats.quantity.label) == ("9", "effect thermal lag")


def test_too_few_units_are_no_batch():
    with pytest.raises(MeasurementError, match="at least 4 units"):
        fit_batch(batch(np.random.default_rng(7), units=3))


def test_effects_count_as_absent_only_where_a_search_could_show(sample, tmp_path):
    verdicts = {
        "a": ("explained", [("thermal_lag", 0.004)]),
        "b": ("clean", []),
        "c": ("unexplained", [("thermal_lag", 0.002)]),
    }
    for name, (verdict, effects) in verdicts.items():
        write_verdict(copy_run(sample, tmp_path / name, unit=name), verdict, effects)
    compensated = copy_run(sample, tmp_path / "d", unit="d")
    compensated.compensation.write_text("{}")
    index = RunIndex(open_store(str(tmp_path)))
    index.update()
    values = read_batch(index, find_runs(index, Selection()))
    sizes = {run.unit: run.bias_dph for run in values.pop(EffectSize("thermal_lag"))}
    assert sizes == {"a": 0.004, "b": 0.0}
    assert all({run.unit for run in runs} == {"a", "b", "c"} for runs in values.values())
