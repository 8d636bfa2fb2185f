"""``gyrobench runs`` as an engineer types it."""

import json
import os
import shutil
from pathlib import Path

import pytest

from gyrobench.bench.cli.output import EXIT_WRONG_INPUT
from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.locks import RunLock
from tests.bench.command_line import gyrobench, output_of, refusal_of
from tests.bench.runs.index.sample_runs import copy_run


@pytest.fixture(scope="module")
def place(tmp_path_factory, sample):
    """A folder with runs of unit 1001 in seven months, whose x gyro drifts, and one of 1002."""
    place = tmp_path_factory.mktemp("place")
    for month in range(1, 8):
        started = f"2026-{month:02d}-01T08:00:00+00:00"
        copy_run(sample, place / "runs" / f"of-{month}", "1001", started, x_dph=0.004 * month)
    copy_run(sample, place / "runs" / "other", "1002", "2026-03-05T08:00:00+00:00")
    (place / "runs" / "units.csv").write_text("unit,batch\n1001,B7\n1002,B8\n")
    return place


def test_runs_are_listed_newest_first_within_80_columns(place):
    printed = output_of("runs", cwd=place)
    lines = printed.splitlines()
    assert max(map(len, lines)) <= 80
    assert lines[2].split()[:5] == ["of-7", "2026-07-01", "1001", "B7", "quick"]
    assert "8 runs of 2 units." in printed
    assert "The newest 3 are shown" in gyrobench("runs", "--most", 3, cwd=place).stdout


def test_a_run_in_progress_is_listed_as_that_until_its_process_ends(tmp_path, sample):
    copy_run(sample, tmp_path / "runs" / "weekend", "1001", "2026-01-01T08:00:00+00:00")
    journal = RunFolder(tmp_path / "runs" / "weekend").journal
    entries = [line for line in journal.read_text().splitlines() if '"event": "run_ended"' not in line]
    journal.write_text("\n".join(entries) + "\n")
    with RunLock(journal.parent, WallClock()):
        in_progress = gyrobench("runs", cwd=tmp_path)
    assert "in progress" in in_progress.stdout, in_progress.stderr
    cut_off = json.loads(gyrobench("runs", "--json", cwd=tmp_path).stdout)
    assert [run["ended"] for run in cut_off["runs"]] == ["not ended"]


def test_a_name_that_the_locale_can_not_decode_matters_only_below_the_current_folder(place, tmp_path):
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/M\xfcller"))
    shutil.copytree(place / "runs" / "other", folder / "runs" / "other")
    assert "1 run of 1 unit." in output_of("runs", cwd=folder)
    refusal = refusal_of("runs", tmp_path, cwd=tmp_path)
    assert "'M\\udcfcller/runs/other': not valid UTF-8 in this locale. Set LC_ALL=C.UTF-8" in refusal


def test_runs_are_selected_and_printed_as_json(place):
    result = gyrobench("runs", "runs", "--batch", "B7", "--since", "2026-06-01", "--json", cwd=place)
    content = json.loads(result.stdout)
    assert [run["path"] for run in content["runs"]] == ["of-7", "of-6"]
    assert content["runs"][0]["started_utc"] == "2026-07-01T08:00:00"
    assert content["problems"] == {}


def test_the_trend_of_a_unit_names_the_gyro_that_drifts_and_draws_it(place):
    printed = output_of("runs", "--unit", "1001", "--trend", "--figure", "drift.png", cwd=place)
    assert "Unit 1001 drifts: X gyro at" in printed
    assert "Y gyro at" not in printed
    assert "\nFigure   drift.png\n" in printed
    assert (place / "drift.png").read_bytes().startswith(b"\x89PNG")
    trends = json.loads(gyrobench("runs", "--unit", "1001", "--trend", "--json", cwd=place).stdout)["trends"]
    slopes = [each["slope_dph_per_month"] for each in trends if each["gyro"] == "x"]
    assert slopes == pytest.approx([0.00402] * len(slopes), rel=0.02)
    assert "a trend is of one unit" in gyrobench("runs", "--trend", cwd=place).stderr


def test_the_trend_names_the_day_by_which_the_unit_leaves_its_limit(place):
    printed = output_of("runs", "--unit", "1001", "--trend", "--limit-dph", "0.05", cwd=place)
    assert max(map(len, printed.splitlines())) <= 80
    text = " ".join(printed.split())
    assert "Unit 1001: calibrate by 2026-" in text or "Unit 1001: calibrate by 2027-" in text
    record = gyrobench("runs", "--unit", "1001", "--trend", "--limit-dph", "0.05", "--json", cwd=place)
    x, y = (
        [each["months"] for each in json.loads(record.stdout)["recalibration"] if each["gyro"] == gyro]
        for gyro in "xy"
    )
    assert max(x) < 6.0 < min(y)  # the x gyro reaches 0.05 deg/h some 5 months after its last run


@pytest.mark.parametrize("by", ["unit", "batch", "bench", "procedure", "month"])
def test_groups_fit_the_terminal(place, by):
    printed = output_of("runs", "--by", by, cwd=place)
    assert max(map(len, printed.splitlines())) <= 80
    first = {"unit": "1001", "batch": "B7", "bench": "quick", "procedure": "fleet_sample", "month": "2026-01"}
    assert printed.splitlines()[2].startswith(first[by])


def test_a_query_is_answered_and_a_wrong_one_reported(place):
    asked = gyrobench(
        "runs", "--sql", "SELECT unit, count(*) AS n FROM runs GROUP BY 1 ORDER BY 1", cwd=place
    )
    assert asked.stdout.split()[-6:-2] == ["1001", "7", "1002", "1"]
    assert "read-only" in refusal_of("runs", "--sql", "DROP TABLE runs", cwd=place)


def test_a_run_that_cannot_be_read_is_reported_below_the_others(place):
    broken = place / "runs" / "zz-broken"
    broken.mkdir()
    (broken / "journal.jsonl").write_text("{}\n")
    result = gyrobench("runs", cwd=place)
    (broken / "journal.jsonl").unlink()
    assert result.returncode == 0
    assert "1 run folder can't be read" in result.stdout
    assert "no provenance.json" in result.stdout


def test_mistakes_have_their_exit_codes(place):
    for wrong in (["--trend", "--by", "unit"], ["--figure", "a.png"], ["--since", "soon"]):
        assert gyrobench("runs", *wrong, cwd=place).returncode == EXIT_WRONG_INPUT
    assert gyrobench("runs", "nowhere", cwd=place).returncode == EXIT_WRONG_INPUT
