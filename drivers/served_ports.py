"""Ports for other programs to connect to: pseudo-terminals, and TCP ports of the loopback."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from pathlib import Path

_CHUNK = 4096


class PseudoTerminal:
    """A pseudo-terminal; clients open ``url`` like a serial device.

    ``link`` is a symbolic link for ``url`` that stays the same when the terminal's name changes; a dangling
    link of a killed program is replaced. Raises OSError if the link can't be made.
    """

    def __init__(self, link: Path | None = None) -> None:
        self._link = link
        self.plug_in()

    def plug_in(self) -> None:
        """Open a terminal, under the same ``url`` if there is a link."""
        import tty  # not on every platform

        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.url = os.ttyname(self._slave)
        if self._link is not None:
            if self._link.is_symlink() and not self._link.exists():
                self._link.unlink()
            self._link.symlink_to(self.url)
            self.url = str(self._link)

    def unplug(self) -> None:
        """Close it: a program that has it open gets input/output errors."""
        if self._link is not None:
            self._link.unlink(missing_ok=True)
        os.close(self._master)
        os.close(self._slave)

    def fileno(self) -> int:
        """Descriptor to wait on."""
        return self._master

    def read(self) -> bytes:
        """Bytes that have arrived, without waiting."""
        try:
            return os.read(self._master, _CHUNK)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> int:
        """Send what fits in the buffer."""
        try:
            return os.write(self._master, data)
        except BlockingIOError:
            return 0


class TcpPort:
    """A TCP port of the loopback with one client at a time; a new client replaces the old one.

    ``number`` 0 stands for any free port; ``greet`` returns bytes to send to each new client. Raises OSError
    if the port is taken.
    """

    def __init__(self, number: int = 0, greet: Callable[[], bytes] = bytes) -> None:
        self._greet = greet
        self._client: socket.socket | None = None
        self.number = number
        self.plug_in()
        self.url = f"socket://127.0.0.1:{self.number}"

    def plug_in(self) -> None:
        """Listen, on the same port as before."""
        self._listener = socket.create_server(("127.0.0.1", self.number))
        self._listener.setblocking(False)
        self.number = self._listener.getsockname()[1]

    def unplug(self) -> None:
        """Disconnect the client and stop listening."""
        self._hang_up()
        self._listener.close()

    def fileno(self) -> int:
        """Descriptor to wait on."""
        return (self._client or self._listener).fileno()

    def read(self) -> bytes:
        """Bytes that have arrived, without waiting."""
        try:
            client, _ = self._listener.accept()
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._hang_up()
            self._client = client
            client.sendall(self._greet())
        except BlockingIOError:
            pass
        if self._client is None:
            return b""
        try:
            data = self._client.recv(_CHUNK)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._hang_up()
        return data

    def write(self, data: bytes) -> int:
        """Send what fits in the buffer; without a client the bytes are lost."""
        if self._client is None:
            return len(data)
        try:
            return self._client.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            self._hang_up()
            return len(data)

    def _hang_up(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None


Port = PseudoTerminal | TcpPort
