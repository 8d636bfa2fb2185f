"""Style of the figures: size, colours, markers; PNG files."""

from __future__ import annotations

import copy
import io
import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import matplotlib.style
import numpy as np
from isal import isal_zlib
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis, Tick, XAxis, YAxis
from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg, get_hinting_flag
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, fontManager, get_font

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.files import write_whole

#: Width of all figures, inch: the text of an A4 page.
WIDTH_IN = 7.2
_PNG_DPI = 160
_INCH_M = 0.0254
_POINTS_PER_INCH, _LEGEND_PT = 72.0, 8
_CHARACTER_WIDTH = 0.58  # mean width of a character relative to the font size
LEGEND_ROW_IN = 1.75 * _LEGEND_PT / _POINTS_PER_INCH  #: Height of a row of a legend, inch.
_LEGEND_KEY_IN = 0.53  # width of a legend column without its text: its line, and the space to the next column
#: Name of the text entry of a PNG file that holds the key; it is within the first bytes of the file.
_PNG_KEY_NAME, _PNG_HEAD_BYTES = "Inputs", 1000

#: The quick classes below override internals of matplotlib and are tested with this version. With any other
#: version, the classes of matplotlib draw the same figures more slowly.
_IS_TESTED = matplotlib.__version_info__[:2] == (3, 11)

_TEXT_CACHE_SIZE = 300  # number of cached images of text lines, some kB each
_STRIP_ROWS = 64  # rows of pixels compressed at once
_SUBPIXELS_PER_PIXEL = 64  # fonts state sizes in this fraction of a pixel

#: Legend titles of figures whose bars are uncertainties.
BARS, BARS_SHORT = "bars: standard uncertainty (k = 1)", "bars: k = 1"

#: Decorator of drawing functions: makes figures independent of matplotlibrc and other code.
house_style = matplotlib.style.context(
    [
        "default",
        {
            "figure.dpi": 100,
            "font.size": 9,
            "axes.titlesize": 11,
            "axes.titleweight": "bold",
            "axes.titlelocation": "left",
            "axes.titley": 1.0,  # fixed, else matplotlib searches for ticks at the top each time
            "axes.grid": True,
            "axes.axisbelow": True,
            "grid.color": "#dddddd",
            "grid.linewidth": 0.6,
            "axes.edgecolor": "#666666",
            "axes.spines.top": False,
            "axes.spines.right": False,
            "legend.frameon": False,
            "legend.fontsize": _LEGEND_PT,
            "lines.linewidth": 1.2,
        },
    ]
)


@dataclass(frozen=True)
class PositionStyle:
    """Style of a position; marker and fill distinguish it without colour."""

    colour: str
    marker: str
    is_filled: bool

    @property
    def line(self) -> str:
        """Line style."""
        return "-" if self.is_filled else "--"

    @property
    def face(self) -> str:
        """Colour inside the marker."""
        return self.colour if self.is_filled else "white"

    @property
    def points(self) -> dict[str, Any]:
        """Options of matplotlib for points."""
        return {"color": self.colour, "marker": self.marker, "markerfacecolor": self.face}


#: Colours of Okabe and Ito; the marker shows which axis is vertical, filled if it points up.
POSITION_STYLES: Mapping[str, PositionStyle] = MappingProxyType(
    {
        "z_up": PositionStyle("#0072B2", "o", True),
        "z_down": PositionStyle("#56B4E9", "o", False),
        "y_up": PositionStyle("#D55E00", "^", True),
        "y_down": PositionStyle("#E69F00", "^", False),
        "x_up": PositionStyle("#009E73", "s", True),
        "x_down": PositionStyle("#CC79A7", "s", False),
    }
)

#: Colour, line and marker of each gyro in figures with several gyros.
GYRO_STYLES: Mapping[str, tuple[str, str, str]] = MappingProxyType(
    {"x": ("#882255", "-", "o"), "y": ("#332288", "--", "^"), "z": ("#117733", "-.", "s")}
)


