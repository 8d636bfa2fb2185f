import pytest


@pytest.fixture
def at(rig):
    """Make a bench whose chamber is on its way to a set point."""

    def make(set_point_c, *entries):
        bench = rig(*entries)
        bench.world.air.set_point_c = set_point_c
        bench.world.air.running = True
        return bench

    return make


def air_c(bench, time_s):
    bench.until(time_s)
    bench.bench.chamber.feed(b"", time_s)
    return bench.world.air.air_c


@pytest.mark.parametrize(("set_point_c", "held_c"), [(60.0, 55.0), (-20.0, -15.0)])
def test_the_temperature_is_not_reached_until_the_fault_is_over(at, set_point_c, held_c):
    bench = at(set_point_c, {"fault": "temperature_not_reached", "at_s": 10, "for_s": 3000, "by_c": 5})
    assert air_c(bench, 2900.0) == pytest.approx(held_c, abs=0.1)
    assert air_c(bench, 4000.0) == pytest.approx(set_point_c, abs=0.1)
    assert bench.kinds == ["temperature_not_reached"]


@pytest.mark.parametrize(("set_point_c", "held_c"), [(60.0, 68.0), (-20.0, -28.0)])
def test_the_temperature_overshoots_in_the_direction_of_the_ramp(at, set_point_c, held_c):
    bench = at(set_point_c, {"fault": "temperature_overshoots", "during": "ramp", "for_s": 3000, "by_c": 8})
    assert air_c(bench, 2900.0) == pytest.approx(held_c, abs=0.1)
    assert air_c(bench, 4000.0) == pytest.approx(set_point_c, abs=0.1)


def test_a_sensor_error_stops_the_control_until_it_is_cleared(at):
    bench = at(60.0, {"fault": "chamber_sensor_error", "at_s": 1000, "for_s": 100, "error": 3})
    chamber = bench.bench.chamber
    reached_c = air_c(bench, 999.0)
    air_c(bench, 1050.0)
    assert chamber.sensor_error == 3
    assert air_c(bench, 1200.0) < reached_c - 0.5
    assert chamber.sensor_error == 3
    clear(bench, 311)
    assert chamber.sensor_error == 0
    assert air_c(bench, 2000.0) == pytest.approx(60.0, abs=0.1)


def test_a_sensor_error_can_not_be_cleared_while_its_cause_is_there(at):
    bench = at(60.0, {"fault": "chamber_sensor_error", "at_s": 10})
    air_c(bench, 20.0)
    clear(bench, 311)
    assert bench.bench.chamber.sensor_error == 1


@pytest.mark.parametrize(("alarm", "state", "number"), [(1, "high", 2), (2, "low", 1)])
def test_an_alarm_stays_until_it_is_cleared_after_its_cause(at, alarm, state, number):
    bench = at(23.0, {"fault": "chamber_alarm", "at_s": 10, "for_s": 60, "alarm": alarm, "state": state})

    def latched():
        bench.bench.chamber.feed(b"", bench.clock.now())
        return getattr(bench.bench.chamber, f"alarm_{alarm}")

    bench.until(20.0)
    clear(bench, 312)
    assert latched() == number
    bench.until(100.0)
    assert latched() == number
    clear(bench, 312)
    assert latched() == 0


def test_an_open_door_lets_the_temperature_jump_and_drift_to_the_room(at):
    bench = at(-20.0, {"fault": "door_opened", "at_s": 3000, "for_s": 600, "share": 0.5})
    before_c = air_c(bench, 2999.0)
    assert before_c == pytest.approx(-20.0, abs=0.1)
    assert air_c(bench, 3000.0) == pytest.approx(1.5, abs=0.2)
    assert air_c(bench, 3500.0) > 15.0
    assert air_c(bench, 5000.0) == pytest.approx(-20.0, abs=0.1)


def test_a_chamber_switched_off_at_the_panel_drifts_while_its_controller_says_on(at):
    bench = at(-20.0, {"fault": "switched_off_at_panel", "at_s": 3000, "for_s": 1800})
    assert air_c(bench, 4700.0) > -10.0
    assert bench.world.air.running
    assert bench.world.air.power == 0.0
    assert air_c(bench, 6000.0) == pytest.approx(-20.0, abs=0.1)


def test_the_set_point_is_changed_at_the_panel(at):
    bench = at(-20.0, {"fault": "set_point_changed_at_panel", "at_s": 100, "to_c": 40})
    assert air_c(bench, 3000.0) == pytest.approx(40.0, abs=0.1)


def clear(bench, register):
    port = bench.port("chamber")
    request = bytes([1, 6, register >> 8, register & 0xFF, 0, 1])
    port.write(request + crc(request))
    assert port.read(8)[:6] == request


def crc(content):
    value = 0xFFFF
    for byte in content:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return value.to_bytes(2, "little")
