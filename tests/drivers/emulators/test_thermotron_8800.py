from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.drivers.emulators.thermotron_8800 import Thermotron8800Emulator
from tests.drivers.emulators.conftest import ChamberPanel

Panel = partial(ChamberPanel, Thermotron8800Emulator)


@pytest.fixture
def panel():
    return Panel()


def test_values_are_answered_with_three_decimals(panel):
    panel.air.air_c = 22.0
    assert panel.ask(b"PVAR1?\r") == b"22.000\r"
    assert panel.ask(b"SETP1,22.000\r") == b"0\r"
    assert panel.ask(b"SETP1?\r") == b"22.000\r"
    assert panel.ask(b"MRMP1,5\r") == b"0\r"
    assert panel.ask(b"MRMP1?\r") == b"5.000\r"
    assert panel.ask(b"DEVN1,2.5\r") == b"0\r"
    assert panel.ask(b"DEVN1?\r") == b"2.500\r"
    assert (panel.air.set_point_c, panel.air.ramp_rate_c_per_min) == (22.0, 5.0)


def test_fahrenheit(panel):
    panel.chamber.use_fahrenheit(True)
    assert panel.ask(b"SETP1,212\rMRMP1,9\r") == b"0\r0\r"
    assert (panel.air.set_point_c, panel.air.ramp_rate_c_per_min) == (pytest.approx(100.0), 5.0)
    assert panel.ask(b"SETP1?\rMRMP1?\r") == b"212.000\r9.000\r"
    panel.chamber.use_fahrenheit(False)
    assert panel.ask(b"SETP1?\rMRMP1?\r") == b"100.000\r5.000\r"


def test_a_controller_may_repeat_what_it_is_sent():
    assert Panel(echo="before").ask(b"SETP1,22.000\r") == b"SETP1,22.000\r0\r"
    assert Panel(echo="before").ask(b"SETP1?\r") == b"SETP1?\r23.000\r"
    assert Panel(echo="instead").ask(b"SETP1,22.000\r") == b"SETP1,22.000\r"
    assert Panel(echo="instead").ask(b"SETP1?\r") == b"23.000\r"
    assert Panel(echo="instead").ask(b"SETP1,999\r") == b"2\r"


def test_it_runs_and_stops(panel):
    assert (panel.ask(b"MODE?\r"), panel.ask(b"SCOD?\r")) == (b"0\r", b"0\r")
    assert panel.ask(b"RUNM\r") == b"0\r"
    assert (panel.ask(b"MODE?\r"), panel.ask(b"SCOD?\r"), panel.air.running) == (b"16\r", b"1\r", True)
    assert panel.ask(b"STOP\r") == b"0\r"
    assert (panel.ask(b"MODE?\r"), panel.ask(b"SCOD?\r"), panel.air.running) == (b"0\r", b"5\r", False)
    panel.ask(b"RUNM\r")
    assert panel.ask(b"INIT\r") == b"0\r"
    assert not panel.air.running


@pytest.mark.parametrize("command", [b"HOLD\r", b"RESM\r"])
def test_without_a_program_nothing_can_be_held(panel, command):
    assert panel.ask(command) == b"3\r"


def test_auxiliaries_are_bits_of_two_groups(panel):
    assert panel.ask(b"AUXE1,59\r") == b"0\r"
    assert panel.ask(b"AUXE1?\r") == b"59\r"
    assert panel.events == [(n, True) for n in (1, 2, 4, 5, 6)]
    panel.ask(b"AUXE2,1\r")
    panel.ask(b"AUXE1,58\r")
    assert panel.events[-2:] == [(9, True), (1, False)]


def test_auxiliaries_may_need_a_running_chamber_and_drop_with_it():
    panel = Panel(auxiliaries_need_run=True)
    assert panel.ask(b"AUXE1,2\r") == b"3\r"
    panel.ask(b"RUNM\rAUXE1,2\rSTOP\r")
    assert panel.events == [(2, True), (2, False)]


def test_what_it_is_and_has_can_be_asked_for(panel):
    panel.air.power = 0.25
    assert panel.ask(b"IDEN?\r") == b"8800\r"
    assert panel.ask(b"VRSN?\r") == b"gyrobench emulator\r"
    assert panel.ask(b"THTL1?\r") == b"25.0\r"
    assert panel.ask(b"ALRM1?\r") == b"0\r"
    assert panel.ask(b"OPTN?\r") == b"0\r"
    assert panel.ask(b"CHST?\r") == b"257\r"


@pytest.mark.parametrize("request_", [b"FLY", b"FLYY", b"FLYY?"])
def test_what_is_not_known_is_answered_by_a_code(panel, request_):
    assert panel.ask(request_ + b"\r") == b"1\r"


@pytest.mark.parametrize(
    "request_",
    [
        b"SETP1,200", b"SETP2,20", b"SETP1", b"MRMP1,-1", b"AUXE3,1", b"AUXE1,256", b"RUNM1", b"SETP1,nan",
        b"PVAR2?",
    ],
)  # fmt: skip
def test_what_can_not_be_done_is_answered_by_a_code(panel, request_):
    assert panel.ask(request_ + b"\r") == b"2\r"
    assert panel.ask(b"\r\r\n") == b""


def test_requests_may_come_in_pieces_and_together(panel):
    assert [panel.ask(bytes([byte])) for byte in b"SCOD?\r"] == 5 * [b""] + [b"0\r"]
    assert panel.ask(b"SCOD?\r\nMODE?\n") == b"0\r0\r"
    assert panel.ask(b"A" * 1000 + b"\rSCOD?\r") == b"0\r"


@given(st.lists(st.binary(max_size=30)))
def test_any_bytes_are_accepted(pieces):
    panel = Panel()
    for piece in pieces:
        panel.ask(piece)
    assert panel.ask(b"\rSCOD?\r").endswith(b"\r")
