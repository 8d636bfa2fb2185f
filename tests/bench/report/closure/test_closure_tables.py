"""Rows of the tables about a search for effects."""

from gyrobench.bench.report.closure.closure_tables import effect_table, evidence_caption, evidence_table
from tests.bench.report.made_up_closure import ambiguous, clean, explained, without_boards


def test_an_effect_has_its_gyros_size_and_probability():
    head, rows = effect_table(ambiguous())
    [row] = [dict(zip(head, row, strict=True)) for row in rows]
    assert row["effect"] == "temperature rate"
    assert row["gyros"] == "x and y"
    assert row["tied with"] == "twin"
    [effect] = ambiguous().effects
    assert row["size"] == f"{1000.0 * effect.rms_dph:.2f} ± {1000.0 * effect.rms_sigma_dph:.2f}"
    assert row["P"] == "0.50"


def test_an_effect_without_alternatives_is_not_tied():
    head, [row] = effect_table(explained())
    assert row[head.index("tied with")] == "none"


def test_every_fitted_effect_has_a_row():
    head, rows = evidence_table(ambiguous())
    marks = {row[0]: row[1] for row in rows}
    assert head == ["effect", "", "share", "p", "odds"]
    assert len(rows) == len(ambiguous().evidence)
    assert (marks["temperature rate"], marks["twin"], marks["bias jump"]) == ("found", "tied", "")


def test_effects_with_a_missing_input_have_no_row():
    names = [row[0] for row in evidence_table(without_boards())[1]]
    assert "thermal gradient" not in names
    assert "time drift" in names


def test_columns_that_would_be_empty_are_left_out():
    head, rows = evidence_table(clean())
    assert head == ["effect", "", "p"]
    assert all(len(row) == len(head) for row in rows)
    assert "share" not in evidence_caption(clean())
    assert "odds" not in evidence_caption(clean())
    assert "odds" in evidence_caption(explained())
