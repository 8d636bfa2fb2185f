"""Speed of CAN frames in bulk, from the bus to decoded signals and log, against frame by frame."""

import time
from itertools import pairwise
from pathlib import Path

import can
import numpy as np

import gyrobench.drivers.ins
from gyrobench.bench.engine.live_unit import Capture
from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.documents import parse_document, validate
from gyrobench.bench.runs.can_log import CanLog, read_can_log
from gyrobench.drivers.frames import FrameBlock, concatenate
from gyrobench.drivers.ins.can_ins import CanIns
from gyrobench.drivers.ins.dbc_codec import DbcCodec, load_dbc
from gyrobench.drivers.ins.navigation_data import decode_navigation
from gyrobench.drivers.ins.signal_map import SignalMap
from tests.drivers.ins.conftest import SIGNALS, make_recording

FRAMES = 200_000
MESSAGE = "HEADING"


def measure() -> dict[str, float]:
    """Seconds for the same frames by cantools, in bulk, and from Message objects to a block."""
    codec = DbcCodec(load_dbc(Path(gyrobench.drivers.ins.__file__).with_name("gyrobench_ins.dbc")))
    message = codec.database.get_message_by_name(MESSAGE)
    payloads = [bytes(row) for row in np.random.default_rng(0).integers(0, 256, (FRAMES, 8), dtype=np.uint8)]
    frames = [
        can.Message(timestamp=i * 0.1, arbitration_id=message.frame_id, is_extended_id=False, data=payload)
        for i, payload in enumerate(payloads)
    ]
    start = time.perf_counter()
    one_by_one = [message.decode(payload, decode_choices=False) for payload in payloads]
    after_cantools = time.perf_counter()
    block = FrameBlock.from_messages(frames)
    after_block = time.perf_counter()
    in_bulk = codec.decode(block, MESSAGE)
    end = time.perf_counter()
    for name, values in in_bulk.items():
        assert np.allclose(values, [decoded[name] for decoded in one_by_one], rtol=1e-15, atol=0.0)
    return {
        "cantools_s": after_cantools - start,
        "block_s": after_block - after_cantools,
        "bulk_s": end - after_block,
        "speed_up": (after_cantools - start) / (end - after_block),
        "block_us_per_frame": (after_block - after_cantools) / FRAMES * 1e6,
    }


def test_bulk_decoding_equals_cantools_and_is_much_faster():
    runs = [measure() for _ in range(3)]
    speed_up = min(run["cantools_s"] for run in runs) / min(run["bulk_s"] for run in runs)
    print(f"bulk decoding: {speed_up:.0f} times cantools")
    print(f"frames to arrays: {min(run['block_us_per_frame'] for run in runs):.2f} us per frame")
    assert speed_up > 20.0


DBC = Path(gyrobench.drivers.ins.__file__).with_name("gyrobench_ins.dbc")
SECONDS = 3600


class GivenBus(can.BusABC):
    """A bus with frames for each second, in blocks or one by one."""

    channel_info = "given"

    def __init__(self, frames: FrameBlock, in_blocks: bool) -> None:
        super().__init__("given")
        ends = np.searchsorted(frames.timestamp_s, np.arange(SECONDS + 1) - 1e-3).tolist()
        self._blocks = (frames.take(slice(*edges)) for edges in pairwise(ends))
        if in_blocks:
            self.recv_block = self._blocks.__next__
        else:
            self._messages = (each for block in self._blocks for each in (*block.messages(), None))

    def _recv_internal(self, timeout):
        return next(self._messages), True

    def send(self, msg, timeout=None):
        raise NotImplementedError


def by_blocks(frames: FrameBlock, folder: Path) -> float:
    """Processor time in us a second of the bench: poll, capture, log."""
    signal_map = validate(parse_document(SIGNALS, Path("station.yaml")), SignalMap)
    clock, log, capture = VirtualClock(), CanLog(folder), Capture(1)
    bus = GivenBus(frames, in_blocks=True)
    driver = CanIns(bus, signal_map, load_dbc(DBC), clock)

    def received(block):
        log.write(block)
        capture.add(block)

    driver.on_frames = received
    begin_s = time.process_time()
    for _ in range(SECONDS):
        driver.poll()
    log.cut()
    polled_s = time.process_time()
    decode_navigation(capture.frames(), signal_map, driver.codec)
    decoded_s = time.process_time()
    assert np.array_equal(concatenate([part for _, part in read_can_log(folder)]).data, frames.data)
    read_s = time.process_time()
    for name, took_s in (("poll, capture, log", polled_s - begin_s), ("decode", decoded_s - polled_s),
                         ("read the log", read_s - decoded_s)):  # fmt: skip
        print(
            f"  {name}: {took_s / SECONDS * 1e6:.1f} us a second, {took_s / len(frames) * 1e6:.3f} us a frame"
        )
    bus.shutdown()
    return decoded_s - begin_s


def by_messages(frames: FrameBlock, path: Path) -> float:
    """The same by python-can's messages: its writer, and cantools for each frame."""
    codec = DbcCodec(load_dbc(DBC))
    bus = GivenBus(frames, in_blocks=False)
    received = []
    begin_s = time.process_time()
    with can.BLFWriter(path, compression_level=1) as log:
        for _ in range(SECONDS):
            while (message := bus.recv(0.0)) is not None:
                log.on_message_received(message)
                received.append(message)
    bus.shutdown()
    assert len(received) == len(frames)
    for message in received[: len(received) // 10]:
        codec.database.decode_message(message.arbitration_id, message.data, decode_choices=False)
    return time.process_time() - begin_s


def test_from_the_bus_to_signals_and_log(tmp_path):
    frames = make_recording(DbcCodec(load_dbc(DBC)), 0, 10 * SECONDS)
    print()
    blocks_s = min(by_blocks(frames, tmp_path / f"{n}") for n in range(3))
    messages_s = by_messages(frames, tmp_path / "messages.blf")
    print(
        f"bus to signals and log: {blocks_s / len(frames) * 1e6:.2f} us a frame in blocks of a second, "
        f"{messages_s / len(frames) * 1e6:.2f} us by messages (1 of 10 decoded); "
        f"{messages_s / blocks_s:.0f} times"
    )
    assert blocks_s / len(frames) < 1e-6
