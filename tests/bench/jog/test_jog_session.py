"""A session of manual control on a bench in real time."""

import os
import signal
import subprocess

import pytest

from gyrobench.bench.foundations.shipped import find_document
from tests.bench.command_line import PROCESS
from tests.bench.guard.served_bench import ServedBench


@pytest.fixture
def served(tmp_path):
    bench = ServedBench(tmp_path)
    yield bench
    bench.close()


class Session:
    """`gyrobench jog` with commands through a pipe."""

    def __init__(self, station, cwd):
        self._process = subprocess.Popen(
            [*PROCESS, "jog", str(station)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=cwd,
            env=os.environ | {"TMPDIR": str(cwd)},
        )
        self.printed = []

    def type(self, line, until):
        """Type a line and read the output until a text is printed."""
        self._process.stdin.write(f"{line}\n")
        self._process.stdin.flush()
        for printed in self._process.stdout:
            self.printed.append(printed.rstrip("\n"))
            if until in printed:
                return
        raise AssertionError(f"{until!r} was never printed: {self.printed}")

    def end(self, number):
        """Send a signal; returns the exit code and the lines printed after it."""
        self._process.send_signal(number)
        printed = self._process.stdout.read().splitlines()
        code = self._process.wait()
        self._process.stdin.close()
        self._process.stdout.close()
        return code, printed


@pytest.mark.wall_time
def test_a_terminal_that_closes_leaves_the_bench_safe(served, tmp_path):
    _, before, _ = served.state()
    session = Session(served.station.path, tmp_path)
    session.type("chamber 40", until="chamber set to 40")
    session.type("table rate inner 10", until="inner axis turns")
    code, printed = session.end(signal.SIGHUP)
    assert code == 1
    assert "rate table's servos off" in printed
    rates_dps, interlocks, set_point_c = served.state()
    assert rates_dps == pytest.approx((0.0, 0.0), abs=0.01)
    assert interlocks == before
    assert set_point_c == pytest.approx(23.0)
    assert not list(tmp_path.glob("gyrobench-jog-*"))


@pytest.mark.wall_time
def test_a_turn_ends_at_its_limit_however_fast_commands_come(tmp_path):
    text = find_document("stations", "quick").read_text()
    text = text.replace("clock: virtual", "clock: wall\nspeed: 5")
    (tmp_path / "fast.yaml").write_text(text)
    commands = ["table rate outer 30", *["show"] * 80]
    run = subprocess.run(
        [*PROCESS, "jog", "fast.yaml", "--world", "quick"],
        input="\n".join(commands), capture_output=True, text=True, cwd=tmp_path, check=False,
    )  # fmt: skip
    assert "outer axis is close to its limit" in run.stdout
    assert run.stdout.index("is close to its limit") < run.stdout.rindex("jog> show")
    assert run.returncode == 0, run.stdout
