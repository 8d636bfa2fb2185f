import struct
import time

import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st
from serial.serialutil import PortNotOpenError

from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.drivers import serial_line
from gyrobench.drivers.chamber.watlow_f4 import WatlowF4
from gyrobench.drivers.emulators.bench import BenchAddress, bench_at, parse_address
from gyrobench.drivers.rate_table.acutrol3000 import Acutrol3000

READ_PV = bytes.fromhex("01 03 00 64 00 01 C5 D5")
PV_23_C = bytes.fromhex("01 03 02 00 E6 39 CE")
IDENTIFY = b"*IDN?\r\n"


@pytest.fixture
def clock():
    return VirtualClock()


@pytest.fixture
def open_port(clock):
    ports = []

    def open_port(instrument, **options):
        url = f"emulator://{instrument}?clock={clock.name}&world=ideal"
        ports.append(serial.serial_for_url(url, **{"timeout": 1.0, **options}))
        return ports[-1]

    assert "gyrobench.drivers.emulators" in serial.protocol_handler_packages
    yield open_port
    for port in ports:
        port.close()


@pytest.fixture
def chamber(open_port):
    return open_port("chamber")


def test_pyserial_opens_the_table_and_the_chamber(open_port):
    table, chamber = open_port("table"), open_port("chamber")
    assert table.is_open
    table.write(IDENTIFY)
    error, length = struct.unpack("<II", table.read(8))
    assert error == 0
    assert b"Acutrol3000" in table.read(length)
    chamber.write(READ_PV)
    assert chamber.read(7) == PV_23_C


def test_a_read_takes_its_time_out_on_the_virtual_clock_alone(chamber, clock):
    chamber.timeout = 3600.0
    started_s = time.monotonic()
    assert chamber.read(5) == b""
    assert time.monotonic() - started_s < 30.0
    assert clock.now() == 3600.0


@pytest.mark.parametrize("timeout_s", [0, 0.0, None])
def test_a_read_that_may_not_wait_or_would_wait_for_ever_returns_at_once(chamber, clock, timeout_s):
    chamber.timeout = timeout_s
    assert chamber.read(5) == b""
    assert clock.now() == 0.0


def test_a_reply_comes_after_the_latency_of_the_instrument_and_ends_the_read(chamber, clock):
    latency_s = chamber._instrument.latency_s
    assert latency_s > 0.0
    chamber.write(READ_PV)
    assert clock.now() == 0.0
    assert chamber.read(7) == PV_23_C
    assert clock.now() == latency_s


def test_a_read_without_a_time_out_waits_for_what_is_on_its_way(chamber, clock):
    chamber.timeout = None
    chamber.write(READ_PV)
    assert chamber.read(7) == PV_23_C
    assert clock.now() == chamber._instrument.latency_s


def test_a_reply_is_not_there_before_its_latency(chamber, clock):
    chamber.timeout = chamber._instrument.latency_s / 2
    chamber.write(READ_PV)
    assert chamber.read(7) == b""
    assert clock.now() == chamber.timeout
    assert chamber.read(7) == PV_23_C


def test_a_read_for_more_than_comes_gives_what_came_after_the_whole_time_out(chamber, clock):
    chamber.write(READ_PV)
    assert chamber.read(100) == PV_23_C
    assert clock.now() == 1.0


def test_in_waiting_counts_what_has_arrived(chamber, clock):
    assert chamber.in_waiting == 0
    chamber.write(READ_PV)
    assert chamber.in_waiting == 0
    clock.sleep(1.0)
    assert chamber.in_waiting == 7
    assert chamber.read(3) == PV_23_C[:3]
    assert chamber.in_waiting == 4


def test_reset_input_buffer_throws_away_what_has_arrived_and_only_that(chamber, clock):
    chamber.write(READ_PV)
    clock.sleep(1.0)
    chamber.write(READ_PV)
    chamber.reset_input_buffer()
    assert chamber.in_waiting == 0
    assert chamber.read(7) == PV_23_C


