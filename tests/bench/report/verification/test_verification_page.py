"""The page of a verification: complete, self-contained, figures beside it."""

import re
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.report.verification.verification_page import (
    day_figure,
    residual_bars_figure,
    verification_sections,
    write_verification_page,
)
from gyrobench.bench.verification.compensation_verification import compensation_result
from tests.bench.report.made_up_verification import (
    SITE,
    alone,
    confirmed,
    improved,
    inconclusive,
    not_confirmed,
    rows_of,
)

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
    assert f"{value:.3g} ± {sigma:.2g}" in page


def test_the_bars_of_each_compensation_are_at_its_plateaus():
    spread = residual_bars_figure(confirmed()).axes[1]
    heights = [[bar.get_height() for bar in container] for container in spread.containers]
    expected = [[1000.0 * row.spread_dph for row in left.rows] for left in confirmed().results]
    np.testing.assert_allclose(heights, expected)
    assert [text.get_text() for text in spread.get_xticklabels()] == ["62 °C (1)", "32 °C (2)", "2 °C (1)"]


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
