"""Signals are kept until somebody asks."""

import os
import signal

import pytest

from gyrobench.bench.jog.terminal import EndSessionError, Interruptions, StoppedByOperatorError


def test_ctrl_c_is_told_once():
    with Interruptions() as interruptions:
        interruptions.check()
        os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(StoppedByOperatorError):
            interruptions.check()
        interruptions.check()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_the_end_is_told_until_it_comes(number):
    with Interruptions() as interruptions:
        os.kill(os.getpid(), number)
        for _ in range(2):
            with pytest.raises(EndSessionError):
                interruptions.check()


def test_signals_do_afterwards_what_they_did_before():
    before = signal.getsignal(signal.SIGINT)
    with Interruptions():
        assert signal.getsignal(signal.SIGINT) != before
    assert signal.getsignal(signal.SIGINT) == before
