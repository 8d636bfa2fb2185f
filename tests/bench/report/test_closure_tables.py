"""Rows of the tables about a search for effects."""

from gyrobench.bench.report.closure_page import effect_table, evidence_table
from tests.bench.report.made_up_closure import ambiguous, clean, explained, without_boards


def test_an_effect_has_its_gyros_size_and_probability():
    table = effect_table(ambiguous())
    [row] = [dict(zip(table.header, row, strict=True)) for row in table.rows]
    assert row["effect"] == "temperature rate"
    assert row["gyros"] == "x and y"
    assert row["tied with"] == "twin"
    [effect] = ambiguous().effects
    assert row["size"] == f"{1000.0 * effect.rms_dph:.2f} ± {1000.0 * effect.rms_sigma_dph:.2f}"
    assert row["P"] == "0.50"


def test_an_effect_without_alternatives_is_not_tied():
    table = effect_table(explained())
    [row] = table.rows
    assert row[table.header.index("tied with")] == "none"


def test_every_fitted_effect_has_a_row():
    table = evidence_table(ambiguous())
    marks = {row[0]: row[1] for row in table.rows}
    assert table.header == ["effect", "status", "share", "p", "odds"]
    assert len(table.rows) == len(ambiguous().evidence)
    assert (marks["temperature rate"], marks["twin"], marks["bias jump"]) == ("found", "tied", "")


def test_effects_with_a_missing_input_have_no_row():
    names = [row[0] for row in evidence_table(without_boards()).rows]
    assert "thermal gradient" not in names
    assert "time drift" in names


def test_columns_that_would_be_empty_are_left_out():
    table = evidence_table(clean())
    assert table.header == ["effect", "p"]
    assert all(len(row) == len(table.header) for row in table.rows)
    assert "share" not in table.caption
    assert "odds" not in table.caption
    assert "odds" in evidence_table(explained()).caption
