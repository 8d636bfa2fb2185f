"""What the picture says while a run does not go on."""

import os
import signal

import pytest

from gyrobench.bench.engine.observers import ObserverGroup
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.observers import RunObserver
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.foundations.documents import find_document
from gyrobench.bench.live.picture import RunState, read_picture
from gyrobench.bench.live.recorder import PictureRecorder
from gyrobench.bench.station.instruments import Emulation
from gyrobench.drivers.emulators.acl_axis import SoftwareFault
from gyrobench.drivers.emulators.bench import BenchAddress, emulated_bench

PROCEDURE = """procedure: two_positions
steps:
  - power_on
  - ask_operator: {question: "Is the cable free?", answers: ["yes", "no"]}
  - repeat:
      over: {position: [z_up, z_down]}
      steps:
        - go_to: {position: $position, rate_dps: 30}
        - align: {duration_s: 60}
        - navigate: {duration_s: 61}
        - turn: {angle_deg: 180, rate_dps: 30, settle_s: 1}
        - navigate: {duration_s: 61}
"""


class SlowOperator(ConsentingOperator):
    """Takes some ticks to answer, with the last of the answers to one question, else the first."""

    def __init__(self, refuses):
        super().__init__()
        self._refuses = refuses
        self._ticks = 0
        self._word = ""

    def ask(self, question, answers):
        self._ticks, self._word = 10, answers[-1 if question.startswith(self._refuses) else 0]

    def answer(self):
        self._ticks -= 1
        return self._word if self._ticks <= 0 else None


class Witness(RunObserver):
    """Does something in the first step of a kind; keeps a picture of each state, and one after it."""

    def __init__(self, recorder, kind, deed):
        self._recorder, self._kind, self._deed = recorder, kind, deed
        self._now = ""
        self.seen = {}

    def step_started(self, planned, bench):
        self._now = planned.step.name

    def ticked(self, bench, left_s):
        if self._now == self._kind and self._deed is not None:
            deed, self._deed = self._deed, None
            deed(bench)

    def beat(self, bench):
        picture = self._recorder.picture()
        self.seen.setdefault(picture.state, []).append(picture)


@pytest.fixture
def witnessed(tmp_path):
    procedure = tmp_path / "two_positions.yaml"
    procedure.write_text(PROCEDURE)

    def run(kind="", deed=None, refuses="nothing", faults=""):
        (tmp_path / "faults.yaml").write_text(f"faults: [{faults}]\n")
        emulation = Emulation("ideal", 0, str(tmp_path / "faults.yaml") if faults else "")
        job = prepare_job(str(procedure), "emulated", emulation)
        recorder = PictureRecorder(job.plan)
        witness = Witness(recorder, kind, deed)
        operator = SlowOperator(refuses)
        folder, _ = run_job(job, tmp_path / "run", ObserverGroup(recorder, witness), operator)
        return witness.seen, read_picture(folder.live)

    return run


def order(number):
    return lambda bench: os.kill(os.getpid(), number)


def test_a_question_of_the_procedure_waits_for_a_person(witnessed):
    seen, last = witnessed()
    waiting = seen[RunState.WAITING]
    assert waiting[0].question.text == "Is the cable free?"
    assert waiting[0].question.answers == ("yes", "no")
    assert all(each.question is None for each in seen[RunState.RUNNING])
    assert (last.state, last.question) == (RunState.FINISHED, None)


def test_an_answer_that_ends_the_run_is_its_reason(witnessed):
    _, last = witnessed(refuses="Is the cable")
    assert last.state is RunState.STOPPED
    assert "'no' to: Is the cable free?" in last.reason


def test_a_pause_gives_the_dwell_up_and_says_who_paused(witnessed):
    seen, last = witnessed("navigate", order(signal.SIGTSTP))
    paused = seen[RunState.PAUSED]
    assert all(each.dwell is None and each.step is None for each in paused)
    assert paused[0].reason == "paused by SIGTSTP"
    assert paused[0].question.answers == ("continue", "abort")
    assert any("repeated" in message.text for message in last.messages)
    assert len(last.dwells) == 2


def test_a_hold_that_was_ordered_keeps_the_dwell_that_was_under_way(witnessed):
    seen, _ = witnessed("navigate", order(signal.SIGUSR1))
    holding = seen[RunState.HOLDING]
    assert [len(each.dwells) for each in holding[:1]] == [1]
    assert "ordered" in holding[0].reason


def test_time_and_readings_go_on_in_a_hold(witnessed):
    seen, _ = witnessed("navigate", order(signal.SIGUSR1))
    holding = seen[RunState.HOLDING]
    assert holding[-1].now_s > holding[0].now_s
    assert holding[-1].left_s == holding[0].left_s


def test_a_trip_waits_for_a_person_and_says_why_when_its_cause_is_gone(witnessed):
    def trip_table(bench):
        world = str(find_document("worlds", "ideal"))
        emulated = emulated_bench(BenchAddress(bench.clock.name, world, 0))
        emulated.serial["table"].trip(1, SoftwareFault.RATE_TRIP, bench.clock.now())

    seen, last = witnessed("navigate", trip_table, refuses="The run holds")
    held = seen[RunState.WAITING][-1]
    assert "rate trip" in held.reason
    assert held.alarms == ()
    assert held.question.answers == ("continue", "abort")
    assert last.state is RunState.STOPPED


def test_what_is_wrong_is_an_alarm_as_long_as_it_lasts(witnessed):
    seen, last = witnessed(faults="{fault: chamber_alarm, alarm: 2, at_s: 200, for_s: 20}")
    alarms = [{alarm.name for alarm in each.alarms} for each in seen[RunState.WAITING]]
    assert {"chamber_alarm"} in alarms
    assert seen[RunState.RUNNING][-1].alarms == ()
    assert last.state is RunState.FINISHED
