"""Metrics as Prometheus reads them."""

import math
from dataclasses import replace

import pytest
from prometheus_client.parser import text_string_to_metric_families

from gyrobench.bench.foundations import packages
from gyrobench.bench.foundations.errors import MissingPackageError
from gyrobench.bench.monitor import website
from gyrobench.bench.monitor.metrics import METRICS, metrics_text
from gyrobench.bench.monitor.website import Website
from tests.bench.monitor.sample_snapshots import made_up_snapshot
from tests.bench.monitor.served_run import ask, now, run_under_way, served
from tests.docs.pages import DOCS


def scraped(text):
    """Value by name and labels."""
    return {
        (sample.name, *(f"{key}={value}" for key, value in sorted(sample.labels.items()))): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def test_a_run_is_scraped_from_the_monitor_while_it_is_under_way(tmp_path):
    snapshot = made_up_snapshot()
    with run_under_way(tmp_path / "first", snapshot), served(tmp_path) as server:
        response, body = ask(server, "/metrics")
    found = scraped(body.decode())
    assert response.status == 200
    assert response.headers["Content-Type"].startswith("text/plain; version=0.0.4")
    run, unit = "run=first", f"unit={snapshot.unit}"
    assert found["gyrobench_run_left_seconds", run] == snapshot.left_s
    assert found["gyrobench_run_state", run, f"state={snapshot.state.value}"] == 1.0
    assert sum(value for key, value in found.items() if key[0] == "gyrobench_run_state") == 1.0
    assert found["gyrobench_temperature_celsius", run, "sensor=gyro_x", unit] == snapshot.bench.gyro_c[0]
    assert found["gyrobench_reply_age_seconds", "instrument=ins", run, unit] == snapshot.bench.ins_age_s
    last = snapshot.dwells[-1]
    key = ("gyrobench_bias_degrees_per_hour", "gyro=z", f"position={last.position}", run, unit)
    assert found[key] == pytest.approx(last.bias_dph[2])
    assert found["gyrobench_dwells_measured", run, unit] == len(snapshot.dwells)
    assert {("gyrobench_alarm", f"name={alarm.name}", run) for alarm in snapshot.alarms} <= set(found)


def test_what_is_not_known_is_left_out(tmp_path):
    snapshot = replace(made_up_snapshot(), bench=None, dwells=(), dwell=None, left_s=math.nan)
    names = {key[0] for key in scraped(metrics_text([(tmp_path, snapshot, 1.0)]).decode())}
    assert "gyrobench_run_left_seconds" not in names
    assert "gyrobench_temperature_celsius" not in names
    assert "gyrobench_run_info" in names


def test_the_page_lists_every_metric():
    page = (DOCS / "howto/watch_and_report.md").read_text(encoding="utf-8")
    assert [name for name in METRICS if f"`{name}`" not in page] == []


def test_without_the_package_the_address_names_what_to_install(tmp_path, monkeypatch):
    def missing(_):
        raise MissingPackageError("pip install 'gyrobench[metrics]'")

    monkeypatch.setattr(website, "metrics_text", missing)
    answer = Website(tmp_path, now).answer("/metrics")
    assert answer.status == 501
    assert b"gyrobench[metrics]" in answer.body
    assert packages._EXTRAS["prometheus_client"] == "metrics"
