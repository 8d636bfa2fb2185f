"""The loop is closed: found effects are loaded into the INS, and the remaining biases are measured."""

import io
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from rich.console import Console

from gyrobench.bench.closure.files import write_closure
from gyrobench.bench.closure.inputs import read_campaign
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.resume import prepare_resumption
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.engine.verification_runs import VerificationRuns, new_emulation
from gyrobench.bench.foundations.errors import DocumentError, RunFolderError
from gyrobench.bench.monitor.terminal_view import LinesView
from gyrobench.bench.report.verification_text import model_sentences
from gyrobench.bench.runs.compensation_file import read_compensation
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.station.instruments import Emulation
from tests.bench.closure.campaigns import EFFECTS, STATION, write_world
from tests.bench.command_line import gyrobench

pytestmark = pytest.mark.long

DWELL = """
              - align: {duration_s: 16}
              - navigate: {duration_s: 60}
              - turn: {angle_deg: 180, rate_dps: 30, settle_s: 1}
              - navigate: {duration_s: 60}
"""
CAMPAIGN = f"""procedure: short_campaign
steps:
  - power_on: {{settle_s: 60}}
  - repeat:
      over: {{cycle: [1, 2], temperature_c: [60, 33, 6, -20]}}
      steps:
        - chamber: {{temperature_c: $temperature_c, ramp_c_per_min: 5.0}}
        - soak: {{for_s: 300}}
        - repeat:
            over: {{position: [z_up, y_down, x_up, z_down, y_up, x_down]}}
            steps:
              - go_to: {{position: $position, rate_dps: 30}}{DWELL}"""
PROOF = f"""procedure: short_proof
steps:
  - power_on: {{settle_s: 60}}
  - chamber: {{temperature_c: -5, ramp_c_per_min: 5.0}}
  - soak: {{for_s: 300}}
  - repeat:
      over: {{position: [z_up, y_down, x_up, z_down, y_up, x_down]}}
      steps:
              - go_to: {{position: $position, azimuth_deg: 180, rate_dps: 30}}{DWELL}
  - repeat:
      over: {{azimuth_deg: [90, 270]}}
      steps:
        - go_to: {{position: z_up, azimuth_deg: $azimuth_deg, rate_dps: 30}}
        - align: {{duration_s: 30}}
        - navigate: {{duration_s: 120, purpose: calibration_check}}
"""


def watched(job):
    return LinesView(Console(file=io.StringIO(), width=80), job.plan)


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """A campaign with the paper's effect in it, what the search finds, and the procedure of the proof."""
    folder = tmp_path_factory.mktemp("campaign")
    world = write_world(folder, [EFFECTS["attitude_thermal"]])
    (folder / "campaign.yaml").write_text(CAMPAIGN)
    (folder / "proof.yaml").write_text(PROOF)
    job = prepare_job(str(folder / "campaign.yaml"), STATION, Emulation(str(world), 3))
    run, outcome = run_job(job, folder / "run", watched(job), ConsentingOperator())
    assert outcome.ended == "finished", outcome.reason
    closure = close_loop(read_campaign(run.path))
    write_closure(run.closure, closure)
    return run, closure, str(folder / "proof.yaml")


def verification_of(campaign, folder, only=(), **emulation):
    run, closure, procedure = campaign
    again = new_emulation(run, **emulation)
    return VerificationRuns(run, closure, procedure, str(run.station), again, folder, only)


@pytest.fixture(scope="module")
def verified(campaign, tmp_path_factory):
    verification = verification_of(campaign, tmp_path_factory.mktemp("proof"))
    for name, job in verification.jobs.items():
        _, outcome = verification.measure(name, watched(job), ConsentingOperator())
        assert outcome.ended == "finished", outcome.reason
    return verification, verification.result()


def test_with_the_effect_added_noise_is_left_where_the_declared_model_leaves_more(campaign, verified):
    none, declared, effect = (each.total for each in verified[1].results)
    assert verified[1].models["effect"].effects == ("attitude_thermal",)
    for before in (none, declared):
        assert before.varying_p_value < 1e-9
        assert effect.varying_rms_dph < 0.5 * before.varying_rms_dph
        assert effect.spread_dph < 0.5 * before.spread_dph
        assert effect.position_nmi < 0.5 * before.position_nmi
    assert effect.varying_p_value > 1e-3
    assert effect.spread_dph < 2.0 * effect.spread_noise_dph
    assert effect.velocity_east_mps < none.velocity_east_mps


