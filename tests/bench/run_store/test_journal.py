import pytest

from bench.clock import VirtualClock
from bench.errors import RunFolderError
from bench.run_store.journal import Journal, read_journal


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


def test_an_entry_is_on_the_disk_before_the_next_thing_happens(tmp_path):
    path = tmp_path / "journal.jsonl"
    with Journal(path, VirtualClock()) as journal:
        journal.record("step_started", step=1)
        assert len(list(read_journal(path))) == 1


def test_a_last_line_that_was_cut_off_is_left_out(tmp_path):
    path = tmp_path / "journal.jsonl"
    path.write_text('{"event": "a"}\n{"event": "b", "st')
    assert [entry["event"] for entry in read_journal(path)] == ["a"]


def test_a_damaged_line_in_the_middle_is_an_error_with_its_place(tmp_path):
    path = tmp_path / "journal.jsonl"
    path.write_text('{"event": "a"}\n{"ev\n{"event": "c"}\n')
    with pytest.raises(RunFolderError, match=r"journal\.jsonl:2: damaged"):
        list(read_journal(path))
