"""Ports for other programs to connect to: pseudo-terminals, and TCP ports of the loopback."""

from __future__ import annotations

import os
import socket
from pathlib import Path

_CHUNK = 4096


class PseudoTerminal:
    """A pseudo-terminal; clients open ``url`` like a serial device.

    If ``link`` is given, ``url`` is a symbolic link of that path, which stays the same when the terminal is
    opened again; replaces a dangling link of a killed program. Raises OSError if the link can't be made.
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
        """Close the terminal: a program that has it open gets input/output errors."""
        if self._link is not None:
            self._link.unlink(missing_ok=True)
        os.close(self._master)
        os.close(self._slave)

    def fileno(self) -> int:
        """File descriptor for ``select``."""
        return self._master

    def read(self) -> bytes:
        """Read the bytes that have arrived, without waiting."""
        try:
            return os.read(self._master, _CHUNK)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> int:
        """Send as many bytes as fit in the buffer; returns their number."""
        try:
            return os.write(self._master, data)
        except BlockingIOError:
            return 0


class TcpListener:
    """A TCP port of the loopback on which clients connect.

    ``number`` is that of the port, 0 for any free one. Raises OSError if the port is taken.
    """

    def __init__(self, number: int = 0) -> None:
        self.number = number
        self.plug_in()
        self.url = f"socket://127.0.0.1:{self.number}"

    def plug_in(self) -> None:
        """Listen, on the same port as before."""
        self._listener = socket.create_server(("127.0.0.1", self.number))
        self._listener.setblocking(False)
        self.number = self._listener.getsockname()[1]

    def unplug(self) -> None:
        """Stop listening."""
        self._listener.close()

    def fileno(self) -> int:
        """File descriptor for ``select``."""
        return self._listener.fileno()

    def accept(self, greeting: bytes = b"") -> TcpClient | None:
        """Accept the next client and send it ``greeting``; None if no client waits."""
        try:
            client, _ = self._listener.accept()
        except BlockingIOError:
            return None
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        accepted = TcpClient(client)
        accepted.write(greeting)
        return accepted


class TcpClient:
    """A connected client."""

    def __init__(self, client: socket.socket) -> None:
        self._client = client
        self.is_connected = True

    def fileno(self) -> int:
        """File descriptor for ``select``."""
        return self._client.fileno()

    def read(self) -> bytes:
        """Read the bytes that have arrived, without waiting; detects that the client disconnected."""
        try:
            data = self._client.recv(_CHUNK)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self.unplug()
        return data

    def write(self, data: bytes) -> int:
        """Send as many bytes as fit in the buffer; returns their number.

        All bytes to a client that has disconnected are lost and count as sent.
        """
        try:
            return self._client.send(data) if data else 0
        except BlockingIOError:
            return 0
        except OSError:
            self.unplug()
            return len(data)

    def unplug(self) -> None:
        """Disconnect the client."""
        self.is_connected = False
        self._client.close()


class TcpPort(TcpListener):
    """A TCP port of the loopback with one client at a time; another one is disconnected at once."""

    _client: TcpClient | None = None

    def unplug(self) -> None:
        """Disconnect the client and stop listening."""
        if self._client is not None:
            self._client.unplug()
            self._client = None
        super().unplug()

    def fileno(self) -> int:
        """File descriptor for ``select``."""
        return self._client.fileno() if self._client else super().fileno()

    def read(self) -> bytes:
        """Read the bytes that have arrived, without waiting."""
        data = self._client.read() if self._client else b""
        if self._client and not self._client.is_connected:
            self._client = None
        if self._client is None:
            self._client = self.accept()
            return self._client.read() if self._client else b""
        # While the client has unread bytes, it is unknown whether it has disconnected.
        if not data and (other := self.accept()):
            other.unplug()
        return data

    def write(self, data: bytes) -> int:
        """Send as many bytes as fit in the buffer; returns their number.

        Without a client all bytes are lost and count as sent.
        """
        sent = self._client.write(data) if self._client else len(data)
        if self._client and not self._client.is_connected:
            self._client = None
        return sent


Port = PseudoTerminal | TcpPort
