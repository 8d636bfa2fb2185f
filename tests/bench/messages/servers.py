"""Servers on loopback that receive messages."""

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


def free_port():
    """A port on which nobody listens."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def wait_for(condition, limit_s=30.0):
    """Wait until a condition is true; fails if it never is."""
    end_s = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end_s, "did not come about"
        time.sleep(0.01)
