"""The server of the monitor: loopback only, read only, with limits of time, size and number of threads."""

from __future__ import annotations

import contextlib
import gzip
import socket
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from gyrobench.bench.foundations.errors import GyrobenchError

#: Content security policy of plain responses.
_DEFAULT_POLICY = "default-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
#: Policy of pages of a run folder: embedded images and styles, no scripts.
RECORD_POLICY = f"{_DEFAULT_POLICY}; img-src data:; style-src 'unsafe-inline'; sandbox allow-popups"

HTML = "text/html; charset=utf-8"
_PLAIN = "text/plain; charset=utf-8"


@dataclass(frozen=True)
class Response:
    """A response without the common headers; ``policy`` is its content security policy."""

    status: HTTPStatus
    body: bytes
    content_type: str = HTML
    policy: str = _DEFAULT_POLICY
    headers: dict[str, str] = field(default_factory=dict)


def page_policy(nonce: str) -> str:
    """Policy of the monitor's pages: a style and a script with the nonce, and connections to this server."""
    return f"{_DEFAULT_POLICY}; style-src 'nonce-{nonce}'; script-src 'nonce-{nonce}'; connect-src 'self'"


def refusal(status: HTTPStatus, text: str, **headers: str) -> Response:
    """Reject a request with a reason in plain text."""
    return Response(status, f"{text}\n".encode(), _PLAIN, headers=headers)


_LOOPBACK = "127.0.0.1"
#: Allowed Host headers; any other name comes from a page that resolved its own name to this address.
_HOST_NAMES = {_LOOPBACK, "localhost"}
_MAX_THREADS = 16
_SOCKET_TIMEOUT_S = 10.0
_MAX_REQUEST_S = 20.0
#: A connection that was shut down releases its thread within this time.
_MAX_RELEASE_S = 1.0
_MAX_TARGET_LENGTH = 2000
_MIN_GZIP_BYTES = 1000
_BUSY_RESPONSE = b"HTTP/1.0 503 Service Unavailable\r\nRetry-After: 2\r\nContent-Length: 0\r\n\r\n"
_HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class MonitorServer(ThreadingHTTPServer):
    """Serves the responses of a function to the targets of GET and HEAD requests.

    ``answer``: returns the response to a target such as ``/runs/mine/``. ``port``: TCP port; 0 for any free
    port. Raises GyrobenchError if the port is not available.
    """

    daemon_threads = True
    request_queue_size = 64

    def __init__(self, answer: Callable[[str], Response], port: int) -> None:
        self.answer = answer
        self._free_threads = threading.BoundedSemaphore(_MAX_THREADS)
        self._waiting: dict[socket.socket, None] = {}  # connections without a complete request, oldest first
        try:
            super().__init__((_LOOPBACK, port), _Handler)
        except (OSError, OverflowError) as error:
            raise GyrobenchError(
                f"port {port} of {_LOOPBACK} is not available: {error}. "
                "Choose another --port, or 0 for any free port."
            ) from error

    @property
    def url(self) -> str:
        """Address of the first page."""
        return f"http://{_LOOPBACK}:{self.server_port}/"

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a separate thread; with too many connections, the longest waiting one is shut down.

        If all are being answered, the request is rejected.
        """
        if not self._free_threads.acquire(blocking=False):
            oldest = next(iter(self._waiting.copy()), None)
            if oldest is not None:
                self.end_waiting(oldest)
                _shut_down(oldest)
            if oldest is None or not self._free_threads.acquire(timeout=_MAX_RELEASE_S):
                with contextlib.suppress(OSError):  # disconnected already
                    request.sendall(_BUSY_RESPONSE)
                self.shutdown_request(request)
                return
        self._waiting[request] = None
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer one request within a total time limit, which also ends requests that arrive too slowly."""
        timer = threading.Timer(_MAX_REQUEST_S, _shut_down, [request])
        timer.daemon = True
        timer.start()
        try:
            super().process_request_thread(request, client_address)
        finally:
            timer.cancel()
            self.end_waiting(request)
            self._free_threads.release()

    def end_waiting(self, request: socket.socket) -> None:
        """Remove a connection that has sent a complete request, or ended, from those that wait."""
        self._waiting.pop(request, None)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore clients that disconnected."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


def _shut_down(request: socket.socket) -> None:
    with contextlib.suppress(OSError):
        request.shutdown(socket.SHUT_RDWR)


class _Handler(BaseHTTPRequestHandler):
    """One request, after which the connection is closed."""

    server: MonitorServer
    server_version = "gyrobench"
    sys_version = ""
    timeout = _SOCKET_TIMEOUT_S

    def do_GET(self) -> None:
        """Answer a request for content, or for headers."""
        self._send(self._answer())

    do_HEAD = do_GET  # noqa: N815 - a name of http.server

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:  # noqa: ARG002
        """Refuse a request that http.server can't read, or whose method has no ``do_...`` here."""
        if code == HTTPStatus.NOT_IMPLEMENTED:
            text = "This page is read only. Send commands with gyrobench control."
            self._send(refusal(HTTPStatus.METHOD_NOT_ALLOWED, text, Allow="GET, HEAD"))
        else:
            self._send(refusal(HTTPStatus(code), message or HTTPStatus(code).phrase))

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        """Log nothing: a browser sends a request every two seconds."""

    def _answer(self) -> Response:
        """Response to the request, also to an invalid one."""
        self.server.end_waiting(self.request)
        if not _is_allowed_host(self.headers.get_all("Host", [])):
            text = f"Open {self.server.url}: requests to other names are rejected."
            return refusal(HTTPStatus.MISDIRECTED_REQUEST, text)
        if len(self.path) > _MAX_TARGET_LENGTH:
            return refusal(HTTPStatus.REQUEST_URI_TOO_LONG, "Address too long.")
        try:
            return self.server.answer(self.path)
        except Exception as error:  # noqa: BLE001 - the outermost loop: a page that fails is only that
            text = f"The page can't be shown: {type(error).__name__}. The run is not affected."
            return refusal(HTTPStatus.INTERNAL_SERVER_ERROR, text)

    def _send(self, answer: Response) -> None:
        """Send a response, compressed if the client accepts that."""
        body = answer.body
        headers = getattr(self, "headers", None) or {}  # a request may be refused before they are read
        is_compressed = len(body) > _MIN_GZIP_BYTES and "gzip" in headers.get("Accept-Encoding", "")
        if is_compressed:
            body = gzip.compress(body, compresslevel=5)
        self.send_response(answer.status)
        content_headers = {"Content-Type": answer.content_type, "Content-Security-Policy": answer.policy}
        encoding = {"Content-Encoding": "gzip"} if is_compressed else {}
        for name, value in {**_HEADERS, **content_headers, **encoding, **answer.headers}.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)


def _is_allowed_host(hosts: list[str]) -> bool:
    """Whether a request has one Host header with a loopback name and any port."""
    if len(hosts) != 1:
        return False
    name, colon, port = hosts[0].strip().partition(":")
    return name.lower() in _HOST_NAMES and (not colon or port.isdecimal())
