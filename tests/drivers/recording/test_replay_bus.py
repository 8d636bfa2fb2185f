"""A recorded CAN log through the driver of the INS."""

import can
import pytest

from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.errors import ConnectionFailedError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.station.station import Station
from gyrobench.drivers.ins.can_bus import open_bus
from gyrobench.drivers.ins.can_ins import CanIns
from gyrobench.drivers.ins.dbc_codec import load_dbc
from gyrobench.drivers.ins.readout import InsMode


@pytest.fixture(params=[".log", ".asc", ".blf"])
def log(request, tmp_path):
    """Two seconds of the emulated INS at an epoch of 1 s, as a log of each kind."""
    clock = VirtualClock()
    world = str(find_document("worlds", "quick"))
    path = tmp_path / f"ins{request.param}"
    with open_bus("emulator", "ins", clock, world=world) as bus, can.Logger(path) as writer:
        bus._bench.world.power_unit(True)
        for _ in range(40):
            frame = bus.recv(30.0)
            writer.on_message_received(frame)
    return path


def stamps(log):
    with can.LogReader(log) as reader:
        return [frame.timestamp for frame in reader]


def test_the_driver_understands_the_log_at_the_pace_at_which_it_was_recorded(log):
    station, clock = Station(find_document("stations", "quick")), VirtualClock()
    stamps_s = stamps(log)
    section = station.file.ins
    bus = open_bus("replay", str(log), clock)
    ins = CanIns(bus, section.signals, load_dbc(station.dbc_path), clock)
    assert ins.sends_frames(30.0)
    assert "serial number 1003" in ins.identify()
    clock.sleep(0.5 + stamps_s[-1] - stamps_s[0])
    ins.poll()
    assert ins.frames == 40
    assert ins.status().mode is InsMode.STANDBY
    assert clock.now() >= stamps_s[-1] - stamps_s[0]
    ins.close()


def test_frames_come_no_sooner_than_they_did(log):
    clock = VirtualClock()
    with open_bus("replay", str(log), clock) as bus:
        first = bus.recv(0.0)
        second_s = next(stamp_s for stamp_s in stamps(log) if stamp_s > first.timestamp + 0.5)
        while (frame := bus.recv(None)).timestamp < second_s:
            pass
        assert clock.now() == pytest.approx(frame.timestamp - first.timestamp, abs=1e-4)


def test_blocks_hold_the_frames_that_single_reading_gives_when_they_are_due(log):
    clock = VirtualClock()
    with open_bus("replay", str(log), clock) as bus, can.LogReader(log) as reader:
        frames = [frame for frame in reader if frame.is_rx]
        zero_s = clock.now() - frames[0].timestamp
        read = []
        while len(read) < len(frames):
            block = bus.recv_block().messages()
            assert all(zero_s + frame.timestamp <= clock.now() for frame in block)
            read += block
            due = sum(zero_s + frame.timestamp <= clock.now() for frame in frames)
            assert len(read) == due
            single = bus.recv(0.0)
            assert single is None
            clock.sleep(0.35)
    assert all(
        a.equals(b, timestamp_delta=0.0, check_channel=False) for a, b in zip(read, frames, strict=True)
    )


def test_after_the_last_frame_nothing_comes(log):
    with open_bus("replay", str(log), VirtualClock()) as bus:
        while bus.recv(100.0) is not None:
            pass
        assert bus.recv(None) is None


def test_a_command_is_refused(log):
    with open_bus("replay", str(log), VirtualClock()) as bus:
        message = can.Message(arbitration_id=0x200, data=b"\x01", is_extended_id=False)
        with pytest.raises(can.CanOperationError, match="can't receive 0x200"):
            bus.send(message)


def test_a_missing_log_is_an_error(tmp_path):
    with pytest.raises(ConnectionFailedError, match=r"can't replay .*absent\.log"):
        open_bus("replay", str(tmp_path / "absent.log"), VirtualClock())
