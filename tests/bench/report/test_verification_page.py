"""The page of a verification: complete, self-contained, figures beside it."""

import re
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.text import with_sigma
from gyrobench.bench.report.figures.verification import day_figure, residual_bars_figure
from gyrobench.bench.report.terminal.tables import section_view
from gyrobench.bench.report.verification_page import (
    verification_findings,
    verification_plan,
    verification_sections,
    write_verification_page,
)
from gyrobench.bench.report.verification_text import compensation_rows, plateau_rows, total_rows
from tests.bench.report.made_up_verification import (
    SITE,
    alone,
    confirmed,
    degraded,
    improved,
    inconclusive,
    not_confirmed,
    rows_of,
    without_a_plateau,
)
from tests.bench.report.plain_terminal import printed
from tests.bench.verification.runs_alone import compensation_result

COLOURS = {
    "Confirmed": "finished",
    "Improved": "stopped",
    "Not confirmed": "failed",
    "Inconclusive": "stopped",
}


@pytest.mark.parametrize("comparison", [confirmed, improved, not_confirmed, inconclusive, alone])
def test_the_page_holds_its_figures_and_the_judgement_in_its_colour(comparison, tmp_path):
    path = write_verification_page(tmp_path, comparison())
    page = path.read_text(encoding="utf-8")
    assert {figure.name for figure in (tmp_path / "figures").iterdir()} == {"residuals.png", "day.png"}
    assert page.count('src="data:image/png;base64,') == 2
    assert not re.search(r'(src|href)="(?!data:)', page)
    [(colour, judgement)] = re.findall(r'class="ending (\w+)">\s*<strong>([^<]+)\.</strong>', page)
    assert COLOURS[judgement] == colour


def test_the_numbers_loaded_have_their_uncertainties(tmp_path):
    result = confirmed()
    page = write_verification_page(tmp_path, result).read_text(encoding="utf-8")
    compensation = result.models["effect"].compensation
    for name in compensation.sigma:
        assert name in page
    value, sigma = compensation.polynomial_dph[0, 1], compensation.sigma["polynomial_dph"][0, 1]
    assert with_sigma(value, sigma) in page
    pairs = [each.split(" ± ") for row in compensation_rows(result.models) for each in row[1:]]
    decimals = [[len(re.sub(r"\)e.*", "", each).partition(".")[2]) for each in pair] for pair in pairs]
    assert all(one == other for one, other in decimals)


def test_the_bars_of_each_compensation_are_at_its_plateaus():
    spread = residual_bars_figure(confirmed()).axes[1]
    heights = [[bar.get_height() for bar in container] for container in spread.containers]
    expected = [[1000.0 * row.spread_dph for row in left.rows] for left in confirmed().results]
    np.testing.assert_allclose(heights, expected)
    assert [text.get_text() for text in spread.get_xticklabels()] == ["62 °C (1)", "32 °C (2)", "2 °C (1)"]


def test_a_plateau_that_one_run_lacks_shifts_no_other():
    """Rows, bars and days stand at their plateau; what the run lacks is empty."""
    whole, result = confirmed(), without_a_plateau()
    rows = plateau_rows(result)
    assert [row[:2] for row in rows if row[0]] == [["62", "1"], ["32", "2"], ["2", "1"]]
    none, declared, effect = (row for row in rows[4:7])
    assert declared[3:] == ["declared", "", "", "", ""]
    whole_none = plateau_rows(whole)[4]
    assert (none[4], none[6]) == (whole_none[4], whole_none[6]) != ("", "")
    assert effect[4] == plateau_rows(whole)[6][4]
    expected = [plateau_rows(whole)[place][-1] for place in (1, 9)]
    assert [rows[place][-1] for place in (1, 9)] == expected
    for figure in (residual_bars_figure(result), residual_bars_figure(whole)):
        # Three runs, at three plateaus each.
        assert [len(each) for each in figure.axes[0].containers] == [3, 3, 3]
    heights = [bar.get_height() for bar in residual_bars_figure(result).axes[0].containers[1]]
    assert np.isnan(heights).tolist() == [False, True, False]
    largest = [axes.get_lines()[1].get_ydata().max() for axes in day_figure(result).axes]
    assert largest == pytest.approx([row.position_nmi for row in result.results[1].rows])


