"""The guard sends an alarm when it had to act."""

import json

import pytest

from tests.bench.guard.served_bench import SmallEngine, is_running, wait_for
from tests.bench.messages.servers import Server, free_port

pytestmark = pytest.mark.wall_time


@pytest.fixture
def start_engine_with_webhook(served, tmp_path):
    """Start an engine in small whose station has a webhook at this address."""
    engines = []

    def start(url):
        station = tmp_path / "alarm.yaml"
        text = served.station.path.read_text()
        station.write_text(f"{text}\nmessages:\n  - {{kind: webhook, address: '{url}', on: [ends]}}\n")
        engines.append(SmallEngine(station, tmp_path / "run"))
        return engines[-1]

    yield start
    for engine in engines:
        engine.close()


def test_an_alarm_is_sent_once_the_network_is_up_and_the_bench_does_not_wait_for_it(
    start_engine_with_webhook,
):
    port = free_port()
    engine = start_engine_with_webhook(f"http://127.0.0.1:{port}")
    engine.process.kill()
    wait_for(lambda: "message delayed" in engine.log() and "the bench is in its safe state" in engine.log())
    server = Server(port=port)
    wait_for(lambda: not is_running(engine.guard_pid))
    ((_, _, body),) = server.received
    server.close()
    received = json.loads(body)
    assert (received["event"], received["station"], received["run"]) == ("guard_acted", "emulated", "run")
    assert received["urgent"]
    assert (
        "The engine died without releasing the guard, so the guard acted. The bench is in its safe state."
        in received["why"]
    )
    assert "message sent" in engine.log()
