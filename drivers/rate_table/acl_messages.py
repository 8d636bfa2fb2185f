"""Replies of the ACL, the command language of the Acutrol 3000: framing and status bits.

Source: manuals TM-8004 (commands, registers) and TM-9374A (error word and length before a reply).
The public manuals do not say in which byte order the two words come over TCP and RS-232.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

PREFIX_BYTES = 8
#: No message is longer, so one of the two readings of a length that is not zero is always absurd.
_MAX_LENGTH = 32768
_WORDS = {"little": struct.Struct("<II"), "big": struct.Struct(">II")}

STATE_SERVOED = 1 << 4
DYNAMICS_POSITION_COMPLETE = 1 << 8

#: Bits of ``AnSTATE`` that tell of an abort.
ABORTS = {6: "software abort", 7: "hardware abort"}
#: Bits of ``AnSWFLT``.
SOFTWARE_FAULTS = {
    0: "software abort",
    1: "rate trip",
    2: "tracking error",
    3: "servo frame time",
    5: "miscorrelation",
    6: "CRC error",
    7: "fine feedback lost",
    8: "coarse feedback lost",
    9: "self test failed",
}
#: Bits of ``AnINTLK``.
INTERLOCKS = {
    0: "user interlock 1",
    1: "user interlock 2",
    2: "user interlock 3",
    3: "output PGOUT3",
    6: "power amplifier does not acknowledge",
    7: "auxiliary interlock 1",
    8: "auxiliary interlock 2",
    9: "master interlock or front panel",
    10: "DMA synchronisation",
    11: "software watchdog",
    12: "clock watchdog",
    13: "serial data link",
    14: "servo interlock link",
    15: "10 kHz lock",
}


class ReplyFraming:
    """Reads the prefix of replies in the byte order that the first one shows."""

    def __init__(self) -> None:
        self._order: str | None = None

    def decode(self, prefix: bytes) -> tuple[int, int] | None:
        """Error code and length of the text, or None if no such reply exists.

        A prefix that only makes sense in the other byte order than before makes none, and the
        order is detected anew with the next one.
        """
        readings = {order: words.unpack(prefix) for order, words in _WORDS.items()}
        plausible = {order: reading for order, reading in readings.items() if reading[1] <= _MAX_LENGTH}
        if self._order is None:
            if len(plausible) == 1:
                (self._order,) = plausible
            return min(plausible.values(), default=None)
        if self._order not in plausible:
            self._order = None
            return None
        return plausible[self._order]


def set_bits(register: int, names: Mapping[int, str], other: str) -> list[str]:
    """Names of the bits that are set; ``other`` and the number for one without a name."""
    return [names.get(bit, f"{other} {bit}") for bit in range(register.bit_length()) if register >> bit & 1]
