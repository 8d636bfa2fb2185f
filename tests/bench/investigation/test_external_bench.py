import json
import sys
import time
from contextlib import suppress
from dataclasses import replace

import psutil
import pytest

from gyrobench.bench.bias.dwell_table import read_dwells, write_dwells
from gyrobench.bench.foundations.errors import DocumentError, GyrobenchError
from gyrobench.bench.investigation.blocks import catalogue
from gyrobench.bench.investigation.external_bench import BlockPlan, BlockRefusedError, ExternalBench
from tests.bench.investigation import simulated_bench
from tests.bench.investigation.simulated_bench import first_campaign, simulate

UNIT = {"unit": "S1", "seed": 3, "effects": {}, "steps": first_campaign([45.0, -20.0])}


@pytest.fixture(scope="module")
def rows():
    return simulate(UNIT)


def plan_of(rows, kind):
    return next(each.plan for each in catalogue(rows) if each.kinds == (kind,))


def bench_that(tmp_path, code, rows=()):
    script = tmp_path / "bench.py"
    script.write_text(f"import json, sys\nplan = json.load(open(sys.argv[1]))\n{code}\n")
    return ExternalBench(f"{sys.executable} {script}", rows, time_limit_s=100.0)


def test_the_plan_is_a_file_with_the_documented_keys(rows):
    text = plan_of(rows, "power cycle").text()
    plan = json.loads(text)
    assert list(plan) == ["schema_version", "unit", "start_s", "state", "next_dwell", "next_cycle", "steps"]
    assert list(plan["state"]) == [
        "chamber_c", "gyro_x_c", "gyro_y_c", "gyro_z_c", "powered", "since_power_on_s", "position"
    ]  # fmt: skip
    off, on, *dwells = plan["steps"]
    assert (off["kind"], off["on"], "factor" in off) == ("power", False, False)
    assert (on["kind"], on["on"], on["factor"]) == ("power", True, 1.0)
    assert {each["kind"] for each in dwells} == {"dwell"}
    assert dwells[0]["dwell"] == plan["next_dwell"] == rows[-1].dwell + 1
    assert dwells[0]["run"] == "B-2"
    assert BlockPlan.model_validate(json.loads(text)).text() == text


def test_a_refused_block_is_an_error_with_the_bench_s_reason(rows, tmp_path):
    bench = bench_that(tmp_path, "sys.stderr.write('no heater'); sys.exit(3)")
    with pytest.raises(BlockRefusedError, match=r"^no heater$"):
        bench.measure(plan_of(rows, "power step"), tmp_path)


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("sys.stderr.write('door open'); sys.exit(4)", "exit code 4: door open"),
        ("import time; time.sleep(1000)", "did not end within"),
    ],
)
def test_a_bench_that_fails_or_hangs_ends_the_block(rows, tmp_path, code, message):
    bench = bench_that(tmp_path, code)
    if "sleep" in code:
        bench = ExternalBench(bench.command, rows, time_limit_s=0.5)
    with pytest.raises(GyrobenchError, match=message):
        bench.measure(plan_of(rows, "reversal"), tmp_path)


def test_no_process_of_a_command_that_is_too_slow_remains(rows, tmp_path):
    code = f"""
import subprocess, time
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(1000)"])
open({str(tmp_path / "child")!r}, "w").write(str(child.pid))
time.sleep(1000)"""
    bench = ExternalBench(bench_that(tmp_path, code).command, rows, time_limit_s=1.5)
    with pytest.raises(GyrobenchError, match="did not end"):
        bench.measure(plan_of(rows, "reversal"), tmp_path)
    with suppress(FileNotFoundError, psutil.NoSuchProcess):
        process = psutil.Process(int((tmp_path / "child").read_text()))
        while process.status() != psutil.STATUS_ZOMBIE:  # it ends a moment after its signal
            time.sleep(0.01)


@pytest.mark.parametrize(("command", "message"), [("python 'my bench.py", "quotation"), ("  ", "is empty")])
def test_a_command_that_can_not_be_split_is_refused_at_once(command, message):
    with pytest.raises(GyrobenchError, match=message):
        ExternalBench(command, ())


@pytest.mark.parametrize("lost", [0, 1])
def test_a_table_that_the_command_finished_is_taken_and_a_part_is_measured_again(rows, tmp_path, lost):
    plan, notices = plan_of(rows, "four headings"), []
    (tmp_path / "unit.json").write_text(json.dumps(UNIT))
    command = f"{sys.executable} {simulated_bench.__file__} {tmp_path / 'unit.json'}"
    whole = ExternalBench(command, rows, notice=notices.append).measure(plan, tmp_path)
    assert not notices
    lines = (tmp_path / "new.csv").read_text().splitlines(keepends=True)
    (tmp_path / "new.csv").write_text("".join(lines[: len(lines) - lost]))
    again = ExternalBench(command if lost else "/no/such/bench", rows, notice=notices.append)
    assert repr(again.measure(plan, tmp_path)) == repr(whole)  # NaN does not equal itself
    assert ["measured again" in each for each in notices] == [True] * lost