class _UniformTicks(Axis):
    """Axis whose ticks are copies of the first one with separate labels; all tick lines are drawn at once."""

    axis_name: str
    _drawn_ticks: list[Tick] | None = None  # while it is drawn; spine and label would ask for them again

    def _update_ticks(self) -> list[Tick]:
        ticks: list[Tick] = self._drawn_ticks or super()._update_ticks()  # type: ignore[misc]
        return ticks

    def _get_tick(self, major: bool) -> Tick:
        existing_ticks = vars(self).get("majorTicks" if major else "minorTicks")
        tick: Tick
        if not existing_ticks:
            tick = super()._get_tick(major)  # type: ignore[misc]
            if not major:
                tick.set_clip_path(self.axes.patch)  # as the axis does for existing ticks
            return tick
        tick = copy.copy(existing_ticks[0])
        tick.label1, tick.label2 = copy.copy(tick.label1), copy.copy(tick.label2)
        for label in (tick.label1, tick.label2):
            label.set_fontproperties(label.get_fontproperties())  # a copy
        return tick

    def _copy_tick_props(self, src: Tick, dest: Tick) -> None:
        """Do nothing: all ticks are equal."""

    def draw(self, renderer: Any) -> None:
        if not self.get_visible():
            return
        self._drawn_ticks = ticks = self._update_ticks()
        for tick_group in (self.majorTicks, self.minorTicks):
            if locations := [tick.get_loc() for tick in ticks if tick in tick_group]:
                template = tick_group[0]
                for line, extent in (
                    (template.gridline, (0.0, 1.0, math.nan)),
                    (template.tick1line, (0.0,)),
                    (template.tick2line, (1.0,)),
                ):
                    data = np.repeat(locations, len(extent)), np.tile(extent, len(locations))
                    line.set_data(*(data if self.axis_name == "x" else reversed(data)))
                    line.draw(renderer)
        for tick in ticks:
            tick.label1.draw(renderer)
            tick.label2.draw(renderer)
        if self.label.get_text():
            self._update_label_position(renderer)  # type: ignore[attr-defined]
            self.label.draw(renderer)
        if offset := self.get_major_formatter().get_offset():
            self._update_offset_text_position(*self._get_tick_boxes_siblings(renderer))  # type: ignore[attr-defined]
            self.offsetText.set_text(offset)
            self.offsetText.draw(renderer)
        self._drawn_ticks = None


class _QuickXAxis(_UniformTicks, XAxis):
    pass


class _QuickYAxis(_UniformTicks, YAxis):
    pass


class _QuickAxes(Axes):
    def _init_axis(self) -> None:
        self.xaxis, self.yaxis = _QuickXAxis(self, clear=False), _QuickYAxis(self, clear=False)
        for axis, spines in ((self.xaxis, ("bottom", "top")), (self.yaxis, ("left", "right"))):
            for name in spines:
                self.spines[name].register_axis(axis)


@lru_cache(_TEXT_CACHE_SIZE)
def _text_image(text: str, font_properties: FontProperties, dpi: float) -> tuple[Any, ...]:
    """Width, height and descent of a line of text, its image and the left and lower offset, in pixels."""
    font = get_font(fontManager._find_fonts_by_props(font_properties))  # noqa: SLF001
    font.clear()
    font.set_size(font_properties.get_size_in_points(), dpi)
    font.set_text(text, 0.0, flags=get_hinting_flag())  # type: ignore[no-untyped-call]
    font.draw_glyphs_to_bitmap(antialiased=True)
    sizes = (*font.get_width_height(), font.get_descent(), *font.get_bitmap_offset())
    width, height, descent, left, low = (each / _SUBPIXELS_PER_PIXEL for each in sizes)
    return width, height, descent, font.get_image().copy(), left, low


class _QuickRenderer(RendererAgg):
    """Renderer that caches images of texts: many figures have the same axis and tick labels."""

    def get_text_width_height_descent(self, s: str, prop: FontProperties, ismath: Any) -> Any:
        if ismath:
            return super().get_text_width_height_descent(s, prop, ismath)  # type: ignore[no-untyped-call]
        return _text_image(s, prop, self.dpi)[:3]

    def draw_text(
        self,
        gc: Any,
        x: float,
        y: float,
        s: str,
        prop: Any,
        angle: float,
        ismath: Any = False,
        mtext: Any = None,
    ) -> None:
        if ismath:
            super().draw_text(gc, x, y, s, prop, angle, ismath, mtext)  # type: ignore[no-untyped-call]
            return
        _, _, descent, image, left, low = _text_image(s, prop.copy(), self.dpi)
        turn = math.radians(angle)
        x, y = round(x + left + descent * math.sin(turn)), round(y + low + descent * math.cos(turn))
        self._renderer.draw_text_image(image, x, y + 1, angle, gc)


