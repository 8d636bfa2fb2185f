import threading

import pytest

from gyrobench.bench.foundations.clock import VirtualClock, WallClock
from gyrobench.bench.foundations.errors import ConnectionFailedError, NoReplyError
from gyrobench.bench.station.time_limit import LimitedCall


def refuses():
    raise NoReplyError("chamber", "says nothing")


@pytest.mark.parametrize("make_clock", [VirtualClock, WallClock])
def test_results_and_errors_come_through(make_clock):
    assert LimitedCall(make_clock(), 10.0, "chamber", lambda: 7).result() == 7
    with pytest.raises(NoReplyError, match="says nothing"):
        LimitedCall(make_clock(), 10.0, "chamber", refuses).result()


def test_what_hangs_is_given_up_and_what_it_gives_later_is_discarded():
    may_end, discarded = threading.Event(), threading.Event()
    call = LimitedCall(WallClock(), 0.05, "rate table", lambda: may_end.wait(20), lambda _: discarded.set())
    with pytest.raises(ConnectionFailedError, match="rate table: its port did not respond"):
        call.result()
    assert not discarded.is_set()
    may_end.set()
    assert discarded.wait(20)


def test_while_it_waits_the_one_who_waits_may_go_on():
    done = threading.Event()
    LimitedCall(WallClock(), 20.0, "chamber", lambda: done.wait(20)).result(meanwhile=done.set)
    assert done.is_set()
