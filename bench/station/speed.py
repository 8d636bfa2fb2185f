"""Which addresses a bench may have that lives faster than real time: those of an emulated one."""

from __future__ import annotations

from collections.abc import Iterable
from urllib.parse import urlsplit

_LOOPBACK = ("127.0.0.1", "localhost", "::1")
_SERVED_INTERFACES = ("slcan", "socketcand", "emulator")
_SCHEMES_HERE = ("emulator", "replay")


def why_not_fast(addresses: Iterable[str], interface: str, host: str) -> str:
    """Say which address belongs to no emulated bench on this computer; empty where all do.

    Parameters
    ----------
    addresses : iterable of str
        Ports of table and chamber, channel of the CAN bus.
    interface, host : str
        python-can's interface of the bus, and the host that its options name.
    """
    if interface not in _SERVED_INTERFACES:
        return f"ins.interface: {interface} reaches a real bus"
    if host and host not in _LOOPBACK:
        return f"{host} is another computer"
    for address in addresses:
        if address.startswith("/dev/") and not address.startswith("/dev/pts/"):
            return f"{address} is a real port"
        url = urlsplit(address)
        if url.scheme and url.scheme not in _SCHEMES_HERE and url.hostname not in _LOOPBACK:
            return f"{address} is no address of this computer"
    return ""