def test_each_run_has_its_compensation_loaded_and_no_other(verified):
    verification, _ = verified
    states = {}
    for name, job in verification.jobs.items():
        events = read_journal(verification.folder / name / "journal.jsonl")
        [event] = [each for each in events if each["event"] == "compensation"]
        assert not event["found"]["active"]
        terms = None if job.compensation is None else list(job.compensation.terms())
        assert event["terms"] == terms
        states[name] = event["in_use"]["active"]
    assert states == {"none": False, "declared": True, "effect": True}
    loaded = read_compensation(verification.folder / "effect" / "compensation.yaml")
    np.testing.assert_array_equal(loaded.onset_c, verification.models["effect"].compensation.onset_c)


def test_the_measurements_are_at_a_temperature_and_in_directions_that_were_not_fitted(verified):
    _, comparison = verified
    [row] = comparison.results[0].rows
    assert row.fit == "between"
    assert comparison.new_attitudes == comparison.dwells == 6
    assert comparison.notes == ()


def test_runs_that_are_there_are_read_instead_of_made_again(campaign, verified):
    verification, comparison = verified
    again = verification_of(campaign, verification.folder)
    assert all(again.is_finished(name) for name in again.jobs)
    for one, other in zip(comparison.results, again.result().results, strict=True):
        assert str(one.rows) == str(other.rows)  # not a number in both is the same


def test_a_run_of_another_seed_in_the_folder_is_refused(campaign, verified):
    with pytest.raises(RunFolderError, match="holds a run of another model"):
        verification_of(campaign, verified[0].folder, seed=77).is_finished("declared")


def test_the_seed_of_the_campaign_is_refused(campaign, tmp_path):
    with pytest.raises(DocumentError, match="the noise would be the same"):
        verification_of(campaign, tmp_path, seed=3)


def test_without_an_effect_the_declared_model_alone_is_measured(campaign, tmp_path):
    run, closure, procedure = campaign
    clean = replace(closure, verdict="clean", effects=())
    verification = verification_of((run, clean, procedure), tmp_path)
    assert list(verification.jobs) == verification.selected == ["none", "declared"]
    with pytest.raises(DocumentError, match="found no effect that an INS can compensate"):
        verification_of((run, clean, procedure), tmp_path, only=["effect"])


def test_what_was_measured_on_another_day_is_compared_with_what_is_measured_now(campaign, verified, tmp_path):
    shutil.copytree(verified[0].folder / "none", tmp_path / "none")
    verification = verification_of(campaign, tmp_path, only=["effect"])
    assert (list(verification.jobs), verification.selected) == (["none", "effect"], ["effect"])
    assert [each.compensation for each in verification.result().results] == ["none"]


def test_a_run_without_compensation_in_which_the_ins_kept_a_stored_one_is_noted(campaign, verified, tmp_path):
    shutil.copytree(verified[0].folder / "none", tmp_path / "none")
    entry = {"event": "compensation", "in_use": {"active": True, "checksum": "0badcafe"}}
    with (tmp_path / "none" / "journal.jsonl").open("a") as journal:
        journal.write(json.dumps(entry) + "\n")
    [note] = verification_of(campaign, tmp_path, only=["none"]).result().notes
    assert note == "In the run without compensation the INS applied a stored compensation (0badcafe)."


def test_another_firmware_than_that_of_the_model_is_noted(campaign, verified, tmp_path):
    shutil.copytree(verified[0].folder / "none", tmp_path / "none")
    provenance = tmp_path / "none" / "provenance.json"
    provenance.write_text(re.sub("firmware [0-9]+", "firmware 999", provenance.read_text()))
    [note] = verification_of(campaign, tmp_path, only=["none"]).result().notes
    assert re.match(
        r"The INS identified as .* for the model, and as .*firmware 999.* in the run without", note
    )


def test_an_ins_that_takes_no_such_term_can_still_be_verified_with_the_declared_model(campaign, tmp_path):
    run, closure, procedure = campaign
    station = yaml.safe_load(run.station.read_text())
    del station["ins"]["commands"]["load_compensation"]["terms"]
    poor = tmp_path / "poor.yaml"
    poor.write_text(yaml.safe_dump(station))
    with pytest.raises(DocumentError, match="load_compensation does not accept"):
        VerificationRuns(run, closure, procedure, str(poor), new_emulation(run), tmp_path / "out")
    only = ["none", "declared"]
    able = VerificationRuns(run, closure, procedure, str(poor), new_emulation(run), tmp_path / "out", only)
    assert able.selected == only


