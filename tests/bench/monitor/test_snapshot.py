import json
import math
from dataclasses import fields, replace

import numpy as np
import pytest

from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.monitor.snapshot import Attitude, RunSnapshot, RunState, read_snapshot
from gyrobench.bench.navigation.positions import POSITIONS
from tests.bench.monitor.sample_snapshots import made_up_snapshot, waiting_snapshot

WORDS = {"E": "East", "W": "West", "N": "North", "S": "South", "U": "Up", "D": "Down"}


def directions(C_nb):
    return Attitude("", 0.0, tuple(tuple(row) for row in C_nb.tolist())).directions()


@pytest.mark.parametrize("name", POSITIONS)
def test_body_axes_are_named_by_where_they_point(name):
    expected = [WORDS[letter] for letter in POSITIONS[name].directions]
    assert [each.split()[1] for each in directions(POSITIONS[name].C_nb()).split(", ")] == expected


@pytest.mark.parametrize(
    ("azimuth_deg", "words"),
    [
        (9.0, "x East, y North, z Up"),
        (40.0, "x East-North, y North-West, z Up"),
        (50.0, "x North-East, y West-North, z Up"),
        (-40.0, "x East-South, y North-East, z Up"),
    ],
)
def test_an_axis_between_two_directions_is_named_after_both_the_nearer_one_first(azimuth_deg, words):
    assert directions(POSITIONS["z_up"].C_nb(np.radians(azimuth_deg))) == words


@pytest.mark.parametrize("snapshot", [made_up_snapshot(), waiting_snapshot()], ids=["running", "waiting"])
def test_a_snapshot_survives_json(snapshot):
    text = snapshot.to_json()
    again = RunSnapshot.from_json(text)
    assert again.to_json() == text
    assert again.state is snapshot.state
    assert again.question == snapshot.question
    assert again.dwell == snapshot.dwell


def test_a_snapshot_without_the_number_of_finished_dwells_has_that_of_its_dwells():
    data = json.loads(made_up_snapshot().to_json())
    del data["finished_dwells"]
    assert RunSnapshot.from_json(json.dumps(data).encode()).finished_dwells == 13


def test_a_number_that_is_not_known_is_null_and_comes_back_as_nan():
    text = made_up_snapshot().to_json()
    assert b"NaN" not in text
    assert json.loads(text)["dwells"][4]["bias_dph"] == [None, None, None]
    assert all(map(math.isnan, RunSnapshot.from_json(text).dwells[4].bias_dph))


def test_the_plan_of_a_run_that_held_is_behind_its_clock():
    snapshot = replace(made_up_snapshot(), now_s=40_000.0, left_s=20_000.0, planned_s=54_000.0)
    assert snapshot.plan_now_s == 34_000.0


@pytest.mark.parametrize("state", RunState)
def test_only_ends_are_over(state):
    assert state.is_over == (state in ("finished", "stopped", "failed"))


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data.pop("now_s"),
        lambda data: data.update(colour="red"),
        lambda data: data["step"].update(colour="red"),
        lambda data: data["step"].update(number="7"),
        lambda data: data.update(state="asleep"),
        lambda data: data.update(format=0),
        lambda data: data["measured"].update(time_s=["noon"]),
        lambda data: data["measured"]["chamber_c"].pop(),
        lambda data: data["dwell"]["windows"][0]["time_s"].pop(),
        lambda data: data["attitude"].update(body_in_enu=[[1.0, 0.0, 0.0]]),
    ],
    ids=[
        "a key less", "a key more", "a key more within", "text for a number", "no state", "an older format",
        "no number", "a value less", "a time less", "half a matrix",
    ],
)  # fmt: skip
def test_a_damaged_snapshot_is_refused_with_its_file(damage, tmp_path):
    data = json.loads(made_up_snapshot().to_json())
    damage(data)
    path = tmp_path / "live.json"
    path.write_text(json.dumps(data))
    with pytest.raises(RunFolderError, match=r"live\.json: damaged, or of another version"):
        read_snapshot(path)


@pytest.mark.parametrize("text", [b"", b"{", b"[]", b"\xff\xfe", b'{"name": "half'])
def test_what_is_no_snapshot_is_refused(text):
    with pytest.raises(RunFolderError):
        RunSnapshot.from_json(text)


def test_every_part_of_the_made_up_snapshot_is_filled():
    snapshot = waiting_snapshot()
    empty = {each.name for each in fields(snapshot) if getattr(snapshot, each.name) in (None, (), "")}
    assert empty == {"dwell", "skipped", "units"}  # of a run with one unit


def test_a_state_is_written_with_the_text_that_other_readers_know():
    text = waiting_snapshot().to_json()
    assert b'"waiting for a person"' in text
    assert RunSnapshot.from_json(text).state is RunState.WAITING
    other = text.replace(b'"waiting for a person"', b'"waiting for the operator"')
    assert RunSnapshot.from_json(other).state is RunState.WAITING
