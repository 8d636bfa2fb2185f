import json
import sys
from dataclasses import replace
from types import SimpleNamespace

import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.outcome import CandidateResult
from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.investigation import investigation, open_hypotheses
from gyrobench.bench.investigation.external_bench import AfterLastDwell, ExternalBench
from gyrobench.bench.investigation.forecast import Forecast
from gyrobench.bench.investigation.investigation import Investigator
from gyrobench.bench.investigation.open_hypotheses import (
    is_settled,
    only_unconfirmed,
    rivals_of,
    search_campaign,
)
from gyrobench.bench.investigation.proposal import outcome_of
from gyrobench.bench.report import investigation_page
from gyrobench.bench.runs.journal import read_journal
from tests.bench.investigation import simulated_bench
from tests.bench.investigation.search_once import search_once
from tests.bench.investigation.simulated_bench import first_campaign, simulate
from tests.benchmarks.bench_investigation import unit_of
from tests.benchmarks.investigation_units import SimulatedUnit


def unit_with(effects, seed=2, refuses=("factor",)):
    steps = first_campaign([45.0, 10.0, -20.0])
    return {"unit": "S1", "seed": seed, "effects": effects, "refuses": list(refuses), "steps": steps}


def investigator(unit, folder, budget_h=60.0, approve=lambda proposal, rivals: True, before=""):
    path = folder.parent / f"{folder.name}.json"
    if not path.exists():
        path.write_text(json.dumps(unit))
    bench = ExternalBench(f"{before}{sys.executable} {simulated_bench.__file__} {path}", simulate(unit))
    return Investigator(bench, folder, budget_h, approve)


@pytest.fixture(scope="module")
def search():
    return search_once()


@pytest.fixture
def searched_once(search, monkeypatch):
    monkeypatch.setattr(investigation, "search_campaign", search)


@pytest.fixture(scope="module")
def settled(search, tmp_path_factory):
    """A warm-up that the first table can't distinguish from a drift, settled."""
    folder = tmp_path_factory.mktemp("investigation") / "whole"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(investigation, "search_campaign", search)
        return investigator(unit_with({"warm_up": 0.02}), folder).run(WallClock()), folder


def test_a_tie_is_settled_in_favour_of_what_is_there_in_a_quarter_of_a_campaign(settled):
    found, _ = settled
    assert found.stages[0].closure.posterior.hypotheses[0].probability < 0.99
    assert found.ended == "settled"
    assert found.closure.posterior.hypotheses[0].names == {"warm_up"}
    at_end = next(each for each in found.stages if each.closure.probability >= 0.99)
    assert at_end.spent_h <= 0.25 * found.repeated_campaign_h
    first, *_ = investigation_page.closing_sentences(found)
    share = f"{100.0 * found.spent_h / found.repeated_campaign_h:.0f} % of a repeat of the first table"
    assert f"On the bench: first table {found.repeated_campaign_h:.1f} h, " in first
    assert first.endswith(f"{len(found.stages) - 1} blocks {found.spent_h:.1f} h ({share}).")


def test_a_settled_cause_is_confirmed_by_a_block_that_was_predicted(settled):
    found, folder = settled
    assert found.test.purpose == "confirm"
    after, before = found.test.outcome.error_dph
    assert after < 2.0 * found.test.outcome.noise_dph < before
    events = [entry["event"] for entry in read_journal(folder / "journal.jsonl")]
    measured = [place for place, event in enumerate(events) if event == "measured"]
    assert len(measured) == len(found.stages) - 1
    assert all("proposed" in events[:place] for place in measured)
    assert events[-1] == "investigation_ended"


def test_predictions_stand_in_the_journal_before_the_block_is_measured(settled):
    found, folder = settled
    first = next(entry for entry in read_journal(folder / "journal.jsonl") if entry["event"] == "proposed")
    assert first["block"] == found.stages[0].proposal.block.name
    assert {each["hypothesis"] for each in first["predictions"]} == {
        each.title for each in found.stages[0].rivals
    }
    assert len(first["predictions"][0]["bias_x_dph"]) == len(first["dwells"])


def test_a_block_is_said_to_agree_only_where_it_does_and_with_the_cause_that_is_stated(settled):
    found, _ = settled
    assert "agrees with the effect found" in investigation_page.test_sentence(found)

    def sentence(closure=found.closure, **changes):
        tested = replace(found.test, outcome=replace(found.test.outcome, **changes))
        last = replace(found.stages[-1], closure=closure)
        return investigation_page.test_sentence(replace(found, stages=(*found.stages[:-2], tested, last)))

    assert "leaves open the effect found" in sentence(probabilities=(0.7, 0.3))
    assert "contradicts the effect found" in sentence(probabilities=(0.001, 0.999))
    assert "fits neither the declared model nor the effect found" in sentence(p_value=(1e-9, 1e-12))
    given_up = replace(found.closure, effects=())
    assert "agrees with warm-up, which is not stated by the last search" in sentence(given_up)


