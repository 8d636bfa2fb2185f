import math
from dataclasses import replace

import pytest

from gyrobench.bench.bias.budget import BiasBudget, Budget, Contribution
from gyrobench.bench.bias.error_sources import SOURCES
from gyrobench.bench.foundations.arrays import RAD_TO_ARCMIN
from gyrobench.bench.report.budget_section import budget_box, budget_figure, budget_section, variance_shares
from gyrobench.bench.report.run_report import write_report
from gyrobench.bench.runs.tables.budget_table import (
    BUDGET_TABLE,
    BudgetSummary,
    budget_rows,
    note_estimated_latitude,
)
from gyrobench.bench.runs.tables.coefficient_table import COEFFICIENT_TABLE, PlateauCoefficientRow


def budget(noise_dph, latitude_dph, dof=math.inf):
    return Budget(
        (
            Contribution("angle_random_walk", 0.0006, noise_dph, dof),
            Contribution("latitude", 0.33, latitude_dph, note="declared"),
            Contribution("power_cycles", math.nan, math.nan, is_within=False, note="not evaluated: one run"),
        )
    )


def summary(budgets):
    return BudgetSummary.of(budget_rows(budgets))


LEVEL, VERTICAL = budget(0.001, 0.0), budget(0.0006, 0.0008)
BUDGETS = [
    *(BiasBudget(gyro, "z_up", LEVEL, dwell) for dwell in (1, 2) for gyro in "xy"),
    *(BiasBudget("z", "z_up", VERTICAL, dwell) for dwell in (1, 2)),
    *(BiasBudget(gyro, "z_up", LEVEL, None, 20.0, 25.0) for gyro in "xyz"),
]
SUMMARY = summary(BUDGETS)


def test_the_statement_gives_the_causes_of_level_and_vertical_gyros_the_largest_first():
    assert budget_box(SUMMARY).text == (
        "0.0010 deg/h for a level gyro, 100 % of the variance by angle random walk of the gyros "
        "(0.0006 deg/sqrt(h), declared); 0.0010 deg/h for a vertical gyro, 64 % of the variance by latitude "
        "and deflection of the vertical (0.33 arcmin, declared) and 36 % by angle random walk of the gyros "
        "(0.0006 deg/sqrt(h), declared). Expanded uncertainty: k = 1.96 (95 %)."
    )


def test_the_statement_says_what_was_estimated_and_the_range_of_k():
    rows = summary(
        BiasBudget("x", "z_up", budget(0.001, 0.0, dof), dwell) for dwell, dof in enumerate((4.0, 1e6), 1)
    )
    text = budget_box(rows).text
    assert "angle random walk of the gyros (0.0006 deg/sqrt(h), estimated)" in text
    assert text.endswith("Expanded uncertainty: k = 1.96 to 2.78 (95 %).")


def test_a_latitude_that_the_data_show_to_be_off_is_not_called_declared():
    def text_of(*budgets):
        found = note_estimated_latitude(budget_rows(budgets), declared_rad=0.33 / RAD_TO_ARCMIN)
        return budget_box(BudgetSummary.of(found)).text

    declared = BiasBudget("z", "z_up", VERTICAL, 1)
    wrong = replace(VERTICAL.contributions[1], input_sigma=2.0)
    other = replace(VERTICAL, contributions=(VERTICAL.contributions[0], wrong))
    assert "(0.33 arcmin, declared)" in text_of(declared)
    assert "(2 arcmin, estimated)" in text_of(BiasBudget("z", "z_up", other, 1))
    assert "(0.33 to 2 arcmin, declared or estimated)" in text_of(declared, BiasBudget("z", "z_up", other, 2))
    level = BiasBudget("x", "z_up", other, 1)
    assert "(0.33 arcmin, declared)" in text_of(declared, level)


def test_without_a_budget_nothing_is_said():
    none = BudgetSummary()
    assert (budget_box(none), budget_section(none), variance_shares(none)) == (None, None, [])


