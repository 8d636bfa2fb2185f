import pytest

from gyrobench.bench.foundations.errors import FaultError, NoReplyError, RefusedError, ReplyError
from gyrobench.drivers.chamber import ChamberReading
from gyrobench.drivers.chamber.thermotron_8800 import Thermotron8800
from gyrobench.drivers.emulators.thermotron_8800 import Stop
from tests.drivers.conftest import Scripted, ThermotronBench


@pytest.fixture
def make_bench(rig):
    return lambda **options: ThermotronBench(rig, **options)


@pytest.fixture(params=["never", "before", "instead"])
def bench(request, make_bench):
    return make_bench(echo=request.param)


@pytest.fixture
def chamber(bench):
    return bench.driver()


def test_a_temperature_and_its_ramp_are_commanded_and_read_back(bench, chamber):
    sent = bench.requests_of(lambda: chamber.set_temperature(22.0, 5.0))
    assert sent == [b"MODE?\r", b"MRMP1,5.000\r", b"MRMP1?\r", b"SETP1,22.000\r", b"SETP1?\r"]
    assert (bench.air.set_point_c, bench.air.ramp_rate_c_per_min) == (22.0, 5.0)
    assert chamber.set_point_c() == 22.0


def test_a_reading_in_fahrenheit_is_a_fault(bench, chamber):
    chamber.set_temperature(20.0, None)
    bench.chamber.use_fahrenheit(True)
    with pytest.raises(FaultError, match="unit was changed from °C to °F; change it back"):
        chamber.read()


def test_a_set_point_whose_confirmation_was_lost_is_not_taken_for_the_one_before_in_fahrenheit(
    chamber, monkeypatch
):
    chamber.set_temperature(10.0, None)
    command = chamber._command

    def loses_the_reply(text, *_):
        command(text)
        if text.startswith("SETP"):
            raise NoReplyError("chamber", "no reply")

    monkeypatch.setattr(chamber, "_command", loses_the_reply)
    with pytest.raises(NoReplyError):
        chamber.set_temperature(50.0, None)  # 10 degC is 50 degF
    monkeypatch.undo()
    assert chamber.read().set_point_c == 50.0
    chamber.set_temperature(50.0, None)


def test_a_reading_has_air_set_point_and_running_state(bench, chamber):
    bench.air.air_c = 22.0
    chamber.set_temperature(60.0, 1.0)
    assert b"PVAR1?\r" in bench.requests_of(chamber.read)
    assert chamber.read() == ChamberReading(22.0, 60.0, False, alarms=())
    assert bench.requests_of(lambda: chamber.switch(True))[1:3] == [b"RUNM\r", b"MODE?\r"]
    assert bench.air.running
    assert chamber.read().is_on
    assert b"STOP\r" in bench.requests_of(lambda: chamber.switch(False))
    assert not bench.air.running
    assert chamber.read().is_on is False


def test_auxiliaries_are_switched_one_by_one(bench, chamber):
    for number in (1, 2, 4, 5):
        chamber.switch_event(number, True)
    assert b"AUXE1,59\r" in bench.requests_of(lambda: chamber.switch_event(6, True))
    chamber.switch_event(9, True)
    chamber.switch_event(2, False)
    assert bench.events == [*((n, True) for n in (1, 2, 4, 5, 6, 9)), (2, False)]
    assert chamber.is_event_on(9)
    assert not chamber.is_event_on(2)


@pytest.mark.parametrize("number", [0, 17])
def test_auxiliary_numbers_are_1_to_16(bench, number):
    with pytest.raises(RefusedError, match=rf"no auxiliary {number}, only 1 to 16"):
        bench.driver().switch_event(number, True)


def test_refused_auxiliaries_name_the_need_for_a_running_chamber(make_bench):
    bench = make_bench(auxiliaries_need_run=True)
    chamber = bench.driver()
    with pytest.raises(RefusedError, match=r"AUXE1,2 was refused with code 3\. .*put a chamber step before"):
        chamber.switch_event(2, True)
    chamber.switch(True)
    chamber.switch_event(2, True)
    assert bench.events == [(2, True)]


@pytest.mark.parametrize(
    ("number", "high", "words"),
    [
        (1, False, ("low process alarm (bit 4 of ALRM1?)", "stopped by a process alarm (SCOD? 7)")),
        (1, True, ("high process alarm (bit 5 of ALRM1?)", "stopped by a process alarm (SCOD? 7)")),
        (2, False, ("low deviation alarm (bit 0 of ALRM1?)",)),
        (2, True, ("high deviation alarm (bit 1 of ALRM1?)",)),
    ],
)
def test_alarms_are_named(bench, chamber, number, high, words):
    chamber.switch(True)
    assert chamber.read().alarms == ()
    bench.chamber.raise_alarm(number, high)
    assert chamber.read().alarms == words
    chamber.clear_alarms()
    assert chamber.read().alarms == words
    bench.chamber.end_alarm(number)
    chamber.clear_alarms()
    assert chamber.read().alarms == ()


