"""The soak in short: a run that is killed, some faults, some hours of a long run, and the table."""

import json

import numpy as np
import pytest

from gyrobench.bench.bias.dwell_table import DwellRow
from tests.soak.faults import ENDED, HELD, NONE, RETRIED, inject_faults, outcomes_of
from tests.soak.kills import BACK, BETWEEN, RESULTS, START, kill_runs, under_way
from tests.soak.long_run import long_run, slope
from tests.soak.results import PartResult, PartTable, keep, kept, page
from tests.soak.truth import Agreement

pytestmark = pytest.mark.long

ONE_LEG = """procedure: one_leg
steps:
  - power_on: {settle_s: 20}
  - chamber: {temperature_c: 30, ramp_c_per_min: 5, within_c: 50}
  - repeat:
      over: {position: [z_up, y_down]}
      steps:
        - go_to: {position: $position, rate_dps: 30}
        - align: {duration_s: 16}
        - navigate: {duration_s: 60}
        - turn: {angle_deg: 180, rate_dps: 30, settle_s: 1}
        - navigate: {duration_s: 60}
  - soak: {for_s: 60}
  - power_off
"""


def test_a_run_that_is_killed_gives_every_dwell_once_and_right(tmp_path):
    procedure = tmp_path / "one_leg.yaml"
    procedure.write_text(ONE_LEG)
    result = kill_runs(tmp_path / "kills", 1, 0, procedure)
    assert result.problems == []
    assert result.figures["SIGKILLs of `gyrobench run` and `resume`"] == "1"
    finished_runs = int(result.figures["runs finished in spite of them"])
    assert int(result.figures["dwells finished"]) == 2 * finished_runs > 0
    assert result.figures["dwells lost"] == result.figures["wrong results let through"] == "0"


@pytest.mark.parametrize("kind", ["port_gone", "write error"])
def test_no_wrong_result_gets_past_a_fault(tmp_path, kind):
    result = inject_faults(tmp_path, 1, 0, [kind])
    assert result.problems == []
    assert int(result.figures["faults injected"]) >= 1
    assert (result.figures["dwells finished"], result.figures["dwells lost"]) == ("8", "0")
    assert result.figures["wrong results let through"] == "0"


def test_a_run_of_some_hours_with_faults_keeps_its_descriptors(tmp_path):
    result = long_run(tmp_path / "long", 1.0, 0)
    assert result.problems == []
    assert result.figures["dwells lost"] == "0"
    fewest, most = result.figures["open descriptors"].split(" to ")
    assert fewest == most


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        ([], START),
        ([{"event": "run_resumed"}], START),
        ([{"event": "step_started", "kind": "turn"}, {"event": "note"}], "turn"),
        ([{"event": "step_started", "kind": "turn"}, {"event": "step_finished", "kind": "turn"}], BETWEEN),
        ([{"event": "approach_started", "kind": "soak"}], f"{BACK}soak"),
        ([{"event": "step_finished", "kind": "turn"}, {"event": "run_ended"}], RESULTS),
    ],
)
def test_the_journal_shows_what_was_under_way_at_a_kill(lines, expected):
    assert under_way([json.dumps(line) for line in lines]) == expected


def test_an_injection_has_the_gravest_outcome_before_the_next():
    entries = [
        {"time_s": 5.0, "event": "retry"},
        {"time_s": 20.0, "event": "retry"},
        {"time_s": 21.0, "event": "tripped"},
        {"time_s": 40.0, "event": "run_ended", "ended": "failed"},
    ]
    assert outcomes_of([30.0, 1.0, 10.0, 12.0], entries) == [RETRIED, NONE, HELD, ENDED]
    assert outcomes_of([], entries) == []


def row(bias_dph, flags=()):
    return DwellRow(
        unit="1", run="1", dwell=1, cycle=1, position="z_up", start_s=0.0, end_s=1.0, since_power_on_s=0.0,
        gyro_c=(20.0,) * 3, gyro_rate_c_per_h=(0.0,) * 3,
        bias_dph=bias_dph, sigma_dph=(0.001,) * 3, flags=flags,
    )  # fmt: skip


def test_a_result_is_wrong_beyond_five_sigma_or_without_a_number_unless_it_is_flagged():
    agreement = Agreement()
    for each in (
        row((0.004, 0.0, 0.0)),
        row((0.006, 0.0, 0.0)),
        row((np.nan, 0.0, 0.0)),
        row((0.006, 0.0, 0.0), "gone"),
    ):
        agreement.add(each, np.zeros(3), "here")
    assert len(agreement.wrong) == 2
    assert agreement.flagged == 1


def test_the_growth_of_memory_is_stated_after_the_warm_up():
    hours = np.arange(100.0)
    samples = np.column_stack([hours, np.where(hours < 10, 10 * hours, 100.0 + 0.02 * hours)])
    growth_mb, spread_mb = slope(samples)
    assert growth_mb == pytest.approx(2.0, abs=0.01)
    assert spread_mb == pytest.approx(0.0, abs=1e-6)


def test_the_page_is_put_together_from_the_parts_that_are_there(tmp_path):
    for part in ("long", "kills"):
        table = PartTable(["kind", "count"], [[part, "3"]])
        keep(tmp_path, PartResult(part, part.title(), {"dwells": "3"}, "How.", [table], [], "a machine"))
    text = page(kept(tmp_path, ("kills", "faults", "long")))
    assert text.index("## Kills") < text.index("## Long")
    assert "| Kills | dwells | 3 |" in text
    assert "| long | 3 |" in text
