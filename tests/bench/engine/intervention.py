"""What tests of interrupted runs share: a procedure, and observers and operators that interrupt it."""

from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.observers import RunObserver
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.station.instruments import Emulation
from gyrobench.drivers.emulators.bench import BenchAddress, bench_at


def short_dwell(position="z_up", align_s=60, navigate_s=61, indent=2):
    """Steps of a procedure file: a dwell with two navigations around half a turn."""
    steps = (
        f"go_to: {{position: {position}, rate_dps: 30}}",
        f"align: {{duration_s: {align_s}}}",
        f"navigate: {{duration_s: {navigate_s}}}",
        "turn: {angle_deg: 180, rate_dps: 30, settle_s: 1}",
        f"navigate: {{duration_s: {navigate_s}}}",
    )
    return "".join(f"{' ' * indent}- {step}\n" for step in steps)


TWO_TEMPERATURES = (
    """procedure: two_temperatures
steps:
  - power_on: {settle_s: 20}
  - repeat:
      over: {temperature_c: [35, 25]}
      steps:
        - chamber: {temperature_c: $temperature_c, ramp_c_per_min: 10}
        - soak: {for_s: 30}
        - repeat:
            over: {position: [z_up, y_down]}
            steps:
"""
    + short_dwell("$position", align_s=16, indent=14)
    + "  - power_off\n  - chamber_off\n"
)


class KilledError(BaseException):
    """Stands for a kill where a separate process would cost seconds."""


class Intervention(RunObserver):
    """Acts once, in the nth step of some kind; the world is ``ideal``."""

    def __init__(self, kind, action, nth=1):
        self.kind = kind
        self.action = action
        self.left = nth
        self.done = False
        self.now = ""
        self.bench = None
        self._world = str(find_document("worlds", "ideal"))

    def step_started(self, planned, bench):
        self.now = planned.step.name
        self.left -= self.now == self.kind

    def ticked(self, live, left_s):
        clock = live.clock
        self.bench = self.bench or bench_at(BenchAddress(clock.name, self._world, 0))
        if self.now == self.kind and self.left == 0 and not self.done:
            self.done = True
            self.bench.advance()
            self.action(self.bench, clock)


class RefusingOperator(ConsentingOperator):
    """Gives the last answer: stop, abort."""

    def ask(self, question, answers):
        self._answer = answers[-1]


def run_with(tmp_path, kind, action, procedure="ten_minute_check", nth=1, operator=None):
    """Run a procedure with an intervention; returns run folder, outcome and emulated bench."""
    intervention = Intervention(kind, action, nth)
    job = prepare_job(str(procedure), "emulated", Emulation("ideal", 0))
    folder, outcome = run_job(job, tmp_path / "run", intervention, operator or RefusingOperator())
    assert intervention.done
    return folder, outcome, intervention.bench
