"""The page, the file and the terminal say the same of a batch."""

import io
import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from rich.console import Console

from gyrobench.bench.fleet.batch import fit_batch
from gyrobench.bench.fleet.batch_report import batch_figure, batch_summary, write_batch
from gyrobench.bench.report.terminal.tables import section_view
from gyrobench.bench.runs.index.run_biases import LEVEL
from gyrobench.bench.runs.index.run_index import watermark
from tests.bench.fleet.test_batch import POSITIONS, batch


@pytest.fixture(scope="module")
def fitted():
    values = batch(np.random.default_rng(3), names=(LEVEL, *POSITIONS), outlier=("z", "x_up", 0.03))
    return fit_batch(values)


def test_page_and_file_name_the_outlier(fitted, tmp_path):
    page = write_batch(tmp_path / "batch", "B7", fitted, "30 runs", "").read_text()
    assert "<h1>Batch B7</h1>" in page
    assert "1 outlier in 10 units" in page
    assert "Z gyro at 20 to 25 °C, X-Up minus the mean" in page
    content = json.loads((tmp_path / "batch" / "batch.json").read_text())
    assert [each["unit"] for each in content["standing_out"]] == ["0"]
    assert content["simulated"] is False
    assert len(content["quantities"]) == 12
    names = sorted(path.name for path in (tmp_path / "batch" / "figures").iterdir())
    assert names == ["batch_levels.png", "batch_positions.png"]


def test_a_batch_of_emulated_runs_is_marked(fitted, tmp_path):
    page = write_batch(
        tmp_path / "batch", "B7", fitted, "30 runs", watermark([{"world": "a"}, {"world": ""}])
    )
    assert 'data-word="SIMULATED"' in page.read_text()
    assert json.loads((tmp_path / "batch" / "batch.json").read_text())["simulated"] is True
    assert watermark([{"world": ""}]) == ""


def test_labels_of_bins_do_not_overlap_and_the_legend_is_inside_without_repeats(fitted):
    ten_bins = [
        replace(each, quantity=replace(each.quantity, bin_low_c=low_c, bin_high_c=low_c + 5))
        for low_c in range(-25, 75, 10)
        for each in fitted
    ]
    for of_positions in (False, True):
        figure = batch_figure(ten_bins, of_positions=of_positions)
        figure.draw_without_rendering()
        for panel in figure.axes:
            for is_minor in (False, True):
                labels = [each.get_window_extent() for each in panel.get_xticklabels(minor=is_minor)]
                assert not any(one.x1 > other.x0 for one, other in pairwise(labels))
        [legend] = figure.legends
        texts = [text.get_text() for text in legend.texts]
        assert sorted(set(texts)) == sorted(texts)
        box = legend.get_window_extent()
        assert figure.bbox.contains(box.x0, box.y0)
        assert figure.bbox.contains(box.x1, box.y1)


def test_the_terminal_needs_80_columns_and_no_colour(fitted):
    console = Console(width=80, no_color=True, file=io.StringIO())
    console.print(section_view(batch_summary("B7", fitted)))
    text = console.file.getvalue()
    assert max(map(len, text.splitlines())) <= 80
    assert "1 outlying unit: unit 0 in Z gyro at 20 to 25 °C, X-Up" in text.replace("\n", " ")


def test_a_batch_without_outliers_says_so(tmp_path):
    page = write_batch(tmp_path, "", fit_batch(batch(np.random.default_rng(8))), "30 runs", "").read_text()
    assert "No outlier in 10 units" in page
    assert "No outlying unit" in page
