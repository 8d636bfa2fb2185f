import contextlib
import gzip
import socket
import threading
import time
from http import HTTPStatus

import pytest

from gyrobench.bench.foundations.errors import GyrobenchError
from gyrobench.bench.monitor.server import MonitorServer, Response
from tests.bench.monitor.served_run import ask, served

LONG = "a long text " * 500


@pytest.fixture(scope="module")
def server():
    def answer(target):
        return Response(HTTPStatus.OK, (LONG if target == "/long" else target).encode())

    with served(answer) as server:
        yield server


def raw(server, request):
    """What the server answers to these bytes."""
    with socket.create_connection(("127.0.0.1", server.server_port), timeout=30) as connection:
        connection.sendall(request)
        connection.shutdown(socket.SHUT_WR)
        return b"".join(iter(lambda: connection.recv(65536), b""))


def test_it_listens_on_the_loopback_alone(server):
    assert server.server_address[0] == "127.0.0.1"
    assert server.url == f"http://127.0.0.1:{server.server_port}/"


def test_a_page_is_given_and_its_headers_alone_to_a_head_request(server):
    got, body = ask(server, "/page")
    headers, nothing = ask(server, "/page", "HEAD")
    assert (got.status, body) == (200, b"/page")
    assert (headers.status, nothing) == (200, b"")
    assert headers.headers["Content-Length"] == "5"


@pytest.mark.parametrize("method", ["POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE", "CONNECT", "BREW"])
def test_nothing_else_is_allowed(server, method):
    response, body = ask(server, "/page", method)
    assert response.status == 405
    assert response.headers["Allow"] == "GET, HEAD"
    assert b"read only" in body


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "LOCALHOST:9000", "127.0.0.1:8765"])
def test_it_answers_to_its_own_names_through_any_port(server, host):
    assert ask(server, Host=host)[0].status == 200


@pytest.mark.parametrize(
    "host",
    ["evil.example", "127.0.0.1.evil.example", "localhost.evil.example:80", "localhost:", "10.0.0.1", ""],
)
def test_it_answers_to_no_other_name(server, host):
    response, body = ask(server, Host=host)
    assert response.status == 421
    assert b"/page" not in body


@pytest.mark.parametrize("hosts", [b"", b"Host: localhost\r\nHost: evil.example\r\n"])
def test_a_request_has_one_name_of_the_server(server, hosts):
    assert raw(server, b"GET /page HTTP/1.1\r\n" + hosts + b"\r\n").startswith(b"HTTP/1.0 421 ")


@pytest.mark.parametrize(
    ("request_bytes", "expected"),
    [
        (b"\x00\xff\x16\x03\x01 nonsense\r\n\r\n", b"Bad HTTP/0.9 request type"),
        (b"GET /" + 3000 * b"a" + b" HTTP/1.1\r\nHost: localhost\r\n\r\n", b"HTTP/1.0 414 "),
        (b"GET /" + 70000 * b"a" + b" HTTP/1.1\r\n\r\n", b"HTTP/1.0 414 "),
        (b"GET / HTTP/1.1\r\n" + 200 * b"X: y\r\n" + b"\r\n", b"HTTP/1.0 431 "),
        (b"GET / HTTP/9.9\r\n\r\n", b"Invalid HTTP version"),
    ],
)
def test_a_request_that_is_wrong_or_too_large_is_refused_and_the_next_one_answered(
    server, request_bytes, expected
):
    assert raw(server, request_bytes).startswith(expected)
    assert ask(server)[0].status == 200


def test_what_every_answer_says_to_browsers(server):
    for target, method in (("/", "GET"), ("/", "POST")):
        headers = ask(server, target, method)[0].headers
        assert headers["Content-Security-Policy"].startswith("default-src 'none'")
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert headers["Cache-Control"] == "no-store"
        assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
        assert "Python" not in headers["Server"]


def test_a_long_answer_is_packed_for_who_can_unpack_it(server):
    packed, body = ask(server, "/long", **{"Accept-Encoding": "gzip"})
    plain, text = ask(server, "/long")
    assert packed.headers["Content-Encoding"] == "gzip"
    assert "Content-Encoding" not in plain.headers
    assert gzip.decompress(body) == text == LONG.encode()


def test_too_many_at_once_are_turned_away_until_some_have_ended():
    may_end, begun = threading.Event(), threading.Semaphore(0)

    def answer(target):
        if target == "/slow":
            begun.release()
            assert may_end.wait(30)
        return Response(HTTPStatus.OK, target.encode())

    with served(answer) as server:
        threads = [threading.Thread(target=ask, args=(server, "/slow")) for _ in range(16)]
        for thread in threads:
            thread.start()
            assert begun.acquire(timeout=30)
        response, _ = ask(server)
        assert (response.status, response.headers["Retry-After"]) == (503, "2")
        may_end.set()
        for thread in threads:
            thread.join()
        end_s = time.monotonic() + 30.0
        while ask(server)[0].status == 503:
            assert time.monotonic() < end_s
            time.sleep(0.02)
        assert ask(server)[0].status == 200


def test_connections_that_send_nothing_keep_no_one_out():
    with (
        served(lambda target: Response(HTTPStatus.OK, target.encode())) as server,
        contextlib.ExitStack() as waiting,
    ):
        for _ in range(40):
            waiting.enter_context(socket.create_connection(("127.0.0.1", server.server_port)))
        for _ in range(20):
            response, body = ask(server, "/page")
            assert (response.status, body) == (200, b"/page")


def test_a_client_that_goes_away_leaves_nothing_in_the_terminal(capfd):
    def answer(target):
        return Response(HTTPStatus.OK, 20_000_000 * b"x")

    with served(answer) as server:
        with socket.create_connection(("127.0.0.1", server.server_port)) as connection:
            connection.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
            connection.recv(100)
        assert ask(server)[0].status == 200
    assert capfd.readouterr() == ("", "")


def test_a_port_that_is_in_use_is_reported(server):
    with pytest.raises(GyrobenchError, match=rf"port {server.server_port} .*Choose another --port"):
        MonitorServer(server.answer, server.server_port)


def test_a_page_that_can_not_be_made_is_reported_and_the_others_are_still_there():
    def answer(target):
        return Response(HTTPStatus.OK, str(1 / len(target.strip("/"))).encode())

    with served(answer) as server:
        response, body = ask(server, "/")
        assert (response.status, b"ZeroDivisionError" in body) == (500, True)
        assert ask(server, "/ab")[1] == b"0.5"


def test_a_client_that_drips_is_cut_off(monkeypatch):
    monkeypatch.setattr("gyrobench.bench.monitor.server._MAX_REQUEST_S", 0.5)
    with (
        served(lambda target: Response(HTTPStatus.OK, target.encode())) as server,
        socket.create_connection(("127.0.0.1", server.server_port), timeout=30) as connection,
    ):
        connection.sendall(b"GET / HTTP/1.0\r\n")
        assert connection.recv(100) == b""
        assert ask(server, "/page")[1] == b"/page"
