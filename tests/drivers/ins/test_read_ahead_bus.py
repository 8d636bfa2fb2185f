"""A bus between polls: a sender whose receiver's buffer holds fewer frames than arrive."""

import threading

import can
import pytest

from gyrobench.bench.foundations.clock import WallClock
from gyrobench.drivers.frames import concatenate
from gyrobench.drivers.ins.can_bus import block_receiver, close_bus, open_bus

#: As many frames as Linux holds for a SocketCAN socket, and those of some seconds.
HELD, SENT = 300, 3000


@pytest.fixture
def far(request):
    with can.Bus(request.node.name, interface="virtual", ignore_config=True) as far:
        yield far


@pytest.fixture
def near(request):
    bus = open_bus("virtual", request.node.name, WallClock(), rx_queue_size=HELD)
    yield bus
    close_bus(bus)


def receive(bus, count):
    blocks, recv_block = [], block_receiver(bus)
    while sum(map(len, blocks)) < count:
        blocks.append(recv_block())
    return concatenate(blocks)


def test_frames_that_the_adapter_can_not_hold_until_the_next_poll_are_kept(near, far):
    for number in range(SENT):
        far.send(can.Message(arbitration_id=number % 2048, is_extended_id=False, data=[1]), timeout=5.0)
    found = receive(near, SENT).arbitration_id
    assert found.tolist() == [number % 2048 for number in range(SENT)]


def test_a_poll_misses_nothing_that_the_thread_has_not_read_yet(near, far):
    """As after a stop of this process, which stops the thread too."""
    recv_block = block_receiver(near)
    for number in range(20):
        far.send(can.Message(arbitration_id=number, is_extended_id=False))
        assert recv_block().arbitration_id.tolist() == [number]


def test_frames_before_an_error_are_returned_first_and_the_bus_is_read_on(near, far, monkeypatch):
    recv, failed = near._bus.recv, threading.Event()

    def recv_once_without(timeout):
        message = recv(timeout)
        if message is not None and message.arbitration_id == 2 and not failed.is_set():
            failed.set()
            raise can.CanOperationError("bus error")
        return message

    monkeypatch.setattr(near._bus, "recv", recv_once_without)
    for number in (1, 2, 3):
        far.send(can.Message(arbitration_id=number, is_extended_id=False))
    assert failed.wait(5.0)
    assert receive(near, 1).arbitration_id.tolist() == [1]
    with pytest.raises(can.CanOperationError, match="bus error"):
        receive(near, 1)
    assert receive(near, 1).arbitration_id.tolist() == [3]


def test_it_sends_and_closes_the_bus_that_it_reads(near, far):
    near.send(can.Message(arbitration_id=7), timeout=1.0)
    assert far.recv(5.0).arbitration_id == 7
    before = threading.active_count()
    close_bus(near)
    close_bus(near)
    assert threading.active_count() == before - 1
    with pytest.raises(can.CanOperationError):
        near._bus.recv(0.0)
