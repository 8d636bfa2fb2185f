import can
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.drivers.ins.can_bus import EXTENDED_ID, FrameBlock, concatenate

messages = st.builds(
    can.Message,
    timestamp=st.floats(0, 1e9),
    arbitration_id=st.integers(0, 0x7FF),
    is_extended_id=st.booleans(),
    is_error_frame=st.booleans(),
    data=st.binary(max_size=8),
)


@given(st.lists(messages, max_size=20))
def test_every_data_frame_keeps_its_contents_and_order(batch):
    block = FrameBlock.from_messages(batch)
    kept = [m for m in batch if not m.is_error_frame]
    assert block.timestamp_s.tolist() == [m.timestamp for m in kept]
    assert block.arbitration_id.tolist() == [
        m.arbitration_id | (EXTENDED_ID if m.is_extended_id else 0) for m in kept
    ]
    assert [bytes(row[:n]) for row, n in zip(block.data, block.length, strict=True)] == [
        bytes(m.data) for m in kept
    ]
    assert all(not row[n:].any() for row, n in zip(block.data, block.length, strict=True))


def test_frames_that_are_not_classic_data_frames_are_left_out():
    block = FrameBlock.from_messages(
        [
            can.Message(arbitration_id=1, is_remote_frame=True, dlc=8),
            can.Message(arbitration_id=2, is_error_frame=True, data=bytes(8)),
            can.Message(arbitration_id=3, is_fd=True, data=bytes(8)),
            can.Message(arbitration_id=4, data=bytes(300)),
            can.Message(arbitration_id=5, data=bytes(8), is_extended_id=False),
        ]
    )
    assert block.arbitration_id.tolist() == [5]


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
