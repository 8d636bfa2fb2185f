"""A log of what an INS sends on its CAN bus."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import can

from gyrobench.bench.foundations.clock import Clock, Deadline
from gyrobench.bench.foundations.errors import DocumentError, NoReplyError
from gyrobench.bench.foundations.files import cant_be_written, make_folder
from gyrobench.bench.station.instruments import Emulation, Outputs, open_ins
from gyrobench.bench.station.station import Station
from gyrobench.drivers.ins.can_bus import INSTRUMENT
from gyrobench.drivers.ins.can_ins import CanIns

#: Logs that a kill leaves readable.
SUFFIXES = (".log", ".asc", ".blf")
#: A unit that is on is heard within this; one that was switched on has started within the other.
_LISTEN_S, _START_S = 3.0, 180.0
_POLL_S = 0.05


def record_can(station: Station, path: Path, clock: Clock, emulation: Emulation, duration_s: float) -> str:
    """Log the frames of so many seconds; a unit that is off and that the bench can switch on is on meanwhile.

    Parameters
    ----------
    path : Path
        ``.log`` (candump), ``.asc`` or ``.blf``.

    Returns
    -------
    str
        What was recorded, for people.

    Raises
    ------
    DocumentError
        Files of that kind can't be written.
    RunFolderError
        This one can't be.
    InstrumentError
        The INS can't be reached, or sends nothing.
    """
    if path.suffix not in SUFFIXES:
        raise DocumentError(f"{path}: a CAN log is named {', '.join(f'*{suffix}' for suffix in SUFFIXES)}")
    make_folder(path.parent)
    ins = open_ins(station, clock, emulation)
    try:
        with Outputs(station, clock, emulation) as outputs:
            switched = _switch_on(station, outputs, ins, clock)
            try:
                return _log(ins, path, clock, duration_s)
            finally:
                if switched:
                    outputs.power_unit(False)
    finally:
        ins.close()


def _log(ins: CanIns, path: Path, clock: Clock, duration_s: float) -> str:
    before = ins.health().frames
    try:
        with can.Logger(path) as log:
            ins.on_frames = partial(_write, log)
            deadline = Deadline(clock, duration_s)
            while not deadline.expired():
                clock.sleep(_POLL_S)
                ins.poll()
            identity = ins.identify()
            ins.on_frames = None
    except OSError as error:
        if isinstance(error, NoReplyError):
            raise
        raise cant_be_written(path, error) from error
    return f"{ins.health().frames - before} frames of {duration_s:g} s; {identity}"


def _write(log: can.Listener, frames: list[can.Message]) -> None:
    for frame in frames:
        log.on_message_received(frame)


def _switch_on(station: Station, outputs: Outputs, ins: CanIns, clock: Clock) -> bool:
    """Wait for a unit that is silent, switched on if the bench can; tells whether it was."""
    if _is_heard(ins, clock, _LISTEN_S):
        return False
    unit = station.unit
    if unit.power != "chamber_event":
        raise NoReplyError(INSTRUMENT, "sends nothing. Switch it on, and check bus, bit rate and cable.")
    outputs.power_unit(True)
    if not _is_heard(ins, clock, _START_S):
        outputs.power_unit(False)
        raise NoReplyError(INSTRUMENT, "sends nothing. Check its power, the bus, its bit rate and the cable.")
    return True


def _is_heard(ins: CanIns, clock: Clock, limit_s: float) -> bool:
    deadline = Deadline(clock, limit_s)
    heard = ins.health().frames
    while ins.health().frames == heard and not deadline.expired():
        clock.sleep(_POLL_S)
        ins.poll()
    return ins.health().frames > heard
