import pytest
from pydantic import TypeAdapter

from bench.station.messages import Receiver
from tests.bench.messages.servers import Server


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
