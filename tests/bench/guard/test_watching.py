import os

import pytest

from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.guard.watching import EngineEnd, GuardConfig, watch_engine


@pytest.fixture
def pipe():
    theirs, ours = os.pipe()
    ends = {"theirs": theirs, "ours": ours}
    yield ends
    for end in ends.values():
        os.close(end)


class JumpingClock(WallClock):
    """A machine that is suspended for an hour between any two readings of the clock."""

    jumps = 0

    def now(self):
        self.jumps += 1
        return super().now() + 3600.0 * self.jumps


def test_an_engine_that_closes_the_pipe_has_ended(pipe):
    os.write(pipe["ours"], b"...")
    os.close(pipe.pop("ours"))
    assert watch_engine(pipe["theirs"], 5.0, WallClock()) is EngineEnd.CLOSED


def test_a_release_counts_also_behind_beats_and_before_the_end(pipe):
    os.write(pipe["ours"], b"..R")
    os.close(pipe.pop("ours"))
    assert watch_engine(pipe["theirs"], 5.0, WallClock()) is EngineEnd.RELEASED


def test_silence_ends_the_watch(pipe):
    assert watch_engine(pipe["theirs"], 0.05, WallClock()) is EngineEnd.SILENT


def test_a_suspended_machine_is_no_silence(pipe):
    clock = JumpingClock()
    os.write(pipe["ours"], b".")
    assert watch_engine(pipe["theirs"], 3.0, clock) is EngineEnd.SILENT
    assert clock.jumps >= 4


def test_a_configuration_comes_through_a_pipe_unchanged(pipe):
    orders = GuardConfig("/a/station.yaml", "/a/run\n1", 60.0, 123, "2026-01-01T00:00:00+00:00", 7.5)
    os.write(pipe["ours"], orders.line() + b"..")
    assert GuardConfig.read(pipe["theirs"]) == orders
    assert os.read(pipe["theirs"], 10) == b".."


def test_an_engine_that_died_before_its_configuration_gives_none(pipe):
    os.write(pipe["ours"], b'{"station": ')
    os.close(pipe.pop("ours"))
    assert GuardConfig.read(pipe["theirs"]) is None
