"""The pages of the monitor by address: one run, or a folder of runs and each of them."""

from __future__ import annotations

import math
import secrets
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from functools import cache
from http import HTTPStatus
from pathlib import Path
from urllib.parse import quote, unquote, urlsplit

from jinja2 import Environment, PackageLoader, StrictUndefined

from gyrobench.bench.foundations.errors import GyrobenchError, RunFolderError
from gyrobench.bench.foundations.reading import read_limited
from gyrobench.bench.monitor.attitude_drawing import axes_drawing
from gyrobench.bench.monitor.charts import bias_charts, profile_chart, window_charts
from gyrobench.bench.monitor.page_content import (
    ListRow,
    News,
    bin_tables,
    headline,
    list_row,
    news_of,
    reading_rows,
    shown_dwells,
    unreadable_row,
)
from gyrobench.bench.monitor.run_list import (
    FolderMemory,
    is_run,
    picture_of,
    records_of,
    runs_in,
    signature_of,
    summarise,
)
from gyrobench.bench.monitor.server import HTML, RECORD_POLICY, Answer, page_policy, refusal
from gyrobench.bench.monitor.snapshot import Attitude, Picture
from gyrobench.bench.navigation.positions import POSITIONS, position_label
from gyrobench.bench.procedure.timeline import hours_minutes
from gyrobench.bench.report.wording import true_minus


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


_MOST_LISTED = 200
_MOST_PICTURES = 8
_MOST_RECORD_BYTES = 50_000_000
_FRAGMENT = "fragment"
_HOME = "../../"


class Site:
    """Answers requests for pages of a run folder, or of a folder of runs.

    Parameters
    ----------
    root : Path
        The folder. It is looked at anew at each request, so a run may begin in it later.
    utc : callable
        Gives the host's calendar time.
    """

    def __init__(self, root: Path, utc: Callable[[], datetime]) -> None:
        self._root = root
        self._utc = utc
        self._pictures = FolderMemory(picture_of, signature_of, _MOST_PICTURES)
        self._summaries = FolderMemory(summarise, signature_of, _MOST_LISTED)

    def answer(self, target: str) -> Answer:
        """Answer a request.

        Parameters
        ----------
        target : str
            Address without the server's name: ``/``, ``/runs/mine/``, ``/runs/mine/report.html``.
        """
        try:
            path = unquote(urlsplit(target).path, errors="strict")
        except ValueError:
            return refusal(HTTPStatus.BAD_REQUEST, "This is no address.")
        if is_run(self._root):
            return self._of_run(self._root, path.removeprefix("/"), "")
        if path in ("/", f"/{_FRAGMENT}"):
            return _page_or_fragment(self._list(), path.removeprefix("/"))
        return self._of_listed(path)

    def _of_listed(self, path: str) -> Answer:
        match path.split("/", maxsplit=3):
            case ["", "runs", name, rest]:
                run = next((run for run in self._runs() if run.name == name), None)
                if run is not None:
                    return self._of_run(run, rest, _HOME)
            case ["", "runs", name] if name:
                return refusal(
                    HTTPStatus.PERMANENT_REDIRECT, "See there.", Location=f"/runs/{quote(name, safe='')}/"
                )
        return _not_found()

    def _runs(self) -> list[Path]:
        try:
            return runs_in(self._root)
        except RunFolderError:
            return []

    def _of_run(self, run: Path, rest: str, home: str) -> Answer:
        if rest in ("", _FRAGMENT):
            return _page_or_fragment(self._run(run, home), rest)
        if rest in records_of(run):
            return _record(run / rest)
        return _not_found()

    def _run(self, run: Path, home: str) -> str:
        try:
            picture = self._pictures.of(run)
        except GyrobenchError as error:
            return problem_fragment(run.absolute().name, str(error), home)
        news = news_of(picture.state, picture.updated_utc, self._utc())
        return run_fragment(picture, news, records_of(run), home)

    def _list(self) -> str:
        try:
            runs = runs_in(self._root)
        except RunFolderError as error:
            return problem_fragment("Runs", str(error), "")
        rows = [self._row(run) for run in runs[:_MOST_LISTED]]
        return list_fragment(str(self._root), rows, max(0, len(runs) - _MOST_LISTED))

    def _row(self, run: Path) -> ListRow:
        try:
            summary = self._summaries.of(run)
        except GyrobenchError as error:
            return unreadable_row(run.name, str(error))
        return list_row(summary, news_of(summary.state, summary.updated_utc, self._utc()))


def _page_or_fragment(fragment: str, what: str) -> Answer:
    if what == _FRAGMENT:
        return Answer(HTTPStatus.OK, fragment.encode())
    nonce = secrets.token_urlsafe(16)
    return Answer(HTTPStatus.OK, whole_page(fragment, nonce).encode(), HTML, page_policy(nonce))


def _record(path: Path) -> Answer:
    try:
        return Answer(
            HTTPStatus.OK, read_limited(path, _MOST_RECORD_BYTES, RunFolderError), HTML, RECORD_POLICY
        )
    except RunFolderError as error:
        return refusal(HTTPStatus.SERVICE_UNAVAILABLE, str(error))


def _not_found() -> Answer:
    return refusal(HTTPStatus.NOT_FOUND, "There is no such page.")
