"""The page of a proof: complete, self-contained, figures beside it."""

import re

import numpy as np
import pytest

from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.report.verification.figures import day_figure, leftovers_figure
from gyrobench.bench.report.verification.page import write_verify_page
from gyrobench.bench.report.verification.section import verify_sections
from tests.bench.report.made_up_comparison import alone, better, confirmed, not_confirmed, nothing_to_tell

COLOURS = {
    "Confirmed": "finished",
    "Better": "stopped",
    "Not confirmed": "failed",
    "Nothing to tell": "stopped",
}


@pytest.mark.parametrize("comparison", [confirmed, better, not_confirmed, nothing_to_tell, alone])
def test_the_page_holds_its_figures_and_the_judgement_in_its_colour(comparison, tmp_path):
    path = write_verify_page(tmp_path, comparison())
    page = path.read_text(encoding="utf-8")
    assert {figure.name for figure in (tmp_path / "figures").iterdir()} == {"leftovers.png", "day.png"}
    assert page.count('src="data:image/png;base64,') == 2
    assert not re.search(r'(src|href)="(?!data:)', page)
    [(colour, judgement)] = re.findall(r'class="ending (\w+)">\s*<strong>([^<]+)\.</strong>', page)
    assert COLOURS[judgement] == colour


def test_the_bars_of_each_compensation_stand_over_its_stops():
    spread = leftovers_figure(confirmed()).axes[1]
    heights = [[bar.get_height() for bar in container] for container in spread.containers]
    expected = [[1000.0 * row.spread_dph for row in left.rows] for left in confirmed().leftovers]
    np.testing.assert_allclose(heights, expected)
    assert [text.get_text() for text in spread.get_xticklabels()] == [
        "62 °C\ncycle 1",
        "32 °C\ncycle 2",
        "2 °C\ncycle 1",
    ]


def test_a_velocity_that_was_not_measured_is_said():
    velocity = leftovers_figure(confirmed()).axes[2]
    assert [text.get_text() for text in velocity.texts] == ["not measured"]


def test_a_day_is_drawn_for_each_stop_with_all_positions():
    figure = day_figure(confirmed())
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["62 °C", "2 °C"]
    lines = {line.get_label(): line.get_ydata() for line in figure.axes[0].get_lines()}
    assert max(lines["none"]) == pytest.approx(confirmed().leftovers[0].rows[0].position_nmi)
    assert max(lines["with effect"]) < 0.2 * max(lines["none"])


def test_the_sections_go_from_what_was_loaded_to_how_to_read_it():
    assert [section.title for section in verify_sections(confirmed())] == [
        "What was loaded",
        "What is left",
        "A day of a rotational INS",
        "How to read the numbers",
    ]


def test_a_place_that_cannot_be_written_is_told(tmp_path):
    (tmp_path / "figures").write_text("in the way")
    with pytest.raises(RunFolderError, match="figures"):
        write_verify_page(tmp_path, confirmed())
