"""Figures: what is in them, and that equal data give equal files."""

import io
import subprocess
import sys
from dataclasses import replace
from itertools import combinations, pairwise

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.image import imread

from gyrobench.bench.bias.bins import BiasBin, bin_biases, compare_positions
from gyrobench.bench.bias.verdicts import AcceptanceLimits
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.procedure.plan import expand
from gyrobench.bench.procedure.procedure_file import load_procedure
from gyrobench.bench.procedure.timeline import position_spans
from gyrobench.bench.report.figures.bias import bias_figure, position_difference_figure, position_pair_figure
from gyrobench.bench.report.figures.style import (
    GYRO_STYLES,
    POSITION_STYLES,
    png_bytes,
    save_figure,
    save_vectors,
)
from gyrobench.bench.report.figures.temperatures import plan_figure, temperature_figure
from gyrobench.bench.report.run_report import run_figures


@pytest.fixture(scope="module")
def plan():
    return expand(*load_procedure(find_document("procedures", "six_position_fig7")))


def series(axes, labelled):
    """Error-bar series with or without an entry in the legend."""
    return [one for one in axes.containers if one.get_label().startswith("_") is not labelled]


def points(container):
    line = container.lines[0]
    return list(line.get_xdata()), list(line.get_ydata())


def texts(figure):
    return [text.get_text() for axes in figure.axes for text in axes.texts]


