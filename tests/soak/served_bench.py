"""The emulators of ``gyrobench emulate``, writing down every frame that the INS sends: eleven bytes each.

``python -m tests.soak.served_bench FRAMES [options of gyrobench.drivers.emulators.serve]``
"""

from __future__ import annotations

import struct
import sys
from pathlib import Path
from typing import Any

import can

from gyrobench.drivers.emulators import serve
from gyrobench.drivers.emulators.bench import EmulatedBench

FRAME = struct.Struct("<HB8s")


def packed(message: can.Message) -> bytes:
    """Identifier, length and data of a frame."""
    return FRAME.pack(message.arbitration_id, message.dlc, bytes(message.data))


def main() -> None:
    """Serve, and write the frames of the bus to the file of the first argument."""
    path = Path(sys.argv[1])

    class RecordedBench(EmulatedBench):
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            file = path.open("wb", buffering=0)
            self.bus.listeners.append(lambda block: file.write(b"".join(map(packed, block.messages()))))

    serve.EmulatedBench = RecordedBench
    serve.main(sys.argv[2:])


if __name__ == "__main__":
    main()