def test_nothing_is_loaded_into_another_unit_than_the_campaigns(campaign, tmp_path):
    text = (world := Path(new_emulation(campaign[0]).world)).read_text()
    [number] = re.findall(r"serial_number: (\d+)", text)
    (tmp_path / world.name).write_text(text.replace(f"serial_number: {number}", "serial_number: 4711"))
    verification = verification_of(campaign, tmp_path / "out", world=str(tmp_path / world.name))
    job = verification.jobs["declared"]
    folder, outcome = verification.measure("declared", watched(job), ConsentingOperator(patience=1))
    assert outcome.ended == "stopped"
    assert f"is unit 4711, but this run measures {number}. Connect {number}." in outcome.reason
    assert not any(entry["event"] == "compensation" for entry in read_journal(folder.journal))
    assert prepare_resumption(folder.path).job.unit == number


def test_an_ins_that_gets_no_limits_of_temperature_is_stated_to_extrapolate(campaign, tmp_path):
    run, closure, procedure = campaign
    station = yaml.safe_load(run.station.read_text())
    unlimited = tmp_path / "unlimited.yaml"
    for key in ("lowest_index", "highest_index"):
        del station["ins"]["commands"]["load_compensation"][key]
    unlimited.write_text(yaml.safe_dump(station))
    runs = VerificationRuns(run, closure, procedure, str(unlimited), new_emulation(run), tmp_path / "out")
    [sentence, *notes] = model_sentences(closure, runs.models)
    assert "Temperatures are not limited to the fitted range" in sentence
    assert notes[-1].startswith("The INS does not get the temperature limits (lowest_index and highest_index")
    limited = verification_of(campaign, tmp_path / "out").models
    [sentence, *notes] = model_sentences(closure, limited)
    assert "Temperatures are limited to the fitted range" in sentence
    assert not any("temperature limits" in note for note in notes)


def test_a_campaign_that_the_ins_compensated_already_is_refused(campaign, tmp_path):
    run, closure, procedure = campaign
    compensated = type(run)(tmp_path)
    for name in ("provenance.json", "dwells.csv"):
        (tmp_path / name).write_bytes((run.path / name).read_bytes())
    entry = {"event": "compensation", "in_use": {"active": True, "checksum": "0badcafe"}}
    compensated.journal.write_text(json.dumps(entry) + "\n")
    with pytest.raises(
        DocumentError, match=r"measured while the INS applied a stored compensation \(0badcafe\)"
    ):
        VerificationRuns(
            compensated, closure, procedure, str(run.station), new_emulation(run), tmp_path / "out"
        )


def test_the_command_prints_what_it_does_and_what_is_left(campaign, verified):
    run, _, procedure = campaign
    folder = verified[0].folder
    result = gyrobench("verify", run.path, "--procedure", procedure, "--out", folder, cwd=folder)
    assert result.returncode == 0, result.stderr
    assert "All runs are complete." in result.stdout
    assert "Confirmed. Varying bias:" in result.stdout
    assert max(len(line) for line in result.stdout.splitlines() if str(folder) not in line) <= 80
    assert (folder / "verification.html").is_file()
    table = (folder / "comparison.csv").read_text().splitlines()
    assert [line.split(",")[0] for line in table[1:]] == ["none"] * 2 + ["declared"] * 2 + ["effect"] * 2
    # The search was there already, and the same one is not written again.
    assert not (run.closure / "closure.html").exists()


def test_an_instrument_past_due_is_used_if_that_is_acknowledged(campaign, tmp_path):
    run, closure, procedure = campaign
    station = yaml.safe_load(run.station.read_text())
    instrument = {"serial_number": "1", "certificate": "2", "calibrated": "2020-01-01", "due": "2021-01-01"}
    station["traceability"] = {"rate_table": {**instrument, "uncertainty": {"value": 1, "unit": "arcsec"}}}
    due = tmp_path / "due.yaml"
    due.write_text(yaml.safe_dump(station))
    arguments = run, closure, procedure, str(due), new_emulation(run), tmp_path / "out"
    for job in VerificationRuns(*arguments).jobs.values():
        with pytest.raises(DocumentError, match="run with --acknowledge rate_table"):
            job.check_calibrations()
    for job in VerificationRuns(*arguments, acknowledged=["rate_table"]).jobs.values():
        job.check_calibrations()
