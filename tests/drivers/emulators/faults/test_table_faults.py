import pytest

from gyrobench.drivers.emulators.acl_axis import ServoMode, SoftwareFault

OUTER, INNER = 1, 2


@pytest.fixture
def servoed(rig):
    """Make a bench whose axes are servoed in position mode."""

    def make(*entries):
        bench = rig(*entries)
        for axis in bench.bench.table.axes.values():
            axis.close()
            axis.set_mode(ServoMode.POSITION)
        return bench

    return make


def look(bench, number=INNER):
    """The axis as the controller sees it now."""
    axis = bench.bench.table.axes[number]
    axis.begin_frame(bench.clock.now())
    return axis


def test_an_axis_that_stalls_trips_on_its_tracking_error(servoed):
    bench = servoed({"fault": "table_stalls", "during": "turn", "after_s": 1, "for_s": 10})
    look(bench).demand_position(90.0)
    bench.until(1.1)
    stalled_deg = look(bench).state.position_deg
    bench.until(6.0)
    axis = look(bench)
    assert axis.state.position_deg == pytest.approx(stalled_deg) == pytest.approx(24.0, abs=2.0)
    assert axis.software_faults == 1 << SoftwareFault.TRACKING_ERROR
    assert not axis.closed
    bench.until(20.0)
    assert look(bench).faulted
    assert look(bench).state.position_deg == axis.state.position_deg
    axis.reset()
    axis.close()
    axis.set_mode(ServoMode.POSITION)
    axis.demand_position(90.0)
    bench.until(40.0)
    assert look(bench).state.position_deg == 90.0
    assert bench.kinds == ["table_stalls"]


def test_a_short_stall_is_made_up_for(servoed):
    bench = servoed({"fault": "table_stalls", "at_s": 0.2, "for_s": 0.2})
    look(bench).demand_position(10.0)
    bench.until(0.5)
    assert look(bench).closed
    bench.until(10.0)
    assert look(bench).state.position_deg == 10.0


def test_a_position_is_not_reached_until_the_fault_is_over(servoed):
    bench = servoed({"fault": "position_not_reached", "at_s": 1, "for_s": 60, "short_by_deg": 0.25})
    bench.until(2.0)
    look(bench).demand_position(-10.0)
    bench.until(30.0)
    axis = look(bench)
    assert axis.state.position_deg == -9.75
    assert axis.following_error_deg == 0.25
    assert axis.closed
    bench.until(70.0)
    assert look(bench).state.position_deg == -10.0
    assert look(bench).following_error_deg == 0.0


def test_a_position_missed_by_more_than_the_tracking_limit_trips(servoed):
    bench = servoed({"fault": "position_not_reached", "at_s": 1, "short_by_deg": 2})
    bench.until(2.0)
    look(bench).demand_position(20.0)
    bench.until(30.0)
    assert look(bench).software_faults == 1 << SoftwareFault.TRACKING_ERROR


@pytest.mark.parametrize(("back", "after_deg"), [(True, 0.0), (False, 0.5)])
def test_an_axis_moved_by_hand_goes_back_or_not(servoed, back, after_deg):
    bench = servoed({"fault": "moved_by_hand", "at_s": 10, "for_s": 20, "by_deg": 0.5, "back": back})
    bench.until(25.0)
    assert look(bench).state.position_deg == pytest.approx(0.5)
    assert look(bench).following_error_deg == pytest.approx(0.5)
    bench.until(45.0)
    assert look(bench).state.position_deg == pytest.approx(after_deg)
    assert look(bench).following_error_deg == 0.0
    assert look(bench).closed


def test_an_axis_moved_far_by_hand_trips_and_stays_there(servoed):
    bench = servoed({"fault": "moved_by_hand", "at_s": 10, "for_s": 20, "by_deg": 30})
    for time_s in (11.0, 13.0, 15.0):
        bench.until(time_s)
        look(bench)
    bench.until(60.0)
    axis = look(bench)
    assert axis.software_faults & (1 << SoftwareFault.TRACKING_ERROR | 1 << SoftwareFault.RATE_TRIP)
    assert axis.state.position_deg == pytest.approx(30.0)


@pytest.mark.parametrize("trip", ["rate_trip", "coarse_feedback_loss"])
def test_a_trip_is_latched_until_a_reset(servoed, trip):
    bench = servoed({"fault": "table_trips", "axis": "outer", "at_s": 10, "trip": trip})
    bench.until(1000.0)
    axis = look(bench, OUTER)
    assert axis.software_faults == 1 << SoftwareFault[trip.upper()]
    assert not axis.closed
    assert look(bench, INNER).closed
    axis.reset()
    axis.close()
    assert axis.closed


def test_an_interlock_is_latched_and_can_be_reset_only_after_its_cause_is_gone(servoed):
    bench = servoed({"fault": "interlock_opens", "at_s": 10, "for_s": 60, "bit": 3})
    bench.until(20.0)
    axis = look(bench)
    assert axis.latched_interlocks == 1 << 3
    axis.reset()
    assert axis.faulted
    bench.until(80.0)
    assert look(bench).faulted
    axis.reset()
    axis.close()
    assert axis.closed


def test_an_open_interlock_outlives_a_restart_of_the_controller(servoed):
    bench = servoed(
        {"fault": "interlock_opens", "at_s": 10, "for_s": 60},
        {"fault": "instrument_restarts", "target": "table", "at_s": 20},
        {"fault": "instrument_restarts", "target": "table", "at_s": 80},
    )
    bench.until(40.0)
    assert look(bench).faulted
    bench.until(100.0)
    assert not look(bench).faulted
