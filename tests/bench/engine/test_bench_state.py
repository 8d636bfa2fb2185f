"""What the bench is expected to do changes only by what happened."""

import pytest

from gyrobench.bench.engine.bench_state import BenchState, ExpectedState, UnitState
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.station.safe_state import SafeAction, SafePart
from gyrobench.bench.station.station import Station

#: Those of a chamber that controls its air.
SAFE_PARTS = [part for part in SafePart if part is not SafePart.CHAMBER_OFF]


@pytest.fixture
def state():
    return BenchState(Station(find_document("stations", "emulated")))


@pytest.fixture
def unit():
    return UnitState(Station(find_document("stations", "emulated")))


@pytest.mark.parametrize("name", ["expected", "run_position", "commanded_c"])
def test_nothing_else_can_write_it(state, name):
    with pytest.raises(AttributeError):
        setattr(state, name, None)


def test_a_set_point_is_expected_once_it_is_reached_and_until_another_is_commanded(state):
    state.chamber_commanded(40.0)
    assert (state.commanded_c, state.expected.chamber_reached) == (40.0, False)
    state.chamber_set_point_reached()
    assert state.expected == ExpectedState(chamber_set_c=40.0, chamber_on=True, chamber_reached=True)
    state.chamber_commanded(20.0)
    assert not state.expected.chamber_reached


def test_a_chamber_that_is_off_has_no_commanded_temperature(state):
    state.chamber_commanded(40.0)
    state.chamber_switching(False)
    assert state.expected == ExpectedState(), "a ramp of its set point may have ended anywhere"
    state.chamber_switched(False)
    assert state.commanded_c is None
    state.chamber_switched(True)
    assert state.expected == ExpectedState(chamber_on=True)
    state.chamber_commanded(40.0)
    state.chamber_switched(True)
    assert state.commanded_c == 40.0


def test_each_power_on_is_counted(state):
    state.run_resumed(2)
    state.units_powered(12.0)
    state.units_powered(20.0)
    assert (state.run_position.power_ons, state.run_position.powered_s) == (4, 20.0)


def test_a_power_on_ends_a_restart(unit):
    unit.restarted()
    assert not unit.has_restarted, "an INS that is off can't restart"
    unit.powered()
    unit.restarted()
    assert unit.has_restarted
    unit.powered()
    assert not unit.has_restarted


def test_the_safe_state_has_the_stations_set_point_open_servos_and_the_ins_as_it_was(state, unit):
    state.chamber_commanded(60.0)
    state.table_prepared()
    unit.powered()
    actions = [SafeAction(part.value, part) for part in SAFE_PARTS]
    for each in (state, unit):
        each.made_safe(actions)
    assert state.expected == ExpectedState(chamber_set_c=23.0, chamber_on=True, table_stopped=True)
    assert unit.expected == ExpectedState(ins_on=True)


def test_a_safe_command_that_failed_leaves_the_state_unknown(state):
    state.chamber_commanded(60.0)
    state.table_prepared()
    state.made_safe(SafeAction(part.value, part, "no reply") for part in SAFE_PARTS)
    assert state.expected == ExpectedState(chamber_set_c=None, chamber_on=True)


def test_a_chamber_that_was_switched_off_has_no_set_point(state):
    state.chamber_commanded(60.0)
    state.made_safe([SafeAction("set point", SafePart.CHAMBER), SafeAction("off", SafePart.CHAMBER_OFF)])
    assert state.expected == ExpectedState(chamber_set_c=None, chamber_on=False)


def test_a_chamber_that_refused_its_safe_set_point_at_first_may_be_off(state):
    state.chamber_commanded(60.0)
    refused = "chamber: it was commanded off, as it refuses its set point: runs a profile"
    state.made_safe([SafeAction("set point", SafePart.CHAMBER, first_problem=refused)])
    assert state.expected == ExpectedState(chamber_set_c=23.0, chamber_on=None)
