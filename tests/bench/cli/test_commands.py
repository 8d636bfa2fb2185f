"""The commands as a technician types them."""

import json
import re
import shutil
import signal
import subprocess
import sys
import time

import pytest

from gyrobench.bench.authoring.new_files import new_station
from gyrobench.bench.bias.dwell_table import read_dwells, write_dwells
from gyrobench.bench.cli.output import EXIT_INSTRUMENT, EXIT_NOT_FINISHED, EXIT_WRONG_INPUT
from gyrobench.bench.foundations.shipped import find_document
from tests.bench.authoring.filled_in import filled_in
from tests.bench.command_line import PROCESS, gyrobench, output_of, refusal_of
from tests.bench.report.made_up_closure import made_up_rows


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    cwd = tmp_path_factory.mktemp("bench")
    return cwd, gyrobench("run", "ten_minute_check", "--world", "ideal", cwd=cwd)


def test_a_shipped_procedure_runs_by_name_from_any_folder(finished):
    cwd, result = finished
    assert result.returncode == 0, result.stderr
    assert (cwd / "runs/ten_minute_check-001/report.html").is_file()


def test_a_run_ends_by_printing_biases_and_where_report_and_figures_are(finished):
    _, result = finished
    for gyro in "XYZ":
        assert f"\n{gyro} gyro\n" in f"\n{result.stdout}"
    assert re.search(r"^Report +runs/ten_minute_check-001/report\.html$", result.stdout, re.MULTILINE)
    assert re.search(r"^Figures +runs/ten_minute_check-001/figures$", result.stdout, re.MULTILINE)
    assert max(map(len, result.stdout.splitlines())) <= 80


def test_a_run_on_an_emulated_bench_states_so_before_its_first_dwell_and_beside_the_verdict(finished):
    _, result = finished
    begin, _, end = result.stdout.partition("\nX gyro\n")
    assert "Emulated bench: world ideal, seed 0, virtual clock. All data are simulated.\n" in begin
    assert "1/1" not in begin.partition("Emulated bench")[0]
    assert "SIMULATED: the bench was emulated, no bias or verdict is that of a real unit.\n" in end


def test_windows_too_short_for_signs_and_axes_are_stated_at_the_end_and_in_the_report(finished):
    cwd, result = finished
    text = "Signs and axes of the signal map were not tested: the windows are too short"
    printed = " ".join(result.stdout.split())
    assert text in printed
    assert "test them with gyrobench check emulated --signs." in printed
    report = (cwd / "runs/ten_minute_check-001/report.html").read_text()
    assert "Signal map not tested." in report
    assert text in " ".join(report.split())
    assert "gyrobench check RUN/station.yaml --signs." in " ".join(report.split())


def test_bins_measures_a_run_again(finished):
    cwd, _ = finished
    folder = cwd / "runs/ten_minute_check-001"
    tables = [folder / name for name in ("dwells.csv", "bias_bins.csv", "joint_biases.csv", "joint.csv")]
    before = [table.read_bytes() for table in tables]
    for table in tables:
        table.unlink()
    output_of("bins", folder, cwd=cwd)
    assert [table.read_bytes() for table in tables] == before


def test_bins_adds_one_seal_for_tables_and_report(finished, tmp_path):
    folder = shutil.copytree(finished[0] / "runs/ten_minute_check-001", tmp_path / "run")
    table, report = folder / "dwells.csv", folder / "report.html"
    edited = table.read_text().replace("z_up", "z_down")
    table.write_text(edited)
    report.unlink()
    seals = len(list((folder / "seals").iterdir()))
    assert gyrobench("bins", folder, cwd=tmp_path).returncode == 0
    assert table.read_text() != edited
    assert "has changed since it was sealed" not in report.read_text()
    assert len(list((folder / "seals").iterdir())) == seals + 1
    assert gyrobench("seal", folder, "--verify", cwd=tmp_path).returncode == 0


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    path = tmp_path_factory.mktemp("campaign") / "dwells.csv"
    write_dwells(path, made_up_rows())
    return path


@pytest.fixture(scope="module")
def searched(table):
    return gyrobench("close", table, "--out", "found", "--hold-out-cycle", 1, cwd=table.parent)