class _QuickCanvas(FigureCanvasAgg):
    renderer: RendererAgg | None = None

    def get_renderer(self) -> RendererAgg:
        size = *self.get_width_height(physical=True), self.figure.dpi
        if self.renderer is None or size != (self.renderer.width, self.renderer.height, self.renderer.dpi):
            self.renderer = _QuickRenderer(*size)  # type: ignore[no-untyped-call]
        return self.renderer


class _QuickFigure(Figure):
    """Figure whose axes create their ticks quickly."""

    def add_subplot(self, *position: Any, **options: Any) -> Any:
        return super().add_subplot(*position, axes_class=_QuickAxes, **options)


def new_figure(
    height_in: float,
    *,
    left_in: float = 0.7,
    right_in: float = 0.12,
    bottom_in: float = 0.47,
    top_in: float = 0.3,
    wspace: float = 0.06,
    hspace: float = 0.25,
) -> Figure:
    """Create an empty figure with fixed margins, drawn without a display.

    Computing margins takes longer than drawing a figure. The default margins have room for a title, tick
    labels and both axis labels. ``wspace`` and ``hspace`` between panels are relative to the panel size.
    """
    figure = _empty_figure(height_in)
    figure.subplots_adjust(
        left_in / WIDTH_IN,
        bottom_in / height_in,
        1.0 - right_in / WIDTH_IN,
        1.0 - top_in / height_in,
        wspace,
        hspace,
    )
    return figure


def fitted_figure(height_in: float) -> Figure:
    """Create an empty figure whose margins are computed from its texts when it is drawn."""
    return _empty_figure(height_in, layout="constrained")


def _empty_figure(height_in: float, **options: Any) -> Figure:
    figure = (_QuickFigure if _IS_TESTED else Figure)(figsize=(WIDTH_IN, height_in), **options)
    _canvas_of(figure)
    return figure


def _canvas_of(figure: Figure) -> FigureCanvasAgg:
    """Create a canvas and attach it to the figure."""
    return (_QuickCanvas if _IS_TESTED else FigureCanvasAgg)(figure)


def text_width_in(texts: Iterable[str], size: float) -> float:
    """Upper estimate of the width, inch, of the longest line of texts in a font of ``size`` points."""
    lines = (line for text in texts for line in text.splitlines())
    return _CHARACTER_WIDTH * size / _POINTS_PER_INCH * max(map(len, lines), default=0)


def label_empty(axes: Axes, message: str) -> None:
    """Write into empty axes why they are empty."""
    axes.text(0.5, 0.5, message, transform=axes.transAxes, ha="center", va="center", color="#666666")


def draw_points(
    axes: Axes,
    x: FloatArray,
    y: FloatArray,
    sigma: FloatArray,
    alpha: float,
    bar_alpha: float,
    *,
    color: str,
    **markers: Any,
) -> None:
    """Draw many points with their uncertainties.

    All bars are one line with gaps, which is faster than one object for each as in matplotlib's error bars.
    """
    ends = np.stack([y - sigma, y + sigma, np.full(len(y), np.nan)], axis=1)
    axes.plot(np.repeat(x, 3), ends.ravel(), color=color, linewidth=0.7, alpha=bar_alpha)
    axes.plot(x, y, linestyle="none", color=color, alpha=alpha, **markers)


def common_legend(
    figure: Figure,
    panels: Iterable[Axes],
    side: Literal["lower center", "upper center"] = "lower center",
    ncols: int = 0,
    title: str = "",
) -> None:
    """Draw one legend for several panels with each label once, by default in one row if it fits.

    The lower or upper margin grows by its height. Without labels nothing is drawn. ``title``: line above the
    labels.
    """
    handles: dict[str, Artist] = {}
    for panel in panels:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if not handles:
        return
    max_columns = int(WIDTH_IN / (_LEGEND_KEY_IN + text_width_in(handles, _LEGEND_PT)))
    ncols = max(min(ncols or len(handles), max_columns), 1)
    if figure.get_layout_engine():
        side = f"outside {side}"  # type: ignore[assignment]
    else:
        rows = math.ceil(len(handles) / ncols) + bool(title)
        legend_height = (0.5 + rows) * LEGEND_ROW_IN / figure.get_figheight()
        margins = figure.subplotpars
        figure.subplots_adjust(
            **{"bottom": margins.bottom + legend_height}
            if side == "lower center"
            else {"top": margins.top - legend_height}
        )
    figure.legend(
        handles.values(), handles, loc=side, ncols=ncols, title=title or None, title_fontsize=_LEGEND_PT
    )


