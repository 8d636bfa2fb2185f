"""Rotations and spins about the table's axes while the INS navigates: recorded, interrupted, resumed."""

import json
import os
import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest
import yaml

from gyrobench.bench.bias.dwell import DwellPurpose
from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.calibration.rotation_list import load_rotation_list
from gyrobench.bench.dwells.measurement_setup import measurement_setup
from gyrobench.bench.dwells.run_dwells import finished_marks, read_frames
from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.monitor.run_list import snapshot_from_records
from gyrobench.bench.monitor.snapshot_recorder import SnapshotRecorder
from gyrobench.bench.navigation.attitude import angle_between
from gyrobench.bench.report.run_content import read_run
from gyrobench.bench.runs.folder import open_run_folder
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.runs.tables.coefficient_table import COEFFICIENT_TABLE
from gyrobench.bench.station.instruments import Emulation
from gyrobench.drivers.ins.readout import InsMode
from tests.bench.command_line import gyrobench
from tests.bench.engine.test_coefficient_compensation import plateau, station
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
    assert (row.dwell, row.position, row.flags) == (1, "z_up", ())
    _, marks = finished_marks(folder)
    assert (marks.dwell, marks.position, marks.purpose) == (2, "y_up", DwellPurpose.ROTATIONS)
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
    recorder = SnapshotRecorder(made.plan)
    folder, outcome = run_job(made, tmp_path / "run", recorder, ConsentingOperator())
    assert outcome.ended == "finished", outcome.reason
    assert_recorded(folder, made)
    assert outcome.finished == {1, 2}
    snapshot, live = snapshot_from_records(folder), recorder.snapshot()
    assert "dwell 2/2, y_up: 3 rotations and 4 whole turns recorded" in [note.text for note in live.messages]
    assert (snapshot.finished_dwells, live.finished_dwells) == (2, 2)
    # The rotations have left the position.
    assert (snapshot.attitude.position, live.attitude.position) == ("", "")
    for each in read_run(folder).step_durations:
        if each.kind in ("rotate", "spin"):
            assert each.count == 1
            assert each.actual_s == pytest.approx(each.planned_s, rel=0.1)  # a small table's moves are short


@pytest.mark.parametrize("kind", ["rotate", "spin"])
def test_a_run_that_was_killed_in_a_rotation_resumes_with_the_alignment_before_it(job, tmp_path, kind):
    made = job()
    with pytest.raises(KilledError):
        run_job(made, tmp_path / "run", Killer(kind, 25), ConsentingOperator())
    folder, outcome, _ = resumed(tmp_path / "run")
    assert_recorded(folder, made)
    assert outcome.finished == {1, 2}
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


@pytest.fixture(scope="module")
def with_increments(tmp_path_factory):
    """18 rotations and a spin on a station with an INS that sends increments on command."""
    folder = tmp_path_factory.mktemp("increments")
    go_to, align, rotate = plateau(on_ramp=False)[-3:]
    steps = [
        {"power_on": {"settle_s": 60}},
        {"chamber": {"temperature_c": 30, "ramp_c_per_min": 5}},
        {"soak": {"for_s": 900}},
        *(go_to, align, rotate, go_to, align),
        {"spin": {"axis": "inner", "turns": 1, "rates_dps": [15, 10], "rest_s": 20, "settle_s": 2}},
        "power_off",
    ]
    paths = folder / "eighteen.yaml", folder / "station.yaml"
    for path, data in zip(paths, ({"procedure": "eighteen", "steps": steps}, station()), strict=True):
        path.write_text(yaml.safe_dump(data, sort_keys=False))
    return tuple(map(str, paths))


def run_with_increments(with_increments, out, faults=""):
    job = prepare_job(*with_increments, Emulation("quick", 0, faults))
    folder, outcome = run_job(job, out, Watcher(), ConsentingOperator())
    assert outcome.ended == "finished", outcome.reason
    return folder, job


@pytest.fixture(scope="module")
def undisturbed(with_increments, tmp_path_factory):
    """Coefficients, and for each kind of step its dwell and the middle of its time."""
    folder, job = run_with_increments(with_increments, tmp_path_factory.mktemp("undisturbed") / "run")
    dwells = {each.number: each.dwell for each in job.plan.steps}
    middles = {
        each["kind"]: (dwells[each["step"]], each["time_s"] - 0.5 * each["took_s"])
        for each in read_journal(folder.journal)
        if each["event"] == "step_finished"
    }
    return COEFFICIENT_TABLE.read(folder.coefficients), middles


def assert_same_coefficients(folder, undisturbed):
    # Dwells of two power cycles are two plateaus: the first is that of the 18 rotations.
    rows = COEFFICIENT_TABLE.read(folder.coefficients)
    for row, other in zip(rows[:21], undisturbed[0], strict=True):
        assert (row.coefficient, row.axis, row.finding) == (other.coefficient, other.axis, "")
        # Each power-on has gyro biases a little different, beside the noise of both.
        power_on = 2e-6 if row.coefficient == "gyro_bias" else 0.0
        assert abs(row.value - other.value) < 4.5 * (row.sigma**2 + other.sigma**2 + power_on) ** 0.5
        assert row.sigma < 2.0 * other.sigma
    assert [(marks.dwell, len(marks.windows)) for marks in finished_marks(folder)] == [(1, 19), (2, 5)]


