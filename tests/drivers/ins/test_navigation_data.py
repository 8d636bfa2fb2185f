from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.station.station import Station
from gyrobench.drivers.frames import FrameBlock, concatenate
from gyrobench.drivers.ins.attitude import EulerSequence, attitude_matrices
from gyrobench.drivers.ins.dbc_codec import DbcCodec, load_dbc
from gyrobench.drivers.ins.navigation_data import (
    EpochCounts,
    _epoch_steps,
    decode_increments,
    decode_navigation,
)
from gyrobench.drivers.ins.readout import Alignment, InsMode
from tests.drivers.ins.conftest import make_frames

HEADING_ID, VELOCITY_ID, TIME_ID, STATUS_ID = 0x007, 0x004, 0x001, 0x010


def without(block, arbitration_id, *which):
    """The block without the frames of that identifier at those places among their own kind."""
    rows = np.flatnonzero(block.arbitration_id == arbitration_id)[list(which)]
    return block.take(np.delete(np.arange(len(block)), rows))


def test_epochs_hold_time_velocity_and_states_of_the_frames(recording, signal_map, codec):
    found = decode_navigation(recording(0, 100), signal_map, codec)
    assert found.ins_time_s == pytest.approx(100 + np.arange(100) / 10, abs=1e-9)
    assert found.velocity_enu_mps[:, 0] == pytest.approx(np.arange(100) * -1e-4)
    assert found.velocity_enu_mps[:, 1] == pytest.approx(np.arange(100) * 1e-3)
    assert found.velocity_enu_mps[:, 2] == pytest.approx(-0.5)
    assert (found.mode == InsMode.NAVIGATE).all()
    assert (found.alignment == Alignment.FINE).all()
    assert found.timestamp_s == pytest.approx(np.arange(100) / 10 + 0.002)
    assert found.counts == EpochCounts()
    assert not found.segment.any()


def test_temperatures_have_the_time_of_the_epoch_they_were_sent_with(recording, signal_map, codec):
    found = decode_navigation(recording(0, 100), signal_map, codec).temperatures
    assert found.ins_time_s == pytest.approx(100 + np.arange(10))
    assert found.optics_c[:, 0] == pytest.approx(20 + np.arange(10) * 0.1)
    assert found.electronics_c[3] == pytest.approx([30, 31, 32])
    assert found.case_c == pytest.approx(18)


def test_temperatures_on_several_pages_of_a_multiplexed_message_are_all_read(in_pages, signal_map):
    codec, block = in_pages
    found = decode_navigation(block, signal_map, codec).temperatures
    assert found.ins_time_s == pytest.approx(100 + np.arange(10))
    expected = np.stack([20 + np.arange(10) * 0.1, np.full(10, 21), np.full(10, 22)], axis=1)
    assert found.optics_c == pytest.approx(expected)
    assert found.spread_k[:, :3] == pytest.approx(np.zeros((10, 3)))


def test_a_time_on_one_page_of_a_multiplexed_message_is_not_that_of_the_frames_of_another(
    codec_with, recording, make_signal_map
):
    codec = codec_with({"TIME_S :": "TIME_S m1 :", "TIME_NS :": "PAGE M :"})
    whole = recording(0, 100)
    is_time = whole.arbitration_id == codec.arbitration_id("SYSTEM_TIME")
    times_s = whole.timestamp_s[is_time]
    first = make_frames(codec, "SYSTEM_TIME", times_s, {"PAGE": 1, "TIME_S": 100 + np.arange(10)})
    second = make_frames(codec, "SYSTEM_TIME", times_s + 0.5, {"PAGE": 2})
    block = concatenate([whole.take(~is_time), first, second]).in_order()
    found = decode_navigation(block, make_signal_map({"time_ns: SYSTEM_TIME.TIME_NS": ""}), codec)
    assert found.ins_time_s == pytest.approx(100 + 0.1 * np.arange(100))
    assert found.counts.restarts == 0


