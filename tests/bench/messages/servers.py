"""Servers on loopback that receive messages."""

import contextlib
import socket
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


class _Handler(BaseHTTPRequestHandler):
    def do_POST(self):
        body = self.rfile.read(int(self.headers["Content-Length"]))
        server = self.server
        server.received.append((self.path, dict(self.headers), body))
        code = server.answers.pop(0) if server.answers else 200
        if code == "hang":
            server.released.wait(60.0)
            code = 200
        self.send_response(code)
        if code in (301, 302, 307):
            self.send_header("Location", "/elsewhere")
        self.end_headers()
        self.wfile.write(b"said the server")

    def do_GET(self):
        self.server.received.append((self.path, "GET", b""))
        self.send_response(200)
        self.end_headers()

    def log_message(self, *_):
        pass


class Server:
    """An HTTP server; each request is answered with the next of ``answers``, then with 200."""

    def __init__(self, *answers, port=0):
        self._server = ThreadingHTTPServer(("127.0.0.1", port), _Handler)
        self._server.daemon_threads = True
        self._server.received, self._server.answers = [], list(answers)
        self._server.released = threading.Event()
        self.port = self._server.server_port
        self.url = f"http://127.0.0.1:{self.port}"
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.02,), daemon=True)
        self._thread.start()

    @property
    def received(self):
        """Path, headers and body of every request."""
        return self._server.received

    def close(self):
        self._server.released.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class RawServer:
    """A server that answers every request with bytes, at once or a line at a time."""

    def __init__(self, answer, pause_s=None):
        self._answer, self._pause_s = answer, pause_s
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._over = threading.Event()
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self):
        with contextlib.suppress(OSError):  # closed from either side
            while True:
                connection, _ = self._listener.accept()
                with connection:
                    self._reply(connection)

    def _reply(self, connection):
        request = b""
        while b"\r\n\r\n" not in request:
            request += connection.recv(65_536)
        head, _, body = request.partition(b"\r\n\r\n")
        left = int(head.lower().partition(b"content-length: ")[2].split(b"\r\n")[0]) - len(body)
        while left > 0:
            left -= len(connection.recv(left))
        pieces = self._answer(head)
        for piece in pieces.splitlines(keepends=True) if self._pause_s else [pieces]:
            connection.sendall(piece)
            if self._over.wait(self._pause_s or 0.0):
                return

    def close(self):
        self._over.set()
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join()


def free_port():
    """A port without a listener."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def wait_for(condition, limit_s=30.0):
    """Wait until a condition is true; fails if it never is."""
    end_s = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end_s, "did not come about"
        time.sleep(0.01)
