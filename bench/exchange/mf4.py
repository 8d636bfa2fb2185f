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
    """Write all frames with the bus database attached and the origin in the comment.

    Samples are in a temporary file beside ``path`` until the file is complete.
    """
    groups: dict[int, int] = {}
    begin_s: float | None = None
    with MDF(version="4.10", temporary_folder=str(path.parent)) as log:
        log.header.comment = f"<HDcomment><TX>{escape(json.dumps(origin))}</TX></HDcomment>"
        for _, part in parts:
            if begin_s is None:
                begin_s = float(part.timestamp_s[0])
                log.header.start_time = datetime.fromtimestamp(begin_s, UTC)
            for kind, structure in _STRUCTURES.items():
                frames = part.take(part.flags == kind)
                if not len(frames):
                    continue
                time_s, samples = frames.timestamp_s - begin_s, _samples(structure, frames)
                if kind in groups:
                    log.extend(groups[kind], [(time_s, None), (samples, None)])
                    continue
                groups[kind] = len(groups)
                attachment = (dbc.read_bytes(), Path(dbc.name), b"") if kind == 0 else None
                log.append(Signal(samples, time_s, name=structure, source=_BUS, attachment=attachment))
        with path.open("wb+") as stream:  # the library changes the suffix of a path
            log.save(stream, overwrite=True, compression=_COMPRESSION)


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