def test_temperatures_that_are_not_mapped_are_nan(recording, make_signal_map, codec):
    signal_map = make_signal_map(
        {
            "gyro_electronics_temperature:\n  x: GYRO_ELECTRONICS_TEMPERATURE.X\n"
            "  y: GYRO_ELECTRONICS_TEMPERATURE.Y\n  z: GYRO_ELECTRONICS_TEMPERATURE.Z\n": "",
            "case_temperature: GYRO_ELECTRONICS_TEMPERATURE.CASE\n": "",
        }
    )
    found = decode_navigation(recording(0, 100), signal_map, codec).temperatures
    assert found.optics_c.shape == found.electronics_c.shape == (10, 3)
    assert np.isnan(found.electronics_c).all()
    assert np.isnan(found.case_c).all()


def test_a_heading_is_yaw_with_the_other_sign(recording, signal_map, codec):
    found = decode_navigation(recording(0, 20, roll=3.0, pitch=-2.0, heading=40.0), signal_map, codec)
    expected = attitude_matrices(EulerSequence.RPY_321, *np.radians([3.0, -2.0, -40.0]))
    assert found.attitude[5] == pytest.approx(expected, abs=1e-9)


def test_the_euler_sequence_is_the_last_one_received_before_each_epoch(recording, signal_map, codec):
    block = recording(0, 40, roll=10.0, pitch=20.0, sequence=np.array([0, 0, 1, 1]))
    found = decode_navigation(block, signal_map, codec)
    angles = np.radians([10.0, 20.0, 0.0])
    for sequence, epochs in ((EulerSequence.RPY_321, slice(0, 20)), (EulerSequence.PRY_231, slice(20, 40))):
        assert found.attitude[epochs] == pytest.approx(
            np.broadcast_to(attitude_matrices(sequence, *angles), (20, 3, 3)), abs=1e-9
        )


def test_the_attitude_is_unknown_until_the_sequence_is_received_and_while_it_is_invalid(
    recording, signal_map, codec
):
    valid = np.ones(30)
    valid[25:] = 0
    found = decode_navigation(without(recording(0, 30, valid=valid), STATUS_ID, 0), signal_map, codec)
    unknown = np.isnan(found.attitude).all(axis=(1, 2))
    assert np.flatnonzero(unknown).tolist() == [*range(10), *range(25, 30)]
    assert (found.mode[:10] == InsMode.UNKNOWN).all()


def test_epochs_that_lack_a_frame_are_dropped_and_counted(recording, signal_map, codec):
    block = without(recording(0, 50), VELOCITY_ID, 12, 13)
    block = without(block, HEADING_ID, 30)
    found = decode_navigation(block, signal_map, codec)
    assert found.counts == EpochCounts(lost=3)
    kept = np.setdiff1d(np.arange(50), [12, 13, 30])
    assert found.ins_time_s == pytest.approx(100 + kept / 10)
    assert found.velocity_enu_mps[:, 1] == pytest.approx(kept * 1e-3)


@pytest.mark.parametrize("late_s", [0.04, 0.07, 0.3, 5.0])
def test_an_epoch_whose_last_frames_come_late_is_not_lost(recording, signal_map, codec, late_s):
    block = recording(0, 50)
    begin = np.flatnonzero(block.arbitration_id == HEADING_ID)[20]
    stamps_s = block.timestamp_s + late_s * (np.arange(len(block)) >= begin)
    found = decode_navigation(block.with_fields(time_s=stamps_s), signal_map, codec)
    assert replace(found.counts, late=0) == EpochCounts()
    assert found.ins_time_s == pytest.approx(100 + np.arange(50) / 10)


@pytest.mark.parametrize("step_s", [-86400.0, -3600.0, 600.0, 3600.0, 86400.0])
def test_setting_the_clock_of_the_can_interface_is_no_restart_and_loses_no_epoch(
    recording, signal_map, codec, step_s
):
    """As a calendar corrected by NTP: the kernel and socketcand stamp frames with it."""
    block = recording(0, 50)
    stamps_s = block.timestamp_s + step_s * (block.timestamp_s > 2.5)
    found = decode_navigation(block.with_fields(time_s=stamps_s), signal_map, codec)
    assert replace(found.counts, late=0) == EpochCounts()
    assert found.ins_time_s == pytest.approx(100 + np.arange(50) / 10)


