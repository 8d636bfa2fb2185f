"""Every recording in ``recordings/`` is replayed to its driver: each file added there is a test."""

from pathlib import Path

import pytest

from gyrobench.bench.recording.replay import replay

RECORDINGS = sorted(Path(__file__).with_name("recordings").glob("*.rec"))


@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)
def test_the_driver_sends_and_returns_what_was_recorded(path):
    recorded, calls = replay(path)
    assert recorded.header.calls, "the header names no call of the driver"
    assert calls == recorded.header.calls


def test_every_dialect_has_a_recording():
    recorded = {replay(path)[0].header.dialect for path in RECORDINGS}
    assert recorded >= {"acutrol3000", "ideal_aerosmith", "thermotron_8800", "watlow_f4", "watlow_f4t"}


def test_the_source_of_the_replies_is_recorded():
    assert {replay(path)[0].header.source for path in RECORDINGS} <= {"instrument", "emulator", "manual"}
