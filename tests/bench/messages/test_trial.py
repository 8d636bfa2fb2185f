import pytest

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.messages.messenger import send_test
from tests.bench.messages.servers import free_port


@pytest.fixture
def station_with(tmp_path):
    """Write the shipped emulated station with these receivers."""

    def write(*receivers):
        path = tmp_path / "station.yaml"
        listed = "".join(f"  - {each}\n" for each in receivers)
        text = find_document("stations", "emulated").read_text()
        path.write_text(f"{text}\nmessages:\n{listed}" if receivers else text)
        return path

    return write


def test_every_receiver_gets_the_text_and_every_reply_is_returned(serve, station_with):
    server = serve()
    down = f"http://127.0.0.1:{free_port()}"
    station = station_with(
        f"{{kind: ntfy, address: '{server.url}/bench', on: [ends]}}", f"{{kind: webhook, address: '{down}'}}"
    )
    first, second = send_test(str(station), "Hello.")
    assert (first.is_sent, first.reply) == (True, "200 OK")
    assert first.receiver == f"ntfy {server.url}/bench"
    assert server.received[0][2].decode().startswith("Hello.")
    assert not second.is_sent
    assert "refused" in second.reply


def test_a_station_without_receivers_is_reported(station_with):
    with pytest.raises(
        DocumentError, match=r"station.yaml:\d+:1: no receivers: the section `messages` is missing"
    ):
        send_test(str(station_with()), "Hello.")
