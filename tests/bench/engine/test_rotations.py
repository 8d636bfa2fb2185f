"""Rotations and spins about the table's axes while the INS navigates: recorded, interrupted, resumed."""

from itertools import pairwise

import numpy as np
import pytest

from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.dwells.dwell import measurement_setup
from gyrobench.bench.dwells.run_dwells import finished_marks, read_frames
from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.navigation.attitude import angle_between
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.station.instruments import Emulation
from gyrobench.drivers.ins.readout import InsMode
from tests.bench.engine.test_resumption import KilledError, Watcher, resumed

PROCEDURE = """procedure: rotations
steps:
  - power_on: {settle_s: 20}
  - go_to: {position: z_up, rate_dps: 30}
  - align: {duration_s: 20}
  - navigate: {duration_s: 61}
  - turn: {angle_deg: 180, rate_dps: 30, settle_s: 1}
  - navigate: {duration_s: 61}
  - go_to: {position: y_up, rate_dps: 30}
  - align: {duration_s: 20}
  - rotate:
      rest_s: 20
      settle_s: 2
      rate_dps: 10
      rotations: [{axis: outer, angle_deg: 90}, {axis: inner, angle_deg: -90}, {axis: outer, angle_deg: -180}]
  - spin: {axis: inner, turns: 1, rates_dps: [15, 10], rest_s: 20, settle_s: 2}
  - power_off
"""
#: Outer and inner angle of each rest, from that of the position on.
MOVES = [(0, 0), (90, 0), (0, -90), (-180, 0), (0, 0), (0, 360), (0, -360), (0, 360), (0, -360)]


class Killer(Watcher):
    """Ends the run in the middle of a kind of step."""

    def __init__(self, kind, after_ticks):
        super().__init__()
        self.kind, self.ticks, self.is_there = kind, after_ticks, False

    def step_started(self, planned, bench):
        self.is_there = planned.step.name == self.kind

    def ticked(self, bench, left_s):
        self.ticks -= self.is_there
        if self.ticks == 0:
            raise KilledError


@pytest.fixture
def job(tmp_path):
    def make(*faults):
        (tmp_path / "rotations.yaml").write_text(PROCEDURE)
        listed = tmp_path / "faults.yaml"
        listed.write_text("faults:\n" + "".join(f"  - {{{fault}}}\n" for fault in faults))
        emulation = Emulation("quick", 0, str(listed) if faults else "")
        return prepare_job(str(tmp_path / "rotations.yaml"), "quick", emulation)

    return make


def assert_recorded(folder, job):
    """Two dwells, of which the second has every rest and rotation, its frames in the log."""
    (row,) = read_dwells(folder.dwells)
    assert (row.dwell, row.position, row.flags) == (1, "z_up", "")
    _, marks = finished_marks(folder)
    assert (marks.dwell, marks.position, marks.is_rotated) == (2, "y_up", True)
    assert marks.disturbances == ()
    angles = np.array([(window.outer_deg, window.inner_deg) for window in marks.windows])
    np.testing.assert_allclose(angles - angles[0], np.cumsum(MOVES, axis=0), atol=0.003)
    setup = measurement_setup(job.station)
    navigation = setup.decode(read_frames(folder, marks))
    for window in marks.windows:
        rows = (navigation.row >= window.first_frame) & (navigation.row < window.end_frame)
        assert np.count_nonzero(rows) >= 18
        assert set(navigation.mode[rows]) == {InsMode.NAVIGATE}
        table = setup.table.attitude(window.outer_deg, window.inner_deg)
        for C_nb in navigation.attitude[rows][:: np.count_nonzero(rows) // 3]:
            assert angle_between(C_nb, table) < np.deg2rad(0.5)
    for (before, after), (outer, inner) in zip(pairwise(marks.windows), MOVES[1:], strict=True):
        if not (outer or inner):
            continue
        assert before.end_frame <= after.turn_first_frame < after.turn_end_frame <= after.first_frame
        rows = (navigation.row >= before.first_frame) & (navigation.row < after.end_frame)
        attitudes = navigation.attitude[rows]
        turned = np.rad2deg(sum(angle_between(*pair) for pair in pairwise(attitudes)))
        assert turned == pytest.approx(abs(outer) + abs(inner), abs=1.0)


def test_rests_and_rotations_are_in_the_journal_and_their_frames_in_the_log(job, tmp_path):
    made = job()
    folder, outcome = run_job(made, tmp_path / "run", Watcher(), ConsentingOperator())
    assert outcome.ended == "finished", outcome.reason
    assert_recorded(folder, made)
    for kind in ("rotate", "spin"):
        ((planned_s, took_s),) = outcome.took_s[kind]
        assert took_s == pytest.approx(planned_s, rel=0.1)  # the moves of a small table are short


@pytest.mark.parametrize("kind", ["rotate", "spin"])
def test_a_run_that_was_killed_in_a_rotation_resumes_with_the_alignment_before_it(job, tmp_path, kind):
    made = job()
    with pytest.raises(KilledError):
        run_job(made, tmp_path / "run", Killer(kind, 25), ConsentingOperator())
    folder, _, _ = resumed(tmp_path / "run")
    assert_recorded(folder, made)
    started = [each["kind"] for each in read_journal(folder.journal) if each["event"] == "step_started"]
    assert started[started.index("rotate") :].count("align") == 1


def test_after_a_trip_in_a_rotation_the_list_is_repeated_from_its_position(job, tmp_path):
    (spin,) = (planned for planned in job().plan.steps if planned.step.name == "spin")
    made = job(f"fault: port_gone, target: table, at_s: {spin.start_s + 60.0}, for_s: 40")
    folder, outcome = run_job(made, tmp_path / "run", Watcher(), ConsentingOperator())
    assert outcome.ended == "finished", outcome.reason
    entries = list(read_journal(folder.journal))
    assert [entry["interlocks"] for entry in entries if entry["event"] == "tripped"] == [["table_silence"]]
    assert [entry["dwell"] for entry in entries if entry["event"] == "dwell_given_up"] == [2]
    assert_recorded(folder, made)
