from dataclasses import replace

import pytest

from gyrobench.bench.bias.dwell import DwellPurpose
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.runs.marks import DwellMarks, WindowMark

MARKS = DwellMarks(
    unit="1001",
    run="1",
    dwell=3,
    cycle=1,
    position="z_up",
    azimuth_deg=0.0,
    log_part=2,
    windows=(WindowMark(10, 20, 0.0, 0.0), WindowMark(30, 40, 0.0, 180.0, 20, 30)),
    start_s=100.0,
    end_s=400.0,
    since_power_on_s=90.0,
    chamber_set_c=None,
    chamber_c=21.5,
)


@pytest.mark.parametrize("purpose", DwellPurpose)
def test_marks_survive_the_journal(purpose):
    marks = replace(MARKS, purpose=purpose, disturbances=("the table moved",))
    assert DwellMarks.from_json(marks.to_json()) == marks


@pytest.mark.parametrize(
    "changes",
    [
        {"position": "sideways"},
        {"dwell": "3"},
        {"log_part": 2.5},
        {"start_s": float("nan")},
        {"windows": "none"},
        {"windows": [{"first_frame": 30, "end_frame": 20, "outer_deg": 0.0, "inner_deg": 0.0}]},
        {"windows": [{"first_frame": -1, "end_frame": 20, "outer_deg": 0.0, "inner_deg": 0.0}]},
        {"disturbances": "x"},
        {"disturbancex": []},
        {"is_verification": 1},
        {"is_rotated": "x"},
    ],
)
def test_damaged_marks_are_refused(changes):
    with pytest.raises(RunFolderError, match="damaged marks of a dwell"):
        DwellMarks.from_json(MARKS.to_json() | changes)


@pytest.mark.parametrize("key", MARKS.to_json())
def test_marks_lack_nothing(key):
    data = MARKS.to_json()
    del data[key]
    with pytest.raises(RunFolderError, match="damaged marks of a dwell"):
        DwellMarks.from_json(data)


@pytest.mark.parametrize("on", [None, 0.0, 2.5])
def test_other_units_on_are_in_the_journal_where_they_are_known(on):
    marks = replace(MARKS, neighbours_on=on)
    data = marks.to_json()
    assert data.get("neighbours_on") == on
    assert ("neighbours_on" in data) == (on is not None)
    assert DwellMarks.from_json(data) == marks
