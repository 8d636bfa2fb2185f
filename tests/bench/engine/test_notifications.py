"""Whole runs that send messages to a server on loopback."""

import json

import pytest

from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.observers import RunObserver
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.engine.run_notifier import UNANSWERED_S
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.station.instruments import Emulation
from tests.bench.engine.intervention import short_dwell
from tests.bench.messages.servers import Server

PROCEDURE = """
procedure: question
bin_width_c: 5
steps:
  - ask_operator: {{question: "Is the cable plugged in?", answers: ["yes", "no"]}}
  - chamber: {{temperature_c: {set_c}, ramp_c_per_min: 4}}
"""


class Slow(ConsentingOperator):
    """Thinks for some answers' time before the answer."""

    def __init__(self, patience, after):
        super().__init__(patience)
        self._left = self._after = after

    def answer(self):
        self._left -= 1
        if self._left > 0:
            return None
        self._left = self._after
        return super().answer()


@pytest.fixture
def server():
    started = Server()
    yield started
    started.close()


@pytest.fixture
def run_with_receiver(tmp_path, server):
    """Run the procedure; returns its journal and what the server received."""

    def run(operator, faults="", on="ends, holds, resumes, needs_person", set_c=40, needs=""):
        station, procedure = tmp_path / "station.yaml", tmp_path / "question.yaml"
        text = find_document("stations", "emulated").read_text()
        station.write_text(
            f"{text}\nmessages:\n  - {{kind: webhook, address: {server.url}, on: [{on}]{needs}}}\n"
        )
        procedure.write_text(PROCEDURE.format(set_c=set_c))
        if faults:
            (tmp_path / "faults.yaml").write_text(faults)
            faults = str(tmp_path / "faults.yaml")
        job = prepare_job(str(procedure), str(station), Emulation("ideal", 0, faults))
        folder, outcome = run_job(job, tmp_path / "run", RunObserver(), operator)
        received = [json.loads(body) for _, _, body in server.received]
        return list(read_journal(folder.journal)), received, outcome

    return run


def test_the_end_of_a_run_is_sent_and_journaled(run_with_receiver):
    journal, (end,), _ = run_with_receiver(ConsentingOperator())
    assert (end["event"], end["ended"]) == ("ends", "finished")
    assert end["procedure"] == "question"
    assert end["left"]["hours"] == 0.0
    sent = [entry for entry in journal if entry["event"] == "message_sent"]
    assert [(entry["about"], entry["answer"]) for entry in sent] == [("ends", "200 OK")]


def test_a_receiver_whose_secret_is_missing_is_named_as_the_run_begins(run_with_receiver, monkeypatch):
    monkeypatch.delenv("BENCH_TOKEN", raising=False)
    entries, *_ = run_with_receiver(ConsentingOperator(), needs=", secret_env: BENCH_TOKEN")
    events = [entry["event"] for entry in entries]
    note = entries[events.index("note")]["text"]
    assert events.index("note") < events.index("step_started")
    assert "gets no message: the environment variable BENCH_TOKEN: no secret found" in note


def test_an_unanswered_question_is_sent(run_with_receiver):
    _, (question, end), _ = run_with_receiver(Slow(30, after=int(UNANSWERED_S) + 5))
    assert question["event"] == "needs_person"
    assert question["question"] == "Is the cable plugged in?"
    assert question["answers"] == ["yes", "no"]
    assert question["left"]["hours"] > 0.0
    assert end["event"] == "ends"


def test_a_question_that_is_answered_at_once_is_not_sent(run_with_receiver):
    _, received, _ = run_with_receiver(Slow(30, after=5))
    assert [each["event"] for each in received] == ["ends"]


def test_an_answer_that_ends_the_run_is_sent_with_the_reason(run_with_receiver):
    _, (end,), outcome = run_with_receiver(ConsentingOperator(patience=0))
    assert end["ended"] == outcome.ended == "stopped"
    assert outcome.reason in end["why"]


def test_only_selected_events_are_sent(run_with_receiver):
    _, received, _ = run_with_receiver(Slow(30, after=50), on="holds")
    assert received == []


def test_a_hold_that_ends_without_an_operator_is_sent_twice(run_with_receiver):
    fault = "faults:\n  - {fault: port_gone, target: chamber, at_s: 60, for_s: 120}\n"
    _, received, outcome = run_with_receiver(ConsentingOperator(), fault)
    assert outcome.ended == "finished"
    assert [each["event"] for each in received] == ["holds", "goes_on", "ends"]
    why = received[0]["why"].removeprefix("It continues without an operator once nothing is tripped: ")
    assert received[1]["why"].startswith(f"The hold is over: {why}")
    assert received[1]["left"]["hours"] > 0.0


def test_a_hold_that_the_operator_ends_at_once_is_not_sent(run_with_receiver):
    fault = "faults:\n  - {fault: chamber_sensor_error, at_s: 100, for_s: 30}\n"
    journal, received, _ = run_with_receiver(ConsentingOperator(), fault)
    assert any(entry["event"] == "held" for entry in journal)
    assert [each["event"] for each in received] == ["ends"]


def test_a_hold_that_waits_for_the_operator_is_sent_with_its_reason(run_with_receiver):
    fault = "faults:\n  - {fault: chamber_sensor_error, at_s: 100, for_s: 30}\n"
    _, received, _ = run_with_receiver(Slow(30, after=int(UNANSWERED_S) + 5), fault)
    hold = received[1]
    assert [each["event"] for each in received] == ["needs_person", "needs_person", "goes_on", "ends"]
    assert hold["question"] == f"The run holds: {hold['why']}"
    assert hold["answers"] == ["continue", "abort"]


DWELLS = (
    """
procedure: dwells
bin_width_c: 5
disturbed_dwell: flag
steps:
  - power_on: {settle_s: 10}
  - repeat:
      over: {cycle: [1, 2, 3, 4]}
      steps:
"""
    + short_dwell(align_s=16, navigate_s=60, indent=8)
    + "  - power_off\n"
)


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ("", ["ends"]),
        ("faults:\n  - {fault: frames_lost, at_s: 0, for_s: 5000, share: 0.4}\n", ["dwells_flagged", "ends"]),
    ],
)
def test_dwells_that_are_flagged_one_after_the_other_are_sent_once(tmp_path, server, fault, expected):
    station, procedure, faults = (tmp_path / f"{name}.yaml" for name in ("station", "dwells", "faults"))
    text = find_document("stations", "quick").read_text()
    station.write_text(f"{text}\nmessages:\n  - {{kind: webhook, address: {server.url}}}\n")
    procedure.write_text(DWELLS)
    faults.write_text(fault)
    job = prepare_job(str(procedure), str(station), Emulation("quick", 0, str(faults) if fault else ""))
    run_job(job, tmp_path / "run", RunObserver(), ConsentingOperator())
    received = [json.loads(body) for _, _, body in server.received]
    assert [each["event"] for each in received] == expected
    if fault:
        assert received[0]["why"].startswith("The last 3 dwells are flagged, number 3: ")