def test_close_holds_a_cycle_out_prints_the_verdict_and_leaves_page_figures_and_tables(table, searched):
    result = searched
    assert result.returncode == 0, result.stderr
    assert result.stdout.startswith(("Search for effects\nExplained.", "Search for effects\nAmbiguous."))
    assert max(map(len, result.stdout.splitlines()[:-4])) <= 80
    assert re.search(r"^Report +found/closure\.html$", result.stdout, re.MULTILINE)
    found = table.parent / "found"
    assert json.loads((found / "closure.json").read_text())["held_out_cycles"] == [1]
    left = {path.name for path in found.iterdir()}
    tables = {"closure.json", "findings.json", "predictions.csv", "model.yaml"}
    assert left == {"closure.html", "figures", *tables}


def test_close_searches_several_tables_and_says_what_is_held_out(table, tmp_path):
    rows = read_dwells(table)
    for name, cycles in (("early", {1, 2}), ("late", {3})):
        write_dwells(tmp_path / f"{name}.csv", [row for row in rows if row.cycle in cycles])
    arguments = ("late.csv", "early.csv", "--hold-out", "late.csv", "--hold-out-each")
    printed = output_of("close", *arguments, cwd=tmp_path)
    assert "In cycle 3 of late.csv (held out" in " ".join(printed.split())
    assert "on the clock of early.csv" in " ".join(printed.split())
    assert max(map(len, printed.splitlines()[:-4])) <= 80
    folder = tmp_path / "closure_late_early"
    found = json.loads((folder / "closure.json").read_text())
    assert [each["held_out_cycle"] for each in found["rotation"]] == [1, 2, 3]
    assert [each["path"] for each in found["tables"]] == ["early.csv", "late.csv"]
    assert "Each cycle held out" in (folder / "closure.html").read_text()
    assert len((folder / "predictions.csv").read_text().splitlines()) == 1 + len(rows)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("TABLE", "TABLE"), "Give each dwell once"),
        (("TABLE", "--hold-out", "other.csv"), "other.csv can't be held out"),
        (("nowhere.csv",), "nowhere.csv"),
        ((".",), "is not a run folder"),
        (("TABLE", "--hold-out-cycle", 9), "no cycle 9"),
        (("TABLE", "--hold-out-cycle", "last"), "whole number"),
    ],
)
def test_close_reports_what_is_wrong_with_its_input(table, tmp_path, arguments, message):
    words = [table if word == "TABLE" else word for word in arguments]
    problem = refusal_of("close", *words, cwd=tmp_path)
    assert message in problem
    assert "Traceback" not in problem


def test_close_says_that_a_run_of_one_cycle_is_too_little(finished):
    cwd, _ = finished
    assert "at least twice" in " ".join(refusal_of("close", "runs/ten_minute_check-001", cwd=cwd).split())


VERIFICATION = """\
procedure: short_verification
steps:
  - power_on: {settle_s: 60}
  - repeat:
      over: {azimuth_deg: [0, 180]}
      steps:
        - go_to: {position: z_up, azimuth_deg: $azimuth_deg, rate_dps: 30}
        - align: {duration_s: 120}
        - navigate: {duration_s: 120, purpose: calibration_check}
"""


def test_a_calibration_check_is_printed_by_run_and_by_bins(tmp_path):
    (tmp_path / "short.yaml").write_text(VERIFICATION)
    printed = output_of("run", "short.yaml", "--world", "ideal", cwd=tmp_path)
    output = output_of("bins", "runs/short_verification-001", cwd=tmp_path)
    for text in (printed, output):
        assert "Calibration check\n" in text
        assert "Z-Up 180°" in text
        assert "No dwell gave a bias" not in text
        assert "bias x" not in text
    tables = output[output.index("Tables") : output.index("Report")]
    assert {"verification.csv", "joint.csv", "joint_biases.csv"} <= set(re.findall(r"\w+\.csv", tables))


def test_plan_prints_the_timeline_and_draws_the_profile_without_an_instrument(tmp_path):
    printed = output_of("plan", "six_position_fig7", "--figure", "plan.png", cwd=tmp_path)
    assert re.search(r"4\d:\d\d", printed)
    assert (tmp_path / "plan.png").read_bytes().startswith(b"\x89PNG")
    assert max(map(len, printed.splitlines())) <= 80