def test_each_maximum_of_all_plateaus_is_in_a_row():
    for result in (confirmed(), without_a_plateau()):
        blocks = [row for row in plateau_rows(result) if row[3] != "noise"]
        for total in total_rows(result)[:-1]:
            mine = [row[4:] for row in blocks if row[3] == total[0]]
            for place in (2, 3):  # spread and 24 h
                assert total[1 + place] in [row[place] for row in mine]


def test_the_caption_states_when_runs_lack_dwells():
    for result, stated in ((confirmed(), False), (without_a_plateau(), True)):
        [section] = [each for each in verification_sections(result) if each.title == "Residual"]
        assert ("dwells that are valid in all runs" in section.tables[0].caption) is stated


def test_what_was_not_measured_has_no_panel_and_no_column(tmp_path):
    titles = [axes.get_title(loc="left") for axes in residual_bars_figure(confirmed()).axes if axes.axison]
    assert titles == ["bias without the gyros' means", "spread between positions", "rotational INS in 24 h"]
    assert "V_E" not in write_verification_page(tmp_path, confirmed()).read_text(encoding="utf-8")
    one_position = of_one_position(confirmed())
    [section] = [each for each in verification_sections(one_position) if each.title == "Residual"]
    assert [table.header[-2:] for table in section.tables] == [["bias", "varying"]] * 2
    [axes] = residual_bars_figure(one_position).axes
    assert axes.get_title(loc="left") == "bias without the gyros' means"
    assert "A day of a rotational INS" not in [each.title for each in verification_sections(one_position)]


def of_one_position(result):
    """The same with dwells in one position, as on ramps."""
    fitted_c = result.closure.campaign.gyro_c[result.closure.searched]
    results = [
        compensation_result(
            each.compensation,
            [row for row in rows_of(0.01) if row.position == "x_up"],
            [], SITE, fitted_c,
        )
        for each in result.results
    ]  # fmt: skip
    return replace(result, results=tuple(results))


def test_a_day_is_drawn_for_each_plateau_with_all_positions():
    figure = day_figure(confirmed())
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["62 °C", "2 °C"]
    lines = {line.get_label(): line.get_ydata() for line in figure.axes[0].get_lines()}
    assert max(lines["none"]) == pytest.approx(confirmed().results[0].rows[0].position_nmi)
    assert max(lines["with effect"]) < 0.2 * max(lines["none"])


def test_the_sections_go_from_the_compensations_to_the_definitions():
    assert [section.title for section in verification_sections(confirmed())] == [
        "Compensations",
        "Residual",
        "A day of a rotational INS",
        "Definitions",
    ]


def test_a_folder_that_cannot_be_written_is_reported(tmp_path):
    (tmp_path / "figures").write_text("in the way")
    with pytest.raises(RunFolderError, match="figures"):
        write_verification_page(tmp_path, confirmed())


ALL = [confirmed, improved, not_confirmed, inconclusive, alone, degraded, without_a_plateau]


def on_terminal(content):
    return printed(section_view(content))


@pytest.mark.parametrize("comparison", ALL)
def test_it_fits_a_terminal_without_colour_and_nothing_is_cut_off(comparison):
    assert "nan" not in on_terminal(verification_findings(comparison()).chapter).split()


def test_it_begins_with_the_judgement_and_has_the_numbers_with_their_noise():
    text = on_terminal(verification_findings(confirmed()).chapter)
    assert text.splitlines()[1].startswith("Confirmed. Varying bias:")
    rows = [line.split() for line in text.splitlines()]
    first = [row[0] for row in rows if row].index("none")
    totals = [row for row in rows if row][first : first + 4]
    assert [row[0] for row in totals] == ["none", "declared", "with", "noise"]
    assert float(totals[0][2]) > 10.0 > float(totals[3][2])


def test_each_plateau_is_named_once():
    lines = [line.split() for line in on_terminal(verification_findings(confirmed()).chapter).splitlines()]
    assert sum(line[:2] == ["62", "1"] for line in lines) == 1


def test_the_duration_of_the_runs_is_stated_before_they_begin():
    comparison = confirmed()
    text = on_terminal(verification_plan(comparison.closure, comparison.models, ["none", "effect"], 68_400.0))
    assert (
        "2 runs of 19:00 h remain, 38:00 h in total: without compensation and with the effects."
        in " ".join(text.split())
    )
    one = on_terminal(verification_plan(comparison.closure, comparison.models, ["declared"], 68_400.0))
    assert "1 run of 19:00 h remains: with the declared model." in one
    assert "All runs are complete" in on_terminal(
        verification_plan(comparison.closure, comparison.models, [], 68_400.0)
    )
