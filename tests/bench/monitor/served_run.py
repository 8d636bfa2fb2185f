"""Run folders with a snapshot in them, held as by a run under way, and a monitor that serves them."""

import contextlib
import http.client
import threading
from dataclasses import replace
from datetime import UTC, datetime, timedelta

from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.monitor.server import MonitorServer
from gyrobench.bench.monitor.website import Website
from gyrobench.bench.runs.locks import RunLock
from tests.bench.monitor.sample_snapshots import made_up_snapshot

NOW = datetime(2026, 3, 2, 16, 42, 1, tzinfo=UTC)


def now():
    """A second after the made-up snapshot."""
    return NOW


def write_snapshot(folder, snapshot=None, age_s=1.0, **changes):
    """Leave a snapshot in a run folder as the run does: at one stroke."""
    updated = (NOW - timedelta(seconds=age_s)).isoformat()
    snapshot = replace(
        snapshot or made_up_snapshot(), updated_utc=updated, **({"name": folder.name} | changes)
    )
    folder.mkdir(exist_ok=True)
    (folder / "journal.jsonl").touch()
    part = folder / ".live.json.part"
    part.write_bytes(snapshot.to_json())
    part.replace(folder / "live.json")
    return snapshot


@contextlib.contextmanager
def run_under_way(folder, snapshot=None, **changes):
    """A run folder with a snapshot that a process, this one, holds."""
    write_snapshot(folder, snapshot, **changes)
    with RunLock(folder, VirtualClock()):
        yield folder


@contextlib.contextmanager
def served(answer):
    """A monitor at a free port; ``answer`` is a folder, or what gives the answers."""
    answer = answer if callable(answer) else Website(answer, now).answer
    with MonitorServer(answer, 0) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


def ask(server, target="/", method="GET", **headers):
    """One request; returns response and body."""
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=30)
    with contextlib.closing(connection):
        connection.request(method, target, headers=headers)
        response = connection.getresponse()
        return response, response.read()
