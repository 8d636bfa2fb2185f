"""The raw CAN log as one MDF4 file, in the structure of ASAM's bus logging.

asammdf, CANape and the like decode it with the DBC file of the run, which is attached.

References
----------
ASAM MDF 4.1, associated standard "Bus logging": groups CAN_DataFrame, CAN_RemoteFrame, CAN_ErrorFrame.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final
from xml.sax.saxutils import escape

import numpy as np
from asammdf import MDF, Signal, Source
from asammdf.blocks.v4_constants import BUS_TYPE_CAN, SOURCE_BUS
from numpy.typing import ArrayLike, NDArray

from gyrobench.bench.exchange.can_export import TimedPart
from gyrobench.drivers.frames import ERROR_FRAME, EXTENDED_ID, MAX_LENGTH, REMOTE_FRAME, FrameBlock

_BUS = Source(name="CAN", path="CAN", comment="", source_type=SOURCE_BUS, bus_type=BUS_TYPE_CAN)
#: Transposed and deflated, which compresses slowly changing signals well.
_COMPRESSION: Final = 2


#: Structure in the standard of each kind of frames, by their flags.
_STRUCTURES = {0: "CAN_DataFrame", REMOTE_FRAME: "CAN_RemoteFrame", ERROR_FRAME: "CAN_ErrorFrame"}


def write_mf4(path: Path, parts: Iterable[TimedPart], dbc: Path, origin: Mapping[str, Any]) -> None:
    """Write all frames with the bus database attached and the origin in the comment."""
    log: _Mf4Log | None = None
    try:
        for part in parts:
            log = log or _Mf4Log(path.parent, float(part.frames.timestamp_s[0]), dbc, origin)
            log.add(part.frames)
        if log is not None:
            log.save(path)
    finally:
        if log is not None:
            log.close()


class _Mf4Log:
    """A file that is being written; its samples are in a temporary file in ``folder`` until it is saved.

    ``begin_s`` is the time of the first frame in seconds since 1970 UTC.
    """

    def __init__(self, folder: Path, begin_s: float, dbc: Path, origin: Mapping[str, Any]) -> None:
        self._begin_s = begin_s
        self._attachment = (dbc.read_bytes(), Path(dbc.name), b"")
        self._groups: dict[int, int] = {}
        self._file = MDF(version="4.10", temporary_folder=str(folder))
        self._file.header.start_time = datetime.fromtimestamp(begin_s, UTC)
        self._file.header.comment = f"<HDcomment><TX>{escape(json.dumps(origin))}</TX></HDcomment>"

    def add(self, frames: FrameBlock) -> None:
        """Add frames."""
        for kind, structure in _STRUCTURES.items():
            selected = frames.take(frames.flags == kind)
            if not len(selected):
                continue
            time_s, samples = selected.timestamp_s - self._begin_s, _samples(structure, selected)
            if kind in self._groups:
                self._file.extend(self._groups[kind], [(time_s, None), (samples, None)])
                continue
            self._groups[kind] = len(self._groups)
            attachment = self._attachment if kind == 0 else None
            self._file.append(Signal(samples, time_s, name=structure, source=_BUS, attachment=attachment))

    def save(self, path: Path) -> None:
        """Write the file by a stream, since the library changes the suffix of a path."""
        with path.open("wb+") as stream:
            self._file.save(stream, overwrite=True, compression=_COMPRESSION)

    def close(self) -> None:
        """Remove the temporary file."""
        self._file.close()


def _samples(structure: str, frames: FrameBlock) -> NDArray[np.void]:
    """Records in the layout of the standard; buses are numbered from 1, and all frames are received ones."""
    values: dict[str, ArrayLike] = {
        "ID": frames.arbitration_id & ~np.uint32(EXTENDED_ID),
        "BusChannel": 1,
        "IDE": (frames.arbitration_id & np.uint32(EXTENDED_ID)) != 0,
        "DLC": frames.length,
        "DataLength": np.where(frames.flags & REMOTE_FRAME, 0, frames.length),
        **dict.fromkeys(("Dir", "EDL", "BRS", "ESI"), 0),
    }
    samples = np.zeros(
        len(frames),
        [
            *((f"{structure}.{name}", "<u4" if name == "ID" else "u1") for name in values),
            (f"{structure}.DataBytes", "u1", (MAX_LENGTH,)),
        ],
    )
    for name, column in values.items():
        samples[f"{structure}.{name}"] = column
    samples[f"{structure}.DataBytes"] = frames.data
    return samples
