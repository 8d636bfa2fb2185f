"""The tests of fit as a picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes

from bench.bias.tables.dwell_table import DwellRow
from bench.report.fit_figure import fit_figure


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
    bad = replace(dwells[3], flags="the model does not fit", fit_ratio=4.0)
    shown = ratios_by_label(fit_figure([*dwells[:3], bad]).axes[0])
    assert shown["flagged"] == {4: 4.0}
    assert shown["Y-Down"] == {4: 4.0}


def test_distribution_rises_by_equal_steps_at_the_p_values(dwells: list[DwellRow]) -> None:
    tested = dwells[:6]
    curve = fit_figure(tested).axes[1].lines[-1]
    assert list(curve.get_xdata()) == [0.0, *sorted(row.fit_p_value for row in tested), 1.0]
    assert np.asarray(curve.get_ydata()) == pytest.approx([*np.arange(7) / 6, 1.0])


def test_run_without_tests_says_so(old_dwells: list[DwellRow]) -> None:
    figure = fit_figure(old_dwells)
    assert [text.get_text() for text in figure.axes[0].texts] == ["no dwell was tested"]
    assert figure.legends == []
