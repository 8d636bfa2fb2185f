"""The server of the monitor: loopback only, read only, with bounded time, size and number of threads."""

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

#: For what needs neither script nor style.
BARE_POLICY = "default-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
#: For pages that a run leaves: pictures and style inside, and never a script, whatever is in them.
RECORD_POLICY = f"{BARE_POLICY}; img-src data:; style-src 'unsafe-inline'; sandbox allow-popups"

HTML = "text/html; charset=utf-8"
PLAIN = "text/plain; charset=utf-8"


@dataclass(frozen=True)
class Answer:
    """An answer without the headers that all have.

    Attributes
    ----------
    status : HTTPStatus
        Status.
    body : bytes
        Content.
    content_type : str
        What the content is.
    policy : str
        Content security policy.
    headers : dict
        Headers that only this answer has.
    """

    status: HTTPStatus
    body: bytes
    content_type: str = HTML
    policy: str = BARE_POLICY
    headers: dict[str, str] = field(default_factory=dict)


def page_policy(nonce: str) -> str:
    """Policy of the monitor's own pages: a style and a script with the nonce, which asks this server."""
    return f"{BARE_POLICY}; style-src 'nonce-{nonce}'; script-src 'nonce-{nonce}'; connect-src 'self'"


def refusal(status: HTTPStatus, text: str, **headers: str) -> Answer:
    """Say in plain text why there is nothing else."""
    return Answer(status, f"{text}\n".encode(), PLAIN, headers=headers)


LOOPBACK = "127.0.0.1"
#: Names by which a browser may call the server: another one comes from a page that rebound its own name.
_OWN_NAMES = {LOOPBACK, "localhost"}
_MOST_THREADS = 16
_PATIENCE_S = 10.0
_LONGEST_REQUEST_S = 20.0
_LONGEST_TARGET = 2000
_WORTH_PACKING = 1000
_BUSY = b"HTTP/1.0 503 Service Unavailable\r\nRetry-After: 2\r\nContent-Length: 0\r\n\r\n"
_HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class MonitorServer(ThreadingHTTPServer):
    """Serves what a function answers to the target of a GET or HEAD request.

    Parameters
    ----------
    answer : callable
        Gives the answer to a target such as ``/runs/mine/``.
    port : int
        TCP port; 0 for any free one.

    Raises
    ------
    GyrobenchError
        The port can't be had.
    """

    daemon_threads = True
    request_queue_size = 64

    def __init__(self, answer: Callable[[str], Answer], port: int) -> None:
        self.answer = answer
        self._free_threads = threading.BoundedSemaphore(_MOST_THREADS)
        try:
            super().__init__((LOOPBACK, port), _Handler)
        except (OSError, OverflowError) as error:
            raise GyrobenchError(
                f"port {port} of {LOOPBACK}: can't be listened on: {error}. Is another monitor there? "
                "Give another --port, or 0 for any free one"
            ) from error

    @property
    def url(self) -> str:
        """Address of the first page."""
        return f"http://{LOOPBACK}:{self.server_port}/"

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread of its own, or say at once that there are too many."""
        if not self._free_threads.acquire(blocking=False):
            self._turn_away(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer one request; one that takes too long in all is cut off, however it drips."""
        end = threading.Timer(_LONGEST_REQUEST_S, _cut_off, [request])
        end.daemon = True
        end.start()
        try:
            super().process_request_thread(request, client_address)
        finally:
            end.cancel()
            self._free_threads.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of clients that went away."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)

    def _turn_away(self, request: socket.socket) -> None:
        try:
            request.sendall(_BUSY)
        except OSError:
            pass  # it has gone already
        finally:
            self.shutdown_request(request)


def _cut_off(request: socket.socket) -> None:
    with contextlib.suppress(OSError):
        request.shutdown(socket.SHUT_RDWR)


class _Handler(BaseHTTPRequestHandler):
    """One request, after which the connection is closed."""

    server: MonitorServer
    server_version = "gyrobench"
    sys_version = ""
    timeout = _PATIENCE_S

    def do_GET(self) -> None:
        """Answer a request for content."""
        self._send(self._answer())

    def do_HEAD(self) -> None:
        """Answer a request for headers."""
        self._send(self._answer())

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:  # noqa: ARG002
        """Refuse a request that http.server can't read, or whose method has no ``do_...`` here."""
        if code == HTTPStatus.NOT_IMPLEMENTED:
            text = "This page is read only. Orders are given with gyrobench tell."
            self._send(refusal(HTTPStatus.METHOD_NOT_ALLOWED, text, Allow="GET, HEAD"))
        else:
            self._send(refusal(HTTPStatus(code), message or HTTPStatus(code).phrase))

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        """Keep the terminal free: a browser asks every other second."""

    def _answer(self) -> Answer:
        if not _is_own_name(self.headers.get_all("Host", [])):
            text = f"Ask for {self.server.url}: no other name of this server is answered."
            return refusal(HTTPStatus.MISDIRECTED_REQUEST, text)
        if len(self.path) > _LONGEST_TARGET:
            return refusal(HTTPStatus.REQUEST_URI_TOO_LONG, "No address here is that long.")
        try:
            return self.server.answer(self.path)
        except Exception as error:  # noqa: BLE001 - the outermost loop: a page that fails is only that
            text = f"This can't be shown: {type(error).__name__}. The run is not touched by that."
            return refusal(HTTPStatus.INTERNAL_SERVER_ERROR, text)

    def _send(self, answer: Answer) -> None:
        body = answer.body
        is_packed = len(body) > _WORTH_PACKING and self._takes_gzip()
        if is_packed:
            body = gzip.compress(body, compresslevel=5)
        self.send_response(answer.status)
        own = {"Content-Type": answer.content_type, "Content-Security-Policy": answer.policy}
        packing = {"Content-Encoding": "gzip"} if is_packed else {}
        for name, value in {**_HEADERS, **own, **packing, **answer.headers}.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def _takes_gzip(self) -> bool:
        headers = getattr(self, "headers", None)  # a request may be refused before it has any
        return headers is not None and "gzip" in headers.get("Accept-Encoding", "")


def _is_own_name(hosts: list[str]) -> bool:
    """Whether a request's Host headers are one, and a name of this machine with whatever port leads here."""
    if len(hosts) != 1:
        return False
    name, colon, port = hosts[0].strip().partition(":")
    return name.lower() in _OWN_NAMES and (not colon or port.isdecimal())
