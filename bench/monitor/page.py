"""The pages of the monitor as HTML, drawn from pictures of runs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache

from jinja2 import Environment, PackageLoader, StrictUndefined

from gyrobench.bench.live.picture import Picture
from gyrobench.bench.live.picture_parts import Attitude
from gyrobench.bench.monitor.axes_drawing import axes_drawing
from gyrobench.bench.monitor.dwell_charts import bias_charts, window_charts
from gyrobench.bench.monitor.headline import headline
from gyrobench.bench.monitor.list_rows import ListRow
from gyrobench.bench.monitor.news import News
from gyrobench.bench.monitor.profile_chart import profile_chart
from gyrobench.bench.monitor.rows import bin_tables, reading_rows, shown_dwells
from gyrobench.bench.navigation.positions import POSITIONS, position_label
from gyrobench.bench.procedure.timeline import hours_minutes
from gyrobench.bench.report.number_format import true_minus


def run_fragment(picture: Picture, news: News, records: Mapping[str, str], home: str) -> str:
    """Draw a run: the content of its page, which the page itself asks for anew.

    Parameters
    ----------
    picture : Picture
        The run.
    news : News
        How fresh the picture is.
    records : mapping
        Addresses and titles of pages that the run has left.
    home : str
        Address of the list of runs; empty where there is none.
    """
    dwell = picture.dwell
    return _filled(
        "run.html.j2",
        title=_title(picture, news),
        picture=picture,
        news=news,
        records=records,
        home=home,
        top=headline(picture),
        step_label=_step_label(picture),
        profile=profile_chart(picture),
        axes=axes_drawing(picture.attitude) if picture.attitude else None,
        azimuth=_azimuth(picture.attitude),
        readings=reading_rows(picture.bench) if picture.bench else [],
        windows=window_charts(dwell) if dwell else [],
        biases=bias_charts(dwell) if dwell else [],
        bins=bin_tables(picture.bins),
        dwells=shown_dwells(picture.dwells),
    )


def list_fragment(folder: str, rows: Sequence[ListRow], left_out: int) -> str:
    """Draw the list of the runs of a folder, ``left_out`` of which are not in ``rows``."""
    return _filled("runs.html.j2", title="Runs", folder=folder, rows=rows, left_out=left_out)


def problem_fragment(title: str, problem: str, home: str) -> str:
    """Say why there is nothing to draw."""
    return _filled("problem.html.j2", title=title, problem=problem, home=home)


def whole_page(fragment: str, nonce: str) -> str:
    """Put style and script around a fragment."""
    return _filled("page.html.j2", fragment=fragment, nonce=nonce)


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("gyrobench.bench.monitor"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["position"] = position_label
    environment.filters["hours"] = hours_minutes
    return environment


def _filled(template: str, **content: object) -> str:
    return _environment().get_template(template).render(**content)


def _title(picture: Picture, news: News) -> str:
    """Title of the browser's tab: what matters most comes first."""
    if news.warning:
        return f"▲ silent: {picture.name}"
    if picture.alarms and not news.is_over:
        return f"▲ ALARM: {picture.name}"
    left = "" if news.is_over else f", {hours_minutes(picture.left_s)} h left"
    return f"{picture.state.value}{left}: {picture.name}"


def _step_label(picture: Picture) -> str:
    """Where the step is, with positions as people write them."""
    if picture.step is None:
        return ""
    parts = picture.step.label.split(", ")
    return ", ".join(position_label(part) if part in POSITIONS else part for part in parts)


def _azimuth(attitude: Attitude | None) -> str:
    if attitude is None or math.isnan(attitude.azimuth_deg):
        return ""
    return true_minus(f"{attitude.azimuth_deg:zg}°")
