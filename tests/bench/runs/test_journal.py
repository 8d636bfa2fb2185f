import hashlib
import json
import os
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.runs.journal import Journal, RunFacts, broken_links, facts_of, read_journal


@pytest.fixture
def path(tmp_path):
    return tmp_path / "journal.jsonl"


def test_entries_come_back_in_order_with_their_time(tmp_path):
    clock = VirtualClock()
    with Journal(tmp_path / "journal.jsonl", clock) as journal:
        journal.record("step_started", step=1)
        clock.sleep(2.5)
        journal.record("step_finished", step=1, took_s=2.5)
    entries = list(read_journal(tmp_path / "journal.jsonl"))
    assert [(entry["event"], entry["time_s"]) for entry in entries] == [
        ("step_started", 0.0),
        ("step_finished", 2.5),
    ]
    assert entries[1]["utc"].startswith("2000-01-01T00:00:02.5")


def test_an_entry_is_on_the_disk_before_the_next_thing_happens(path):
    with Journal(path, VirtualClock()) as journal:
        journal.record("step_started", step=1)
        assert len(list(read_journal(path))) == 1


def test_a_last_line_that_was_cut_off_is_left_out(path):
    path.write_text('{"event": "a"}\n{"event": "b", "st')
    assert [entry["event"] for entry in read_journal(path)] == ["a"]


def test_a_damaged_line_in_the_middle_is_an_error_with_its_place(path):
    path.write_text('{"event": "a"}\n{"ev\n{"event": "c"}\n')
    entries = read_journal(path)
    assert next(entries) == {"event": "a"}
    with pytest.raises(RunFolderError, match=r"journal\.jsonl:2: damaged"):
        next(entries)


@pytest.mark.parametrize(
    "tail",
    [
        b'{"event": "b", "st',
        b'{"event": "b"}',
        b"\0" * 40,
        b'{"eve\0\0\0\0\n',
        b"[1, 2]\n",
        b"\xff\xfe\n",
        b"[" * 100_000 + b"\n",
    ],
)
def test_a_journal_that_was_cut_off_is_repaired_and_says_so(path, tail):
    path.write_bytes(b'{"event": "a"}\n' + tail)
    assert [entry["event"] for entry in read_journal(path)] == ["a"]
    with Journal(path, VirtualClock(3.0)) as journal:
        journal.record("c")
    entries = list(read_journal(path))
    assert [entry["event"] for entry in entries] == ["a", "journal_repaired", "c"]
    assert entries[1]["cut_off"] == tail[:60].decode(errors="replace")
    assert path.read_bytes().count(b"\n") == 3


def test_a_whole_journal_is_over_on_with_as_it_is(path):
    for event in "ab":
        with Journal(path, VirtualClock()) as journal:
            journal.record(event)
    assert [entry["event"] for entry in read_journal(path)] == ["a", "b"]


def test_a_journal_damaged_in_the_middle_is_not_written_to(path):
    path.write_text('{"ev\n{"event": "c"}\n')
    with pytest.raises(RunFolderError, match=r"journal\.jsonl:1: damaged"):
        Journal(path, VirtualClock())
    assert path.read_text() == '{"ev\n{"event": "c"}\n'


