"""Soaks until the gyros have settled, and those that end before."""

import pytest

from gyrobench.bench.runs.journal import read_journal

PROCEDURE = """procedure: soaks
steps:
  - power_on
  - chamber: {{temperature_c: 40, ramp_c_per_min: 4}}
  - soak: {{until_gyro_rate_below_c_per_h: {limit_c_per_h}, at_most_s: {at_most_s}}}
"""


@pytest.fixture
def soaked(run_procedure, tmp_path):
    """``soaked(limit_c_per_h, at_most_s)``: the soaks that did not settle, and what was printed."""

    def run(limit_c_per_h, at_most_s):
        path = tmp_path / "soaks.yaml"
        path.write_text(PROCEDURE.format(limit_c_per_h=limit_c_per_h, at_most_s=at_most_s))
        folder, outcome, printed = run_procedure(path, tmp_path / "run")
        assert outcome.ended == "finished", outcome.reason
        entries = list(read_journal(folder.journal))
        return [entry for entry in entries if entry["event"] == "soak_not_settled"], " ".join(printed.split())

    return run


def test_a_soak_that_ends_by_its_time_is_recorded_with_the_rate_it_reached(soaked):
    (entry,), printed = soaked(0.5, 1500)
    assert 0.5 < entry["rate_c_per_h"] < 100.0
    assert entry["limit_c_per_h"] == 0.5
    rate = f"a gyro still changes by {entry['rate_c_per_h']:.3g} degC/h"
    text = f"soak not settled after at_most_s (25 min), the run continues: {rate}, limit 0.5 degC/h"
    assert entry["text"] == text
    assert entry["text"] in printed


def test_a_soak_too_short_for_a_rate_has_none(soaked):
    (entry,), _ = soaked(0.5, 300)
    assert entry["rate_c_per_h"] is None
    assert "the rate is not known yet, limit 0.5 degC/h" in entry["text"]


def test_a_soak_that_settled_is_not_mentioned(soaked):
    found, printed = soaked(200, 3600)
    assert found == []
    assert "not settled" not in printed
