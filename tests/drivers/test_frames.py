"""Frames in blocks: the same contents and order as the messages they come from."""

import can
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.drivers.frames import ERROR_FRAME, EXTENDED_ID, REMOTE_FRAME, FrameBlock, concatenate


@st.composite
def frames(draw):
    kind = draw(st.sampled_from(["data", "remote", "error"]))
    extended = draw(st.booleans())
    data = draw(st.binary(max_size=8))
    return can.Message(
        timestamp=draw(st.floats(0, 1e9)),
        arbitration_id=draw(st.integers(0, 0x1FFF_FFFF if extended else 0x7FF)),
        is_extended_id=extended,
        is_remote_frame=kind == "remote",
        is_error_frame=kind == "error",
        dlc=len(data),
        data=None if kind == "remote" else data,
    )


@given(st.lists(frames(), max_size=20))
def test_messages_come_back_from_a_block_as_they_went_in(batch):
    block = FrameBlock.from_messages(batch)
    assert all(a.equals(b, timestamp_delta=0.0) for a, b in zip(block.messages(), batch, strict=True))
    assert block.arbitration_id.tolist() == [
        m.arbitration_id | (EXTENDED_ID if m.is_extended_id else 0) for m in batch
    ]
    assert all(not row[n:].any() for row, n in zip(block.data, block.length, strict=True))
    kept = [m.timestamp for m in batch if not (m.is_error_frame or m.is_remote_frame)]
    assert block.data_frames().timestamp_s.tolist() == kept


def test_frames_longer_than_a_classic_frame_are_left_out_and_kinds_are_flagged():
    block = FrameBlock.from_messages(
        [
            can.Message(arbitration_id=1, is_remote_frame=True, dlc=8),
            can.Message(arbitration_id=2, is_error_frame=True, data=bytes(8)),
            can.Message(arbitration_id=3, is_fd=True, data=bytes(8)),
            can.Message(arbitration_id=4, data=bytes(300)),
            can.Message(arbitration_id=5, data=bytes(8), is_extended_id=False),
        ]
    )
    assert block.arbitration_id.tolist() == [1 | EXTENDED_ID, 2 | EXTENDED_ID, 5]
    assert block.flags.tolist() == [REMOTE_FRAME, ERROR_FRAME, 0]


def test_blocks_join_in_order_and_split_by_identifier():
    def block(identifier, stamps):
        return FrameBlock.from_messages(
            [
                can.Message(timestamp=t, arbitration_id=identifier, is_extended_id=False, data=bytes(8))
                for t in stamps
            ]
        )

    joined = concatenate([block(4, [1.0, 2.0]), block(7, [3.0])])
    assert len(joined) == 3
    assert joined.with_id(4).timestamp_s.tolist() == [1.0, 2.0]
    assert len(joined.with_id(4 | EXTENDED_ID)) == 0
    assert np.array_equal(joined.take(slice(1, None)).timestamp_s, [2.0, 3.0])
    assert len(concatenate([])) == 0