def mark_temperatures(axes: Axes, axis_name: Literal["x", "y"], marked_c: Sequence[float]) -> None:
    """Draw lines at those temperatures in degC that lie within the limits of a temperature axis."""
    is_x = axis_name == "x"
    low, high = axes.get_xlim() if is_x else axes.get_ylim()
    for temperature_c in (each for each in marked_c if low < each < high):
        line = (axes.axvline if is_x else axes.axhline)(temperature_c)
        line.set(color="#444444", linewidth=0.9, linestyle=(0, (6, 3)), zorder=1.5)
        axes.annotate(
            f"{temperature_c:g} °C",
            (temperature_c, 1.0) if is_x else (1.0, temperature_c),
            (2, -8) if is_x else (-2, 2),
            xycoords=axes.get_xaxis_transform() if is_x else axes.get_yaxis_transform(),
            textcoords="offset points",
            horizontalalignment="left" if is_x else "right",
            color="#444444",
            fontsize=7,
        )


@house_style
def png_bytes(figure: Figure, key: str = "") -> bytes:
    """Draw a figure as PNG; equal figures give equal pixels. The key is stored, see :func:`is_up_to_date`."""
    dpi = figure.dpi
    figure.set_dpi(_PNG_DPI)
    renderer: RendererAgg = _canvas_of(figure).get_renderer()  # type: ignore[no-untyped-call]
    figure.draw(renderer)  # unlike savefig, which draws everything twice
    figure.set_dpi(dpi)
    # Takes a fifth of the time of PIL, which searches for the best filter of each row.
    pixels = np.asarray(renderer.buffer_rgba())[:, :, :3]  # type: ignore[no-untyped-call]
    height, width, _ = pixels.shape
    compressor = isal_zlib.compressobj(1)
    data = []
    for strip in np.array_split(pixels, math.ceil(height / _STRIP_ROWS)):  # strips, to save memory
        rows = np.zeros((len(strip), 1 + 3 * width), np.uint8)  # each row starts with 0: no filter
        rows[:, 1:].reshape(strip.shape)[:] = strip  # without a copy
        data.append(compressor.compress(rows.data))
    data.append(compressor.flush())
    dots_per_m, text = round(_PNG_DPI / _INCH_M), f"{_PNG_KEY_NAME}\0{key}"
    chunks = [
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)),  # 8 bits of red, green and blue
        *([(b"tEXt", text.encode())] if key else []),
        (b"pHYs", struct.pack(">IIB", dots_per_m, dots_per_m, 1)),
        (b"IDAT", b"".join(data)),
        (b"IEND", b""),
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", isal_zlib.crc32(kind + data))
        for kind, data in chunks
    )


def draw_watermark(figure: Figure, word: str) -> None:
    """Write a word across a figure; an empty word writes nothing."""
    if word:
        style: Mapping[str, Any] = {"size": 44, "weight": "bold", "color": "#b3261e", "alpha": 0.16}
        figure.text(0.5, 0.5, word, rotation=20, ha="center", va="center", **style)


@house_style
def save_vectors(figure: Figure, path: Path, formats: Iterable[str]) -> None:
    """Write a figure as vector graphics, ``svg`` or ``pdf``, into files beside ``path`` with the same stem.

    Equal figures give equal files. Raises RunFolderError if a file can't be written.
    """
    for name in formats:
        buffer = io.BytesIO()
        without_date = {"Date": None} if name == "svg" else {"CreationDate": None}
        with matplotlib.rc_context({"svg.hashsalt": path.stem, "svg.fonttype": "none", "pdf.fonttype": 42}):
            figure.savefig(buffer, format=name, metadata=without_date)
        write_whole(path.with_suffix(f".{name}"), buffer.getvalue())


def save_figure(figure: Figure, path: Path, key: str = "") -> None:
    """Write a figure as a PNG file. Raises RunFolderError if the file can't be written."""
    write_whole(path, png_bytes(figure, key))


def is_up_to_date(path: Path, key: str) -> bool:
    """Whether a PNG file was saved with this key, a hash of what the figure shows."""
    if not key or not path.is_file():
        return False
    with path.open("rb") as png:
        return f"{_PNG_KEY_NAME}\0{key}".encode() in png.read(_PNG_HEAD_BYTES)