def test_a_reset_of_the_output_buffer_unsends_nothing(chamber):
    chamber.write(READ_PV)
    chamber.flush()
    chamber.reset_output_buffer()
    assert chamber.read(7) == PV_23_C


@pytest.mark.parametrize(
    "use",
    [
        lambda port: port.read(1),
        lambda port: port.write(b"x"),
        lambda port: port.in_waiting,
        lambda port: port.reset_input_buffer(),
    ],
)
def test_a_closed_port_can_not_be_used(chamber, use):
    chamber.close()
    chamber.close()
    with pytest.raises(PortNotOpenError):
        use(chamber)


def test_an_open_port_can_not_be_opened_again_and_a_closed_one_can(chamber):
    with pytest.raises(serial.SerialException, match="already open"):
        chamber.open()
    chamber.write(READ_PV)
    chamber.close()
    chamber.open()
    chamber.write(READ_PV)
    assert chamber.read(100) == PV_23_C


def test_settings_of_a_real_port_are_taken_and_have_no_effect(chamber):
    chamber.baudrate, chamber.parity, chamber.rts, chamber.dtr = 115200, "E", False, False
    chamber.write(READ_PV)
    assert chamber.read(7) == PV_23_C


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("oven?world=ideal", "'oven'; available: chamber, table"),
        ("?world=ideal", "available: chamber, table"),
        ("table?world=atlantis", "atlantis"),
        ("table?clock=unknown-clock", "unknown-clock"),
        ("table?wrold=ideal", "wrold"),
        ("table?ideal", "'ideal'"),
        ("table?seed=-1", "seed"),
        ("table?seed=one", "seed"),
        ("table?seed=", "seed"),
        ("[table", "address"),
    ],
)
def test_a_wrong_address_is_a_serial_exception(address, words):
    with pytest.raises(serial.SerialException, match=words.replace("[", r"\[")):
        serial.serial_for_url(f"emulator://{address}")


def test_an_address_says_which_bench():
    assert parse_address("emulator://table") == ("table", BenchAddress())
    assert parse_address("emulator://chamber?seed=7&world=a/b.yaml&clock=clock-1&faults=c/d.yaml") == (
        "chamber",
        BenchAddress("clock-1", "a/b.yaml", 7, "c/d.yaml"),
    )


@given(rest=st.text(max_size=30))
def test_any_address_is_understood_or_refused(rest):
    try:
        name, address = parse_address(f"emulator://{rest}")
    except DocumentError:
        return
    assert isinstance(name, str)
    assert address.seed >= 0


def test_two_ports_of_one_address_share_one_world(open_port, clock):
    first, second = open_port("chamber"), open_port("chamber")
    assert first._bench is second._bench is bench_at(BenchAddress(clock.name, "ideal", 0))
    first.write(bytes.fromhex("01 06 01 2C 03 52 C8 F2"))  # set point 85.0
    first.read(8)
    second.write(bytes.fromhex("01 03 01 2C 00 01 44 3F"))
    assert second.read(7)[3:5] == bytes.fromhex("03 52")
    assert first.in_waiting == 0


def test_the_drivers_work_through_it(clock):
    def line(name):
        url = f"emulator://{name}?clock={clock.name}&world=ideal"
        return serial_line.SerialLine(name, url, clock)

    table, chamber = Acutrol3000(line("table")), WatlowF4(line("chamber"))
    world = bench_at(BenchAddress(clock.name, "ideal", 0)).world
    table.prepare()
    table.move_to({1: 90.0, 2: -20.0}, 20.0)
    chamber.set_temperature(40.0, None)
    chamber.switch(True)
    clock.sleep(1800.0)
    assert table.in_position()
    assert table.read().position_deg == pytest.approx((90.0, -20.0), abs=1e-5)
    assert chamber.read().temperature_c == pytest.approx(40.0, abs=0.1)
    assert world.air.air_c == pytest.approx(40.0, abs=0.1)
    chamber.switch_event(2, True)
    assert world.unit.powered
    chamber.switch_event(2, False)
    assert not world.unit.powered
    for driver in (table, chamber):
        driver.close()
