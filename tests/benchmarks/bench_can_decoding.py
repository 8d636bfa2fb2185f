"""Speed of decoding CAN frames in bulk, against cantools frame by frame."""

import time
from pathlib import Path

import can
import numpy as np

import gyrobench.drivers.ins
from gyrobench.drivers.frames import FrameBlock
from gyrobench.drivers.ins.dbc_codec import DbcCodec, load_dbc

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
