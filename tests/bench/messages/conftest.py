import pytest
from pydantic import TypeAdapter

from gyrobench.bench.station.receivers import Receiver
from tests.bench.messages.servers import RawServer, Server


@pytest.fixture
def serve():
    """Start HTTP servers; they are ended with the test."""
    servers = []

    def start(*answers, **options):
        servers.append(Server(*answers, **options))
        return servers[-1]

    yield start
    for server in servers:
        server.close()


@pytest.fixture(scope="session")
def receiver():
    """Make a receiver as a station file does."""
    adapter = TypeAdapter(Receiver)
    return lambda **keys: adapter.validate_python(keys)


@pytest.fixture
def serve_raw():
    """Start servers that answer a request as a function says, byte by byte; gives their address."""
    servers = []

    def start(answer, pause_s=None):
        servers.append(RawServer(answer, pause_s))
        return servers[-1].url

    yield start
    for server in servers:
        server.close()


@pytest.fixture
def serve_drip(serve_raw):
    """Start servers that send a head without end, a line every now and then."""
    return lambda: serve_raw(lambda _: b"HTTP/1.0 200 OK\r\n" + b"X-A: 1\r\n" * 90, pause_s=0.1)
