import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.drivers.emulators.ideal_aerosmith import IdealAerosmithEmulator
from gyrobench.drivers.emulators.world.table_axis import AxisParameters, TableAxis


class Panel:
    def __init__(self, **options):
        self.axis = TableAxis(AxisParameters(rate_limit_dps=400.0))
        self.table = IdealAerosmithEmulator(self.axis, **options)
        self.now_s = 1.0

    def ask(self, request, after_s=0.0):
        self.now_s += after_s
        return self.table.feed(request, self.now_s)


@pytest.fixture
def panel():
    panel = Panel()
    assert panel.ask(b"SRV1\r") == b">"
    return panel


def test_a_value_comes_with_a_prompt_after_it(panel):
    assert panel.ask(b"MOV123.456\r") == b">"
    assert panel.ask(b"PPO\r", 60.0) == b"123.4560\r>"
    assert panel.ask(b"PPO\r\n") == b"123.4560\r>"
    assert panel.ask(b"PVE\r") in (b"0.0000\r>", b"-0.0000\r>")


def test_the_prompt_of_a_jog_comes_with_the_stop(panel):
    assert panel.ask(b"JOG10.5\r") == b""
    assert panel.ask(b"PVE\r", 5.0) == b"10.5000\r>"
    assert panel.ask(b"STO\r") == b">>"
    assert panel.ask(b"STO\r") == b">"


def test_the_prompt_of_a_jog_comes_with_the_next_status(panel):
    panel.ask(b"JOG-10.5\r")
    assert panel.ask(b"STA\r", 5.0) == b">1\r>"
    assert panel.ask(b"STO\r") == b">"
    assert panel.ask(b"STA\r", 60.0) == b"0\r>"


def test_the_prompt_of_a_jog_may_come_at_once():
    panel = Panel(jog_prompt="at_once")
    assert panel.ask(b"SRV1\rJOG10\r") == b">>"
    assert panel.ask(b"STO\r") == b">"


@pytest.mark.parametrize("done", [0, 1])
def test_both_conventions_of_a_complete_motion(done):
    panel = Panel(done=done)
    panel.ask(b"SRV1\rP30\r")
    assert panel.ask(b"MCO0.01\r", 0.5) == b"%d\r>" % (1 - done)
    assert panel.ask(b"MCO0.01\r", 60.0) == b"%d\r>" % done
    assert panel.ask(b"MCO\r") == b"%d\r>" % done


def test_it_moves_by_and_to_and_home(panel):
    panel.ask(b"VEL90\rACL20\rMOV30\r")
    panel.ask(b"RMO-10\r", 60.0)
    assert panel.ask(b"PPO\r", 60.0) == b"20.0000\r>"
    panel.ask(b"HOF5\rHOM\r")
    assert panel.ask(b"PPO\r", 60.0) == b"5.0000\r>"
    assert panel.ask(b"PZR\r") == b">"
    assert panel.ask(b"PPO\r") == b"0.0000\r>"
    panel.ask(b"MOV10\r")
    assert panel.axis.encoder(panel.now_s + 60.0).position_deg == pytest.approx(15.0)


def test_the_direction_of_a_jog_may_be_turned_round(panel):
    panel.ask(b"DIR1\rJOG10\r")
    assert panel.ask(b"PVE\r", 5.0) == b"-10.0000\r>"


def test_it_loses_its_motor_with_its_power(panel):
    panel.ask(b"JOG10\r")
    panel.table.power_off(panel.now_s + 2.0)
    panel.table.power_on(panel.now_s + 3.0)
    assert panel.ask(b"JOG10\r", 10.0) == b"?\r>"
    assert not panel.table.is_servoed(2)
    with pytest.raises(KeyError):
        panel.table.is_servoed(1)


@pytest.mark.parametrize(
    "command",
    [
        b"FLY", b"JOG", b"JOG401", b"JOGx", b"MOV", b"MOV1e9", b"VEL0", b"VEL-1", b"ACL0", b"SRV2", b"DIR2",
        b"AMP10", b"FRQ1", b"PER2", b"CYC3", b"SGO", b"CAL", b"CLU1", b"REX", b"SAV", b"P",
    ],
)  # fmt: skip
def test_what_is_not_understood_is_answered_with_a_question_mark(panel, command):
    assert panel.ask(command + b"\r") == b"?\r>"


def test_without_the_motor_nothing_moves(panel):
    panel.ask(b"SRV0\r")
    assert panel.ask(b"MOV30\rJOG10\rHOM\r") == 3 * b"?\r>"
    assert not panel.axis.is_moving(panel.now_s)


@given(st.lists(st.binary(max_size=30)))
def test_any_bytes_are_accepted(pieces):
    panel = Panel()
    for piece in pieces:
        panel.ask(piece, 0.1)
    assert panel.ask(b"\rPPO\r").endswith(b"\r>")