def test_shares_are_those_of_the_variance_and_add_up():
    found = {each.label: each for each in variance_shares(SUMMARY)}
    assert list(found) == ["X gyro level", "Y gyro level", "Z gyro vertical"]
    assert found["Z gyro vertical"].parts == pytest.approx({"angle_random_walk": 0.36, "latitude": 0.64})
    assert (found["X gyro level"].count, found["X gyro level"].sigma_dph) == (2, pytest.approx(0.001))


def test_each_bar_of_the_figure_reaches_100_percent_and_has_its_number_of_dwells():
    [axes] = budget_figure(variance_shares(SUMMARY)).axes
    ends = {}
    for bar in axes.patches:
        ends[bar.get_y()] = max(ends.get(bar.get_y(), 0.0), bar.get_x() + bar.get_width())
    assert list(ends.values()) == pytest.approx([100.0] * 3)
    assert [text.get_text() for text in axes.texts] == ["0.0010 deg/h (2)"] * 3


def test_the_tables_hold_contributions_sums_and_what_was_not_evaluated():
    level, vertical, bins = budget_section(SUMMARY).tables
    assert vertical.rows == [
        ["angle random walk of the gyros", "B", "normal", "0.0006 deg/sqrt(h)", "1", "0.600", "36.0", "∞"],
        [
            "latitude and deflection of the vertical",
            "B",
            "normal",
            "0.33 arcmin",
            "0.00242",
            "0.800",
            "64.0",
            "∞",
        ],
        ["repeatability between power cycles", "B", "not evaluated: one run"],
        ["combined", "", "", "U = 1.960", "k = 1.96", "1.000", "100.0", "∞"],
    ]
    assert "over 4 values" in level.caption
    assert [row[0] for row in bins.rows] == ["X gyro", "Y gyro", "Z gyro"]
    assert bins.rows[0][1:] == ["20 to 25", "2.0 (1.96)"]


def test_u_of_a_bin_has_the_decimals_that_its_bias_has():
    of_bin = BiasBudget("x", "z_up", budget(0.0029, 0.0), None, 20.0, 25.0)
    *_, bins = budget_section(summary([*BUDGETS[:6], of_bin])).tables
    assert bins.rows[0][1:] == ["20 to 25", "5.7 (1.96)"]


def test_the_first_page_of_the_report_shows_the_figure_before_the_contents(empty_folder):
    BUDGET_TABLE.write(empty_folder.budget, budget_rows(BUDGETS))
    page = write_report(empty_folder).path.read_text()
    assert page.index("Standard uncertainty of a bias in a dwell") < page.index("Shares of the variance")
    assert page.index("Shares of the variance") < page.index("<h2>Contents</h2>")
    assert (empty_folder.figures / "uncertainty_budget.png").is_file()


def test_a_report_of_coefficients_has_them_on_its_first_page_and_the_figure_in_the_section(empty_folder):
    BUDGET_TABLE.write(empty_folder.budget, budget_rows(BUDGETS))
    scale_factor = PlateauCoefficientRow(
        *(1, 1, 25.0, 30.0, "accelerometer_scale_factor", "x", 12.3, 0.4, "ppm", "", math.nan, 0.0)
    )
    COEFFICIENT_TABLE.write(empty_folder.coefficients, [scale_factor])
    first, sections = write_report(empty_folder).path.read_text().split("<h2>Contents</h2>")
    assert ">12.3<" in first
    assert "Shares of the variance" not in first
    assert sections.index("Uncertainty budget") < sections.index("Shares of the variance")


def test_bars_keep_their_height_above_a_legend_of_many_sources():
    few, many = (
        [
            replace(each, parts=dict.fromkeys(list(SOURCES)[:count], 1.0 / count))
            for each in variance_shares(SUMMARY)
        ]
        for count in (1, 6)
    )
    heights_in = [
        figure.axes[0].get_position().height * figure.get_figheight()
        for figure in map(budget_figure, (few, many))
    ]
    assert heights_in[1] == pytest.approx(heights_in[0])
