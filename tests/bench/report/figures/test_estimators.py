"""The difference of the two estimators as a picture."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.report.figures.estimators import differences_dph, estimators_figure, has_both_estimates


def test_every_good_dwell_shows_the_paper_minus_the_state_space_estimate(dwells: list[DwellRow]) -> None:
    figure = estimators_figure(dwells)
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["X gyro", "Y gyro", "Z gyro"]
    for axis, axes in enumerate(figure.axes):
        markers = [line for line in axes.lines if line.get_marker() != "None"]
        drawn = [value for line in markers for value in np.asarray(line.get_ydata()).tolist()]
        expected = [1e3 * (row.paper_bias_dph[axis] - row.bias_dph[axis]) for row in dwells if not row.flags]
        assert sorted(drawn) == pytest.approx(sorted(expected))


def test_bars_are_both_uncertainties_combined(dwells: list[DwellRow]) -> None:
    row = dwells[0]
    assert differences_dph(row)[1] == pytest.approx(
        (row.paper_bias_dph[1] - row.bias_dph[1], math.hypot(row.sigma_dph[1], row.paper_sigma_dph[1]))
    )


def test_dwells_with_flags_or_one_estimate_are_left_out(
    dwells: list[DwellRow], old_dwells: list[DwellRow]
) -> None:
    both = [row.dwell for row in (*dwells[:8], *old_dwells[:8]) if has_both_estimates(row)]
    assert both == [1, 2, 3, 4, 5, 6, 8]


def test_run_without_the_papers_method_says_so(old_dwells: list[DwellRow]) -> None:
    texts = [text.get_text() for axes in estimators_figure(old_dwells).axes for text in axes.texts]
    assert texts == ["the paper's method gave no bias"]