@pytest.mark.long
@pytest.mark.parametrize(("kind", "ticks"), [("rotate", 200), ("spin", 40)])
def test_after_a_kill_in_a_rotation_the_increments_give_the_same_coefficients(
    with_increments, undisturbed, tmp_path, kind, ticks
):
    path, made = tmp_path / "run", prepare_job(*with_increments, Emulation("quick", 0))
    with pytest.raises(KilledError):
        run_job(made, path, Killer(kind, ticks), ConsentingOperator())
    assert len(finished_marks(open_run_folder(path))) == (kind == "spin")
    folder, _, _ = resumed(path)
    assert_same_coefficients(folder, undisturbed)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["rotate", "spin"])
def test_after_a_trip_in_a_rotation_the_bench_is_made_safe_and_the_whole_list_repeated(
    with_increments, undisturbed, tmp_path, kind
):
    dwell, at_s = undisturbed[1][kind]
    faults = tmp_path / "faults.yaml"
    faults.write_text(f"faults:\n  - {{fault: port_gone, target: table, at_s: {at_s}, for_s: 120}}\n")
    folder, _ = run_with_increments(with_increments, tmp_path / "run", str(faults))
    entries = list(read_journal(folder.journal))
    steps = ("tripped", "dwell_given_up", "made_safe", "held", "continued")
    story = [each["event"] for each in entries if each["event"] in steps]
    # The table is made safe when it answers again.
    expected = ["made_safe", "tripped", "dwell_given_up", "made_safe", "held", "made_safe", "continued"]
    assert story == expected
    assert [each["dwell"] for each in entries if each["event"] == "dwell_given_up"] == [dwell]
    assert_same_coefficients(folder, undisturbed)


@pytest.mark.long
@pytest.mark.parametrize("bench", ["emulated", "emulated_sbg"])
def test_plan_observability_promises_what_the_run_states(bench, tmp_path):
    rotations = load_rotation_list(find_document("rotations", "eighteen_rotations"))
    steps = [
        {"power_on": {"settle_s": 120}},
        {"go_to": {"position": rotations.start, "rate_dps": rotations.rate_dps}},
        {"align": {"duration_s": 300}},
        {
            "rotate": {
                "rest_s": rotations.dwell_s,
                "rate_dps": rotations.rate_dps,
                "rotations": [each.model_dump(exclude_none=True) for each in rotations.rotations],
            }
        },
        "power_off",
    ]
    path = tmp_path / "rotations.yaml"
    path.write_text(yaml.safe_dump({"procedure": "rotations", "steps": steps}))
    made = prepare_job(str(path), bench, Emulation("ideal"))
    folder, outcome = run_job(made, tmp_path / "run", Watcher(), ConsentingOperator())
    assert outcome.ended == "finished", outcome.reason
    stated = {(row.coefficient, row.axis): row.sigma for row in COEFFICIENT_TABLE.read(folder.coefficients)}
    command = ("plan", "eighteen_rotations", "--observability", "--station", bench, "--json")
    planned = json.loads(gyrobench(*command, cwd=tmp_path).stdout)["coefficients"]
    ratios = [
        row["sigma"] / stated[row["coefficient"], row["axis"]] for row in planned if row["sigma"] is not None
    ]
    assert len(ratios) == (21 if bench == "emulated" else 18)
    if bench == "emulated":
        assert ratios == pytest.approx([1.0] * 21, abs=0.1)
    else:  # how often coarse output changes differs from rest to rest
        assert min(ratios) > 0.6
        assert max(ratios) < 1.5
        assert np.median(ratios) == pytest.approx(1.0, abs=0.15)


COMPILING = """
import sys
from gyrobench import run
from gyrobench.bench.engine.observers import RunObserver
from gyrobench.bench.foundations.kernels import Kernel
from gyrobench.drivers.emulators.bench import compile_world

class Counter(RunObserver):
    compiled = None

    def noted(self, text):
        if text.startswith("Compiled the estimators"):
            print(text)

    def step_started(self, planned, bench):
        if planned.step.name == "go_to":
            self.compiled = self.compiled or Kernel.compilations()

compile_world()
observer = Counter()
run(sys.argv[1], station="quick", world="quick", out=sys.argv[2], observer=observer)
print(Kernel.compilations() - observer.compiled)
"""


@pytest.mark.long
def test_all_kernels_are_compiled_before_the_table_turns_and_only_once(tmp_path):
    (tmp_path / "rotations.yaml").write_text(PROCEDURE)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    for number in range(2):
        command = [sys.executable, "-c", COMPILING, "rotations.yaml", f"run_{number}"]
        printed = subprocess.run(command, cwd=tmp_path, env=environment, check=True, capture_output=True)
        *said, later = printed.stdout.decode().splitlines()
        assert [text.startswith("Compiled the estimators, once after") for text in said] == [True] * (
            not number
        )
        assert later == "0"