def test_dwells_that_overlap_are_refused_and_the_next_call_measures_the_block_again(rows, tmp_path):
    plan = plan_of(rows, "four headings")
    (tmp_path / "unit.json").write_text(json.dumps(UNIT))
    honest = f"{sys.executable} {simulated_bench.__file__} {tmp_path / 'unit.json'}"
    whole = ExternalBench(honest, rows).measure(plan, tmp_path)
    same = [replace(row, start_s=whole[0].start_s) for row in whole]
    (tmp_path / "new.csv").unlink()
    write_dwells(tmp_path / "same.csv", same)
    code = f"import shutil\nshutil.copy({str(tmp_path / 'same.csv')!r}, sys.argv[2])"
    with pytest.raises(DocumentError, match=r"new.csv: 4 of \d+ dwells start at"):
        bench_that(tmp_path, code, rows).measure(plan, tmp_path)
    notices = []
    again = ExternalBench(honest, rows, notice=notices.append).measure(plan, tmp_path)
    assert repr(again) == repr(whole)  # NaN does not equal itself
    assert "measured again" in notices[0]


def test_a_command_that_does_not_exist_is_reported(rows, tmp_path):
    with pytest.raises(GyrobenchError, match=r"can't be started"):
        ExternalBench("/no/such/bench", rows).measure(plan_of(rows, "reversal"), tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("dwell", "999"), "dwell 999 is not in the plan"),
        (("position", "x_up"), "position x_up, not z_up"),
        (("unit", "OTHER"), "has the unit OTHER"),
        (("run", "B-7"), "run B-7, not B-1"),
        (("start_s", "5.0"), "before its block"),
        (("azimuth_deg", "33.0"), "azimuth 33 deg"),
        (("sigma_x_dph", "1e-12"), r"new.csv: dwell .* has sigma_x_dph 1e-12, .* outside 1/5 to 5"),
        (("sigma_z_dph", "0.1"), "sigma_z_dph 0.1"),
        (("gyro_y_c", "300.0"), "gyro_y_c is 300 degC"),
    ],
)
def test_rows_that_are_not_the_plan_s_are_refused(rows, tmp_path, change, message):
    plan = plan_of(rows, "four headings")
    code = f"""
import csv
row = dict(unit=plan["unit"], dwell=plan["steps"][0]["dwell"], since_power_on_s=1.0)
names = ("run", "cycle", "position", "start_s", "end_s", "azimuth_deg")
row |= {{name: plan["steps"][0][name] for name in names}}
for axis in "xyz":
    row |= {{f"gyro_{{axis}}_c": 20.0, f"gyro_{{axis}}_rate_c_per_h": 0.0}}
    row |= {{f"bias_{{axis}}_dph": 0.0, f"sigma_{{axis}}_dph": 0.001}}
row |= {{{change[0]!r}: {change[1]!r}}}
with open(sys.argv[2], "w", newline="") as file:
    writer = csv.DictWriter(file, list(row)); writer.writeheader(); writer.writerow(row)
"""
    with pytest.raises(DocumentError, match=message):
        bench_that(tmp_path, code, rows).measure(plan, tmp_path)
    assert len(read_dwells(tmp_path / "new.csv")) == 1


def test_the_dwells_of_the_plan_come_back(rows, tmp_path):
    plan = plan_of(rows, "four headings")
    unit = tmp_path / "unit.json"
    unit.write_text(json.dumps(UNIT))
    bench = ExternalBench(f"{sys.executable} {simulated_bench.__file__} {unit}", rows)
    measured = bench.measure(plan, tmp_path)
    assert [row.dwell for row in measured] == [step.dwell for step in plan.dwells]
    assert json.loads((tmp_path / "plan.json").read_text())["next_dwell"] == measured[0].dwell


def test_the_plan_fits_its_published_schema(rows):
    jsonschema = pytest.importorskip("jsonschema")
    from gyrobench.bench.authoring.file_kinds import KINDS, schema_of

    schema = schema_of(KINDS["plan"])
    for block in catalogue(rows):
        jsonschema.validate(json.loads(block.plan.text()), schema)
    wrong = json.loads(plan_of(rows, "reversal").text()) | {"steps": [{"kind": "dance"}]}
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(wrong, schema)