def legend_labels(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def test_positions_differ_without_their_colours():
    assert set(POSITION_STYLES) == set(POSITIONS)
    assert len({(style.marker, style.is_filled) for style in POSITION_STYLES.values()}) == 6
    assert len({style.colour for style in POSITION_STYLES.values()}) == 6


def test_bias_figure_joins_the_bins_of_each_position(dwells, bins):
    axes = bias_figure("y", dwells, bins).axes[0]
    lines = series(axes, labelled=True)
    assert [one.get_label() for one in lines] == ["Z-Up", "Z-Down", "Y-Up", "Y-Down", "X-Up", "X-Down"]
    mine = [each for each in bins if each.gyro == "y" and each.position == "z_up" and not each.is_empty]
    assert points(lines[0]) == ([each.temperature_c for each in mine], [1e3 * each.bias_dph for each in mine])


def test_bias_figure_shows_both_estimators_on_one_scale(dwells, bins):
    left, right = bias_figure("y", dwells, bins).axes
    assert left.get_title(loc="left") == "Y gyro, state-space estimator"
    assert right.get_title(loc="left") == "paper's method"
    assert left.get_ylim() == right.get_ylim()
    mine = [each for each in bins if each.gyro == "y" and each.position == "x_up" and not each.is_empty]
    for axes, biases in (
        (left, [each.bias_dph for each in mine]),
        (right, [each.paper_bias_dph for each in mine]),
    ):
        line = next(one for one in series(axes, labelled=True) if one.get_label() == "X-Up")
        assert points(line)[1] == pytest.approx([1e3 * bias for bias in biases])


def test_the_temperatures_of_two_panels_do_not_run_into_one_another(dwells, bins):
    figure = bias_figure("y", dwells, bins)
    left, right = figure.axes
    left.set(xlim=(32.5, 35.0), xticks=[32.5, 35.0])  # labels at both ends
    figure.draw_without_rendering()
    last, first = left.get_xticklabels()[-1], right.get_xticklabels()[0]
    assert last.get_window_extent().x1 < first.get_window_extent().x0


def test_bias_figure_without_the_papers_method_has_one_panel(old_dwells):
    (axes,) = bias_figure("y", old_dwells, bin_biases([row for row in old_dwells if not row.flags])).axes
    assert axes.get_title(loc="left") == "Y gyro"
    assert len(series(axes, labelled=True)) == 6


def test_bias_figure_shows_every_good_dwell_with_its_uncertainty(dwells, bins):
    good = [row for row in dwells if not row.flags]
    lines = bias_figure("x", dwells, bins).axes[0].lines
    faint = [line for line in lines if line.get_alpha() == 0.35]
    markers, bars = (
        [each for each in faint if (each.get_marker() == "None") is way] for way in (False, True)
    )
    shown = [value for line in markers for value in np.asarray(line.get_xdata()).tolist()]
    assert sorted(shown) == sorted(row.gyro_c[0] for row in good)
    ends = [np.asarray(line.get_ydata()).reshape(-1, 3)[:, :2] for line in bars]
    expected = [
        (1e3 * (row.bias_dph[0] - s), 1e3 * (row.bias_dph[0] + s)) for row in good for s in [row.sigma_dph[0]]
    ]
    assert np.array(sorted(map(tuple, np.concatenate(ends)))) == pytest.approx(np.array(sorted(expected)))


def test_bias_figure_marks_temperatures_inside_its_axis(dwells, bins):
    marked = texts(bias_figure("x", dwells, bins, marked_c=[50.0, 20.0]))
    assert {"50 °C", "20 °C"} <= set(marked)
    assert "50 °C" not in texts(bias_figure("x", dwells, bins))
    cold_bins = [each for each in bins if each.bin_high_c < 40.0]
    cold = bias_figure("x", [row for row in dwells if row.gyro_c[0] < 40.0], cold_bins, marked_c=[50.0])
    assert "50 °C" not in texts(cold)
    assert cold.axes[0].get_xlim()[1] < 50.0


def test_bias_figure_without_dwells_says_so():
    assert texts(bias_figure("x", [], [])) == ["no dwell gave a bias"]


def test_large_biases_are_drawn_in_degrees_per_hour(bins):
    large = [replace(each, bias_dph=each.bias_dph + 3.0) for each in bins]
    assert bias_figure("x", [], large).axes[0].get_ylabel() == "bias / (deg/h)"
    assert bias_figure("x", [], bins).axes[0].get_ylabel() == "bias / (0.001 deg/h)"


def spans_h(axes):
    """Begin and end of each bar or band."""
    paths = axes.collections[0].get_paths()
    return [(path.get_extents().x0, path.get_extents().x1) for path in paths]


def test_temperature_figure_has_a_band_and_a_bar_for_each_dwell(telemetry, dwells):
    figure = temperature_figure(telemetry, dwells)
    bands, bars = (axes.collections[0] for axes in figure.axes)
    known_h = np.array([(row.start_s, row.end_s) for row in dwells]) / 3600.0
    for axes in figure.axes:
        assert np.array(spans_h(axes)) == pytest.approx(known_h)
    colours = [to_rgba(POSITION_STYLES[row.position].colour)[:3] for row in dwells]
    assert [tuple(each[:3]) for each in bands.get_facecolor()] == colours
    assert [tuple(each[:3]) for each in bars.get_edgecolor()] == colours
    assert [each[3] for each in bars.get_facecolor()] == [0.0 if row.flags else 1.0 for row in dwells]


def test_temperature_figure_draws_what_was_recorded(telemetry):
    nan = np.full(len(telemetry["time_s"]), np.nan)
    without_boards = {**telemetry, **{f"board_{axis}_c": nan for axis in "xyz"}}
    assert len(legend_labels(temperature_figure(telemetry, []))) == 8
    figure = temperature_figure(without_boards, [], marked_c=[50.0])
    assert legend_labels(figure) == [
        "chamber, set point",
        "chamber, air",
        *(f"{gyro} gyro, optics" for gyro in "XYZ"),
    ]
    air = figure.axes[0].lines[1]
    assert np.array_equal(air.get_xdata(), telemetry["time_s"] / 3600.0)
    assert np.array_equal(air.get_ydata(), telemetry["chamber_c"])
    assert "50 °C" in texts(figure)


def test_long_runs_are_drawn_by_few_readings_with_every_spike_and_gap(telemetry):
    places = np.arange(200_000)
    long = {name: np.interp(places, 100.0 * np.arange(len(each)), each) for name, each in telemetry.items()}
    long["chamber_c"] += np.random.default_rng(1).normal(0.0, 0.3, len(places))
    air_c = long["chamber_c"]
    air_c[[123_456, 134_567]] = 90.0, -70.0
    air_c[150_010:150_050] = np.nan
    drawn = temperature_figure(long, []).axes[0].lines[1]
    time_h, drawn_c = drawn.get_xdata(), drawn.get_ydata()
    assert len(drawn_c) < 10_000
    assert np.isnan(drawn_c).sum() == 1
    edges_h = [*long["time_s"][::100] / 3600.0, np.inf]
    for part, (begin_h, end_h) in enumerate(pairwise(edges_h)):
        read_c = air_c[100 * part : 100 * (part + 1)]
        shown_c = drawn_c[(time_h >= begin_h) & (time_h < end_h)]
        assert (np.nanmin(shown_c), np.nanmax(shown_c)) == (np.nanmin(read_c), np.nanmax(read_c))
        assert (shown_c[0], shown_c[-1]) == (read_c[0], read_c[-1])


def test_temperature_figure_without_telemetry_shows_the_dwells(dwells):
    figure = temperature_figure({}, dwells)
    assert len(spans_h(figure.axes[1])) == len(dwells)
    assert texts(figure) == ["no temperatures recorded"]


def test_short_runs_are_drawn_in_minutes(telemetry):
    first = {name: values[:10] for name, values in telemetry.items()}
    figure = temperature_figure(first, [])
    assert figure.axes[-1].get_xlabel() == "time / min"
    assert figure.axes[-1].get_xlim() == (0.0, 9.0)


def test_without_dwells_there_are_no_lanes_of_positions(telemetry, dwells):
    (axes,) = temperature_figure(telemetry, []).axes
    assert axes.get_xlabel() == "time / h"
    assert len(axes.lines) > 5
    assert len(temperature_figure(telemetry, dwells).axes) == 2


def test_plan_figure_shows_every_stay_in_a_position(plan):
    figure = plan_figure(plan)
    spans = position_spans(plan)
    begins_h = [begin_h for begin_h, _ in spans_h(figure.axes[1])]
    assert begins_h == pytest.approx([start_s / 3600.0 for start_s, _, _ in spans])
    assert figure.axes[0].get_title(loc="left") == "Plan of six_position_fig7"
    assert legend_labels(figure) == ["chamber, ramped set point", "gyros, predicted"]


def test_difference_figure_fills_the_markers_of_what_differs(bins):
    comparisons = compare_positions(bins)
    axes = position_difference_figure(comparisons).axes[0]
    for one in series(axes, labelled=True):
        gyro, verdict = one.get_label().split(" gyro, ")
        colour = to_rgba(GYRO_STYLES[gyro.lower()][0])
        is_filled = to_rgba(one.lines[0].get_markerfacecolor()) == colour
        assert is_filled is (verdict == "p < 0.01")
    drawn = [value for one in series(axes, labelled=True) for value in points(one)[1]]
    assert sorted(drawn) == pytest.approx(sorted(1e3 * each.largest_difference_dph for each in comparisons))


def test_difference_figure_has_the_acceptance_limits_within_its_range(bins):
    limits = AcceptanceLimits(position_difference_dph=1.0, vertical_difference_dph=0.5)
    figure = position_difference_figure(compare_positions(bins), limits)
    assert {"acceptance limit", "with the gyro up and down"} <= set(texts(figure))
    assert figure.axes[0].get_ylim()[1] > 1e3


def test_difference_figure_without_comparisons_says_so():
    assert texts(position_difference_figure([])) == ["no bin has dwells in two positions"]


def test_equal_data_give_equal_files_regardless_of_user_settings(dwells, bins):
    first = png_bytes(bias_figure("x", dwells, bins))
    with matplotlib.rc_context({"font.size": 22.0, "savefig.dpi": 30, "axes.grid": False}):
        second = png_bytes(bias_figure("x", dwells, bins))
    assert first == second
    assert first.startswith(b"\x89PNG")
    assert b"Software" not in first
    assert b"tEXt" not in first


def pixels(figure):
    return np.asarray(imread(io.BytesIO(png_bytes(figure))))


@pytest.mark.parametrize("every", [3, pytest.param(1, marks=pytest.mark.long)])
def test_ticks_are_those_of_matplotlib(monkeypatch, telemetry, dwells, bins, every):
    figures = list(run_figures(lambda: telemetry, dwells, bins))[::every]
    drawn = {name: pixels(draw()) for name, draw in figures}
    monkeypatch.setattr("gyrobench.bench.report.figures.style._QuickFigure", Figure)
    for name, draw in figures:
        np.testing.assert_array_equal(pixels(draw()), drawn[name], name)


def test_other_data_give_another_file(dwells, bins):
    assert png_bytes(bias_figure("x", dwells, bins)) != png_bytes(bias_figure("y", dwells, bins))


def is_cut(figure):
    """Whether anything reaches beyond the edge of a figure."""
    box = figure.get_tightbbox()
    width, height = figure.get_size_inches()
    return min(box.x0, box.y0) < 0.0 or box.x1 > width or box.y1 > height


@pytest.mark.parametrize("every", [2, pytest.param(1, marks=pytest.mark.long)])
def test_figures_have_room_for_their_labels(telemetry, dwells, bins, every):
    figures = list(run_figures(lambda: telemetry, dwells, bins))[::every]
    cut = {name: is_cut(draw()) for name, draw in figures}
    wide = [replace(each, bias_dph=100.0 * each.bias_dph) for each in bins]
    for gyro in "xyz"[::every]:
        cut[gyro] = is_cut(bias_figure(gyro, dwells, wide))
    assert cut == dict.fromkeys(cut, False)


def test_there_are_figures_for_what_there_are_data_for(tmp_path, telemetry, dwells, bins):
    figures = dict(run_figures(lambda: telemetry, dwells, bins))
    biases = ["bias_x", "bias_y", "bias_z"]
    assert list(figures) == ["temperature", *biases, "position_pair", "position_differences"]
    save_figure(figures["position_pair"](), tmp_path / "pair")
    assert (tmp_path / "pair").read_bytes().startswith(b"\x89PNG")
    assert list(dict(run_figures(lambda: telemetry, [], []))) == ["temperature"]
    assert not dict(run_figures(None, [], []))
    one_position = [each for each in bins if each.position == "z_up"]
    assert list(dict(run_figures(None, [], one_position))) == biases


def test_z_up_and_y_up_stand_side_by_side_for_all_gyros(bins):
    figure = position_pair_figure(bins)
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["Z-Up", "Y-Up"]
    for axes, position in zip(figure.axes, ("z_up", "y_up"), strict=True):
        for container, gyro in zip(series(axes, labelled=True), "xyz", strict=True):
            own = [each for each in bins if (each.gyro, each.position) == (gyro, position) and each.count]
            assert points(container)[0] == [each.temperature_c for each in own]
    assert legend_labels(figure) == ["X gyro", "Y gyro", "Z gyro"]


def test_each_bar_of_several_dwells_has_their_number_and_the_legend_its_coverage_factor(bins):
    for figure, shown in (
        (position_pair_figure(bins), [each for each in bins if each.position in ("z_up", "y_up")]),
        (bias_figure("x", [], bins), 2 * [each for each in bins if each.gyro == "x"]),
    ):
        assert sorted(texts(figure)) == sorted(str(each.count) for each in shown if each.count > 1)
        [legend] = figure.legends
        assert "standard uncertainty (k = 1)" in legend.get_title().get_text()


def test_figures_are_written_as_vectors_twice_alike(tmp_path, bins):
    for folder in ("one", "other"):
        (tmp_path / folder).mkdir()
        save_vectors(position_pair_figure(bins), tmp_path / folder / "pair.png", ["svg", "pdf"])
    for name, begin in (("pair.svg", b"<?xml"), ("pair.pdf", b"%PDF")):
        written = (tmp_path / "one" / name).read_bytes()
        assert written.startswith(begin)
        assert written == (tmp_path / "other" / name).read_bytes()
    assert "Z-Up" in (tmp_path / "one" / "pair.svg").read_text()


def test_figure_that_cannot_be_written_is_a_run_folder_error(tmp_path):
    with pytest.raises(RunFolderError, match="can't be written"):
        save_figure(bias_figure("x", [], []), tmp_path / "missing" / "figure.png")


def test_global_state_of_matplotlib_is_left_alone():
    code = (
        "import sys, matplotlib\n"
        "from gyrobench.bench.report.figures.bias import bias_figure\n"
        "from gyrobench.bench.report.figures.style import png_bytes\n"
        "matplotlib.rcParams['font.size'] = 13.0\n"
        "png_bytes(bias_figure('x', [], []))\n"
        "assert matplotlib.rcParams['font.size'] == 13.0\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_numbers_at_bars_of_positions_that_coincide_do_not_overlap():
    bins = [
        BiasBin("x", each, 20.0, 30.0, 25.0, 0.002, 0.001, 12, chi2_reduced=1.0, spread_p_value=0.5)
        for each in POSITIONS
    ]
    figure = bias_figure("x", [], bins)
    figure.canvas.draw()
    numbers = [text for axes in figure.axes for text in axes.texts if text.get_text() == "12"]
    assert len(numbers) == 6
    boxes = [each.get_window_extent() for each in numbers]
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
