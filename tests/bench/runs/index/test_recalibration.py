"""Dates of recalibration, on simulated fleets with known drift."""

from datetime import datetime, timedelta

import numpy as np
import pytest

from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.runs.index.recalibration import MAX_MONTHS, MONTH_DAYS, recalibration
from gyrobench.bench.runs.index.run_biases import RunBias

LIMIT_DPH, SIGMA_DPH, SCATTER_DPH = 0.01, 0.0005, 0.0008
KINDS = {
    "eight units of six runs": {"units": 8, "runs": 6},
    "a unit alone": {"units": 1, "runs": 6},
    "siblings of two runs": {"units": 8, "runs": 2},
    "with a random walk": {"units": 8, "runs": 6, "walk": 0.0003},
}


def runs_of(unit, months, biases):
    start = datetime(2026, 1, 1)
    return [
        RunBias(unit, start + timedelta(days=MONTH_DAYS * month), float(bias), SIGMA_DPH)
        for month, bias in zip(months, biases, strict=True)
    ]


def fleet(rng, units, runs, drift=0.0003, spread=0.0003, walk=0.0):
    """Runs of each unit, and the true bias of the first as a function of the months since its last run."""
    found = {}
    for number in reversed(range(units)):
        bias, slope = rng.normal(0.0, 0.003), rng.normal(drift, spread)
        months = np.cumsum(np.r_[0.0, rng.uniform(1.0, 3.0, runs - 1)])
        grid = np.arange(0.0, 200.0, 0.25)
        walked = np.cumsum(rng.normal(0.0, walk * 0.5, len(grid)))

        def true(month, bias=bias, slope=slope, grid=grid, walked=walked):
            return bias + slope * month + np.interp(month, grid, walked)

        noise = rng.normal(0.0, np.hypot(SCATTER_DPH, SIGMA_DPH), runs)
        found[str(number)] = runs_of(str(number), months, true(months) + noise)
    return found, lambda later: true(months[-1] + later)


def share_that_holds(rng, count, **kind):
    """Share of dates on which the bias of a run is still within the limit, and their number."""
    holds = []
    while len(holds) < count:
        runs, true = fleet(rng, **kind)
        due = recalibration(runs, "0", LIMIT_DPH)
        if due.due is not None and due.months > 0.0:
            holds.append(abs(true(due.months) + rng.normal(0.0, SCATTER_DPH)) <= LIMIT_DPH)
    return float(np.mean(holds))


@pytest.mark.parametrize(
    ("kind", "count"),
    [
        *(pytest.param(each, 8, id=name) for name, each in KINDS.items()),
        *(pytest.param(each, 25, id=f"{name}, 25", marks=pytest.mark.long) for name, each in KINDS.items()),
    ],
)
def test_dates_hold(kind, count):
    # Of 25 at 95 %: p = 0.007 for 20 or fewer; of 8 p = 0.006 for 5 or fewer.
    assert share_that_holds(np.random.default_rng(1), count, **kind) >= (0.84 if count == 25 else 0.75)


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_at_least_95_percent_of_many_dates_hold(kind):
    assert share_that_holds(np.random.default_rng(2), 200, **kind) >= 0.95


def test_siblings_give_a_unit_with_two_runs_a_later_date():
    rng = np.random.default_rng(3)
    months = np.arange(0.0, 12.0, 2.0)
    siblings = {
        str(number): runs_of(str(number), months, rng.normal(0.0, SIGMA_DPH, len(months)))
        for number in range(1, 9)
    }
    own = {"0": runs_of("0", [0.0, 1.0], [0.0, 0.0004])}
    alone = recalibration(own | {"1": siblings["1"][:2]}, "0", LIMIT_DPH)
    among = recalibration(own | siblings, "0", LIMIT_DPH)
    assert (alone.siblings, among.siblings) == (1, 8)
    assert among.months > 2.0 * alone.months
    assert among.drift_sigma_dph_per_month < alone.drift_sigma_dph_per_month


def test_the_drift_is_recovered():
    months = np.arange(0.0, 24.0, 2.0)
    rng = np.random.default_rng(4)
    runs = {"0": runs_of("0", months, 0.0004 * months + rng.normal(0.0, SIGMA_DPH, len(months)))}
    due = recalibration(runs, "0", 0.02)
    assert due.drift_dph_per_month == pytest.approx(0.0004, abs=3.0 * due.drift_sigma_dph_per_month)
    assert 12.0 < due.months < 28.0  # the line alone takes 28 months from 22 to 50


def test_a_bias_beyond_its_limit_is_due_now_and_a_steady_one_far_from_it_has_no_date():
    months = np.arange(0.0, 40.0, 1.0)
    rng = np.random.default_rng(5)
    over = recalibration({"0": runs_of("0", months, 0.02 + 0.0 * months)}, "0", LIMIT_DPH)
    assert over.months == 0.0
    steady = runs_of("0", months, rng.normal(0.0, SIGMA_DPH, len(months)))
    far = recalibration({"0": steady}, "0", 1.0)
    assert far.due is None
    assert far.months == MAX_MONTHS


def test_too_few_runs_give_no_date():
    with pytest.raises(MeasurementError, match="2 runs of 1 units do not show how its bias changes"):
        recalibration({"0": runs_of("0", [0.0, 1.0], [0.0, 0.0])}, "0", LIMIT_DPH)
    with pytest.raises(MeasurementError, match="unit 7: no run measured this bias"):
        recalibration({"0": runs_of("0", [0.0, 1.0], [0.0, 0.0])}, "7", LIMIT_DPH)