@pytest.mark.parametrize("code", Stop)
def test_the_stop_code_is_an_alarm_where_a_fault_stopped_it(bench, chamber, code):
    bench.chamber.stop_code = code
    if code == 6:
        with pytest.raises(FaultError, match=r"open temperature input \(SCOD\? 6\); check"):
            chamber.read()
    else:
        assert bool(chamber.read().alarms) == (code in (4, 7, 8, 9, 10))
    chamber.clear_alarms()
    assert chamber.read().alarms == ()


def test_clearing_does_not_stop_a_chamber_that_runs(bench, chamber):
    chamber.switch(True)
    chamber.clear_alarms()
    assert bench.air.running


def test_an_open_input_is_a_fault_until_it_is_repaired_and_cleared(bench, chamber):
    chamber.switch(True)
    bench.chamber.break_sensor(1)
    with pytest.raises(FaultError, match="open temperature input"):
        chamber.read()
    with pytest.raises(RefusedError, match="code 3"):
        chamber.switch(True)
    bench.chamber.repair_sensor()
    chamber.clear_alarms()
    chamber.switch(True)
    assert chamber.read().is_on


def test_it_comes_back_stopped_from_a_loss_of_power(bench, chamber):
    chamber.set_temperature(60.0, 5.0)
    chamber.switch(True)
    chamber.switch_event(2, True)
    bench.chamber.power_off(1.0)
    bench.chamber.power_on(2.0)
    assert bench.events[-1] == (2, False)
    assert chamber.read().alarms == ("stopped by a power failure (SCOD? 9)",)
    reading = chamber.read()
    assert (reading.set_point_c, reading.is_on) == (60.0, False)


def test_a_set_point_outside_the_controllers_range_is_refused(bench):
    with pytest.raises(RefusedError, match=r"SETP1,180.000 was refused with code 2"):
        bench.driver().set_temperature(180.0, None)


def test_identity(bench):
    assert bench.driver().identify() == "Thermotron 8800, version gyrobench emulator, channel 1"


def test_the_end_of_commands_is_an_option(make_bench):
    bench = make_bench()
    chamber = bench.driver(ending=b"\r\n")
    assert bench.requests_of(lambda: chamber.set_point_c()) == [b"SETP1?\r\n"]


@pytest.mark.parametrize(
    ("replies", "error", "message"),
    [
        ([], NoReplyError, r"no reply to MODE\? within 1 s .*line ending"),
        ([b"16"], NoReplyError, r"only '16'"),
        ([b"what?\r"], ReplyError, r"MODE\? was answered by 'what\?'"),
        ([b"-1\r"], ReplyError, "answered by '-1'"),
        ([b"\xff" * 300], ReplyError, r"answered by '\\xff"),
    ],
)
def test_another_device_is_an_error(rig, replies, error, message):
    line, _ = rig.line("chamber", Scripted(*replies))
    with pytest.raises(error, match=message):
        Thermotron8800(line)


def test_a_set_point_that_is_not_kept_is_refused(rig):
    kept = [b"20.000\r"] * 30
    line, _ = rig.line("chamber", Scripted(b"0\r", b"0\r", b"0\r", b"0.000\r", b"0\r", *kept))
    with pytest.raises(RefusedError, match="holds 20 as SETP1 although 60 was written"):
        Thermotron8800(line).set_temperature(60.0, None)


def test_after_a_late_reply_the_next_query_waits_for_silence(rig):
    bench = ThermotronBench(rig)
    chamber = bench.driver()
    bench.chamber.latency_s = 1.5
    with pytest.raises(NoReplyError):
        chamber.set_point_c()
    bench.chamber.latency_s, bench.air.air_c = 0.05, 40.0
    assert chamber.read().temperature_c == pytest.approx(40.0, abs=0.1)


@pytest.mark.parametrize(("asked", "held"), [(0.06, "0.1"), (0.14, "0.1"), (0.55, "0.6")])
def test_a_ramp_that_rounding_to_tenths_changes_is_refused(rig, asked, held):
    line, _ = rig.line("chamber", Tenths())
    chamber = Thermotron8800(line)
    with pytest.raises(RefusedError, match=rf"holds {held} degC/min as MRMP1 although {asked} was written"):
        chamber.set_temperature(60.0, asked)


def test_a_ramp_that_rounding_to_tenths_keeps_is_accepted(rig):
    line, _ = rig.line("chamber", Tenths())
    chamber = Thermotron8800(line)
    chamber.set_temperature(60.04, 1.04)
    assert chamber.set_point_c() == 60.0


class Tenths:
    """A controller that keeps tenths."""

    latency_s = 0.01

    def __init__(self):
        self._held = {}

    def feed(self, data, now_s):
        name, _, value = data.decode().strip().partition(",")
        if not value:
            return f"{self._held.get(name.rstrip('?'), '0')}\r\n".encode()
        self._held[name] = f"{float(value) + 1e-9:.1f}"
        return b"0\r\n"


def test_an_error_code_is_not_a_temperature(make_bench):
    with pytest.raises(RefusedError, match=r"PVAR2. was refused with code 2"):
        make_bench().driver(channel=2).read()


def test_replies_may_end_otherwise(make_bench):
    for line_ending in ("crlf", "lf"):
        assert make_bench(line_ending=line_ending).driver().set_point_c() == 23.0
