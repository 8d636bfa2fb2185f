"""Protocol between engine and guard: the configuration and the bytes in the pipe."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass

#: Bytes in the pipe after the configuration.
BEAT, RELEASE = b".", b"R"
#: The guard's answer when it watches.
READY = b"ready\n"
#: Name of the guard's log in the run folder.
LOG_NAME = "guard.log"

#: A write of up to this many bytes to a pipe is atomic.
_MAX_BYTES = 4096


@dataclass(frozen=True)
class GuardConfig:
    """Settings of a guard: one line of JSON, the first through the pipe."""

    station: str  #: absolute path of the station file
    folder: str  #: absolute path of the run folder
    silence_s: float  #: silence after which the engine counts as hanging
    engine_pid: int  #: the engine's process
    epoch: str  #: calendar time at zero of the run's clock, ISO 8601
    now_s: float  #: the run's clock when the guard starts

    def line(self) -> bytes:
        """Return the bytes to send; raises ValueError if they are too long for the pipe."""
        data = json.dumps(asdict(self)).encode() + b"\n"
        if len(data) > _MAX_BYTES:
            raise ValueError(f"{self.folder}: the path is too long for the guard")
        return data

    @classmethod
    def read(cls, descriptor: int) -> GuardConfig | None:
        """Read the line from the pipe; None if the engine died before it sent one."""
        data = bytearray()
        while not data.endswith(b"\n"):
            if not (byte := os.read(descriptor, 1)):
                return None
            data += byte
        return cls(**json.loads(data))
