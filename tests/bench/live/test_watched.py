"""A run as it is seen: on a terminal, on one that can't move its cursor, and in a file."""

import fcntl
import io
import os
import pty
import select
import struct
import subprocess
import sys
import termios

import pytest

from gyrobench.bench.engine.run import run_job
from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.live.console import PatientConsole
from gyrobench.bench.live.picture import RunState, read_picture
from gyrobench.bench.live.watched import watched
from gyrobench.bench.station.instruments import Emulation

PROCEDURE = """procedure: short
steps:
  - power_on
  - go_to: {position: z_up, rate_dps: 30}
  - align: {duration_s: 60}
  - navigate: {duration_s: 61}
  - turn: {angle_deg: 180, rate_dps: 30, settle_s: 1}
  - navigate: {duration_s: 61}
"""
#: What the command does, without the seconds that a report takes.
PROGRAM = """
import sys
from pathlib import Path

from gyrobench.bench.engine.session import prepare_job, run_job
from gyrobench.bench.live.console import PatientConsole
from gyrobench.bench.live.watched import watched
from gyrobench.bench.station.instruments import Emulation

console = PatientConsole(markup=False)
job = prepare_job("short.yaml", "emulated", Emulation("ideal"))
with watched(console, job, sys.argv[1] == "live") as (progress, operator):
    _, outcome = run_job(job, Path("run"), progress, operator)
console.print("The run", outcome.ended, outcome.reason)
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


def test_a_terminal_shows_the_picture_and_is_as_before_at_the_end(on_terminal):
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
    assert "stopped by SIGINT" in text or "The run finished" in text
    assert text.rindex(SHOWS_CURSOR) > text.rindex(HIDES_CURSOR)
    assert terminal.is_as_before()
    assert not any(colour in text for colour in COLOURS)


@pytest.mark.parametrize(
    ("environment", "is_terminal"), [({"TERM": "dumb"}, True), ({}, False)], ids=["dumb terminal", "file"]
)
def test_text_alone_goes_where_no_cursor_moves(folder, environment, is_terminal):
    output = io.StringIO()
    console = PatientConsole(
        file=output, force_terminal=is_terminal, width=80, markup=False, _environ=environment
    )
    job = prepare_job(str(folder / "short.yaml"), "emulated", Emulation("ideal"))
    with watched(console, job, wants_live=True) as (progress, operator):
        run_job(job, folder / "run", progress, operator)
    assert console.file is output
    text = output.getvalue()
    assert "  1/1       1  z_up" in text
    assert "from now on: plan" not in text
    assert MOVES_CURSOR not in text
    assert max(map(len, text.splitlines())) <= 80
    assert read_picture(folder / "run" / "live.json").state is RunState.FINISHED
