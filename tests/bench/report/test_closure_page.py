"""The page of a search for effects: complete, self-contained, figures beside it."""

import re
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.report.closure_page import (
    closure_findings,
    closure_sections,
    effect_table,
    evidence_table,
    write_closure_page,
)
from gyrobench.bench.report.terminal.tables import section_view
from tests.bench.report.made_up_closure import (
    ambiguous,
    clean,
    explained,
    faint,
    made_up_rows,
    quiet,
    quiet_unexplained,
    unexplained,
    without_boards,
)
from tests.bench.report.plain_terminal import printed

SEARCHES = [
    *(clean, explained),
    *(
        pytest.param(search, marks=pytest.mark.long)
        for search in (ambiguous, unexplained, faint, quiet, without_boards)
    ),
]


@pytest.fixture(scope="module", params=SEARCHES)
def written(request, tmp_path_factory):
    """A closure, and the page that was written for it."""
    closure = request.param()
    return closure, write_closure_page(tmp_path_factory.mktemp("closure"), closure, "dwells.csv")


@pytest.mark.draws
def test_the_page_holds_every_figure_inside(written):
    closure, path = written
    page = path.read_text(encoding="utf-8")
    names = {figure.stem for figure in (path.parent / "figures").iterdir()}
    assert {"residuals_x", "residuals_y", "residuals_z", "errors"} <= names
    assert {f"effect_{each.candidate.effect.name}" for each in closure.effects} <= names
    assert page.count('src="data:image/png;base64,') == len(names)
    assert not re.search(r'(src|href)="(?!data:)', page)


def test_no_number_is_missing(written):
    _, path = written
    text = re.sub(r'src="[^"]*"', "", path.read_text(encoding="utf-8"))
    assert not re.search(r"\bnan\b", text)


def test_the_dwells_searched_are_reported_beside_those_of_the_table(tmp_path):
    rows = made_up_rows()
    rows[5] = replace(rows[5], flags=("vibration",))
    rows[6] = replace(rows[6], gyro_c=(np.nan,) * 3)
    page = write_closure_page(tmp_path, close_loop(campaign_of(rows), effects=[]), "dwells.csv")
    assert "142 of 144" in page.read_text(encoding="utf-8")


def test_the_verdict_stands_at_the_top_in_its_colour(written):
    closure, path = written
    colours = {"clean": "finished", "explained": "finished", "ambiguous": "stopped", "unexplained": "failed"}
    start = rf'class="ending {colours[closure.verdict]}">\s*<strong>{closure.verdict.capitalize()}\.</strong>'
    assert re.search(start, path.read_text(encoding="utf-8"))


@pytest.mark.draws
def test_equal_searches_give_equal_pages(tmp_path):
    once, again = (write_closure_page(tmp_path, clean(), "dwells.csv").read_bytes() for _ in range(2))
    assert once == again


def test_the_sections_go_from_the_residual_to_the_lack_of_fit():
    assert [section.title for section in closure_sections(explained())] == [
        "Residual of the declared model",
        "Effect",
        "Alternatives",
        "Held-out error",
        "Lack of fit",
    ]


def test_a_clean_search_has_no_effect_and_no_shares_to_draw():
    sections = {section.title: section for section in closure_sections(clean())}
    assert "Effect" not in sections
    assert not sections["Candidate effects"].figures
    assert any("is detectable from about" in text for text in sections["Candidate effects"].paragraphs)


def test_an_unexplained_residual_has_a_warning():
    *_, section = closure_sections(unexplained())
    text = " ".join(section.paragraphs)
    assert "7.3 times the noise" in text
    assert "Do not rely on the model below that size" in text


@pytest.mark.parametrize(("make", "is_stated"), [(explained, True), (clean, False)])
def test_noise_that_gyros_share_is_stated_where_it_may_pass_for_an_effect(make, is_stated):
    closure = make()
    closure = replace(closure, after=replace(closure.after, correlated=(0, 2, 0.7)))
    text = " ".join(closure_sections(closure)[0].paragraphs)
    assert ("The remaining residuals of the x and z gyros are correlated (+0.70)." in text) == is_stated


def test_errors_are_listed_by_gyro_and_sizes_by_term():
    sections = {section.title: section for section in closure_sections(explained())}
    [table] = sections["Held-out error"].tables
    assert [row[0] for row in table.rows] == [
        "declared model",
        "with the effects found",
        "noise",
        "prediction",
    ]
    assert float(table.rows[0][-1]) == pytest.approx(1000.0 * explained().error_before_dph, abs=0.005)
    sizes = sections["Effect"].tables[1]
    [row] = sizes.rows
    values, sigmas = zip(*(map(float, cell.split(" ± ")) for cell in row[2:]), strict=True)
    assert values == pytest.approx([1.0, -0.8, 0.0], abs=0.1)
    assert sigmas == pytest.approx(1000.0 * explained().effects[0].sizes_sigma_dph[:, 0], rel=0.2)


def test_a_term_that_no_gyro_has_is_not_listed():
    effect = explained().effects[0]
    without = replace(effect, sizes_dph=np.zeros_like(effect.sizes_dph))
    sections = {
        section.title: section for section in closure_sections(replace(explained(), effects=(without,)))
    }
    assert not sections["Effect"].tables[1].rows


def test_the_lack_of_fit_tests_are_listed_before_and_after():
    *_, section = closure_sections(explained())
    rows = {row[0]: row[1:] for row in section.tables[0].rows}
    assert rows["follows temperature rate"][0] == "<1e-9"
    assert float(rows["follows temperature rate"][1]) > 0.01


def test_a_folder_that_cannot_be_written_is_reported(tmp_path):
    (tmp_path / "figures").write_text("in the way")
    with pytest.raises(RunFolderError, match="figures"):
        write_closure_page(tmp_path, clean(), "dwells.csv")


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


def on_terminal(closure):
    return printed(section_view(closure_findings(closure).chapter))


@pytest.mark.parametrize(
    "search", [clean, explained, ambiguous, faint, unexplained, quiet, quiet_unexplained, without_boards]
)
def test_it_fits_a_terminal_without_colour_and_nothing_is_cut_off(search):
    assert "nan" not in on_terminal(search()).split()


def test_it_begins_with_the_verdict():
    assert on_terminal(explained()).splitlines()[1].startswith("Explained. One effect explains the residual")
    assert on_terminal(clean()).splitlines()[1].startswith("Clean. ")