def test_a_block_far_from_its_forecast_is_named_at_the_end(settled):
    found, _ = settled
    assert investigation_page.forecast_sentence(found) == ""
    stage = found.stages[0]
    cold = [replace(row, gyro_c=(-60.0, -60.0, -60.0)) for row in stage.proposal.rows]
    forecast = Forecast(found.rows[: -sum(len(each.proposal.rows) for each in found.stages[:-1])])
    outcome = outcome_of(forecast, stage.proposal, cold, stage.rivals)
    assert outcome.off_forecast_k > 10.0
    idle = replace(found, stages=(replace(stage, outcome=outcome), *found.stages[1:]))
    assert "of block 1 differ by up to" in investigation_page.forecast_sentence(idle)


@pytest.mark.long
@pytest.mark.parametrize("fails_at", [1, 2])
def test_an_investigation_that_was_killed_decides_the_same_again(settled, tmp_path, fails_at):
    unit, folder = unit_with({"warm_up": 0.02}), tmp_path / "killed"
    calls = []

    def approve(proposal, rivals):
        calls.append(proposal.block.name)
        if len(calls) == fails_at:
            raise KeyboardInterrupt
        return True

    with pytest.raises(KeyboardInterrupt):
        investigator(unit, folder, approve=approve).run(WallClock())
    again = investigator(unit, folder).run(WallClock())
    whole, _ = settled
    assert [each.proposal and each.proposal.block.name for each in again.stages] == [
        each.proposal and each.proposal.block.name for each in whole.stages
    ]
    assert repr(again.rows) == repr(whole.rows)  # NaN does not equal itself


@pytest.mark.long
def test_a_block_that_the_bench_refuses_is_replaced_by_another(tmp_path):
    unit = unit_with({"warm_up": 0.02}, refuses=("factor", "chamber"))
    found = investigator(unit, tmp_path / "refusing", budget_h=20.0).run(WallClock())
    assert found.refused
    assert all(
        step.kind != "chamber"
        for stage in found.stages
        if stage.proposal
        for step in stage.proposal.block.plan.steps
    )


def test_nothing_is_measured_for_a_unit_without_an_effect(tmp_path):
    found = investigator(unit_with({}, seed=5), tmp_path / "clean").run(WallClock())
    assert (found.ended, found.spent_h, found.test) == ("nothing_found", 0.0, None)
    assert found.closure.posterior.no_effect_probability < 0.99
    assert "above 0.5 but below 0.99" in found.reason
    assert found.closure.verdict == "clean"
    first, *_ = investigation_page.closing_sentences(found)
    assert first.endswith(f"On the bench: first table {found.repeated_campaign_h:.1f} h.")


@pytest.mark.long
def test_no_block_is_longer_than_what_is_left_of_the_budget(tmp_path):
    found = investigator(unit_with({"warm_up": 0.02}), tmp_path / "short", budget_h=1.5).run(WallClock())
    assert found.spent_h <= 1.6
    assert found.ended in ("budget", "no_block", "settled")


def test_a_bench_that_refuses_all_is_asked_once_for_each_kind(searched_once, tmp_path):
    unit, asked = unit_with({"warm_up": 0.02}), []

    def approve(proposal, rivals):
        asked.append(proposal.block.kinds)
        return True

    refusing = f"{sys.executable} -c 'raise SystemExit(3)' "
    found = investigator(unit, tmp_path / "all", 3.0, approve, refusing).run(WallClock())
    assert found.ended == "no_block"
    assert found.reason.startswith(f"The bench refused {', then '.join(asked[0])} (no reason was given)")
    assert "; warm-up: reach the same" in found.reason
    assert asked
    assert len(asked) == len(set(asked))


def test_a_settled_cause_whose_test_is_declined_says_that_no_block_tested_it(searched_once, tmp_path):
    def approve(proposal, rivals):
        return len({each.probability for each in rivals}) > 1

    found = investigator(unit_with({"warm_up": 0.02}), tmp_path / "test", approve=approve).run(WallClock())
    assert found.ended == "settled"
    assert found.reason.endswith("No further block tested it. The proposed block was declined.")


def test_measured_blocks_are_taken_from_the_folder_with_any_budget(searched_once, settled):
    whole, folder = settled

    def approve(proposal, rivals):
        raise AssertionError

    again = investigator(unit_with({"warm_up": 0.02}), folder, 0.5, approve).run(WallClock())
    assert repr(again.rows) == repr(whole.rows)  # NaN does not equal itself
    assert again.ended == "settled"


