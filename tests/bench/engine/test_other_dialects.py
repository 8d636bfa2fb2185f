"""Whole procedures on benches of other dialects, over the bytes of each."""

import io

import numpy as np
import pytest
from rich.console import Console

from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.monitor.terminal_view import LinesView
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.station.instruments import Emulation

PROCEDURE = """procedure: two_temperatures
steps:
  - power_on: {settle_s: 30}
  - repeat:
      over: {temperature_c: [30, 20]}
      steps:
        - chamber: {temperature_c: $temperature_c, ramp_c_per_min: 8, within_c: 1, retries: 5}
        - go_to: {position: z_up, rate_dps: 30, retries: 5}
        - align: {duration_s: 16}
        - navigate: {duration_s: 60}
        - turn: {angle_deg: 180, rate_dps: 30, settle_s: 1, retries: 5}
        - navigate: {duration_s: 60}
  - power_off
  - chamber_off
"""
CHAMBERS = {
    "thermotron_8800": "  dialect: thermotron_8800\n  port: emulator://chamber\n",
    "watlow_f4t": "  dialect: watlow_f4t\n  port: emulator://chamber\n",
}
TWO_AXES = (
    "  dialect: acutrol3000\n", "  outer_axis_number: 1\n", "  inner_axis_number: 2\n",
    "  outer_axis: east\n", "    outer_deg: [-200, 200]\n",
)  # fmt: skip


@pytest.fixture
def run_on(tmp_path):
    """Run the procedure on the quick station with another chamber or table; returns outcome and folder."""

    def run(chamber="watlow_f4", single_axis=False, faults=""):
        text = find_document("stations", "quick").read_text()
        if chamber in CHAMBERS:
            before = "  dialect: watlow_f4\n  port: emulator://chamber\n  address: 1\n"
            assert before in text
            text = text.replace(before, CHAMBERS[chamber])
        if single_axis:
            for key in TWO_AXES:
                text = text.replace(key, "  dialect: ideal_aerosmith\n" if "dialect" in key else "")
        (tmp_path / "station.yaml").write_text(text)
        (tmp_path / "procedure.yaml").write_text(PROCEDURE)
        (tmp_path / "faults.yaml").write_text(faults)
        emulation = Emulation("quick", 3, str(tmp_path / "faults.yaml") if faults else "")
        job = prepare_job(str(tmp_path / "procedure.yaml"), str(tmp_path / "station.yaml"), emulation)
        with LinesView(Console(file=io.StringIO(), width=80), job.plan) as view:
            folder, outcome = run_job(job, tmp_path / "run", view, ConsentingOperator())
        return folder, outcome

    return run


@pytest.mark.parametrize(
    "bench", [{"chamber": "thermotron_8800"}, {"chamber": "watlow_f4t"}, {"single_axis": True}]
)
def test_a_procedure_runs_as_on_any_other_bench(run_on, bench):
    folder, outcome = run_on(**bench)
    assert outcome.ended == "finished", outcome.reason
    assert [dwell.row.flags for dwell in outcome.dwells] == [(), ()]
    finished = [entry for entry in read_journal(folder.journal) if entry["event"] == "step_finished"]
    motions = [entry for entry in finished if entry["kind"] in ("go_to", "turn")]
    # A tick of this station is 2 s, and an exchange may end just after one.
    assert [each for each in motions if abs(each["took_s"] - each["planned_s"]) > 2.5] == []
    np.testing.assert_allclose([dwell.row.chamber_c for dwell in outcome.dwells], [30.0, 20.0], atol=1.0)


@pytest.mark.parametrize("chamber", ["thermotron_8800", "watlow_f4t"])
def test_faults_of_the_line_are_tried_again(run_on, chamber):
    faults = "faults:\n" + "".join(
        f"  - {{fault: {fault}, target: {target}, every_s: 60}}\n"
        for target in ("chamber", "table")
        for fault in ("lost_reply", "half_reply", "damaged_reply", "garbage")
    )
    _, outcome = run_on(chamber, faults=faults)
    assert outcome.ended == "finished", outcome.reason
    assert len(outcome.dwells) == 2


def test_faults_of_the_line_are_tried_again_with_a_single_axis(run_on):
    faults = "faults:\n" + "".join(
        f"  - {{fault: {fault}, target: table, every_s: 60}}\n"
        for fault in ("lost_reply", "half_reply", "damaged_reply", "garbage", "lost_request")
    )
    _, outcome = run_on(single_axis=True, faults=faults)
    assert outcome.ended == "finished", outcome.reason
    assert len(outcome.dwells) == 2
