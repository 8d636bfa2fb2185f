"""Sender of a real bus at a high rate: the text of frames, made from arrays, to a descriptor or a socket.

Run as a process: ``text_sender.py KIND RATE SECONDS``; ``KIND`` is ``pty``, ``socket`` or ``socketcand``.
Prints the address, sends when a client has opened the bus, and prints the number of frames sent and its
processor time.
"""

import os
import socket
import sys
import time
import tty

import numpy as np

#: Five messages of an INS.
IDENTIFIERS = (0x001, 0x004, 0x005, 0x006, 0x007)
_PERIOD_S = 0.002
_HEX = np.frombuffer(b"0123456789abcdef", np.uint8)


def payloads(first: int, count: int) -> np.ndarray:
    """Data bytes of frames, shape (count, 8): the frame's number, and a number that scatters."""
    numbers = np.arange(first, first + count, dtype=np.uint64)
    scattered = (numbers * np.uint64(2654435761) >> np.uint64(7)) & np.uint64(0xFFFF_FFFF)
    return (numbers | scattered << np.uint64(32)).astype("<u8")[:, np.newaxis].view(np.uint8)


def text(kind: str, first: int, count: int, now_s: float) -> bytes:
    """Lines of some frames."""
    data = payloads(first, count)
    digits = np.stack([_HEX[data >> 4], _HEX[data & 15]], axis=-1).reshape(count, 16)
    identifiers = np.array(IDENTIFIERS)[np.arange(first, first + count) % len(IDENTIFIERS)]
    id_digits = _HEX[identifiers[:, np.newaxis] >> np.array([8, 4, 0]) & 15]
    if kind != "socketcand":
        before, between, after = b"t", b"8", b"\r"
    else:
        before, between, after = b"< frame ", f" {now_s:.6f} ".encode(), b" >"
    parts = [np.tile(np.frombuffer(part, np.uint8), (count, 1)) for part in (before, between, after)]
    return np.concatenate([parts[0], id_digits, parts[1], digits, parts[2]], axis=1).tobytes()


def main(kind: str, rate: float, seconds: float) -> None:
    if kind == "pty":
        near, far = os.openpty()
        tty.setraw(far)
        print(os.ttyname(far), flush=True)
    else:
        server = socket.create_server(("127.0.0.1", 0))
        print(server.getsockname()[1], flush=True)
        client, _ = server.accept()
        near = client.fileno()
        if kind == "socketcand":
            client.sendall(b"< hi >")
    opened = b""
    while b"rawmode >" not in opened and b"O\r" not in opened:
        opened += os.read(near, 1000)
        if kind == "socketcand":
            os.write(near, b"< ok >")
    begin_s, sent = time.monotonic(), 0
    while sent < rate * seconds:
        time.sleep(_PERIOD_S)
        due = min(int(rate * (time.monotonic() - begin_s)), int(rate * seconds)) - sent
        lines = text(kind, sent, due, time.time())
        while lines:
            lines = lines[os.write(near, lines) :]
        sent += due
    took_s = time.monotonic() - begin_s
    print(f"{sent} {took_s:.3f} {time.process_time():.3f}", flush=True)
    sys.stdin.read()  # the port stays until the receiver has read everything


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]), float(sys.argv[3]))
