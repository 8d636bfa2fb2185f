"""How a controller is reached by default; each dialect states it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LineDefaults:
    """How a controller is reached unless the station file says otherwise.

    Attributes
    ----------
    baudrate : int
        Bits per second.
    parity : {"N", "E", "O"}
        Parity bit; eight data bits and one stop bit always.
    tcp_port : int or None
        Its TCP port, for an address that names none; None where it has no usual one.
    """

    baudrate: int = 9600
    parity: str = "N"
    tcp_port: int | None = None