def test_setting_the_clock_of_the_can_interface_is_no_reset_of_a_time_in_microseconds_that_wraps():
    """Of 32 bits, which wraps after 72 min, with epochs of 40 ms that are some microseconds late."""
    late_us = np.random.default_rng(1).integers(0, 40, 200)
    time_s = (4_290_000_000 + 40_000 * np.arange(200) + late_us) % 2**32 * 1e-6
    arrival = np.arange(200.0) + 90_000.0 * (np.arange(200) >= 60)
    steps, is_reset = _epoch_steps(time_s / 0.04, 2**32 * 1e-6 / 0.04, np.diff(arrival))
    assert steps == pytest.approx(1.0, abs=0.01)
    assert not is_reset.any()


@pytest.mark.parametrize("whole", [0, 3])
def test_the_halves_of_two_epochs_do_not_make_one(recording, signal_map, codec, whole):
    block = without(recording(0, 50), HEADING_ID, *range(20, 21 + whole))
    block = without(block, VELOCITY_ID, *range(21, 22 + whole))
    found = decode_navigation(block, signal_map, codec)
    kept = np.setdiff1d(np.arange(50), np.arange(20, 22 + whole))
    assert found.velocity_enu_mps[:, 1] == pytest.approx(kept * 1e-3)
    assert found.counts.lost == 2 + whole


def test_epochs_cut_off_at_the_edges_are_not_lost(recording, signal_map, codec):
    block = recording(0, 50)
    first = np.flatnonzero(block.arbitration_id == VELOCITY_ID)[0]
    last = np.flatnonzero(block.arbitration_id == HEADING_ID)[-1]
    found = decode_navigation(block.take(slice(first + 1, last)), signal_map, codec)
    assert found.counts == EpochCounts()
    assert len(found.ins_time_s) == 48


def test_the_counter_wraps_without_a_break(recording, signal_map, codec):
    found = decode_navigation(recording(0, 100, counter_offset=65500), signal_map, codec)
    assert found.counts == EpochCounts()
    assert found.ins_time_s == pytest.approx(100 + np.arange(100) / 10, abs=1e-9)


@pytest.mark.parametrize(("changed", "contradicted"), [(0, 0), (1, 10)])
def test_frames_that_come_twice_in_an_epoch_count_where_they_differ(
    recording, signal_map, codec, changed, contradicted
):
    block = recording(0, 50)
    velocities = np.flatnonzero(block.arbitration_id == 4)[20:30]
    doubled = block.take(np.insert(np.arange(len(block)), velocities, velocities))
    data = doubled.data.copy()
    data[velocities + np.arange(10), 0] += changed
    found = decode_navigation(doubled.with_fields(data=data), signal_map, codec)
    assert found.counts.contradicted == contradicted


@pytest.mark.parametrize("repeated", [slice(None), slice(3, None, 7)])
def test_frames_that_arrive_twice_lose_no_epoch(recording, signal_map, codec, repeated):
    """As through two gateways to the same bus."""
    block = recording(0, 50)
    copies = np.ones(len(block), np.int64)
    copies[repeated] = 2
    found = decode_navigation(block.take(np.repeat(np.arange(len(block)), copies)), signal_map, codec)
    once = decode_navigation(block, signal_map, codec)
    assert found.counts == EpochCounts()
    assert found.ins_time_s.tolist() == once.ins_time_s.tolist()
    assert found.velocity_enu_mps.tolist() == once.velocity_enu_mps.tolist()


def test_increments_that_arrive_twice_count_once():
    station = Station(find_document("stations", "emulated"))
    codec = DbcCodec(load_dbc(station.dbc_path))
    samples, copies = 40, 2
    counts = (np.arange(samples, dtype="<u8") % 16 << 60) + 1000
    block = FrameBlock.from_columns(
        np.repeat(0.01 * np.arange(samples), 2),
        np.tile([8, 9], samples),
        np.full(2 * samples, 8),
        np.repeat(counts, 2).view(np.uint8).reshape(-1, 8),
    )
    signals = station.file.ins.signals
    once = decode_increments(block, signals, codec)
    twice = decode_increments(block.take(np.repeat(np.arange(len(block)), copies)), signals, codec)
    assert twice.angle.tolist() == once.angle.tolist()
    assert twice.is_consecutive[1:].all()
    assert twice.sent.tolist() == once.sent.tolist()


