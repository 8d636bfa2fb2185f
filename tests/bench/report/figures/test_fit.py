"""The tests of fit as a picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.statistics import uniformity_p_value
from gyrobench.bench.report.figures.estimators import fit_figure, has_distribution
from gyrobench.bench.report.figures.style import png_bytes
from gyrobench.bench.report.run_text import POSITION_SIGNIFICANCE


def ratios_by_label(axes: Axes) -> dict[str, dict[float, float]]:
    return {
        str(line.get_label()): dict(zip(line.get_xdata(), line.get_ydata(), strict=True))
        for line in axes.lines
        if not str(line.get_label()).startswith("_")
    }


def test_ratio_of_every_tested_dwell_is_drawn_in_the_style_of_its_position(dwells: list[DwellRow]) -> None:
    shown = ratios_by_label(fit_figure(dwells).axes[0])
    assert list(shown) == ["Z-Up", "Z-Down", "Y-Up", "Y-Down", "X-Up", "X-Down"]
    assert shown["X-Up"] == {row.dwell: row.fit_ratio for row in dwells if row.position == "x_up"}
    assert 7 not in shown["Z-Up"]  # flagged, and not tested


def test_tested_dwell_with_a_flag_is_crossed_out(dwells: list[DwellRow]) -> None:
    bad = replace(dwells[3], flags=("the model does not fit",), fit_ratio=4.0)
    shown = ratios_by_label(fit_figure([*dwells[:3], bad]).axes[0])
    assert shown["flagged"] == {4: 4.0}
    assert shown["Y-Down"] == {4: 4.0}


def test_distribution_rises_by_equal_steps_at_the_p_values(dwells: list[DwellRow]) -> None:
    tested = dwells[:6]
    curve = fit_figure(tested).axes[1].lines[-1]
    assert list(curve.get_xdata()) == [0.0, *sorted(row.fit_p_value for row in tested), 1.0]
    assert np.asarray(curve.get_ydata()) == pytest.approx([*np.arange(7) / 6, 1.0])


def test_band_ends_where_the_test_of_the_text_rejects(dwells: list[DwellRow]) -> None:
    axes = fit_figure(dwells[:6]).axes[1]
    band = float(axes.collections[0].get_paths()[0].vertices[:, 1].max()) - 1.0
    # Six p-values whose distribution is nowhere below uniform, and above it by the band at most.
    at_the_edge = [max((number + 1) / 6 - band, 0.0) for number in range(6)]
    assert uniformity_p_value(at_the_edge) == pytest.approx(POSITION_SIGNIFICANCE, rel=1e-6)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_few_dwells_have_whole_numbers_a_wide_range_and_no_distribution(
    dwells: list[DwellRow], count: int
) -> None:
    figure = fit_figure(dwells[:count])
    png_bytes(figure)
    (axes,) = figure.axes
    low, high = axes.get_ylim()
    assert low <= 0.8
    assert high >= 1.2
    assert all(float(tick).is_integer() for tick in axes.get_xticks())
    assert not has_distribution(dwells[:count])
    assert has_distribution(dwells[:5])


def test_ratios_far_from_one_are_all_in_the_picture(dwells: list[DwellRow]) -> None:
    low, high = fit_figure([*dwells[:3], replace(dwells[3], fit_ratio=4.0)]).axes[0].get_ylim()
    assert low < 0.8
    assert high > 4.0


def test_run_without_tests_says_so(old_dwells: list[DwellRow]) -> None:
    figure = fit_figure(old_dwells)
    assert [text.get_text() for text in figure.axes[0].texts] == ["no dwell tested"]
    assert figure.legends == []