def test_the_folder_of_another_table_is_refused(settled):
    _, folder = settled
    rows = simulate(unit_with({}, seed=9))
    with pytest.raises(RunFolderError, match="another table"):
        Investigator(ExternalBench("x", rows), folder, 1.0, lambda *_: True)


@pytest.mark.long
def test_a_bench_that_fails_leaves_what_was_measured(tmp_path):
    unit, folder = unit_with({"warm_up": 0.02}), tmp_path / "failing"
    found = investigator(unit, folder, before=f"{sys.executable} -c 'import_error' ").run(WallClock())
    assert found.ended == "bench_failed"
    assert "exit code 1" in found.reason
    assert (folder / "dwells.csv").exists()
    assert investigator(unit, folder).run(WallClock()).ended == "settled"


class UnitBench(AfterLastDwell):
    """A unit that measures in this process; its dwells have flags."""

    def __init__(self, unit, *flags):
        self.unit, self.flags, self.rows = unit, flags, simulate(unit)

    def measure(self, plan, folder):
        self.unit["steps"] = self.unit["steps"] + [step.model_dump() for step in plan.steps]
        return [replace(row, flags=self.flags) for row in simulate(self.unit) if row.dwell >= plan.next_dwell]


@pytest.mark.long
@pytest.mark.parametrize(
    ("law", "verdict", "probability"),
    [("resonance", "confirms", 1.0), ("moved_resonance", "fits neither the declared model nor", 0.0)],
)
def test_a_law_composed_for_what_is_on_no_list_is_tested_by_a_new_cycle(tmp_path, law, verdict, probability):
    steps = first_campaign([45.0, 30.0, 10.0, -20.0], cycles=3)
    unit = {"unit": "S1", "seed": 2, "effects": {"resonance": 0.03}, "steps": steps}
    bench = UnitBench(unit)
    bench.unit = unit | {"effects": {law: 0.03}}
    found = Investigator(bench, tmp_path / law, 60.0, lambda *_: True).run(WallClock())
    assert found.ended == "not_on_list"
    assert (found.test.purpose, found.test.proposal.block.name) == ("test_law", "new cycle")
    assert found.test.rivals[0].names == ("composed_board_c_resonance",)
    assert found.test.outcome.probabilities[0] == pytest.approx(probability, abs=1e-6)
    assert (
        f"{verdict} the composed law (the bias follows the electronics"
        in investigation_page.test_sentence(found)
    )
    events = [entry["event"] for entry in read_journal(tmp_path / law / "journal.jsonl")]
    assert events.index("proposed") < events.index("measured")
    assert events.count("measured") == 1


def test_a_block_that_brings_flagged_dwells_alone_is_not_repeated_for_ever_and_may_be_declined(
    searched_once, tmp_path
):
    proposed, unit = [], unit_with({"warm_up": 0.02})

    def approve(proposal, rivals):
        proposed.append(proposal.block.kinds)
        return len(proposed) < 5

    found = Investigator(UnitBench(dict(unit), "moved"), tmp_path / "flags", 60.0, approve)
    found = found.run(WallClock())
    assert found.ended == "declined"
    assert max(map(proposed.count, proposed)) == 2
    assert all(stage.outcome is None for stage in found.stages)
    assert found.spent_h > 0.0


@pytest.mark.long
def test_a_cause_that_held_out_dwells_leave_open_is_tested_by_a_block_and_searched_again(tmp_path):
    """An ageing from the power-on is found as a warm-up, and the held-out dwells do not confirm that."""
    found = Investigator(unit_of(642), tmp_path / "ageing", 75.0, lambda *_: True).run(WallClock())
    first = found.stages[0]
    assert (first.closure.verdict, first.purpose) == ("ambiguous", "confirm")
    assert first.rivals[0].names == ("warm_up",)
    assert found.ended == "settled"
    assert [each.effect.name for each in found.closure.effects] == ["ageing"]


@pytest.mark.long
def test_an_effect_that_the_law_of_another_may_lack_is_tested_by_a_power_cycle(tmp_path):
    """In one power cycle an ageing at several time constants does what an ageing and a warm-up do."""
    found = Investigator(unit_of(757), tmp_path / "lack", 75.0, lambda *_: True).run(WallClock())
    first = found.stages[0]
    assert [each.effect.name for each in first.closure.effects] == ["ageing"]
    assert first.purpose == "confirm"
    assert [each.names for each in first.rivals] == [("ageing", "warm_up"), ("ageing",)]
    assert first.proposal.block.kinds == ("power cycle",)
    assert found.ended == "settled"
    assert {each.effect.name for each in found.closure.effects} == {"ageing", "warm_up"}