def test_a_repeated_epoch_is_dropped_and_counted(recording, signal_map, codec):
    block = recording(0, 50)
    rows = np.arange(len(block))
    epoch = rows[np.isin(block.arbitration_id, (4, 6, 7))][60:63]
    again = np.insert(rows, epoch[-1] + 1, epoch)
    found = decode_navigation(block.take(again), signal_map, codec)
    assert found.counts == EpochCounts(repeated=1)
    assert found.ins_time_s == pytest.approx(100 + np.arange(50) / 10)


def test_arrival_in_bursts_changes_no_time(recording, signal_map, codec):
    block = recording(0, 300)
    bursts = block.with_fields(time_s=np.ceil(block.timestamp_s / 5.0) * 5.0)
    found, even = (decode_navigation(b, signal_map, codec) for b in (bursts, block))
    assert np.array_equal(found.ins_time_s, even.ins_time_s)
    assert (found.counts.lost, found.counts.restarts) == (0, 0)


def test_an_epoch_that_arrives_late_is_counted_and_keeps_its_time(recording, signal_map, codec):
    block = recording(0, 50)
    stamps = block.timestamp_s.copy()
    stamps[(stamps > 2.0) & (stamps < 2.25)] = 2.3
    late = block.with_fields(time_s=stamps)
    found = decode_navigation(late, signal_map, codec)
    assert found.counts == EpochCounts(late=1)
    assert found.ins_time_s == pytest.approx(100 + np.arange(50) / 10)


def test_a_restart_of_the_ins_begins_a_new_segment_with_its_own_time(recording, frames_of, signal_map, codec):
    before, after = recording(500, 600), recording(0, 40)
    later = after.with_fields(time_s=after.timestamp_s + 90.0)
    found = decode_navigation(concatenate([before, later]), signal_map, codec)
    assert found.counts == EpochCounts(restarts=1)
    assert found.segment.tolist() == [0] * 100 + [1] * 40
    assert found.ins_time_s[found.segment == 0] == pytest.approx(150 + np.arange(100) / 10)
    assert found.ins_time_s[found.segment == 1] == pytest.approx(100 + np.arange(40) / 10)


def test_epochs_after_a_restart_without_a_time_are_dropped(recording, signal_map, codec):
    before, after = recording(500, 600), without(recording(0, 9), TIME_ID, 0)
    later = after.with_fields(time_s=after.timestamp_s + 90.0)
    found = decode_navigation(concatenate([before, later]), signal_map, codec)
    assert found.counts == EpochCounts(restarts=1)
    assert len(found.ins_time_s) == 100


def test_a_clock_set_again_between_two_times_leaves_the_epochs_between_them_without_time(
    recording, frames_of, signal_map, codec
):
    block = recording(0, 100)
    shifted = frames_of("SYSTEM_TIME", np.arange(5, 10.0), {"TIME_S": 7 + np.arange(5)})
    rows = np.flatnonzero(block.arbitration_id == TIME_ID)[5:]
    block.data[rows] = shifted.data
    found = decode_navigation(block, signal_map, codec)
    assert found.counts == EpochCounts(restarts=1)
    assert found.ins_time_s[found.segment == 0] == pytest.approx(100 + np.arange(41) / 10)
    assert found.ins_time_s[found.segment == 1] == pytest.approx(7 + np.arange(50) / 10)


def test_a_part_of_a_recording_has_the_numbers_of_the_whole(recording, signal_map, codec):
    block = recording(0, 1000, counter_offset=65000, heading=12.3)
    whole = decode_navigation(block, signal_map, codec)
    cut = np.flatnonzero((block.arbitration_id == TIME_ID) & (block.timestamp_s > 30))[0]
    part = decode_navigation(block.take(slice(cut, None)), signal_map, codec)
    same = np.isin(whole.ins_time_s, part.ins_time_s)
    assert np.sum(same) == len(part.ins_time_s) == 690
    assert np.array_equal(whole.velocity_enu_mps[same], part.velocity_enu_mps)
    assert np.array_equal(whole.attitude[same], part.attitude)


NO_COUNTER = {"epoch_counter: HEADING.EPOCH_COUNTER\n": ""}
NO_TIME = {"time_s: SYSTEM_TIME.TIME_S\ntime_ns: SYSTEM_TIME.TIME_NS\n": ""}


