"""Limits of manual control."""

from dataclasses import replace

import pytest

from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.jog.manual_limits import AxisRange, ManualLimits, manual_limits
from gyrobench.bench.jog.terminal import CommandError
from gyrobench.bench.station.instruments import Emulation, Outputs
from gyrobench.bench.station.station import Station

LIMITS = ManualLimits(
    {"outer": AxisRange(-200.0, 200.0, 30.0), "inner": AxisRange(-380.0, 380.0, 30.0)}, 30.0, -50.0, 75.0, 4.0
)


@pytest.mark.parametrize("angle_deg", [-200.0, 0.0, 200.0])
def test_an_angle_within_the_limits_passes(angle_deg):
    LIMITS.check_angle("outer", angle_deg)


@pytest.mark.parametrize("angle_deg", [-200.1, 200.1, float("nan"), float("inf")])
def test_an_angle_outside_is_refused_with_the_limits(angle_deg):
    with pytest.raises(CommandError, match=r"-200 to 200 deg\. Nothing was moved"):
        LIMITS.check_angle("outer", angle_deg)


@pytest.mark.parametrize("rate_dps", [30.1, -30.1, float("nan")])
def test_a_rate_too_high_in_either_direction_is_refused(rate_dps):
    LIMITS.check_rate("inner", -30.0)
    with pytest.raises(CommandError, match="limit of 30 deg/s"):
        LIMITS.check_rate("inner", rate_dps)


@pytest.mark.parametrize(
    ("temperature_c", "ramp"), [(75.1, 1.0), (-50.1, 1.0), (20.0, 4.1), (20.0, 0.0), (20.0, -1.0)]
)
def test_a_set_point_or_ramp_outside_is_refused(temperature_c, ramp):
    LIMITS.check_chamber(75.0, 4.0)
    with pytest.raises(CommandError):
        LIMITS.check_chamber(temperature_c, ramp)


def test_room_is_the_angle_left_before_braking_must_begin():
    # A second late at 10 deg/s, and twice the 100/60 deg of a constant deceleration for its jerk.
    assert LIMITS.room_deg("outer", 100.0, 10.0) == pytest.approx(100.0 - 10.0 - 100.0 / 30.0)
    assert LIMITS.room_deg("outer", 100.0, -10.0) == pytest.approx(300.0 - 10.0 - 100.0 / 30.0)
    assert LIMITS.room_deg("outer", 199.0, 10.0) < 0.0


def test_an_axis_that_the_table_does_not_have_is_refused():
    single = replace(LIMITS, axes={"inner": LIMITS.axes["inner"]})
    with pytest.raises(CommandError, match="no outer axis"):
        single.check_angle("outer", 0.0)


def test_the_narrower_of_station_and_controller_applies():
    clock, station = VirtualClock(), Station(find_document("stations", "emulated"))
    with Outputs(station, clock, Emulation("ideal")) as outputs:
        own = outputs.table.limits()
        found = manual_limits(station, outputs.table, outputs.chamber)
    ours = station.file.rate_table.limits
    assert found.axes["outer"].rate_dps == min(ours.rate_dps, own[0].rate_dps)
    assert found.axes["inner"].high_deg == min(ours.inner_deg[1], own[1].high_deg)
    low_c, high_c = station.file.chamber.limits.low_c, station.file.chamber.limits.high_c
    assert (found.low_c, found.high_c) == (low_c, high_c)


class NarrowTable:
    """A controller with narrower limits than the station."""

    def __init__(self, limits):
        self._limits = limits

    def limits(self):
        return self._limits


def test_narrower_limits_of_the_controller_apply():
    clock, station = VirtualClock(), Station(find_document("stations", "emulated"))
    with Outputs(station, clock, Emulation("ideal")) as outputs:
        narrow = tuple(
            replace(each, low_deg=-90.0, high_deg=80.0, rate_dps=7.0) for each in outputs.table.limits()
        )
        found = manual_limits(station, NarrowTable(narrow), outputs.chamber)
    assert set(found.axes.values()) == {AxisRange(-90.0, 80.0, 7.0)}
