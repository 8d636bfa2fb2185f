"""Navigation data of the INS from a block of frames, and the epochs that the frames form.

:func:`decode_navigation` finds the epochs in the block and reads every quantity at their last frames.

The frames of one epoch arrive one after the other. The order of arrival and the epoch counter determine which
frames belong together and which epochs are missing. The time stamps of the CAN interface jitter; they only
serve to distinguish a pause from a restart of the INS.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, IntArray
from gyrobench.drivers.frames import FrameBlock
from gyrobench.drivers.ins.dbc_codec import DbcCodec
from gyrobench.drivers.ins.readout import BlockReadout
from gyrobench.drivers.ins.signal_map import SignalMap

_TEMPERATURES = ("gyro_optics_temperature", "gyro_electronics_temperature", "case_temperature")
_SENSORS = (*(f"{name}.{axis}" for name in _TEMPERATURES[:2] for axis in "xyz"), _TEMPERATURES[2])


@dataclass(frozen=True, eq=False)
class Temperatures:
    """Temperatures inside the INS, degrees Celsius; NaN where the INS does not send them."""

    ins_time_s: FloatArray  #: Shape (m,). Time of the epoch with which they were sent.
    #: optics_c, electronics_c: Shape (m, 3). Temperatures of each gyro, by body axis.
    optics_c: FloatArray
    electronics_c: FloatArray
    case_c: FloatArray  #: Shape (m,). Temperature of the case.
    #: Shape (m, 7). Largest difference between successive readings of a sensor since the previous row:
    #: optics x, y, z, electronics x, y, z, case; 0 for a single reading.
    spread_k: FloatArray


@dataclass(frozen=True, eq=False)
class NavigationData:
    """Output of the INS, epoch by epoch."""

    ins_time_s: FloatArray  #: Shape (n,). Time on the clock of the INS; increases within a segment.
    timestamp_s: FloatArray  #: Shape (n,). Time stamp of the CAN interface.
    row: IntArray  #: Shape (n,). Row of the epoch's last frame in the block.
    segment: IntArray  #: Shape (n,). Number of earlier restarts of the INS in the block.
    velocity_enu_mps: FloatArray  #: Shape (n, 3). Velocity; Up is the last value received, NaN if none.
    #: Shape (n, 3, 3). ``C_nb``; NaN where the INS marks it invalid, and before the Euler sequence has been
    #: received.
    attitude: FloatArray
    #: mode, alignment: Shape (n,). Last received :class:`~gyrobench.drivers.ins.readout.InsMode` and
    #: :class:`~gyrobench.drivers.ins.readout.Alignment`.
    mode: NDArray[np.int8]
    alignment: NDArray[np.int8]
    temperatures: Temperatures  #: Temperatures, at their own, slower times.
    counts: EpochCounts  #: Lost and irregular epochs.
    short_frames: int  #: Frames with fewer bytes than in the DBC; dropped.
    latitude: float = math.nan  #: Latitude that the INS uses, last value, rad; NaN if not sent.

    def between(self, first_row: int, end_row: int) -> slice:
        """Epochs whose last frames are in the rows ``first_row`` to ``end_row`` (exclusive) of the block."""
        begin, end = np.searchsorted(self.row, [first_row, end_row]).tolist()
        return slice(begin, end)


def decode_navigation(block: FrameBlock, signal_map: SignalMap, codec: DbcCodec) -> NavigationData:
    """Decode one uninterrupted block. Raises DocumentError if the signal map does not fit the DBC."""
    readout = BlockReadout(block, signal_map, codec)
    epochs = _find_epochs(readout)
    messages = {each.message for path, each in readout.signals.items() if not path.startswith("increments.")}
    return NavigationData(
        ins_time_s=epochs.ins_time_s,
        timestamp_s=epochs.arrival_s,
        row=epochs.rows,
        segment=epochs.segment,
        velocity_enu_mps=readout.velocity_enu_mps(epochs.rows),
        attitude=readout.attitude(epochs.rows),
        mode=readout.mode(epochs.rows),
        alignment=readout.alignment(epochs.rows),
        temperatures=_temperatures(readout, epochs),
        counts=epochs.counts,
        short_frames=sum(codec.count_short(block, message) for message in messages),
        latitude=next(iter(readout.value("latitude", epochs.rows[-1:]).tolist()), math.nan),
    )


@dataclass(frozen=True, eq=False)
class Increments:
    """Increments of angle and velocity from the inertial sensors, sample by sample, in body axes."""

    row: IntArray  #: Shape (n,). Row of the sample's last frame in the block.
    #: angle, velocity: Shape (n, 3). Increments since the previous sample, rad and m/s; NaN where saturated.
    angle: FloatArray
    velocity: FloatArray
    is_consecutive: BoolArray  #: Shape (n,). Whether the previous sample has arrived.
    interval_s: float  #: Time between samples.
    #: Shape (2, n). Number of samples sent since the first. First row: by the counter alone, or those
    #: received if there is no counter. Second row: also by arrival times; NaN if these don't show it.
    sent: FloatArray


def decode_increments(block: FrameBlock, signal_map: SignalMap, codec: DbcCodec) -> Increments | None:
    """Decode the increments in a block, or the rates as increments; None if the map has neither."""
    mapped = signal_map.increments
    if mapped is None:
        return None
    readout = BlockReadout(block, signal_map, codec)
    rows = readout.last_rows("increments.")
    if mapped.counter is not None:
        counts = readout.value("increments.counter", rows)
        rows = _without_repeats(block, rows, np.diff(counts) == 0.0)
    angle, velocity = (
        readout.axes(f"increments.{increment}", rows)
        if getattr(mapped, increment) is not None
        else mapped.period_s * readout.axes(f"increments.{mean}", rows)
        for increment, mean in (("angle", "rate"), ("velocity", "specific_force"))
    )
    intervals_s = np.diff(block.timestamp_s[rows])
    counter_steps, modulus = np.ones(len(intervals_s)), 1.0
    if mapped.counter is not None:
        counter_steps = np.diff(readout.value("increments.counter", rows))
        modulus = readout.modulus("increments.counter")
    steps = _unwrap_steps(counter_steps, modulus, 1.0)
    is_next = steps == 1.0 if mapped.counter is not None else np.rint(intervals_s / mapped.period_s) == 1.0
    # In units of the median interval, as the declared period may be wrong; NaN if frames come in bursts.
    median_s = float(np.median(intervals_s)) if len(intervals_s) else 0.0
    by_arrival = _unwrap_steps(counter_steps, modulus, intervals_s / median_s if median_s > 0.0 else np.nan)
    sent = np.cumsum([steps, by_arrival], axis=1)
    return Increments(
        row=rows,
        angle=angle,
        velocity=velocity,
        is_consecutive=np.concatenate([[False], is_next])[: len(rows)],
        interval_s=mapped.period_s,
        sent=np.concatenate([np.zeros((2, 1)), sent], axis=1)[:, : len(rows)],
    )


def _temperatures(readout: BlockReadout, epochs: _Epochs) -> Temperatures:
    """Temperatures, with one row for each frame of the temperature with the highest identifier and page."""
    rows = readout.last_rows(_TEMPERATURES) if len(epochs.rows) else np.zeros(0, np.int64)
    following = np.minimum(np.searchsorted(epochs.rows, rows), len(epochs.rows) - 1)
    return Temperatures(
        ins_time_s=epochs.ins_time_s[following],
        optics_c=readout.axes("gyro_optics_temperature", rows),
        electronics_c=readout.axes("gyro_electronics_temperature", rows),
        case_c=readout.value("case_temperature", rows),
        spread_k=np.stack([_spread(readout, path, rows) for path in _SENSORS], axis=-1),
    )


def _spread(readout: BlockReadout, path: str, rows: IntArray) -> FloatArray:
    """Largest difference (m,) between successive readings of a sensor, from each row to the next."""
    spread = np.zeros(len(rows) + 1)
    if path in readout.signals:
        sensor_rows = readout.rows_with(readout.signals[path])
        interval = np.searchsorted(rows, sensor_rows)
        is_same_interval = interval[1:] == interval[:-1]
        differences = np.abs(np.diff(readout.value(path, sensor_rows)))
        np.fmax.at(spread, interval[1:][is_same_interval], differences[is_same_interval])
    return spread[:-1]


#: A counter that is ahead of the arrival times by more epochs than this has been reset.
_MAX_COUNTER_LEAD = 300.0
#: A gap in the frames of a counter that wraps after so many epochs hardly ends exactly with the next number.
_MIN_LONG_COUNT = 4096.0
#: Epochs by which a number that is a time may differ from the next one.
_TIME_JITTER = 0.1
_LATE_PERIODS = 2.0
_TIME_DECIMALS = 9
_STAMP_DECIMALS = 6


@dataclass(frozen=True, slots=True)
class EpochCounts:
    """Counts of irregular epochs."""

    lost: int = 0  #: Epochs that are missing or incomplete, except those cut off at the ends of the block.
    repeated: int = 0  #: Epochs with the same number as the previous one; dropped.
    #: Epochs delayed by more than two periods relative to the least delayed epoch before them. Over many
    #: hours the drift between the two clocks has the same effect.
    late: int = 0
    restarts: int = 0  #: Resets of the clock or the counter of the INS.
    #: Additional frames of a message in one epoch whose content differs from that of the previous frame.
    contradicted: int = 0


@dataclass(frozen=True, eq=False)
class _Epochs:
    """Complete epochs in order of arrival."""

    rows: IntArray  #: Shape (n,). Row of each epoch's last frame in the block.
    arrival_s: FloatArray  #: Shape (n,). Time stamp of its first navigation frame.
    ins_time_s: FloatArray  #: Shape (n,). Time on the clock of the INS.
    #: Shape (n,). Number of earlier restarts of the INS; times of different segments are unrelated.
    segment: IntArray
    counts: EpochCounts


def _find_epochs(readout: BlockReadout) -> _Epochs:
    """Find the epochs and their times; see :class:`_Epochs`."""
    groups, incomplete = _group_frames(readout)
    period_s = readout.map.epoch_period_s
    if readout.map.epoch_counter is not None:
        numbers, modulus = readout.value("epoch_counter", groups.rows), readout.modulus("epoch_counter")
    elif readout.map.time_s is not None:
        numbers, modulus = readout.time_s(groups.rows) / period_s, readout.modulus("time_s") / period_s
    else:
        times_s = np.round(groups.arrival_s, _STAMP_DECIMALS)
        one_segment = np.zeros(len(times_s), np.int64)
        return _Epochs(groups.rows, groups.arrival_s, times_s, one_segment, EpochCounts(lost=incomplete))
    finite = np.isfinite(numbers)
    numbers, groups = numbers[finite], groups.take(finite)
    steps, is_reset = _epoch_steps(numbers, modulus, np.diff(groups.arrival_s) / period_s)
    is_new = steps != 0.0
    position = np.cumsum(steps)[is_new]
    groups = groups.take(is_new)
    restart = is_reset[is_new]
    lost = int(np.sum(np.rint(np.diff(position)[~restart[1:]]) - 1.0))
    times_s = _times(readout, groups, position, restart)
    has_time = ~np.isnan(times_s)
    contradicted = _count_contradicted(readout, groups.rows, np.where(restart, np.inf, steps[is_new]))
    groups, times_s, segment = groups.take(has_time), times_s[has_time], np.cumsum(restart)[has_time]
    counts = EpochCounts(
        lost=lost,
        repeated=int(np.sum(~is_new)),
        late=_count_late(groups.arrival_s - times_s, segment, _LATE_PERIODS * period_s),
        restarts=int(np.sum(restart)),
        contradicted=contradicted,
    )
    return _Epochs(groups.rows, groups.arrival_s, times_s, segment, counts)


@dataclass(frozen=True, eq=False)
class _Groups:
    """Complete groups of frames that were sent together."""

    rows: IntArray  #: Shape (n,). Row of the last frame.
    arrival_s: FloatArray  #: Shape (n,). Time stamp of the first required frame.
    time_rows: IntArray  #: Shape (n,). Row of the frame with the INS time; -1 if it is missing.

    def take(self, mask: BoolArray) -> _Groups:
        return _Groups(self.rows[mask], self.arrival_s[mask], self.time_rows[mask])


def _group_frames(readout: BlockReadout) -> tuple[_Groups, int]:
    """Collect the complete groups, and count the incomplete ones between the first and the last.

    A frame that arrives twice, as through two gateways, is no second epoch.
    """
    names = _messages_in_order(readout)
    required = np.array([name in readout.map.messages_of_epoch() for name in names])
    stamps_s = readout.block.timestamp_s
    message_index = np.full(len(stamps_s), -1, np.int8)
    for index, name in enumerate(names):
        message_index[readout.rows(name)] = index
    rows = np.flatnonzero(message_index >= 0)
    if len(names) > 1:  # of a single message, equal frames may be two epochs with the same output
        rows = _without_repeats(readout.block, rows, np.diff(message_index[rows]) == 0)
    order = message_index[rows]
    # A new epoch begins where the order restarts, or a pause separates the frames.
    restarts = np.diff(order) <= 0
    pause = ~restarts & (np.diff(stamps_s[rows]) > readout.map.epoch_period_s / 2.0)
    has_count = [name == readout.message_of("epoch_counter") for name in names]
    begins = restarts | (pause & ~_is_delayed(readout, rows, restarts, np.array(has_count)[order]))
    group = np.cumsum(np.concatenate([[True], begins]))[: len(rows)] - 1
    table = np.full((int(group.max(initial=-1)) + 1, len(names)), -1, np.int64)
    table[group, order] = rows
    complete = np.all(table[:, required] >= 0, axis=1)
    complete_rows = table[complete]
    has_time = [name == readout.message_of("time_s") for name in names]
    groups = _Groups(
        rows=complete_rows.max(axis=1, initial=-1),
        arrival_s=stamps_s[complete_rows[:, int(np.argmax(required))]],
        time_rows=complete_rows[:, has_time].max(axis=1, initial=-1),
    )
    return groups, int(np.sum(~complete[1:-1]))


def _without_repeats(block: FrameBlock, rows: IntArray, is_same: BoolArray) -> IntArray:
    """Drop the rows that follow an equal frame; ``is_same``, shape (n - 1,): which of them may be repeats."""
    later, data = 1 + np.flatnonzero(is_same), block.data
    is_repeated = np.all(data[rows[later]] == data[rows[later - 1]], axis=1)
    return np.delete(rows, later[is_repeated])


def _is_delayed(
    readout: BlockReadout, rows: IntArray, restarts: BoolArray, has_count: BoolArray
) -> BoolArray:
    """Mark the frames that came after a pause but belong to the same epoch as the previous frame.

    The epoch counter shows it: two successive counts are one epoch apart. ``restarts`` marks where the order
    of the frames restarts, ``has_count`` the frames that contain a count.
    """
    counted = np.flatnonzero(has_count)
    if not len(counted):
        return np.zeros(len(restarts), np.bool_)
    numbers = readout.value("epoch_counter", rows[counted])
    steps = _unwrap_steps(np.diff(numbers), readout.modulus("epoch_counter"), 1.0)
    is_next = np.concatenate([[False], steps == 1.0])
    later = np.arange(1, len(rows))
    next_count = np.minimum(np.cumsum(has_count)[:-1], len(counted) - 1)
    group = np.concatenate([[0], np.cumsum(restarts)])
    is_same_group = (counted[next_count] >= later) & (group[counted[next_count]] == group[later])
    return np.asarray(is_same_group & is_next[next_count], np.bool_)


def _messages_in_order(readout: BlockReadout) -> list[str]:
    """Messages of an epoch, and that of the time, in the order in which they are sent.

    By default this is the order of the identifiers, as frames that are ready at the same time are sent in
    that order.
    """
    members = readout.map.messages_of_epoch()
    time_message = readout.message_of("time_s")
    if time_message is not None:
        members.add(time_message)
    if readout.map.epoch_messages is None:
        return sorted(members, key=readout.codec.arbitration_id)
    unlisted = members - set(readout.map.epoch_messages)
    return [*unlisted, *(name for name in readout.map.epoch_messages if name in members)]


def _epoch_steps(numbers: FloatArray, modulus: float, elapsed: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Steps (n,) between epoch numbers (n,), the first being 1, and a mask of the resets of the numbering.

    ``elapsed``, shape (n - 1,), is the number of epochs in each step by arrival time; ignored where that
    clock was set: where it is negative, or a long count continues with the next number.
    """
    changes = np.diff(numbers)
    continues = (np.abs(changes % modulus - 1.0) < _TIME_JITTER) & (modulus >= _MIN_LONG_COUNT)
    elapsed = np.where((elapsed < 0.0) | continues, 1.0, elapsed)
    steps = _unwrap_steps(changes, modulus, elapsed)
    max_lead = min(_MAX_COUNTER_LEAD, modulus / 4.0)
    is_reset = (steps < 0.0) | (steps - elapsed > max_lead)
    count = len(numbers)
    return np.concatenate([[1.0], steps])[:count], np.concatenate([[False], is_reset])[:count]