@pytest.fixture(scope="module")
def shown_by_one_dwell(tmp_path_factory):
    """An investigation of a hysteresis; a single dwell shows a jump of the bias as well."""
    folder = tmp_path_factory.mktemp("dwell") / "investigation"
    return Investigator(unit_of(67), folder, 75.0, lambda *_: True).run(WallClock())


@pytest.mark.long
def test_an_effect_that_a_single_dwell_shows_keeps_a_cause_open_while_blocks_distinguish_it(
    shown_by_one_dwell,
):
    """Which blocks are measured, and whether one can distinguish, is decided by last digits of the search."""
    found = ["thermal_hysteresis"]
    shown = [
        each
        for each in shown_by_one_dwell.stages
        if each.closure.posterior.rivals(found).get("bias_jump", 0.0) > 0.9
    ]
    assert shown
    for each in shown:
        assert [one.effect.name for one in each.closure.effects] == found
        can_distinguish = len(rivals_of(each.closure)) > 1
        is_end = each is shown_by_one_dwell.stages[-1]
        assert each.purpose == ("distinguish" if can_distinguish or is_end else "confirm")
    assert [each.purpose for each in shown_by_one_dwell.stages].count("confirm") == 1


@pytest.mark.long
def test_a_large_hysteresis_is_settled_by_itself(shown_by_one_dwell):
    assert shown_by_one_dwell.ended == "settled"
    assert [each.effect.name for each in shown_by_one_dwell.closure.effects] == ["thermal_hysteresis"]


@pytest.mark.parametrize(
    ("rejected", "rival", "probability", "not_on_list", "share", "without"),
    [
        ("it rests on dwell 1 alone (p = 1 without it)", 0.9, 0.999, 0.0, 1.0, True),
        ("not significant beside warm-up", 0.9, 0.999, 0.0, 1.0, False),
        ("not significant beside warm-up", 0.4, 0.999, 0.0, 1.0, True),
        ("warm-up alone is about as probable and simpler", 0.4, 0.999, 0.0, 1.0, False),
        ("it rests on dwell 1 alone (p = 1 without it)", 0.9, 0.98, 0.0, 1.0, False),
        ("it rests on dwell 1 alone (p = 1 without it)", 0.9, 0.999, 0.09, 1.0, True),
        ("it rests on dwell 1 alone (p = 1 without it)", 0.9, 0.999, 0.11, 1.0, False),
        ("it rests on dwell 1 alone (p = 1 without it)", 0.9, 0.999, 0.11, 0.2, True),
    ],
)
def test_a_cause_is_open_for_lack_of_confirmation_alone_if_nothing_else_remains(
    rejected, rival, probability, not_on_list, share, without, monkeypatch
):
    monkeypatch.setattr(open_hypotheses, "remainder_share", lambda closure: share)
    effects = [SimpleNamespace(effect=SimpleNamespace(name="warm_up"))]
    other = CandidateResult(SimpleNamespace(name="bias_jump"), rejected=rejected)
    posterior = SimpleNamespace(
        rivals=lambda names: {"bias_jump": rival},
        joint_probability=lambda names, has_remainder: probability,
        unlisted_probability=not_on_list,
    )
    closure = SimpleNamespace(
        verdict="ambiguous", effects=effects, names=("warm_up",), evidence=[other], posterior=posterior
    )
    assert not only_unconfirmed(closure, with_weak=True)
    assert only_unconfirmed(closure, with_weak=False) == without


@pytest.mark.long
def test_a_logarithmic_ageing_is_one_cause(tmp_path):
    """An exponential one and a drift imitate it together."""
    found = Investigator(unit_of(5), tmp_path / "ageing", 36.0, lambda *_: True).run(WallClock())
    assert found.ended == "settled"
    assert found.closure.names == ("ageing",)


@pytest.mark.long
def test_an_ageing_and_a_drift_are_not_settled_as_two_effects(tmp_path):
    """Together they imitate a slow law that is neither exponential nor logarithmic."""
    unit = SimulatedUnit(5, ("ageing", "time_drift"), (9.0, 5.0))
    found = Investigator(unit, tmp_path / "slow", 36.0, lambda *_: True).run(WallClock())
    assert found.closure.posterior.sets[0] == {"ageing", "time_drift"}
    assert found.ended == "not_on_list"


@pytest.mark.long
@pytest.mark.parametrize("seed", [302, 305])
def test_small_effects_that_a_first_campaign_shows(seed):
    """A refrigeration of 1.2 times the noise that runs on after ramps; a rate, and no lag of minutes."""
    unit = unit_of(seed)
    closure = search_campaign(campaign_of(unit.rows), [max(row.cycle for row in unit.rows)])
    assert is_settled(closure)
    assert set(closure.names) == set(unit.kinds)