def test_without_a_counter_the_time_that_comes_with_each_epoch_counts(
    recording, frames_of, make_signal_map, codec
):
    block = without(recording(0, 50), TIME_ID, *range(5))
    epochs = np.arange(50)
    times = frames_of("SYSTEM_TIME", epochs * 0.1, {"TIME_S": epochs // 10, "TIME_NS": epochs % 10 * 10**8})
    block = concatenate([times, block])
    block = block.take(np.argsort(block.timestamp_s, kind="stable"))
    block = without(block, HEADING_ID, 20)
    found = decode_navigation(block, make_signal_map(NO_COUNTER), codec)
    assert found.counts == EpochCounts(lost=1)
    assert found.ins_time_s == pytest.approx(np.delete(epochs, 20) / 10, abs=1e-9)


def test_without_a_time_the_counter_continues_from_the_first_arrival(recording, make_signal_map, codec):
    block = recording(0, 50)
    jitter = np.random.default_rng(0).normal(0, 0.01, len(block))
    jitter[:10] = 0
    jittery = block.with_fields(time_s=block.timestamp_s + jitter)
    found = decode_navigation(jittery, make_signal_map(NO_TIME), codec)
    assert found.ins_time_s == pytest.approx(0.002 + np.arange(50) / 10, abs=1e-9)


def test_without_time_and_counter_the_time_stamps_count_to_a_microsecond(recording, make_signal_map, codec):
    block = recording(0, 50)
    stamps = block.timestamp_s + 1e-8
    stamped = block.with_fields(time_s=stamps)
    signal_map = make_signal_map({**NO_COUNTER, **NO_TIME})
    found = decode_navigation(without(stamped, VELOCITY_ID, 7), signal_map, codec)
    assert found.counts == EpochCounts(lost=1)
    assert np.array_equal(found.ins_time_s, np.round(found.timestamp_s, 6))


def test_frames_may_follow_each_other_in_an_order_that_the_map_gives(recording, make_signal_map, codec):
    block = recording(0, 50)
    order = np.argsort(block.timestamp_s - 0.001 * (block.arbitration_id == HEADING_ID), kind="stable")
    reordered = block.take(order)
    key = "epoch_messages: [SYSTEM_TIME, HEADING, VELOCITY_NE, ROLL_PITCH]"
    signal_map = make_signal_map({"epoch_period_s: 0.1": f"epoch_period_s: 0.1\n{key}"})
    found = decode_navigation(reordered, signal_map, codec)
    assert found.counts == EpochCounts()
    assert found.ins_time_s == pytest.approx(100 + np.arange(50) / 10)


def test_short_frames_are_counted(recording, signal_map, codec):
    block = recording(0, 50)
    block.length[np.flatnonzero(block.arbitration_id == VELOCITY_ID)[[3, 4]]] = 7
    found = decode_navigation(block, signal_map, codec)
    assert found.short_frames == 2
    assert found.counts.lost == 2


def test_no_frames_make_no_epochs(recording, make_signal_map, codec):
    for changes in ({}, NO_COUNTER, NO_TIME, {**NO_COUNTER, **NO_TIME}):
        found = decode_navigation(recording(0, 0), make_signal_map(changes), codec)
        assert found.ins_time_s.shape == (0,)
        assert found.attitude.shape == (0, 3, 3)
        assert found.temperatures.optics_c.shape == (0, 3)


@given(data=st.data())
def test_any_frames_give_increasing_times_within_a_segment(make_signal_map, codec, data):
    frames = data.draw(
        st.lists(
            st.tuples(st.sampled_from([1, 4, 6, 7, 7, 16, 32, 33, 99]), st.binary(min_size=6, max_size=8)),
            max_size=60,
        )
    )
    block = FrameBlock.from_columns(
        np.cumsum(data.draw(st.lists(st.floats(0, 0.2), min_size=len(frames), max_size=len(frames)))),
        np.array([identifier for identifier, _ in frames], np.uint32),
        np.array([len(payload) for _, payload in frames], np.uint8),
        np.array([list(payload.ljust(8, b"\0")) for _, payload in frames], np.uint8).reshape(-1, 8),
    )
    changes = data.draw(st.sampled_from([{}, NO_COUNTER, NO_TIME]))
    found = decode_navigation(block, make_signal_map(changes), codec)
    assert np.isfinite(found.ins_time_s).all()
    steps = np.diff(found.ins_time_s)[np.diff(found.segment) == 0]
    assert (steps > 0).all()
