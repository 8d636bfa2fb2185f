"""Navigation data out of recorded frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrobench.bench.foundations.arrays import FloatArray, IntArray
from gyrobench.drivers.ins.bound_signals import BlockReader, bind_signals
from gyrobench.drivers.ins.dbc_codec import DbcCodec
from gyrobench.drivers.ins.epochs import EpochCounts, Epochs, find_epochs
from gyrobench.drivers.ins.frames import FrameBlock
from gyrobench.drivers.ins.readout import Readout
from gyrobench.drivers.ins.signal_map import SignalMap

Rows = IntArray

_TEMPERATURES = ("gyro_optics_temperature", "gyro_electronics_temperature", "case_temperature")
_SENSORS = (*(f"{name}.{axis}" for name in _TEMPERATURES[:2] for axis in "xyz"), _TEMPERATURES[2])


@dataclass(frozen=True, eq=False)
class Temperatures:
    """Temperatures inside the INS, degrees Celsius; NaN where the INS does not tell them.

    Attributes
    ----------
    ins_time_s : ndarray, shape (m,)
        Time of the epoch that they were sent with.
    optics_c, electronics_c : ndarray, shape (m, 3)
        Of each gyro, by body axis.
    case_c : ndarray, shape (m,)
        Of the case.
    spread_k : ndarray, shape (m, 7)
        By how much several readings of one sensor differ that came since the last time: optics,
        electronics, case; 0 where there was only one.
    """

    ins_time_s: FloatArray
    optics_c: FloatArray
    electronics_c: FloatArray
    case_c: FloatArray
    spread_k: FloatArray


@dataclass(frozen=True, eq=False)
class NavigationData:
    """What the INS put out, epoch by epoch.

    Attributes
    ----------
    ins_time_s : ndarray, shape (n,)
        Time on the clock of the INS; increases within a segment.
    timestamp_s : ndarray, shape (n,)
        Time of arrival as the CAN interface stamped it.
    row : ndarray of int64, shape (n,)
        Where in the block the last frame of the epoch stands.
    segment : ndarray of int64, shape (n,)
        Counts the restarts of the INS.
    velocity_enu_mps : ndarray, shape (n, 3)
        Velocity; Up is the last value known, and NaN where none is.
    attitude : ndarray, shape (n, 3, 3)
        ``C_nb``; NaN where the INS says that it is not valid and as long as a block has not told
        which Euler sequence applies.
    mode, alignment : ndarray of int8, shape (n,)
        :class:`~gyrobench.drivers.ins.readout.InsMode` and :class:`~gyrobench.drivers.ins.readout.Alignment`,
        the last known.
    temperatures : Temperatures
        On their own, slower time line.
    counts : EpochCounts
        What was lost on the way.
    short_frames : int
        Frames with fewer bytes than the DBC says; left out.
    """

    ins_time_s: FloatArray
    timestamp_s: FloatArray
    row: Rows
    segment: IntArray
    velocity_enu_mps: FloatArray
    attitude: FloatArray
    mode: NDArray[np.int8]
    alignment: NDArray[np.int8]
    temperatures: Temperatures
    counts: EpochCounts
    short_frames: int


def decode_navigation(block: FrameBlock, signal_map: SignalMap, codec: DbcCodec) -> NavigationData:
    """Decode one uninterrupted recording; the same frames always give the same numbers.

    Raises
    ------
    DocumentError
        The signal map does not fit the DBC.
    """
    reader = BlockReader(block, codec)
    readout = Readout(reader, signal_map, bind_signals(signal_map, codec))
    epochs = find_epochs(reader, readout)
    messages = {bound.message for bound in readout.signals.values()}
    return NavigationData(
        ins_time_s=epochs.ins_time_s,
        timestamp_s=epochs.arrival_s,
        row=epochs.rows,
        segment=epochs.segment,
        velocity_enu_mps=readout.velocity_enu_mps(epochs.rows),
        attitude=readout.attitude(epochs.rows),
        mode=readout.mode(epochs.rows),
        alignment=readout.alignment(epochs.rows),
        temperatures=_temperatures(reader, readout, epochs),
        counts=epochs.counts,
        short_frames=sum(codec.count_short(block, message) for message in messages),
    )


def _temperatures(reader: BlockReader, readout: Readout, epochs: Epochs) -> Temperatures:
    """One row for each frame of the last of the temperature messages."""
    messages = {b.message for path, b in readout.signals.items() if path.startswith(_TEMPERATURES)}
    rows = np.zeros(0, np.int64)
    if messages and len(epochs.rows):
        rows = reader.rows(max(messages, key=reader.codec.arbitration_id))
    following = np.minimum(np.searchsorted(epochs.rows, rows), len(epochs.rows) - 1)
    return Temperatures(
        ins_time_s=epochs.ins_time_s[following],
        optics_c=readout.axes("gyro_optics_temperature", rows),
        electronics_c=readout.axes("gyro_electronics_temperature", rows),
        case_c=readout.value("case_temperature", rows),
        spread_k=np.stack([_spread(reader, readout, path, rows) for path in _SENSORS], axis=-1),
    )


def _spread(reader: BlockReader, readout: Readout, path: str, rows: Rows) -> FloatArray:
    """Largest difference (m,) between neighbouring readings of a sensor from one of the rows to the next."""
    spread = np.zeros(len(rows) + 1)
    if path in readout.signals:
        own = reader.rows(readout.signals[path].message)
        since = np.searchsorted(rows, own)
        again = since[1:] == since[:-1]
        differences = np.abs(np.diff(readout.value(path, own)))
        np.fmax.at(spread, since[1:][again], differences[again])
    return spread[:-1]
