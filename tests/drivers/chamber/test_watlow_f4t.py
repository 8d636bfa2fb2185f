import pytest

from gyrobench.bench.foundations.errors import FaultError, NoReplyError, RefusedError, ReplyError
from gyrobench.drivers.chamber.watlow_f4t import WatlowF4T
from tests.drivers.conftest import Echoing, Scripted, WatlowBench

LOOP = b":SOURCE:CLOOP1:"
OPENED = WatlowBench.opened


@pytest.fixture
def make_bench(rig):
    return lambda **options: WatlowBench(rig, **options)


@pytest.fixture(params=[1, 4])
def bench(request, make_bench):
    return make_bench(decimals=request.param)


def test_it_is_identified_and_set_to_degrees_celsius(bench):
    assert bench.requests_of(bench.driver) == [
        b"*IDN?\n", b":UNIT:TEMPERATURE C\n", b":UNIT:TEMPERATURE?\n", b":PROGRAM:SELECTED:STATE?\n",
    ]  # fmt: skip
    assert "F4T" in bench.driver().identify()
    assert bench.driver().identify().endswith("control loop 1")


def test_a_controller_that_was_set_to_fahrenheit_works(rig):
    bench = WatlowBench(rig)
    bench.chamber.feed(b":UNIT:TEMPERATURE F\n", 0.0)
    bench.air.air_c = 25.0
    assert bench.chamber.feed(LOOP + b"PVALUE?\n", 0.0) == b"77.0000\n"
    assert bench.driver().read().temperature_c == pytest.approx(25.0, abs=0.01)


def test_a_temperature_and_its_ramp_are_commanded_and_read_back(bench):
    chamber = bench.driver()
    sent = bench.requests_of(lambda: chamber.set_temperature(25.0, 5.0))
    assert sent == [
        b":UNIT:TEMPERATURE?\n", b":PROGRAM:SELECTED:STATE?\n",
        LOOP + b"RRATE 5\n", LOOP + b"RRATE?\n",
        LOOP + b"RSCALE MINUTES\n", LOOP + b"RSCALE?\n",
        LOOP + b"RACTION SETPOINT\n", LOOP + b"RACTION?\n",
        LOOP + b"SPOINT 25\n", LOOP + b"SPOINT?\n",
    ]  # fmt: skip
    assert (bench.air.set_point_c, bench.air.ramp_rate_c_per_min) == (25.0, 5.0)
    assert chamber.set_point_c() == 25.0


def test_a_ramp_too_slow_for_the_controller_to_hold_is_refused(make_bench):
    with pytest.raises(RefusedError, match=r"holds 0 degC/min as RRATE although 0\.04 was written"):
        make_bench(decimals=1).driver().set_temperature(60.0, 0.04)


def test_a_ramp_that_rounding_to_tenths_changes_is_refused(make_bench):
    bench = make_bench(decimals=1)
    with pytest.raises(RefusedError, match=r"holds 0\.1 degC/min as RRATE although 0\.06 was written"):
        bench.driver().set_temperature(60.0, 0.06)
    assert bench.air.set_point_c != 60.0
    bench.driver().set_temperature(60.0, 1.04)


def test_a_reading_has_air_set_point_and_running_state(make_bench):
    bench = make_bench()
    chamber = bench.driver()
    bench.air.air_c = -12.25
    assert bench.requests_of(chamber.read) == [
        LOOP + b"ERROR?\n", LOOP + b"PVALUE?\n", b":OUTPUT1:STATE?\n", LOOP + b"SPOINT?\n",
    ]  # fmt: skip
    chamber.set_temperature(60.0, 1.0)
    assert bench.requests_of(lambda: chamber.switch(True))[1] == b":OUTPUT1:STATE ON\n"
    reading = chamber.read()
    assert (reading.set_point_c, reading.is_on) == (60.0, True)
    assert bench.air.running
    assert bench.requests_of(lambda: chamber.switch(False))[0] == b":OUTPUT1:STATE OFF\n"
    assert not bench.air.running
    assert chamber.read().is_on is False


def test_outputs_are_switched(bench):
    chamber = bench.driver(chamber_output=3)
    chamber.switch_event(2, True)
    chamber.switch(True)
    assert bench.events == [(2, True), (3, True)]
    assert (chamber.is_event_on(2), chamber.is_event_on(4)) == (True, False)
    with pytest.raises(RefusedError, match="no output 9, only 1 to 8"):
        chamber.switch_event(9, True)


