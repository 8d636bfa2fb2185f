"""What chambers that are commanded by text have in common, whatever their dialect."""

import contextlib
import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gyrobench.bench.foundations.errors import InstrumentError, RefusedError
from gyrobench.drivers.chamber import ChamberReading
from tests.drivers.conftest import Scripted, ThermotronBench, WatlowBench, any_rig

BENCHES = [ThermotronBench, WatlowBench]


@pytest.fixture(params=BENCHES)
def bench(request, rig):
    return request.param(rig)


def test_there_is_no_query_for_its_limits(bench):
    with pytest.raises(RefusedError, match="read them from its panel"):
        bench.driver().limits_c()


@pytest.mark.parametrize(
    ("temperature_c", "rate"),
    [(math.nan, None), (math.inf, 1.0), (20.0, math.nan), (20.0, 0.0), (20.0, -1.0), (20.0, math.inf)],
)
def test_numbers_that_can_not_be_commanded_are_not_sent(bench, temperature_c, rate):
    chamber = bench.driver()
    bench.heard.requests.clear()
    with pytest.raises(RefusedError, match="can't be commanded"):
        chamber.set_temperature(temperature_c, rate)
    assert bench.heard.requests == []


def test_without_a_rate_there_is_no_ramp(bench):
    chamber = bench.driver()
    chamber.set_temperature(60.0, 0.5)
    assert bench.air.ramp_rate_c_per_min == 0.5
    chamber.set_temperature(-40.0, None)
    assert (bench.air.set_point_c, bench.air.ramp_rate_c_per_min) == (-40.0, None)


def test_after_a_change_of_its_unit_at_the_panel_nothing_is_commanded_and_the_chamber_is_off(bench):
    chamber = bench.driver()
    chamber.set_temperature(20.0, 1.0)
    chamber.switch(True)
    bench.chamber.use_fahrenheit(True)
    with pytest.raises(RefusedError, match="unit was changed from °C to °F, so the chamber was switched off"):
        chamber.set_temperature(23.0, 1.0)
    assert (bench.air.set_point_c, bench.air.running) == (20.0, False)
    bench.chamber.use_fahrenheit(False)
    chamber.set_temperature(-40.0, None)
    assert chamber.read().set_point_c == -40.0


@pytest.mark.parametrize("end", [False, True])
def test_a_profile_is_refused_or_ended(bench, end):
    chamber = bench.driver()
    chamber.end_profiles = end
    bench.chamber.start_profile(85.0)
    assert (chamber.set_point_c(), chamber.read().is_on) == (23.0, True)
    if end:
        chamber.set_temperature(40.0, None)
        assert (bench.air.set_point_c, chamber.running_profile()) == (40.0, "")
        assert chamber.read().is_on
        return
    for command in (lambda: chamber.set_temperature(40.0, None), lambda: chamber.switch(True)):
        with pytest.raises(RefusedError, match=rf"runs a {bench.profile}, which overrides"):
            command()


@pytest.mark.parametrize("bench_type", BENCHES)
@given(
    replies=st.lists(
        st.binary(max_size=12) | st.sampled_from([b"0\r", b"22.0\r", b"NONE\n", b"22.0\n", b"ON\n", b"nan\n"])
    )
)
@example(replies=[b"22.0\r"] * 8)
@example(replies=[b"NONE\n", b"22.0\n", b"22.0\n", b"ON\n"])
def test_any_reply_gives_a_value_or_an_instrument_error(bench_type, replies):
    line, _ = any_rig().line("chamber", Scripted(*bench_type.opened, *replies))
    chamber = bench_type.driver_of(line)
    for action in (
        chamber.read,
        chamber.clear_alarms,
        lambda: chamber.set_temperature(20.0, 1.0),
        lambda: chamber.switch(True),
        lambda: chamber.switch_event(2, True),
    ):
        with contextlib.suppress(InstrumentError):
            result = action()
            if isinstance(result, ChamberReading):
                assert math.isfinite(result.temperature_c)
