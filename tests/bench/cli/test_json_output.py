"""What commands print for programs: one JSON object, and nothing else on standard output."""

import io
import json
import math
import shutil
from datetime import UTC, datetime, timedelta
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest

from gyrobench.bench.bias.bins import BIAS_BINS_TABLE
from gyrobench.bench.cli.output import plain, print_json
from gyrobench.bench.runs.folder import RunFolder
from tests.bench.command_line import gyrobench

DWELLS = Path(__file__).parents[1] / "closure"


def test_arrays_paths_and_numbers_without_end_become_what_json_has():
    content = {"a": np.array([1.0, math.nan]), "b": Path("x"), 3: (1, {"c": math.inf}), "d": np.float64(2.0)}
    assert plain(content) == {"a": [1.0, None], "b": "x", "3": [1, {"c": None}], "d": 2.0}


def test_times_decimals_and_all_else_become_text_or_numbers():
    time = datetime(2026, 3, 1, 12, 30, tzinfo=UTC)
    content = {"at": time, "on": time.date(), "n": Decimal("1.5"), "took": timedelta(seconds=90), "no": None}
    assert plain(content) == {
        "at": "2026-03-01T12:30:00+00:00",
        "on": "2026-03-01",
        "n": 1.5,
        "took": "0:01:30",
        "no": None,
    }


@pytest.mark.parametrize(
    ("encoding", "printed"), [("utf-8", "≥"), ("latin-1", "\\u2265"), ("ascii", "\\u2265")]
)
def test_json_can_be_printed_in_every_encoding_of_a_terminal(monkeypatch, encoding, printed):
    output = io.TextIOWrapper(io.BytesIO(), encoding)
    monkeypatch.setattr("sys.stdout", output)
    print_json({"reason": "≥ 5 s"})
    output.seek(0)
    text = output.read()
    assert printed in text
    assert json.loads(text) == {"reason": "≥ 5 s"}


def test_a_plan(tmp_path):
    answer = gyrobench("plan", "ten_minute_check", "--json", cwd=tmp_path)
    found = json.loads(answer.stdout)
    assert (found["procedure"], found["station"], found["dwells"]) == ("ten_minute_check", "emulated", 1)
    assert [step["step"] for step in found["steps"]][:3] == ["power_on", "go_to", "align"]
    last = found["steps"][-1]
    assert last["start_s"] + last["duration_s"] == found["duration_s"]
    assert (tmp_path / found["figure"]).is_file()


def test_separability_is_not_reported_as_json(tmp_path):
    answer = gyrobench("plan", "ten_minute_check", "--json", "--separability", cwd=tmp_path)
    assert (answer.returncode, answer.stdout) == (2, "")
    assert "--separability" in answer.stderr


def test_a_check_of_a_fit_bench(tmp_path):
    answer = gyrobench("check", "quick", "--world", "quick", "--json", cwd=tmp_path)
    found = json.loads(answer.stdout)
    assert (answer.returncode, found["station"], found["fit"]) == (0, "quick", True)
    assert {each["verdict"] for each in found["checks"]} <= {"pass", "skipped"}
    assert all({"subject", "what", "found", "advice"} <= each.keys() for each in found["checks"])


def test_a_check_of_a_bench_that_is_not_fit(tmp_path):
    (tmp_path / "hot.yaml").write_text(
        "procedure: p\nsteps:\n  - chamber: {temperature_c: 300, ramp_c_per_min: 1}\n"
    )
    answer = gyrobench(
        "check", "quick", "--world", "quick", "--procedure", "hot.yaml", "--json", cwd=tmp_path
    )
    found = json.loads(answer.stdout)
    assert (answer.returncode, found["fit"]) == (1, False)
    assert "300" in next(each["found"] for each in found["checks"] if each["verdict"] == "fail")


def test_bins_of_a_run(short_run, tmp_path):
    shutil.copytree(short_run[0].path, tmp_path / "run")
    answer = gyrobench("bins", "run", "--json", cwd=tmp_path)
    found = json.loads(answer.stdout)
    expected = BIAS_BINS_TABLE.read(RunFolder(tmp_path / "run").bias_bins)
    assert [each["bias_dph"] for each in found["bins"]] == [each.bias_dph for each in expected]
    assert (tmp_path / found["report"]).is_file()
    assert {each["result"] for each in found["budget"]} == {"dwell", "bin", "coefficient"}
    assert all(each["combined"]["share"] == 1.0 for each in found["budget"])
    assert found["verification"] == []
    assert found["acceptance"] == json.loads((tmp_path / "run" / "acceptance.json").read_text())


def test_a_wrong_file_leaves_standard_output_empty(tmp_path):
    for command in ("plan", "bins", "close", "verify"):
        answer = gyrobench(command, "nowhere", "--json", cwd=tmp_path)
        assert answer.returncode in (1, 2)
        assert answer.stdout == ""
        assert "nowhere" in answer.stderr
