import json
from dataclasses import replace
from pathlib import Path

from gyrobench.bench.messages.delivery import Message
from tests.bench.messages.made_up import ENDS, NEEDS_PERSON


def test_data_have_the_same_keys_for_every_event():
    bare = Message("test", "A test.", "bench_2", ENDS.time)
    assert bare.to_json().keys() == NEEDS_PERSON.to_json().keys() == ENDS.to_json().keys()
    assert json.loads(json.dumps(NEEDS_PERSON.to_json())) == NEEDS_PERSON.to_json()
    assert bare.to_json()["run"] is None


def test_data_state_what_where_when_and_what_is_left():
    data = NEEDS_PERSON.to_json()
    assert data["event"] == "needs_person"
    assert (data["run"], data["folder"]) == ("fig7-001", "/data/runs/fig7-001")
    assert (data["unit"], data["station"], data["procedure"]) == ("1001", "bench_2", "six_position_fig7")
    assert data["answers"] == ["continue", "abort"]
    assert data["time"] == "2026-03-01T02:30:00+00:00"
    assert data["left"] == {"hours": 31.7, "dwells": 45}
    assert data["urgent"]


def test_the_end_of_a_hold_has_the_name_that_receivers_know():
    assert replace(NEEDS_PERSON, event="resumes").to_json()["event"] == "goes_on"


def test_text_says_what_can_be_answered():
    assert "Answer continue or abort" in NEEDS_PERSON.text
    assert NEEDS_PERSON.why in NEEDS_PERSON.text
    assert "/data/runs/fig7-001" in NEEDS_PERSON.text


def test_title_is_one_printable_line_for_every_name_of_a_unit():
    title = replace(ENDS, unit="10\r\n01").title
    assert title.isprintable()
    assert title.startswith("bench_2, unit 10  01: the run finished")


def test_a_failed_end_is_urgent_and_a_good_one_is_not():
    assert not ENDS.is_urgent
    assert replace(ENDS, ended="failed").is_urgent


def test_a_run_folder_with_a_strange_name_is_reported():
    assert "ü\n" not in replace(ENDS, folder=Path("/x/ü\n")).title
