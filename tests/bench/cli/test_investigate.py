import json
import sys

import pytest

from gyrobench.bench.bias.dwell_table import write_dwells
from gyrobench.bench.investigation import investigation
from tests.bench.command_line import output_of, refusal_of
from tests.bench.investigation import simulated_bench
from tests.bench.investigation.search_once import search_once
from tests.bench.investigation.simulated_bench import first_campaign, simulate


@pytest.fixture(scope="module", autouse=True)
def searched_once():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(investigation, "search_campaign", search_once())
        yield


def table_of(tmp_path, effects, seed):
    unit = {"unit": "S1", "seed": seed, "effects": effects, "steps": first_campaign([45.0, 10.0, -20.0])}
    (tmp_path / "unit.json").write_text(json.dumps(unit))
    write_dwells(tmp_path / "dwells.csv", simulate(unit))
    return f"{sys.executable} {simulated_bench.__file__} {tmp_path / 'unit.json'}"


def test_a_unit_without_an_effect_ends_without_a_block(tmp_path):
    command = table_of(tmp_path, {}, 5)
    options = ("--bench", command, "--approve", "auto", "--json")
    found = json.loads(output_of("investigate", "dwells.csv", *options, cwd=tmp_path))
    assert (found["ended"], found["blocks"], found["verdict"]) == ("nothing_found", 0, "clean")
    assert (tmp_path / "investigation" / "investigation.html").exists()
    assert (tmp_path / "investigation" / "closure" / "closure.json").exists()


def test_without_an_answer_at_the_prompt_no_block_is_measured(tmp_path):
    command = table_of(tmp_path, {"warm_up": 0.02}, 2)
    printed = output_of("investigate", "dwells.csv", "--bench", command, cwd=tmp_path, code=1)
    assert "the mean biases are" in printed.replace("\n", " ")
    assert not list((tmp_path / "investigation").glob("block-*/new.csv"))


def test_a_table_that_does_not_exist_is_wrong_input(tmp_path):
    assert "none.csv" in refusal_of("investigate", "none.csv", "--bench", "true", cwd=tmp_path)


def test_a_bench_that_fails_is_reported_with_what_was_measured(tmp_path):
    table_of(tmp_path, {"warm_up": 0.02}, 2)
    command = f"{sys.executable} -c 'import sys; sys.exit(\"chamber door open\")'"
    options = ("--bench", command, "--approve", "auto", "--json")
    found = json.loads(output_of("investigate", "dwells.csv", *options, cwd=tmp_path, code=1))
    assert (found["ended"], found["hours"], found["blocks"]) == ("bench_failed", 0.0, 0)
    assert "chamber door open" in found["reason"]
    assert (tmp_path / "investigation" / "investigation.html").exists()


def test_a_verification_is_not_ignored_with_a_bench(tmp_path):
    options = ("--bench", "true", "--verification", "none")
    assert "--verification" in refusal_of("investigate", "dwells.csv", *options, cwd=tmp_path)


def test_an_open_quotation_mark_is_wrong_input(tmp_path):
    table_of(tmp_path, {}, 5)
    problem = refusal_of("investigate", "dwells.csv", "--bench", "python 'bench.py", cwd=tmp_path)
    assert "Close each quotation mark" in problem.replace("\n", " ")


def test_an_adaptive_campaign_needs_a_procedure(tmp_path):
    problem = refusal_of("investigate", "dwells.csv", "--bench", "true", "--adaptive", cwd=tmp_path)
    assert "--adaptive goes with a procedure" in problem.replace("\n", " ")