def _unwrap_steps(steps: FloatArray, modulus: float, expected: FloatArray | float) -> FloatArray:
    """Add the multiple of the modulus to each step that brings it closest to the expected step."""
    return steps if np.isinf(modulus) else steps + modulus * np.rint((expected - steps) / modulus)


def _times(readout: BlockReadout, groups: _Groups, position: FloatArray, restart: BoolArray) -> FloatArray:
    """INS time of each epoch, shape (n,); NaN where it is unknown.

    If two times of the INS contradict the count of epochs between them, its clock was reset in between: the
    epochs between have no time, and ``restart`` is set at the second time.
    """
    period_s = readout.map.epoch_period_s
    if readout.map.time_s is not None:
        timed = np.flatnonzero(np.isin(groups.time_rows, readout.rows_with(readout.signals["time_s"])))
        timed_s = readout.time_s(groups.time_rows[timed])
        timed, timed_s = timed[np.isfinite(timed_s)], timed_s[np.isfinite(timed_s)]
    else:
        timed = np.flatnonzero(np.concatenate([[True], restart[1:]])[: len(restart)])
        timed_s = np.round(groups.arrival_s[timed], _STAMP_DECIMALS)
    offsets_s = timed_s - position[timed] * period_s
    continuous = np.diff(np.cumsum(restart)[timed]) == 0
    changes_s = np.where(
        continuous, _unwrap_steps(np.diff(offsets_s), readout.modulus("time_s"), 0.0), np.diff(offsets_s)
    )
    offsets_s[1:] = offsets_s[:1] + np.cumsum(changes_s)
    contradicted = continuous & (np.abs(changes_s) > period_s / 2.0)
    restart[timed[1:][contradicted]] = True
    times_s = position * period_s + _interpolated(position, np.cumsum(restart), timed, offsets_s)
    for first, second in zip(timed[:-1][contradicted], timed[1:][contradicted], strict=True):
        times_s[first + 1 : second] = np.nan
    return np.round(times_s, _TIME_DECIMALS)