def test_a_plan_whose_figure_can_not_be_written_is_printed(tmp_path):
    (tmp_path / "plan_ten_minute_check.png").mkdir()
    printed = output_of("plan", "ten_minute_check", cwd=tmp_path)
    assert "Plan, times in h:mm" in printed
    assert "No figure: plan_ten_minute_check.png: can't be written: it is not a plain file." in printed
    answer = gyrobench("plan", "ten_minute_check", "--figure", "plan_ten_minute_check.png", cwd=tmp_path)
    assert answer.returncode == EXIT_WRONG_INPUT
    assert "Plan, times in h:mm" in answer.stdout
    assert answer.stderr.startswith("gyrobench: plan_ten_minute_check.png: can't be written")


def test_a_plan_states_acceptance_limits_that_its_dwells_can_not_reach(tmp_path):
    text = find_document("procedures", "six_position_fig7").read_text()
    (tmp_path / "strict.yaml").write_text(re.sub(r"(position_difference_dph:) \S+", r"\1 0.001", text))
    heading = "Acceptance limits that no unit can pass because of the noise of these dwells:"
    printed = gyrobench("plan", "strict.yaml", cwd=tmp_path).stdout
    text = "position_difference_dph: at best below 0.0017 deg/h (95 %), limit 0.001 deg/h"
    assert f"{heading}\n  {text}\n" in printed
    assert max(map(len, printed.splitlines())) <= 80
    assert heading not in gyrobench("plan", "six_position_fig7", cwd=tmp_path).stdout


@pytest.mark.long
def test_plan_reports_the_effects_that_its_dwells_distinguish(tmp_path):
    procedure = "three_temperature_shift"
    output = output_of("plan", procedure, "--separability", "--target-dph", "0.05", cwd=tmp_path)
    printed = " ".join(output.split())
    assert "Not found" not in printed
    assert "Not distinguished at 50.00: chamber state from bias jump" in printed
    assert "add a cycle and measure two positions on each ramp. This distinguishes" in printed
    assert (tmp_path / f"separability_{procedure}.png").read_bytes().startswith(b"\x89PNG")


def test_plan_starts_from_a_search(table, searched, tmp_path):
    arguments = ("plan", "quick_campaign", "--station", "quick", "--separability", "--closure")
    text = " ".join(output_of(*arguments, table.parent / "found", cwd=tmp_path).split())
    assert re.search(r"The search uses \d+ of \d+ dwells; the last cycle is held out", text)
    assert "as measured in the closure" in text
    assert "Effects found, with their sizes in the plan's dwells: temperature rate" in text
    assert "there is no closure.json" in refusal_of(*arguments, "nowhere", cwd=tmp_path)
    result = gyrobench("plan", "quick_campaign", "--closure", table.parent / "found", cwd=tmp_path)
    assert "--separability only" in result.stderr


def test_a_size_of_effect_without_separability_is_refused(tmp_path):
    problem = refusal_of("plan", "ten_minute_check", "--target-dph", "0.001", cwd=tmp_path)
    assert "--target-dph has a meaning with --separability only. Add --separability" in problem
    assert not list(tmp_path.iterdir())


def test_plan_of_a_calibration_check_has_no_effects_to_distinguish(tmp_path):
    printed = output_of("plan", "calibration_check", "--separability", cwd=tmp_path)
    assert "calibration_check has no dwell that measures a bias" in printed


def test_a_wrong_procedure_lists_its_mistakes_and_nothing_is_made(tmp_path):
    (tmp_path / "wrong.yaml").write_text(
        "procedure: wrong\nsteps:\n  - sook: {for_s: 5}\n  - wait: {duration: 5}\n"
    )
    problem = refusal_of("run", "wrong.yaml", cwd=tmp_path)
    assert "wrong.yaml:3:" in problem
    assert "did you mean 'soak'?" in problem
    assert "wrong.yaml:4:" in problem
    assert "Traceback" not in problem
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("run", "absent"), EXIT_WRONG_INPUT, "six_position_fig7"),
        (("run", "absent.yaml"), EXIT_WRONG_INPUT, "there is no such file"),
        (("run", "ten_minute_check", "--world", "mars"), EXIT_WRONG_INPUT, "gyro_a"),
        (("run", "ten_minute_check", "--station", "mars"), EXIT_WRONG_INPUT, "emulated"),
        (("run", "ten_minute_check", "--seed", "-1"), EXIT_WRONG_INPUT, "seed"),
        (("bins", "."), EXIT_WRONG_INPUT, "is not a run folder"),
        (("plan", "warm_up", "--observability"), EXIT_WRONG_INPUT, "Choose a list of rotations"),
    ],
)
def test_a_wrong_word_gets_a_message_and_an_exit_code(tmp_path, arguments, code, message):
    problem = refusal_of(*arguments, cwd=tmp_path, code=code)
    assert message in problem
    assert "Traceback" not in problem