def test_a_second_writer_is_refused_until_the_first_is_over(path):
    program = (
        "import sys, pathlib; from gyrobench.bench.foundations.clock import VirtualClock;"
        "from gyrobench.bench.runs.journal import Journal;"
        "journal = Journal(pathlib.Path(sys.argv[1]), VirtualClock()); journal.record('a');"
        "print('writes', flush=True); sys.stdin.read()"
    )
    command = [sys.executable, "-c", program, str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout.readline() == b"writes\n"
        with pytest.raises(RunFolderError, match="another process is writing this run"):
            Journal(path, VirtualClock())
        other.kill()
        other.wait()
    with Journal(path, VirtualClock()) as journal:
        journal.record("b")
    assert [entry["event"] for entry in read_journal(path)] == ["a", "b"]


def test_an_entry_that_could_not_be_written_leaves_the_journal_as_it_was(path, small_files):
    with Journal(path, VirtualClock()) as journal:
        journal.record("a")
        with small_files(path.stat().st_size + 20), pytest.raises(RunFolderError, match="can't be written"):
            journal.record("b", text="x" * 100)
        assert [entry["event"] for entry in read_journal(path)] == ["a"]
        assert path.read_bytes().endswith(b"\n")
        journal.record("c")
    assert [entry["event"] for entry in read_journal(path)] == ["a", "c"]


def test_an_entry_that_is_not_on_the_disk_is_taken_back(path, monkeypatch):
    def broken(descriptor):
        raise OSError(5, "Input/output error")

    with Journal(path, VirtualClock()) as journal:
        journal.record("a")
        monkeypatch.setattr(os, "fsync", broken)
        with pytest.raises(RunFolderError, match="Input/output error"):
            journal.record("b")
    assert [entry["event"] for entry in read_journal(path)] == ["a"]


def test_a_number_that_is_not_finite_becomes_null(path):
    with Journal(path, VirtualClock()) as journal:
        journal.record("trip", value_c=float("nan"), limits_c=(float("-inf"), 70.0), of={"x": float("inf")})
    (entry,) = read_journal(path)
    assert (entry["value_c"], entry["limits_c"], entry["of"]) == (None, [None, 70.0], {"x": None})


@given(text=st.text(max_size=30), share=st.floats(0.0, 1.0))
def test_cut_anywhere_a_journal_gives_the_entries_that_are_whole(path, text, share):
    path.unlink(missing_ok=True)
    with Journal(path, VirtualClock()) as journal:
        for number in range(4):
            journal.record("said", number=number, text=text)
    whole = path.read_bytes()
    cut = whole[: round(share * len(whole))]
    path.write_bytes(cut)
    entries = list(read_journal(path))
    assert [entry["number"] for entry in entries] == list(range(cut.count(b"\n")))
    assert all(entry["text"] == text for entry in entries)


STARTED = {
    "time_s": 0.0, "utc": "2026-03-01T10:00:00+00:00", "event": "run_started", "procedure": "shift",
    "station": "bench_1", "options": {"clock": "real"},
}  # fmt: skip
IDENTIFIED = {"time_s": 60.0, "event": "ins_identified", "unit": "1001"}
DWELL = {"time_s": 1500.0, "event": "dwell_finished"}
STOPPED = {
    "time_s": 1600.0, "event": "run_ended", "ended": "stopped", "reason": "stopped by the operator (Ctrl-C)",
    "safe_state": [{"what": "rate table stopped"}],
}  # fmt: skip
RESUMED = {"time_s": 9000.0, "event": "run_resumed", "procedure": "shift", "station": "bench_1"}
FINISHED = {"time_s": 9900.0, "event": "run_ended", "ended": "finished", "reason": ""}


def test_a_run_is_reported_by_its_entries():
    facts = facts_of([STARTED, IDENTIFIED, DWELL, STOPPED])
    assert (facts.procedure, facts.station, facts.unit) == ("shift", "bench_1", "1001")
    assert (facts.started_utc, facts.last_s, facts.dwells) == (STARTED["utc"], 1600.0, 1)
    assert (facts.ended, facts.reason, facts.resumes) == ("stopped", "stopped by the operator (Ctrl-C)", 0)
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


def test_entries_that_are_not_as_they_should_be_are_reported_as_far_as_they_go():
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


def test_each_line_carries_the_hash_of_the_line_before_also_after_a_cut(path):
    with Journal(path, VirtualClock()) as journal:
        journal.record("a")
        journal.record("b")
    path.write_bytes(path.read_bytes() + b'{"event": "c", "ha')
    with Journal(path, VirtualClock()) as journal:
        journal.record("d")
    content = path.read_bytes()
    lines = content.splitlines()
    assert json.loads(lines[2])["previous_sha256"] == hashlib.sha256(lines[1]).hexdigest()
    assert broken_links(content.splitlines(keepends=True)) == []
    assert broken_links(content.replace(b'"b"', b'"x"').splitlines(keepends=True)) == [3]
    assert broken_links(b"\n".join([*lines[:1], *lines[2:], b""]).splitlines(keepends=True)) == [2]
    assert broken_links(b"\n".join([*lines[1:], b""]).splitlines(keepends=True)) == [1]
    assert all("previous_sha256" not in entry for entry in read_journal(path))


def test_an_old_journal_is_linked_from_where_it_is_continued(path):
    path.write_text('{"event": "a"}\n{"event": "b"}\n')
    assert broken_links(path.read_bytes().splitlines(keepends=True)) == []
    with Journal(path, VirtualClock()) as journal:
        journal.record("c")
        journal.record("d")
    content = path.read_bytes()
    assert broken_links(content.splitlines(keepends=True)) == []
    assert broken_links(content.replace(b'"b"', b'"x"').splitlines(keepends=True)) == [3]


@pytest.mark.parametrize(
    ("tested", "known"),
    [((), None), ((None,), None), ((False, None, False), False), ((False, True, False), True)],
)
def test_one_dwell_that_tests_signs_and_axes_is_enough(tested, known):
    dwells = [DWELL if each is None else {**DWELL, "signs_tested": each} for each in tested]
    assert facts_of([STARTED, *dwells]).are_signs_tested is known
