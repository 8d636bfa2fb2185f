import fcntl
import io
import math
import os
import pty
import re
import select
import struct
import subprocess
import sys
import termios
from dataclasses import replace

import pytest
from rich.console import Console

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.monitor.snapshot import RunState, read_snapshot
from gyrobench.bench.monitor.terminal import RunConsole
from gyrobench.bench.monitor.terminal_view import LinesView, observe_in_terminal
from gyrobench.bench.station.instruments import Emulation
from tests.bench.engine.intervention import short_dwell

ROW = DwellRow(
    unit="1000", run="1", dwell=1, cycle=1, position="z_down",
    start_s=0.0, end_s=1300.0, since_power_on_s=600.0,
    gyro_c=(-24.5, -24.0, -23.0), gyro_rate_c_per_h=(0.1, 0.1, 0.1),
    bias_dph=(-0.02587, 0.01234, 0.0), sigma_dph=(0.00146, 0.00146, 0.00114),
)  # fmt: skip


def printed(*rows):
    stream = io.StringIO()
    with LinesView(Console(file=stream, width=80), prepare_job("ten_minute_check", "emulated").plan) as view:
        for row in rows:
            view.dwell_measured(row)
    return stream.getvalue().splitlines()


def test_a_dwell_is_one_line_under_its_heads_within_80_columns():
    lines = printed(ROW)
    head, line = lines[-2:]
    assert max(map(len, lines)) <= 80
    assert line.split()[:4] == ["1/1", "1", "z_down", "-24.5"]
    assert "-25.87 ±1.46" in line
    assert line.index("z_down") == head.index("position")


def test_a_flagged_dwell_shows_its_reason_and_no_number():
    none = (math.nan,) * 3
    flagged = replace(ROW, bias_dph=none, gyro_c=none, flags=("the INS left navigation",))
    line, reason = printed(flagged)[-2:]
    assert line.endswith(" -  flagged")
    assert reason.rstrip() == "        the INS left navigation"
    assert "nan" not in line


def test_a_long_reason_is_folded_and_stays_indented():
    reasons = ("the INS left navigation at 12.3 s",) * 6
    lines = printed(replace(ROW, flags=reasons))
    below = lines[next(n for n, line in enumerate(lines) if line.endswith("flagged")) + 1 :]
    assert len(below) > 2
    assert all(line.startswith(" " * 8) and len(line) <= 80 for line in below)
    assert " ".join(" ".join(below).split()) == "; ".join(reasons)


def test_heads_stand_above_the_first_dwell_only():
    assert len(printed()) == 1
    assert sum(line.startswith("dwell ") for line in printed(ROW, ROW)) == 1


def test_a_bias_of_zero_has_no_minus():
    line = printed(replace(ROW, bias_dph=(-1e-7, 0.0, 0.0)))[-1]
    assert "-0.00" not in line


def test_one_dwell_has_no_plural():
    assert ", 1 dwell, " in printed()[0]


def test_nothing_but_text_goes_into_a_file():
    assert not any("\x1b" in line for line in printed(ROW))


@pytest.mark.parametrize("procedure", ["six_position_fig7", "three_temperature_shift"])
def test_the_plan_is_printed_before_it_begins(procedure):
    stream = io.StringIO()
    with LinesView(Console(file=stream, width=80), prepare_job(procedure, "emulated").plan):
        pass
    assert procedure in stream.getvalue()
    assert " dwells, " in stream.getvalue()


class Shown(LinesView):
    """Keeps what the line at the bottom of a terminal says."""

    def __enter__(self):
        super().__enter__()
        self.lines = []
        return self

    def ticked(self, bench, left_s):
        super().ticked(bench, left_s)
        line = str(self._status.status)
        if line not in self.lines[-1:]:
            self.lines.append(line)


@pytest.fixture(scope="module")
def lines(tmp_path_factory):
    """Lines of a run on a terminal, from first to last."""
    job = prepare_job("ten_minute_check", "emulated", Emulation("ideal", 0))
    console = Console(file=io.StringIO(), force_terminal=True, width=200)
    with Shown(console, job.plan) as view:
        run_job(job, tmp_path_factory.mktemp("terminal") / "run", view, ConsentingOperator())
    return view.lines


def test_on_a_terminal_biases_so_far_stand_beside_the_navigation_after_the_turn(lines):
    estimates = [number for number, line in enumerate(lines) if "±" in line]
    (turn,) = [number for number, line in enumerate(lines) if "turn 180 deg" in line]
    assert estimates
    assert min(estimates) > turn
    value = r"[-+]\d+\.\d±\d+\.\d"
    for number in estimates:
        assert re.search(rf"left \| x {value} y {value} z {value} \| z_up: navigate 2\.5 min$", lines[number])


def test_the_line_says_what_is_done_how_warm_it_is_and_how_long_it_takes(lines):
    warm = [line for line in lines if "±" not in line]
    assert all(re.match(r"\d+:\d\d h left \| chamber 2\d\.\d degC, ", line) for line in warm)
    assert any("z_up: align 2 min" in line for line in lines)