def test_a_station_that_is_not_filled_in_is_not_run(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(filled_in(new_station("mine", path)))
    problem = refusal_of("run", "ten_minute_check", "--station", "mine.yaml", cwd=tmp_path)
    assert "not filled in yet: rate_table.port and chamber.port. Fill them in" in problem


def test_an_instrument_that_can_not_be_reached_has_its_own_exit_code(tmp_path, pytestconfig):
    text = (pytestconfig.rootpath / "stations/emulated.yaml").read_text()
    text = text.replace("port: emulator://table", "port: /dev/does-not-exist").replace(
        "clock: virtual", "clock: wall"
    )
    (tmp_path / "station.yaml").write_text(text)
    problem = refusal_of(
        "run", "ten_minute_check", "--station", "station.yaml", cwd=tmp_path, code=EXIT_INSTRUMENT
    )
    assert "rate table: can't open /dev/does-not-exist" in problem
    assert not (tmp_path / "runs").exists()


@pytest.mark.long
def test_sigterm_ends_a_run_with_what_was_measured_and_the_safe_state(tmp_path):
    command = [*PROCESS, "run", "quick_campaign", "--station", "quick", "--world", "quick"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as process:
        journal = tmp_path / "runs/quick_campaign-001/journal.jsonl"
        deadline = time.monotonic() + 600
        while not (journal.is_file() and "dwell_finished" in journal.read_text()):
            assert time.monotonic() < deadline
            time.sleep(0.05)
        process.send_signal(signal.SIGTERM)
        printed, _ = process.communicate(timeout=600)
    assert process.returncode == EXIT_NOT_FINISHED
    assert "stopped by another program (SIGTERM)" in printed
    assert "rate table stopped" in printed
    assert "Report" in printed


def test_a_compensation_that_is_no_compensation_file_is_printed_before_anything_moves(tmp_path):
    (tmp_path / "wrong.yaml").write_text("low_c: [0, 0, 0]\n")
    problem = refusal_of("run", "ten_minute_check", "--compensation", "wrong.yaml", cwd=tmp_path)
    assert "wrong.yaml:1:1: the key 'polynomial_dph' is missing" in problem
    assert not (tmp_path / "runs").exists()


def test_help_names_every_command_with_an_example(tmp_path):
    overview = gyrobench("--help", cwd=tmp_path).stdout
    for command in ("run", "plan", "bins", "close", "verify"):
        assert command in overview
        assert f"Example: gyrobench {command}" in gyrobench(command, "--help", cwd=tmp_path).stdout


def test_help_does_not_load_the_heavy_libraries():
    code = (
        "import sys; sys.argv = ['gyrobench', '--help']\n"
        "from gyrobench.bench.cli import app\n"
        "try: app()\nexcept SystemExit: pass\n"
        "heavy = {'numpy', 'scipy', 'matplotlib', 'numba', 'can', 'cantools', 'pyarrow', 'pydantic'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


@pytest.mark.long
def test_a_run_does_not_load_scipy(tmp_path):
    code = (
        "import sys; sys.argv = ['gyrobench', 'run', 'ten_minute_check', '--world', 'ideal']\n"
        "from gyrobench.bench.cli import app\n"
        "try: app()\nexcept SystemExit: pass\n"
        "assert {'scipy.special', 'scipy.linalg', 'scipy.optimize'}.isdisjoint(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, cwd=tmp_path)


@pytest.mark.long
def test_what_is_typed_during_a_run_on_virtual_time_is_executed_or_answered(tmp_path):
    command = [*PROCESS, "run", "quick_campaign", "--station", "quick", "--world", "quick", "--out", "run"]
    typed = "hello\npause\nabort\n"
    ended = subprocess.run(command, input=typed, cwd=tmp_path, capture_output=True, text=True, timeout=200)
    assert ended.returncode == EXIT_NOT_FINISHED
    assert ended.stdout.count("Type one of: skip, finish, abort") == 2
    assert "pause: a run on virtual time never waits" in ended.stdout
    assert "stopped by the operator (terminal)" in ended.stdout
