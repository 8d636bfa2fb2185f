import math

import pytest

from gyrobench.bench.monitor.terminal_plot import Canvas, PlotCurve, plot


def drawn(canvas):
    return [row.plain for row in canvas.rows()]


def test_a_line_from_corner_to_corner_fills_the_diagonal():
    canvas = Canvas(4, 4)
    canvas.line([(0.0, 0.0), (1.0, 1.0)])
    rows = drawn(canvas)
    assert all(rows[3 - cell][cell] != " " for cell in range(4))
    assert sum(letter != " " for row in rows for letter in row) <= 8


@pytest.mark.parametrize("gap", [(math.nan, 0.5), (0.5, math.nan), (0.5, 1.5)])
def test_a_point_that_is_not_known_or_outside_breaks_the_line(gap):
    canvas = Canvas(20, 1)
    canvas.line([(0.0, 0.5), (0.3, 0.5), gap, (0.7, 0.5), (1.0, 0.5)])
    (row,) = drawn(canvas)
    assert row[0] != " "
    assert row[-1] != " "
    assert row[8:12] == "    "


def test_a_dotted_line_is_thinner_than_a_whole_one():
    def dots(every):
        canvas = Canvas(30, 1)
        canvas.line([(0.0, 0.5), (1.0, 0.5)], every=every)
        return sum(bin(ord(letter) & 0xFF).count("1") for letter in drawn(canvas)[0] if letter != " ")

    assert dots(1) == 60
    assert dots(3) == 20


def test_letters_stand_above_lines():
    canvas = Canvas(3, 1)
    canvas.letter((0.5, 0.5), "x")
    canvas.line([(0.0, 0.5), (1.0, 0.5)])
    assert drawn(canvas)[0][1] == "x"


@pytest.mark.parametrize("is_ascii", [True, False])
def test_a_plot_fills_its_rectangle_and_names_its_ends(is_ascii):
    curve = PlotCurve([0.0, 50.0, 100.0], [-3.0, 1.0, 7.0], "cyan", "c")
    lines = [line.plain for line in plot([curve], 40, 8, (0.0, 100.0), ("0", "100 s"), 1.0, is_ascii)]
    assert len(lines) == 8
    assert {len(line) for line in lines} == {40}
    assert lines[0].strip().startswith("8")
    assert lines[-2].strip().startswith("-4")
    assert lines[-1].split() == ["0", "100", "s"]
    assert any("c" in line for line in lines[:3])
    assert all(line.isascii() for line in lines) == is_ascii


@pytest.mark.parametrize("values", [[], [math.nan], [2.0], [2.0, 2.0], [0.0], [1e-12, -1e-12], [1e6, -1e6]])
def test_any_values_give_a_plot(values):
    curve = PlotCurve(list(range(len(values))), values, "cyan", "c")
    lines = plot([curve], 30, 6, (0.0, 2.0), ("0", "2"), 0.5, False)
    assert len(lines) == 6
    assert {len(line.plain) for line in lines} == {30}


def test_what_changes_little_is_not_blown_up():
    curve = PlotCurve([0.0, 1.0], [20.0, 20.01], "cyan")
    lines = [line.plain for line in plot([curve], 30, 6, (0.0, 1.0), ("0", "1"), 4.0, True)]
    assert float(lines[0].split("|")[0]) - float(lines[-2].split("|")[0]) >= 4.0
