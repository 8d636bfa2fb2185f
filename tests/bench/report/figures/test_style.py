import matplotlib.image
import numpy as np

from gyrobench.bench.report.figures import style


def drawn(path):
    figure = style.new_figure(2.5)
    axes = figure.add_subplot(1, 2, 1)
    axes.plot(np.linspace(0.0, 3.0, 50), np.linspace(1.0, 1.01, 50), label="a line")
    axes.set(xlabel="time / h", ylabel="bias / (deg/h)", title="A title")
    style.common_legend(figure, [axes])
    style.mark_temperatures(axes, "x", [1.5])
    style.save_figure(figure, path)
    return matplotlib.image.imread(path)


def test_pinned_matplotlib_is_one_that_the_quick_classes_are_tested_with():
    assert style._IS_TESTED


def test_another_matplotlib_draws_the_same_without_its_internals(tmp_path, monkeypatch):
    quick = drawn(tmp_path / "quick.png")
    monkeypatch.setattr(style, "_IS_TESTED", False)
    # None of the overrides may be reached: what they rely on may be gone.
    for name in (
        "_QuickAxes",
        "_QuickFigure",
        "_QuickRenderer",
        "_QuickCanvas",
        "_QuickXAxis",
        "_QuickYAxis",
        "_text_image",
    ):
        monkeypatch.delattr(style, name)
    plain = drawn(tmp_path / "plain.png")
    assert plain.shape == quick.shape
    assert np.sqrt(np.mean((plain - quick) ** 2)) < 0.05
