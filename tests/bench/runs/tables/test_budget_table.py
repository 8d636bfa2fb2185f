import json
import math

import pytest

from gyrobench.bench.bias.budget import BiasBudget, Budget, Contribution
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.runs.tables.budget_table import BUDGET_TABLE, budget_records, budget_rows

BUDGET = Budget(
    (
        Contribution("angle_random_walk", 0.0006, 3e-3, 9.0),
        Contribution("latitude", 0.33, 4e-3),
        Contribution("power_cycles", math.nan, math.nan, is_within=False, note="not evaluated"),
    )
)
ROWS = budget_rows([BiasBudget("x", "z_up", BUDGET, 7), BiasBudget("x", "z_up", BUDGET, None, 20.0, 25.0)])


def test_each_budget_has_a_row_for_each_contribution_and_one_for_the_sum():
    assert [(row.result, row.dwell, row.contribution) for row in ROWS[:5]] == [
        ("dwell", 7, "angle_random_walk"), ("dwell", 7, "latitude"), ("dwell", 7, "power_cycles"),
        ("dwell", 7, "combined"), ("bin", None, "angle_random_walk"),
    ]  # fmt: skip
    combined = ROWS[3]
    assert (combined.sigma, combined.share, combined.distribution) == (pytest.approx(5e-3), 1.0, "t")
    assert combined.expanded == pytest.approx(combined.k * 5e-3)
    assert [row.share for row in ROWS[:2]] == pytest.approx([0.36, 0.64])


def test_a_table_that_is_written_is_read_as_it_was(tmp_path):
    path = tmp_path / "budget.csv"
    BUDGET_TABLE.write(path, ROWS)
    BUDGET_TABLE.write(tmp_path / "again.csv", BUDGET_TABLE.iterate(path))
    assert (tmp_path / "again.csv").read_bytes() == path.read_bytes()
    found = list(BUDGET_TABLE.iterate(path))
    assert [row.dwell for row in found] == [row.dwell for row in ROWS]
    assert math.isinf(found[1].dof)
    assert math.isnan(found[2].sigma)


def test_a_wrong_number_is_named(tmp_path):
    path = tmp_path / "budget.csv"
    BUDGET_TABLE.write(path, ROWS)
    path.write_text(path.read_text().replace(",0.36,", ",much,"))
    with pytest.raises(DocumentError, match=r"budget\.csv:2: column share: expected a number; found 'much'"):
        list(BUDGET_TABLE.iterate(path))


def test_records_hold_only_what_json_can_say():
    first, second = json.loads(json.dumps(budget_records(ROWS), allow_nan=False))
    assert (first["result"], first["dwell"], first["quantity"]) == ("dwell", 7, "gyro_bias")
    assert second["bin_low_c"] == 20.0
    assert first["combined"]["sigma"] == pytest.approx(5e-3)
    assert "dof" not in first["contributions"]["latitude"]
    assert first["contributions"]["power_cycles"] == {
        "type": "B", "distribution": "normal", "input_unit": "deg/h", "note": "not evaluated"
    }  # fmt: skip