def _interpolated(
    position: FloatArray, segment: IntArray, timed: IntArray, offsets_s: FloatArray
) -> FloatArray:
    """Offsets at every position, interpolated between those at ``timed`` indices of the same segment."""
    result = np.full(len(position), np.nan)
    for run in _segment_ranges(segment):
        inside = slice(*np.searchsorted(timed, (run.start, run.stop)))
        if inside.start < inside.stop:
            result[run] = np.interp(position[run], position[timed[inside]], offsets_s[inside])
    return result


def _count_contradicted(readout: BlockReadout, ends: IntArray, steps: FloatArray) -> int:
    """Count frames in excess of one per epoch; ``steps`` is the number of epochs since the previous end."""
    if not len(ends):
        return 0
    contradicted = 0
    for message in readout.map.messages_of_epoch():
        rows = readout.rows(message)
        data = readout.block.data.view(np.uint64)[rows, 0]
        is_different = np.concatenate([[True], data[1:] != data[:-1]])[: len(rows)]
        counts = np.bincount(np.searchsorted(ends, rows[is_different]), minlength=len(ends) + 1)
        # Frames before the first and after the last epoch belong to epochs cut off at the ends of the block.
        contradicted += int(np.maximum(counts[1 : len(ends)] - steps[1:], 0.0).sum())
    return contradicted


def _count_late(delays_s: FloatArray, segment: IntArray, tolerance_s: float) -> int:
    late = 0
    for run in _segment_ranges(segment):
        late += int(np.sum(delays_s[run] - np.minimum.accumulate(delays_s[run]) > tolerance_s))
    return late


def _segment_ranges(segment: IntArray) -> Iterator[slice]:
    """Yield the ranges of equal segment number."""
    edges = [0, *(np.flatnonzero(np.diff(segment)) + 1).tolist(), len(segment)]
    for start, stop in pairwise(edges):
        if start < stop:
            yield slice(start, stop)
