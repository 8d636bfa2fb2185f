"""A campaign in place of a procedure: until its biases are as certain, and the cause is settled."""

from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.investigation.blocks import Timeline
from gyrobench.bench.investigation.choice import Rival
from gyrobench.bench.investigation.forecast import Forecast
from gyrobench.bench.investigation.investigation import Investigator
from gyrobench.bench.investigation.profile import Profile
from gyrobench.bench.investigation.proposal import calibration_of
from gyrobench.bench.runs.journal import read_journal
from tests.bench.closure.plans import dwell, planned, shipped
from tests.benchmarks.bench_adaptive import OPENING, PLAN, PROFILE, UnitBench, block_plan
from tests.benchmarks.investigation_units import SimulatedUnit

DECLARED = (Rival((), (), 1.0),)


@pytest.fixture(scope="module")
def unit():
    """A unit without an undeclared effect, after the first dwells of an adaptive campaign."""
    whole = SimulatedUnit.measured_by(1000, [], [], block_plan(PLAN))
    return whole.beginning_with(block_plan(OPENING))


def test_the_profile_of_a_plan_has_its_temperatures_positions_and_hours():
    assert PROFILE.set_points_c == [62.0, 46.7, 20.5, -9.5, -36.0]
    assert PROFILE.positions == ["z_up", "z_down", "y_up", "y_down", "x_up", "x_down"]
    assert [each.set_c for each in PROFILE.visits] == [62, 20.5, -36, -9.5, 46.7, 62, 46.7, -9.5, -36, 20.5]
    assert PROFILE.duration_h == pytest.approx(PLAN.duration_s / 3600.0)
    assert PROFILE.ramp_c_per_h == pytest.approx(120.0)


def test_a_procedure_without_temperatures_has_no_profile():
    _, plan = planned("  - power_on\n" + dwell("z_up"))
    with pytest.raises(DocumentError, match="fewer than two temperatures"):
        Profile.of(plan)


@pytest.mark.parametrize(
    ("procedure", "station"), [("six_position_fig7", "emulated"), ("quick_campaign", "quick")]
)
def test_the_first_dwells_are_at_the_extremes_and_in_the_middle_in_two_cycles(procedure, station):
    profile = Profile.of(shipped(procedure, station)[1])
    first, second = profile.opening
    assert {min(profile.set_points_c), max(profile.set_points_c)} < set(first) < {*profile.set_points_c, None}
    assert second == (min(profile.set_points_c),)


def test_biases_are_as_certain_as_by_the_procedure_once_it_was_measured(unit):
    before = calibration_of(Forecast(unit.rows), PROFILE, DECLARED)
    assert before.ratio > 1.5
    assert 0.0 < before.missing_h(before.variances) < PROFILE.duration_h
    assert before.missing_h(before.reference) == 0.0
    whole = Forecast(unit.rows).rows(PROFILE.whole_plan(unit.rows, None))
    measured = [replace(row, sigma_dph=unit.rows[0].sigma_dph) for row in whole]
    after = calibration_of(Forecast([*unit.rows, *measured]), PROFILE, DECLARED)
    assert after.ratio < 1.0


def test_longer_dwells_replace_more_hours_of_the_procedure(unit):
    timeline = Timeline(unit.rows)
    kinds = {each.name: each for each in PROFILE.kinds()}
    assert len(kinds) == 2 * len(PROFILE.set_points_c)
    kinds["long dwells at 62 degC"].add(timeline)
    lengths_s = {step.end_s - step.start_s for step in timeline.plan().dwells}
    assert [*lengths_s] == pytest.approx([2.0 * timeline.dwell_s])


@pytest.mark.long
def test_an_adaptive_campaign_ends_with_certain_biases_before_the_procedure_would(unit, tmp_path):
    found = Investigator(UnitBench(unit), tmp_path, 100.0, lambda *_: True, PROFILE).run(WallClock())
    assert found.ended == "nothing_found"
    assert found.calibration.ratio <= 1.0
    assert found.stages[0].spent_h == pytest.approx(OPENING.duration_s / 3600.0)
    assert found.spent_h < 0.7 * PROFILE.duration_h == 0.7 * found.repeated_campaign_h
    assert (found.stages[0].purpose, found.test) == ("calibrate", None)
    ratios = [
        each["uncertainty_ratio"]
        for each in read_journal(tmp_path / "journal.jsonl")
        if each["event"] == "searched"
    ]
    assert np.argmin(ratios) == len(ratios) - 1
