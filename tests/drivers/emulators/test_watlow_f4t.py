from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.drivers.emulators.watlow_f4t import WatlowF4TEmulator
from tests.drivers.emulators.conftest import ChamberPanel

Panel = partial(ChamberPanel, WatlowF4TEmulator)


@pytest.fixture
def panel():
    return Panel()


def test_queries_are_answered_and_commands_are_not(panel):
    panel.air.air_c = 22.5
    assert panel.ask(b"*IDN?\n").startswith(b"WATLOW")
    assert panel.ask(b":SOURCE:CLOOP1:PVALUE?\n") == b"22.5000\n"
    assert panel.ask(b":SOURCE:CLOOP1:SPOINT 25\n") == b""
    assert panel.ask(b":SOURCE:CLOOP1:SPOINT?\n") == b"25.0000\n"
    assert panel.ask(b":SOURCE:CLOOP1:ERROR?\n") == b"NONE\n"
    panel.chamber.break_sensor(1)
    assert panel.ask(b":SOURCE:CLOOP1:ERROR?\n") == b"ERROR\n"


@pytest.mark.parametrize(
    ("action", "scale", "ramp"),
    [
        (b"OFF", b"MINUTES", None),
        (b"SETPOINT", b"MINUTES", 5.0),
        (b"BOTH", b"HOURS", 5.0 / 60.0),
        (b"STARTUP", b"MINUTES", None),
    ],
)
def test_ramps_follow_action_scale_and_rate(panel, action, scale, ramp):
    panel.ask(b":SOURCE:CLOOP1:RRATE 5\n:SOURCE:CLOOP1:RSCALE " + scale + b"\n")
    panel.ask(b":SOURCE:CLOOP1:RACTION " + action + b"\n")
    assert panel.ask(b":SOURCE:CLOOP1:RACTION?\n") == action + b"\n"
    assert panel.air.ramp_rate_c_per_min == ramp


def test_a_ramp_at_start_up_is_over_with_another_set_point(panel):
    panel.ask(b":SOURCE:CLOOP1:RRATE 2\n:SOURCE:CLOOP1:RACTION STARTUP\n:OUTPUT1:STATE ON\n")
    assert panel.air.ramp_rate_c_per_min == 2.0
    panel.ask(b":SOURCE:CLOOP1:SPOINT 60\n")
    assert panel.air.ramp_rate_c_per_min is None


def test_outputs_are_switched(panel):
    assert panel.ask(b":OUTPUT1:STATE?\n") == b"OFF\n"
    panel.ask(b":OUTPUT1:STATE ON\n:OUTPUT2:STATE ON\n:OUTPUT1:STATE OFF\n")
    assert panel.events == [(1, True), (2, True), (1, False)]
    assert panel.ask(b":OUTPUT2:STATE?\n") == b"ON\n"


def test_fahrenheit(panel):
    panel.ask(b":UNIT:TEMPERATURE F\n:SOURCE:CLOOP1:SPOINT 212\n")
    assert panel.air.set_point_c == pytest.approx(100.0)
    panel.ask(b":UNIT:TEMPERATURE C\n")
    assert panel.ask(b":SOURCE:CLOOP1:SPOINT?\n") == b"100.0000\n"


@pytest.mark.parametrize(
    "request_",
    [
        b":PROGRAM:NUMBER 1\n",
        b":PROGRAM:SELECTED:STATE START\n",
        b":SOURCE:CLOOP1:RTIME 5\n",
        b":SOURCE:CLOOP1:SPOINT 500\n",
        b":SOURCE:CLOOP1:SPOINT hot\n",
        b":SOURCE:CLOOP1:RRATE 0\n",
        b":SOURCE:CLOOP2:SPOINT 25\n",
        b":OUTPUT9:STATE ON\n",
        b":OUTPUT1:STATE MAYBE\n",
        b":NOTHING?\n",
        b"\n",
    ],
)
def test_what_it_can_not_do_is_passed_over(panel, request_):
    before = vars(panel.air).copy()
    assert panel.ask(request_) == b""
    assert vars(panel.air) == before
    assert panel.events == []


@given(st.lists(st.binary(max_size=30)))
def test_any_bytes_are_accepted(pieces):
    panel = Panel()
    for piece in pieces:
        panel.ask(piece)
    assert panel.ask(b"\n:OUTPUT2:STATE?\n").endswith(b"\n")
