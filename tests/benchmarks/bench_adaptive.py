"""An adaptive campaign from nothing against the fixed profile of Fig. 7, on the same simulated units.

Both begin with a cold unit and end with the chamber at 25 degC. Their hours are those of the planner of the
station emulated, each dwell with its go_to, alignment and turn; a block of the adaptive campaign follows the
one before without a pause. As a script it prints the table of docs/decisions/14-next-measurement.md::

    python -m tests.benchmarks.bench_adaptive
"""

import argparse
import statistics
import tempfile
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from pathlib import Path

import numpy as np
import pytest

from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.documents import parse_document
from gyrobench.bench.investigation.block_procedure import DwellPattern, opening_procedure
from gyrobench.bench.investigation.external_bench import (
    BlockPlan,
    ChamberStep,
    DwellStep,
    PowerStep,
    SoakStep,
    StartState,
)
from gyrobench.bench.investigation.forecast import Forecast
from gyrobench.bench.investigation.investigation import Investigator
from gyrobench.bench.investigation.open_hypotheses import rivals_of, search_campaign
from gyrobench.bench.investigation.profile import Profile
from gyrobench.bench.investigation.proposal import calibration_of
from gyrobench.bench.procedure.steps import Navigate, PowerOn, SetChamber
from tests.bench.closure.plans import shipped, station
from tests.benchmarks.closure_laws import ON_THE_LIST
from tests.benchmarks.investigation_units import SimulatedUnit

SEEDS = range(1000, 1050)
_END_C, _END_C_PER_H = 25.0, 60.0


def block_plan(plan):
    """A plan of a procedure from a cold unit as steps of a bench."""
    steps, now_s = [], 0.0

    def add(kind, end_s, **keys):
        nonlocal now_s
        if end_s > now_s:
            steps.append(kind(start_s=now_s, end_s=end_s, **keys))
            now_s = end_s

    for dwell, members in groupby(plan.steps, key=lambda each: each.dwell):
        if dwell is not None:
            windows = [each for each in members if isinstance(each.step, Navigate)]
            place = windows[0].before
            add(SoakStep, windows[0].start_s)
            add(
                DwellStep, windows[-1].end_s, dwell=dwell, cycle=windows[0].cycle, run="A-1",
                position=place.position, azimuth_deg=place.azimuth_deg,
            )  # fmt: skip
            continue
        for each in members:
            if isinstance(each.step, PowerOn):
                add(PowerStep, each.end_s, on=True, factor=1.0)
            elif isinstance(each.step, SetChamber):
                rate_c_per_h = 60.0 * each.step.ramp_c_per_min
                add(ChamberStep, each.end_s, to_c=each.step.temperature_c, ramp_c_per_h=rate_c_per_h)
            else:
                add(SoakStep, each.end_s)
    state = StartState(
        chamber_c=22.0, gyro_x_c=22.0, gyro_y_c=22.0, gyro_z_c=22.0, powered=False, since_power_on_s=0.0,
        position="z_up",
    )  # fmt: skip
    return BlockPlan(unit="A", start_s=0.0, state=state, next_dwell=1, next_cycle=1, steps=steps)


DOCUMENT, PLAN = shipped("six_position_fig7")
PROFILE = Profile.of(PLAN)
_PATTERN = DwellPattern.of(PLAN)
OPENING = station().plan_document(parse_document(opening_procedure(PROFILE, _PATTERN), Path("opening.yaml")))


def _between_dwells_s():
    """From the end of a dwell to the start of the next one in another position."""
    dwells = block_plan(PLAN).dwells
    return float(np.median([after.start_s - each.end_s for each, after in pairwise(dwells)]))


class UnitBench:
    """A simulated unit on a bench that aligns it before each dwell."""

    def __init__(self, unit):
        self._unit, self.rows, self._pause_s = unit, unit.rows, _between_dwells_s()
        self.campaign_h, self.campaign, self.start = OPENING.duration_s / 3600.0, unit.campaign, unit.start

    def timed(self, block):
        """The block with the time between its dwells."""
        steps, late_s = [], 0.0
        for step in block.plan.steps:
            if step.kind == "dwell":
                begin_s = step.start_s + late_s
                late_s += self._pause_s
                steps.append(SoakStep(start_s=begin_s, end_s=begin_s + self._pause_s))
            moved = {"start_s": step.start_s + late_s, "end_s": step.end_s + late_s}
            steps.append(step.model_copy(update=moved))
        return replace(block, plan=block.plan.model_copy(update={"steps": steps}))

    def measure(self, plan, folder):
        return self._unit.measure(plan)


@dataclass(frozen=True)
class Campaign:
    """What one campaign found of one unit."""

    hours: float
    effects: frozenset  #: Effects that are found; empty for a clean unit.
    verdict: str
    #: Root of the mean variance of the biases of the next pass, deg/h, by all hypotheses together.
    sigma_dph: np.ndarray


