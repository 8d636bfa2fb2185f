import pytest

from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.drivers.emulators.bench import EmulatedBench

AT = "at_s: 10"


@pytest.fixture
def bench_with(tmp_path):
    """Make a bench of some dialects with one fault."""

    def make(fault, **dialects):
        path = tmp_path / "faults.yaml"
        path.write_text(f"faults:\n  - {{{fault}}}\n")
        return EmulatedBench(VirtualClock(), find_document("worlds", "quick"), 0, path, **dialects)

    return make


def until(bench, time_s):
    bench.clock.sleep_until(time_s)
    bench.advance()


@pytest.mark.parametrize(
    ("fault", "dialects", "reason"),
    [
        (f"fault: wrong_crc, {AT}", {"chamber": "thermotron_8800"}, "chamber of the dialect thermotron_8800"),
        (f"fault: exception_code, {AT}", {"chamber": "watlow_f4t"}, "chamber of the dialect watlow_f4t"),
        (f"fault: chamber_alarm, {AT}", {"chamber": "watlow_f4t"}, "chamber of the dialect watlow_f4t"),
        (f"fault: error_word, {AT}", {"table": "ideal_aerosmith"}, "table of the dialect ideal_aerosmith"),
        (f"fault: table_trips, {AT}", {"table": "ideal_aerosmith"}, "table of the dialect ideal_aerosmith"),
        (f"fault: interlock_opens, {AT}", {"table": "ideal_aerosmith"}, "the dialect ideal_aerosmith"),
        (f"fault: table_stalls, {AT}, axis: outer", {"table": "ideal_aerosmith"}, "has no outer axis"),
    ],
)
def test_a_fault_that_a_dialect_can_not_have_is_refused_by_name_and_place(
    bench_with, fault, dialects, reason
):
    kind = fault.split(",")[0].removeprefix("fault: ")
    with pytest.raises(DocumentError, match=rf"faults\.yaml:2:5: the fault '{kind}': .*{reason}"):
        bench_with(fault, **dialects)


@pytest.mark.parametrize("chamber", ["thermotron_8800", "watlow_f4t"])
@pytest.mark.parametrize(
    "fault", ["lost_reply", "half_reply", "garbage", "damaged_reply", "lost_request", "earlier_reply"]
)
def test_faults_of_the_line_go_with_every_dialect(bench_with, chamber, fault):
    requests = {"thermotron_8800": b"SETP1?\r", "watlow_f4t": b":SOURCE:CLOOP1:SPOINT?\n"}
    bench = bench_with(f"fault: {fault}, target: chamber, at_s: 10", chamber=chamber)
    right = bench.serial["chamber"].feed(requests[chamber], 0.0)
    assert right
    until(bench, 11.0)
    bench.serial["chamber"].feed(requests[chamber], 11.0)
    assert [each.kind for each in bench.injected] == [fault]
    assert bench.serial["chamber"].feed(requests[chamber], 12.0) == right


@pytest.mark.parametrize("chamber", ["thermotron_8800", "watlow_f4t"])
def test_a_chamber_that_restarts_drops_the_unit_and_is_silent_meanwhile(bench_with, chamber):
    on = {
        "thermotron_8800": (b"AUXE1,2\r", b"AUXE1?\r"),
        "watlow_f4t": (b":OUTPUT2:STATE ON\n", b":OUTPUT2:STATE?\n"),
    }
    command, query = on[chamber]
    bench = bench_with("fault: instrument_restarts, target: chamber, at_s: 10, for_s: 20", chamber=chamber)
    bench.serial["chamber"].feed(command, 1.0)
    assert bench.world.unit.powered
    until(bench, 15.0)
    assert not bench.world.unit.powered
    assert bench.serial["chamber"].feed(query, 15.0) == b""
    until(bench, 31.0)
    assert bench.serial["chamber"].feed(query, 31.0) in (b"0\r", b"OFF\n")


@pytest.mark.parametrize("chamber", ["thermotron_8800", "watlow_f4t"])
def test_a_broken_sensor_stops_the_control_until_it_is_repaired(bench_with, chamber):
    bench = bench_with("fault: chamber_sensor_error, at_s: 10, for_s: 20", chamber=chamber)
    until(bench, 15.0)
    assert bench.world.air.faults.blind
    until(bench, 35.0)
    assert not bench.world.air.faults.blind


def test_an_axis_of_a_single_axis_table_stalls_and_continues(bench_with):
    bench = bench_with("fault: table_stalls, at_s: 2, for_s: 5", table="ideal_aerosmith")
    bench.serial["table"].feed(b"SRV1\rMOV90\r", 0.0)
    until(bench, 6.0)
    stalled_deg = bench.world.axes[2].encoder(6.0).position_deg
    assert stalled_deg < 89.0
    until(bench, 60.0)
    assert bench.world.axes[2].encoder(60.0).position_deg == pytest.approx(90.0)


def test_a_single_axis_table_that_restarts_has_its_motor_off(bench_with):
    bench = bench_with("fault: instrument_restarts, target: table, at_s: 10", table="ideal_aerosmith")
    bench.serial["table"].feed(b"SRV1\r", 0.0)
    until(bench, 30.0)
    assert not bench.table.is_servoed(2)
