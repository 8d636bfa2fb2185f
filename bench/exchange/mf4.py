"""The raw CAN log as one MDF4 file, in the structure of ASAM's bus logging.

asammdf, CANape and the like decode it with the DBC file of the run, which is attached.

References
----------
ASAM MDF 4.1, associated standard "Bus logging": groups CAN_DataFrame, CAN_RemoteFrame, CAN_ErrorFrame.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final
from xml.sax.saxutils import escape

import can
import numpy as np
from asammdf import MDF, Signal, Source
from asammdf.blocks.v4_constants import BUS_TYPE_CAN, SOURCE_BUS
from can.util import channel2int, len2dlc
from numpy.typing import NDArray

from gyrobench.bench.exchange.can_export import TimedPart

_BUS = Source(name="CAN", path="CAN", comment="", source_type=SOURCE_BUS, bus_type=BUS_TYPE_CAN)
#: Transposed and deflated: what changes little from frame to frame takes little space.
_COMPRESSION: Final = 2


@dataclass(frozen=True)
class _Kind:
    """A kind of frames: the structure that the standard gives it, and the longest payload."""

    structure: str
    max_bytes: int

    @property
    def dtype(self) -> np.dtype[np.void]:
        fields = ("BusChannel", "IDE", "DLC", "DataLength", "Dir", "EDL", "BRS", "ESI")
        return np.dtype(
            [
                (f"{self.structure}.ID", "<u4"),
                *((f"{self.structure}.{name}", "u1") for name in fields),
                (f"{self.structure}.DataBytes", "u1", (self.max_bytes,)),
            ]
        )


_DATA = _Kind("CAN_DataFrame", 8)
_FD_DATA = _Kind("CAN_DataFrame", 64)
_REMOTE = _Kind("CAN_RemoteFrame", 8)
_ERROR = _Kind("CAN_ErrorFrame", 8)


def write_mf4(path: Path, parts: Iterable[TimedPart], dbc: Path, origin: Mapping[str, Any]) -> int:
    """Write all frames with the bus database attached and the origin in the comment; returns their number."""
    log: _Mf4Log | None = None
    try:
        for part in parts:
            log = log or _Mf4Log(path.parent, part.messages[0].timestamp, dbc, origin)
            log.add(part.messages)
        if log is not None:
            log.save(path)
    finally:
        if log is not None:
            log.close()
    return log.count if log is not None else 0


class _Mf4Log:
    """The growing file; its samples are in a temporary file in ``folder`` until it is saved.

    ``begin_s`` is the time of the first frame in seconds since 1970 UTC.
    """

    def __init__(self, folder: Path, begin_s: float, dbc: Path, origin: Mapping[str, Any]) -> None:
        self.count = 0
        self._begin_s = begin_s
        self._attachment = (dbc.read_bytes(), Path(dbc.name), b"")
        self._groups: dict[_Kind, int] = {}
        self._file = MDF(version="4.10", temporary_folder=str(folder))
        self._file.header.start_time = datetime.fromtimestamp(begin_s, UTC)
        self._file.header.comment = f"<HDcomment><TX>{escape(json.dumps(origin))}</TX></HDcomment>"

    def add(self, messages: Sequence[can.Message]) -> None:
        """Add frames."""
        self.count += len(messages)
        for kind, some in _by_kind(messages).items():
            time_s = np.array([message.timestamp for message in some]) - self._begin_s
            samples = _samples(kind, some)
            if kind in self._groups:
                self._file.extend(self._groups[kind], [(time_s, None), (samples, None)])
                continue
            self._groups[kind] = len(self._groups)
            attachment = self._attachment if kind is _DATA else None
            self._file.append(
                Signal(samples, time_s, name=kind.structure, source=_BUS, attachment=attachment)
            )

    def save(self, path: Path) -> None:
        """Write the file, by a stream: of a path the library would change the suffix."""
        with path.open("wb+") as stream:
            self._file.save(stream, overwrite=True, compression=_COMPRESSION)

    def close(self) -> None:
        """Remove the temporary file."""
        self._file.close()


def _by_kind(messages: Sequence[can.Message]) -> dict[_Kind, list[can.Message]]:
    kinds: defaultdict[_Kind, list[can.Message]] = defaultdict(list)
    for message in messages:
        if message.is_error_frame:
            kinds[_ERROR].append(message)
        elif message.is_remote_frame:
            kinds[_REMOTE].append(message)
        else:
            kinds[_FD_DATA if message.is_fd else _DATA].append(message)
    return dict(kinds)


def _samples(kind: _Kind, messages: Sequence[can.Message]) -> NDArray[np.void]:
    """Records as the standard lays them out; the bus is counted from 1."""
    samples = np.zeros(len(messages), kind.dtype)
    values: dict[str, list[Any]] = {
        "ID": [m.arbitration_id for m in messages],
        "BusChannel": [1 + (channel2int(m.channel) or 0) for m in messages],
        "IDE": [m.is_extended_id for m in messages],
        "DLC": [len2dlc(m.dlc) for m in messages],
        "DataLength": [len(m.data) for m in messages],
        "Dir": [not m.is_rx for m in messages],
        "EDL": [m.is_fd for m in messages],
        "BRS": [m.bitrate_switch for m in messages],
        "ESI": [m.error_state_indicator for m in messages],
    }
    for name, column in values.items():
        samples[f"{kind.structure}.{name}"] = column
    payloads = b"".join(bytes(m.data[: kind.max_bytes]).ljust(kind.max_bytes, b"\0") for m in messages)
    samples[f"{kind.structure}.DataBytes"] = np.frombuffer(payloads, np.uint8).reshape(-1, kind.max_bytes)
    return samples
