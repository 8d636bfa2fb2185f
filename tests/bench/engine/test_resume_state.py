"""What a journal holds on the progress of a run, and journals that can't belong to the run."""

import math

import pytest

from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.resume_state import UNKNOWN_CHECKSUM, ResumeState
from gyrobench.bench.foundations.errors import RunFolderError


@pytest.fixture(scope="module")
def plan():
    return prepare_job("quick_campaign", "quick").plan


@pytest.fixture(scope="module")
def entries(plan):
    """Entries of a run that came to the end of its second dwell."""
    last = max(index for index, planned in enumerate(plan.steps) if planned.dwell == 2)
    written = [{"event": "powered_on", "run": 1}, {"event": "ins_identified", "unit": "1003"}]
    for number, planned in enumerate(plan.steps[: last + 1], start=1):
        written.append({"event": "step_started", "step": number, "label": planned.label, "what": "something"})
        written.append({"event": "step_finished", "step": number})
        if planned.dwell and planned.dwell != plan.steps[number].dwell:
            written.append({"event": "dwell_finished", "marks": {"dwell": planned.dwell}})
    return [{"time_s": 10.0 * index, **entry} for index, entry in enumerate(written)]


def test_a_valid_journal_gives_what_is_finished(plan, entries):
    progress = ResumeState.of_journal(entries, plan)
    assert progress.finished == {1, 2}
    assert plan.steps[progress.next_index - 1].dwell == 2
    assert plan.steps[progress.next_index].dwell != 2
    assert (progress.unit, progress.power_ons, progress.in_progress) == ("1003", 1, "")
    assert progress.last_s == entries[-1]["time_s"]
    assert not progress.is_over(plan)


def test_a_dwell_is_done_with_its_entry_and_not_before(plan, entries):
    before = ResumeState.of_journal(entries[:-1], plan)
    assert before.finished == {1}
    assert plan.steps[before.next_index - 1].dwell != 2
    skipped = ResumeState.of_journal(
        [*entries[:-1], {"time_s": 1e4, "event": "dwell_skipped", "dwell": 2}], plan
    )
    assert (skipped.finished, skipped.skipped) == ({1}, {2})


def test_a_dwell_whose_end_the_journal_lacks_is_lost_and_comes_first(plan, entries):
    without = [entry for entry in entries if entry.get("marks") != {"dwell": 1}]
    state = ResumeState.of_journal(without, plan)
    assert state.lost == {1}
    first = state.resume_index(plan)
    assert (plan.steps[first - 1].dwell, plan.steps[first].dwell) == (None, 1)
    assert first < state.next_index


def test_dwells_to_measure_again_come_first_and_keep_their_measurement_until_then(plan, entries):
    repeat = {"time_s": 1e4, "event": "repeat_commanded", "dwells": [1]}
    state = ResumeState.of_journal([*entries, repeat], plan)
    assert (state.lost, state.replaced, state.finished) == ({1}, {1}, {2})
    assert plan.steps[state.resume_index(plan)].dwell == 1
    assert state.next_index == ResumeState.of_journal(entries, plan).next_index
    skipped = {"time_s": 2e4, "event": "dwell_skipped", "dwell": 1}
    again = ResumeState.of_journal([*entries, repeat, skipped], plan)
    assert (again.lost, again.replaced, again.finished, again.skipped) == (set(), set(), {1, 2}, set())
    measured = ResumeState.of_journal([*entries, repeat, {**entries[-1], "marks": {"dwell": 1}}], plan)
    assert (measured.lost, measured.replaced, measured.finished) == (set(), set(), {1, 2})


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({}, "'time_s'"),
        ({"time_s": None}, "entry None at None s does not belong"),
        ({"time_s": -1.0}, "-1.0 s is not a time of a run"),
        ({"time_s": 1e10}, "10000000000.0 s is not a time of a run"),
        ({"time_s": math.nan}, "nan s is not a time of a run"),
        ({"time_s": 10**400}, "too large"),
        ({"time_s": 1.0, "event": "step_started"}, "'label'"),
        ({"time_s": 1.0, "event": "step_finished"}, "'step'"),
        ({"time_s": 1.0, "event": "step_finished", "step": 0}, "0 is not an integer from 1 to"),
        ({"time_s": 1.0, "event": "step_finished", "step": 10**6}, "1000000 is not an integer"),
        ({"time_s": 1.0, "event": "step_finished", "step": 1.5}, "1.5 is not an integer"),
        ({"time_s": 1.0, "event": "dwell_finished"}, "'marks'"),
        ({"time_s": 1.0, "event": "dwell_finished", "marks": []}, "indices"),
        ({"time_s": 1.0, "event": "dwell_finished", "marks": {"dwell": 10**6}}, "not an integer"),
        ({"time_s": 1.0, "event": "dwell_skipped", "dwell": "1"}, "'1' is not an integer"),
        ({"time_s": 1.0, "event": "dwell_given_up", "counts": True, "dwell": -1}, "-1 is not an integer"),
        ({"time_s": 1.0, "event": "repeat_commanded", "dwells": [0]}, "0 is not an integer from 1 to"),
        ({"time_s": 1.0, "event": "continued", "by": "itself", "after": 5}, "not iterable"),
        ({"time_s": 1.0, "event": "powered_on", "run": 10**9}, "from 1 to 1000000"),
        ({"time_s": 1.0, "event": "run_ended", "ended": "finished"}, "'reason'"),
    ],
)
def test_an_entry_that_no_run_writes_is_refused(plan, entries, entry, message):
    with pytest.raises(RunFolderError, match="does not belong to this procedure") as error:
        ResumeState.of_journal([*entries, entry], plan)
    assert message in str(error.value)


def test_an_answer_on_a_compensation_without_checksum_is_known_from_older_journals(plan, entries):
    older = {"time_s": 5.0, "event": "compensation_decided", "which": "a compensation", "answer": "keep"}
    assert ResumeState.of_journal([*entries, older], plan).stored_compensation_answers == {
        UNKNOWN_CHECKSUM: "keep"
    }
