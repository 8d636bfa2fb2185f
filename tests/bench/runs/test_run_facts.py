import pytest

from gyrobench.bench.runs.run_facts import RunFacts, facts_of

STARTED = {
    "time_s": 0.0, "utc": "2026-03-01T10:00:00+00:00", "event": "run_started", "procedure": "shift",
    "station": "bench_1", "options": {"clock": "real"},
}  # fmt: skip
IDENTIFIED = {"time_s": 60.0, "event": "ins_identified", "unit": "1001"}
DWELL = {"time_s": 1500.0, "event": "dwell_finished"}
STOPPED = {
    "time_s": 1600.0, "event": "run_ended", "ended": "stopped", "reason": "stopped by SIGINT",
    "safe_state": [{"what": "rate table stopped"}],
}  # fmt: skip
RESUMED = {"time_s": 9000.0, "event": "run_resumed", "procedure": "shift", "station": "bench_1"}
FINISHED = {"time_s": 9900.0, "event": "run_ended", "ended": "finished", "reason": ""}


def test_a_run_is_told_by_its_entries():
    facts = facts_of([STARTED, IDENTIFIED, DWELL, STOPPED])
    assert (facts.procedure, facts.station, facts.unit) == ("shift", "bench_1", "1001")
    assert (facts.started_utc, facts.last_s, facts.dwells) == (STARTED["utc"], 1600.0, 1)
    assert (facts.ended, facts.reason, facts.resumes) == ("stopped", "stopped by SIGINT", 0)
    assert facts.safe_state == ({"what": "rate table stopped"},)
    assert facts.options == {"clock": "real"}


def test_a_run_that_was_stopped_and_resumed_and_then_cut_off_has_not_ended():
    facts = facts_of([STARTED, IDENTIFIED, DWELL, STOPPED, RESUMED])
    assert (facts.ended, facts.reason, facts.safe_state) == ("", "", ())
    assert (facts.resumes, facts.last_s, facts.dwells) == (1, 9000.0, 1)
    assert (facts.procedure, facts.unit, facts.started_utc) == ("shift", "1001", STARTED["utc"])
    assert facts.options == {"clock": "real"}


def test_the_last_end_of_a_run_that_was_resumed_counts():
    facts = facts_of([STARTED, STOPPED, RESUMED, DWELL, FINISHED])
    assert (facts.ended, facts.reason, facts.safe_state, facts.resumes) == ("finished", "", (), 1)


@pytest.mark.parametrize("time_s", [None, "soon", -1.0, 10**400, float("nan"), float("inf")])
def test_a_time_that_is_none_is_passed_over(time_s):
    assert facts_of([DWELL, {"time_s": time_s, "event": "note"}]).last_s == 1500.0


def test_entries_that_are_not_as_they_should_be_are_told_as_far_as_they_go():
    facts = facts_of(
        [
            {},
            {"event": ["run_ended"]},
            {"event": "run_started", "procedure": 7, "options": "none"},
            {"event": "ins_identified", "unit": None},
            {"event": "run_ended", "ended": 5, "safe_state": ["off", {"what": "chamber off"}]},
        ]
    )
    assert facts == RunFacts(procedure="7", ended="5", safe_state=({"what": "chamber off"},))
