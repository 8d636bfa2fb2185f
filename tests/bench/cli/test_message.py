import pytest

from gyrobench.bench.foundations.shipped import find_document
from tests.bench.command_line import gyrobench, output_of, refusal_of
from tests.bench.messages.servers import Server, free_port


@pytest.fixture
def server():
    started = Server()
    yield started
    started.close()


@pytest.fixture
def station(tmp_path):
    """Write the shipped emulated station with receivers at these addresses."""

    def write(*urls):
        listed = "".join(f"  - {{kind: ntfy, address: '{url}/bench'}}\n" for url in urls)
        text = find_document("stations", "emulated").read_text()
        (tmp_path / "mine.yaml").write_text(f"{text}\nmessages:\n{listed}" if urls else text)
        return "mine.yaml"

    (tmp_path / "mine.yaml").write_text("")
    return write


def test_what_the_receiver_answers_is_reported(server, station, tmp_path):
    printed = output_of("message", station(server.url), "Hello, bench.", cwd=tmp_path)
    assert printed == f"sent     ntfy {server.url}/bench: 200 OK\n"
    assert server.received[0][2].decode().startswith("Hello, bench.")


def test_a_receiver_that_can_not_be_reached_is_reported_and_the_others_get_it(server, station, tmp_path):
    down = f"http://127.0.0.1:{free_port()}"
    printed = output_of("message", station(down, server.url), cwd=tmp_path, code=3)
    assert f"NOT SENT ntfy {down}/bench: Connection refused" in printed
    assert f"sent     ntfy {server.url}" in printed


def test_a_station_without_receivers_is_a_mistake(station, tmp_path):
    assert "no receivers: the section `messages` is missing" in refusal_of("message", station(), cwd=tmp_path)


def test_check_shows_receivers_and_misses_a_secret(station, server, tmp_path, monkeypatch):
    path = tmp_path / station(server.url)
    path.write_text(
        path.read_text() + "  - {kind: webhook, address: 'https://h/{secret}', secret_env: HOOK}\n"
    )
    printed = " ".join(output_of("check", "mine.yaml", cwd=tmp_path, code=1).split())
    assert "receives: ends, holds, resumes, needs person, unit dropped and dwells flagged" in printed
    assert "the environment variable HOOK" in printed
    monkeypatch.setenv("HOOK", "abc")
    assert gyrobench("check", "mine.yaml", cwd=tmp_path).returncode == 0
    assert not server.received