def test_the_status_line_drops_biases_with_their_step(lines):
    assert "±" not in lines[-1]


#: It takes longer than the view to draw twice.
PROCEDURE = """procedure: short
steps:
  - power_on
  - wait: {duration_s: 20000}
""" + short_dwell()
#: What the command does, without the seconds that a report takes.
PROGRAM = """
import sys
from pathlib import Path

from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.monitor.terminal import RunConsole
from gyrobench.bench.monitor.terminal_view import observe_in_terminal
from gyrobench.bench.station.instruments import Emulation

console = RunConsole(markup=False)
job = prepare_job("short.yaml", "emulated", Emulation("ideal"))
with observe_in_terminal(console, job, sys.argv[1] == "live") as (progress, operator):
    _, outcome = run_job(job, Path("run"), progress, operator)
console.print("The run", outcome.ended, outcome.reason, highlight=False)
"""
MOVES_CURSOR, HIDES_CURSOR, SHOWS_CURSOR = "\x1b[1A", "\x1b[?25l", "\x1b[?25h"
COLOURS = [f"\x1b[{bold}{number}m" for number in range(31, 37) for bold in ("", "1;")]


class OnTerminal:
    """A run in a process of its own, in the foreground of a terminal of its own."""

    def __init__(self, folder, view="live", **environment):
        self.far, self._near = pty.openpty()
        fcntl.ioctl(self._near, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 80, 0, 0))
        self.before = termios.tcgetattr(self._near)
        self.process = subprocess.Popen(
            ["setsid", "--ctty", "--wait", sys.executable, "-c", PROGRAM, view],
            cwd=folder,
            stdin=self._near,
            stdout=self._near,
            stderr=self._near,
            env={**os.environ, "TERM": "xterm-256color", "OPENBLAS_NUM_THREADS": "1", **environment},
        )
        self.shown = b""

    def read_until(self, text=None):
        """Read what is shown until a text comes, or until the end."""
        while text is None or text not in self.shown:
            if self._has_more():
                self.shown += os.read(self.far, 65536)
            elif self.process.poll() is not None:
                break
        assert text is None or text in self.shown
        return self.shown.decode()

    def _has_more(self):
        return bool(select.select([self.far], [], [], 0.1)[0])

    def is_as_before(self):
        return termios.tcgetattr(self._near) == self.before

    def close(self):
        self.process.kill()
        self.process.wait()
        os.close(self._near)
        os.close(self.far)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "short.yaml").write_text(PROCEDURE)
    (tmp_path / "shorter.yaml").write_text(PROCEDURE.replace("20000", "20"))
    return tmp_path


@pytest.fixture
def on_terminal(folder):
    runs = []

    def start(*options, **environment):
        runs.append(OnTerminal(folder, *options, **environment))
        return runs[-1]

    yield start
    for each in runs:
        each.close()


def test_a_terminal_shows_the_snapshot_and_is_as_before_at_the_end(folder, on_terminal):
    (folder / "short.yaml").write_text(PROCEDURE.replace("20000", "4000"))
    terminal = on_terminal()
    text = terminal.read_until()
    assert MOVES_CURSOR in text
    assert "RUNNING" in text
    assert "from now on: plan" in text
    assert any(colour in text for colour in COLOURS)
    assert text.index("RUNNING") < text.index("The run finished")
    assert text.rindex(SHOWS_CURSOR) > text.rindex(HIDES_CURSOR)
    assert terminal.is_as_before()


def test_ctrl_c_ends_the_run_and_leaves_the_terminal_as_it_was(on_terminal):
    terminal = on_terminal(NO_COLOR="1")
    terminal.read_until(b"RUNNING")
    assert not terminal.is_as_before()
    os.write(terminal.far, b"\x03")
    text = terminal.read_until()
    assert "stopped by the operator (Ctrl-C)" in text or "The run finished" in text
    assert text.rindex(SHOWS_CURSOR) > text.rindex(HIDES_CURSOR)
    assert terminal.is_as_before()
    assert not any(colour in text for colour in COLOURS)


@pytest.mark.parametrize(
    ("environment", "is_terminal"), [({"TERM": "dumb"}, True), ({}, False)], ids=["dumb terminal", "file"]
)
def test_text_alone_goes_where_no_cursor_moves(folder, environment, is_terminal):
    output = io.StringIO()
    console = RunConsole(
        file=output, force_terminal=is_terminal, width=80, markup=False, _environ=environment
    )
    job = prepare_job(str(folder / "shorter.yaml"), "emulated", Emulation("ideal"))
    with observe_in_terminal(console, job, wants_live=True) as (progress, operator):
        run_job(job, folder / "run", progress, operator)
    assert console.file is output
    text = output.getvalue()
    assert "  1/1       1  z_up" in text
    assert "from now on: plan" not in text
    assert MOVES_CURSOR not in text
    assert max(map(len, text.splitlines())) <= 80
    assert read_snapshot(folder / "run" / "live.json").state is RunState.FINISHED