def found_by(unit, rows, hours, closure, *, is_settled=False):
    """Outcome of a campaign; ``is_settled``: its blocks confirmed the effects."""
    rivals = rivals_of(closure)
    forecast = Forecast(closure.noise.weighted(rows), closure.noise.scales)
    known = calibration_of(forecast, PROFILE, rivals)
    variance = np.array([each.probability for each in known.rivals]) @ known.variances
    set_c = unit._set_c[-1]
    hours += abs(set_c - _END_C) / _END_C_PER_H
    effects = frozenset(each.effect.name for each in closure.effects)
    verdict = "explained" if is_settled and effects else closure.verdict
    return Campaign(hours, effects, verdict, np.sqrt(variance))


def compared(seed):
    """The fixed and the adaptive campaign of a unit, and its effects."""
    draw = np.random.default_rng([seed, 33])
    count = int(draw.choice([0, 1, 2], p=[0.3, 0.5, 0.2]))
    kinds = draw.choice([*ON_THE_LIST], count, replace=False).tolist()
    sizes = np.exp(draw.uniform(np.log(1.0), np.log(10.0), count)).tolist()
    whole = SimulatedUnit.measured_by(seed, kinds, sizes, block_plan(PLAN))
    own = whole.beginning_with(block_plan(OPENING))
    closure = search_campaign(whole.campaign(whole.rows), [whole.campaign(whole.rows).last_cycle])
    fixed = found_by(whole, whole.rows, whole.rows[-1].end_s / 3600.0, closure)
    with tempfile.TemporaryDirectory() as folder:
        investigator = Investigator(UnitBench(own), Path(folder), 100.0, lambda *_: True, PROFILE)
        found = investigator.run(WallClock())
    is_settled = found.ended == "settled"
    adaptive = found_by(own, found.rows, found.spent_h, found.closure, is_settled=is_settled)
    return kinds, fixed, adaptive, found


def table(found):
    """Lines of a table of both campaigns, and of each unit."""
    yield "| campaign | hours, median | right effects, or none where there is none | stated |"
    yield "|---|---|---|---|"
    for place, name in ((1, "fixed"), (2, "adaptive")):
        own = [each[place] for each in found]
        stated = [each.verdict in ("explained", "clean") for each in own]
        right = [
            is_stated and each.effects == frozenset(kinds)
            for (kinds, *_), each, is_stated in zip(found, own, stated, strict=True)
        ]
        hours = statistics.median(each.hours for each in own)
        yield f"| {name} | {hours:.1f} | {sum(right)} of {len(own)} | {sum(stated)} |"
    same = sum((one.verdict, one.effects) == (other.verdict, other.effects) for _, one, other, _ in found)
    uncertainty = statistics.median(
        float(np.sqrt(np.mean(other.sigma_dph**2) / np.mean(one.sigma_dph**2))) for _, one, other, _ in found
    )
    yield f"Hours over those of the fixed campaign, median: {share_of(found):.2f}"
    yield f"Rms standard uncertainty over that of the fixed campaign, median: {uncertainty:.2f}"
    yield f"Same verdict and effects: {same} of {len(found)}"
    for seed, (kinds, fixed, own, ended) in zip(SEEDS, found, strict=False):
        yield (
            f"{seed} {sorted(kinds)}: {fixed.verdict} {sorted(fixed.effects)} | {own.verdict} "
            f"{sorted(own.effects)} in {own.hours:.1f} h, {ended.ended}, ratio {ended.calibration.ratio:.2f}"
        )


def share_of(found):
    """Median of the hours over those of the fixed campaign."""
    return statistics.median(other.hours / one.hours for _, one, other, _ in found)


@pytest.fixture(scope="module")
def both():
    found = [compared(seed) for seed in SEEDS]
    print("\n" + "\n".join(table(found)))
    return found


@pytest.mark.timeout(7200)
def test_an_adaptive_campaign_leaves_biases_as_certain(both):
    ratios = [np.sqrt(np.mean(own.sigma_dph**2) / np.mean(fixed.sigma_dph**2)) for _, fixed, own, _ in both]
    print(f"rms standard uncertainty over that of the fixed campaign, median: {np.median(ratios):.3f}")
    assert np.median(ratios) <= 1.05


@pytest.mark.timeout(7200)
def test_an_adaptive_campaign_states_the_right_cause_at_least_as_often_as_the_fixed_one(both):
    fixed, own = (
        sum(
            each[place].verdict in ("explained", "clean") and each[place].effects == set(each[0])
            for each in both
        )
        for place in (1, 2)
    )
    assert own >= fixed


def test_an_adaptive_campaign_takes_70_percent_of_the_hours(both):
    assert share_of(both) <= 0.7


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--units", type=int, default=len(SEEDS), help="how many of them")
    print("\n".join(table([compared(seed) for seed in SEEDS[: parser.parse_args().units]])))
