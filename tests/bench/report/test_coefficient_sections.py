"""Figures of coefficients and of characteristic tests."""

from math import nan

import numpy as np
import pytest

from gyrobench.bench.characteristics.results import Curve
from gyrobench.bench.report.characteristic_sections import characteristics_figure
from gyrobench.bench.report.coefficient_sections import coefficients_figure, coefficients_overview
from gyrobench.bench.runs.tables.coefficient_table import PlateauCoefficientRow


def curve(parts):
    x = np.arange(6.0)
    return Curve.of("x", x, x, np.ones(6), x, parts)


def drawn(axes):
    """Lines of the fit as (label, x of its points, style)."""
    return [
        (line.get_label(), line.get_xdata().tolist(), (line.get_linestyle(), line.get_color()))
        for line in axes.get_lines()
        if not str(line.get_label()).startswith("_")
    ]


def test_the_drift_of_scale_factors_ends_with_its_power_cycle():
    figure = characteristics_figure("scale_factor_stability", [curve(["r1"] * 2 + ["r2"] * 4)])
    lines = drawn(figure.axes[0])
    assert [(label, x) for label, x, _ in lines] == [("drift", [0.0, 1.0]), ("drift", [2.0, 3.0, 4.0, 5.0])]
    assert len({style for *_, style in lines}) == 1


def test_heating_and_cooling_have_a_line_and_a_label_each():
    parts = ["heating, cycle 1"] * 2 + ["cooling, cycle 1"] * 2 + ["heating, cycle 1"] * 2
    figure = characteristics_figure("thermal_sensitivity", [curve(parts)])
    (first, first_x, up), (second, _, down), (third, _, again) = drawn(figure.axes[0])
    assert (first, second, third) == ("fit, heating, cycle 1", "fit, cooling, cycle 1", first)
    assert first_x == [0.0, 1.0]
    assert up == again != down


@pytest.mark.parametrize("test", ["scale_factor_stability", "thermal_sensitivity", "warm_up"])
def test_the_legend_covers_no_panel_and_a_fit_without_parts_is_one_line(test):
    figure = characteristics_figure(test, [curve([])])
    figure.canvas.draw()
    [legend], [axes] = figure.legends, figure.axes
    assert axes.get_legend() is None
    assert not legend.get_window_extent().overlaps(axes.get_window_extent())
    [(label, x, _)] = drawn(axes)
    assert len(x) == 6
    assert label == {"scale_factor_stability": "drift"}.get(test, "fit")


def test_plateaus_at_one_temperature_have_an_axis_with_distinct_ticks():
    rows = [
        PlateauCoefficientRow(
            number, 1, 25.0, 29.19 + 5e-5 * number, "gyro_bias", "x", 0.001, 1e-4, "deg/h", "", nan, nan
        )
        for number in (1, 2, 3)
    ]
    axes = coefficients_figure(rows).axes[0]
    low, high = axes.get_xlim()
    assert high - low >= 2.0
    assert low < 29.19 < high


def row(plateau, coefficient, axis, value, sigma):
    temperature_c, unit = 20.0 * plateau, "ppm" if coefficient.endswith("factor") else "deg/h"
    return PlateauCoefficientRow(
        *(plateau, 1, 25.0, temperature_c, coefficient, axis, value, sigma, unit, "", nan, nan)
    )


def test_the_overview_has_the_values_of_all_axes_and_the_largest_change_and_uncertainty():
    rows = [
        row(1, "gyro_bias", "x", 0.0139, 0.0004),
        row(1, "gyro_bias", "y", -0.0101, 0.0005),
        row(2, "gyro_bias", "x", 0.0056, 0.0004),
        row(2, "gyro_bias", "y", -0.0021, 0.0004),
    ]
    table = coefficients_overview(rows)
    assert "at 2 plateaus (gyros 20 to 40 °C)" in table.caption
    assert table.rows[0] == ["gyro bias", "deg/h", "-0.0101 to 0.0139", "0.0083 (x)", "0.0005"]


def test_the_overview_names_what_is_not_observable_and_states_no_change_of_one_plateau():
    rows = [
        row(1, "gyro_scale_factor", "x", nan, nan),
        row(1, "gyro_scale_factor", "y", 12.5, 0.4),
        row(1, "accelerometer_scale_factor", "x", nan, nan),
    ]
    by_name = {name.split("\n")[0]: [name, *cells] for name, *cells in coefficients_overview(rows).rows}
    assert by_name["gyro scale factor"] == [
        *("gyro scale factor\nx not observable", "ppm", "12.5", "", "0.4")
    ]
    assert by_name["accel. scale factor"] == ["accel. scale factor", "not observable"]