def test_an_error_of_the_loop_is_a_fault(bench):
    chamber = bench.driver()
    assert chamber.read().alarms == ()
    bench.chamber.break_sensor(1)
    with pytest.raises(FaultError, match="control loop 1 reports an error; check the temperature sensor"):
        chamber.read()
    bench.chamber.repair_sensor()
    chamber.clear_alarms()
    assert chamber.read().alarms == ()


def test_outputs_drop_with_its_power(bench):
    chamber = bench.driver()
    chamber.switch(True)
    chamber.switch_event(2, True)
    bench.chamber.power_off(1.0)
    bench.chamber.power_on(2.0)
    assert bench.events == [(1, True), (2, True), (1, False), (2, False)]
    assert chamber.read().is_on is False


def test_a_set_point_that_the_controller_ignores_is_refused(bench):
    with pytest.raises(RefusedError, match="holds 23 as SPOINT although 180 was written"):
        bench.driver().set_temperature(180.0, None)


def test_another_loop_has_separate_commands(rig):
    line, heard = rig.line("chamber", Scripted(*OPENED, b"25.0\n"))
    assert WatlowF4T(line, loop=2).set_point_c() == 25.0
    assert heard.requests[-1] == b":SOURCE:CLOOP2:SPOINT?\n"


@pytest.mark.parametrize(("state", "is_on"), [(b"ON", True), (b"off", False), (b"1", True), (b"0", False)])
def test_a_state_is_a_word_or_a_number(rig, state, is_on):
    line, _ = rig.line("chamber", Scripted(*OPENED, state + b"\r\n"))
    assert WatlowF4T(line).is_event_on(1) is is_on


def test_a_word_may_come_back_short(rig):
    line, _ = rig.line("chamber", Scripted(*OPENED, b"C\n", b"IDLE\n", b"", b"OFF\n", b"", b"25.0\n"))
    WatlowF4T(line).set_temperature(25.0, None)
    line, _ = rig.line(
        "chamber",
        Scripted(*OPENED, b"C\n", b"IDLE\n", b"", b"5.0\n", b"", b"MIN\n", b"", b"SETP\n", b"", b"25.0\n"),
    )
    WatlowF4T(line).set_temperature(25.0, 5.0)


@pytest.mark.parametrize(
    ("reply", "error", "message"),
    [
        (b"", NoReplyError, r"no reply to :SOURCE:CLOOP1:ERROR\? within 1 s"),
        (b"MAYBE\n", ReplyError, "was answered by 'MAYBE'"),
        (b"\xfe\xff\n", ReplyError, r"was answered by '\\xfe\\xff'"),
    ],
)
def test_an_unexpected_reply_is_an_error(rig, reply, error, message):
    line, _ = rig.line("chamber", Scripted(*OPENED, reply))
    with pytest.raises(error, match=message):
        WatlowF4T(line).read()


def test_a_controller_without_queries_for_unit_and_profile_is_used_without_them(rig):
    without = [b"", b"F4T\n"] * 4
    line, heard = rig.line("chamber", Scripted(b"F4T\n", b"", *without, b"", b"OFF\n", b"", b"25.0\n"))
    chamber = WatlowF4T(line)
    chamber.set_temperature(25.0, None)
    assert chamber.running_profile() == ""
    assert heard.requests[-1] == LOOP + b"SPOINT?\n"


def test_one_lost_reply_disables_neither_check_of_unit_nor_of_profile(rig):
    lost = [b"", b"F4T\n"]
    opened = [b"F4T\n", b"", *lost, b"C\n", *lost, b"IDLE\n"]
    line, _ = rig.line("chamber", Scripted(*opened, b"", b"F\n", b"", b"OFF\n", b"", b"RUN\n"))
    chamber = WatlowF4T(line)
    with pytest.raises(NoReplyError):
        chamber.set_temperature(25.0, None)
    with pytest.raises(RefusedError, match="its unit was changed"):
        chamber.set_temperature(25.0, None)
    with pytest.raises(NoReplyError):
        chamber.running_profile()
    assert chamber.running_profile() == "a profile (its state is RUN)"


def test_the_echo_of_an_adapter_is_no_reply(rig):
    """Nor is the echo of a command, which has no reply, that of the next query."""
    bench = WatlowBench(rig)
    bench.heard.instrument = Echoing(bench.chamber)
    chamber = bench.driver()
    assert "F4T" in chamber.identify()
    chamber.set_temperature(25.0, 5.0)
    chamber.switch(True)
    assert bench.air.running
    reading = chamber.read()
    assert (reading.set_point_c, reading.is_on) == (25.0, True)
    bench.heard.instrument = Echoing(Scripted())
    with pytest.raises(NoReplyError, match=r"no reply to :SOURCE:CLOOP1:ERROR\? within"):
        chamber.read()
