"""The pages of the monitor by address: one run, or a folder of runs and each of them."""

from __future__ import annotations

import contextlib
import math
import secrets
from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import datetime
from functools import cache
from http import HTTPStatus
from pathlib import Path
from urllib.parse import quote, unquote, urlsplit

from jinja2 import Environment

from gyrobench.bench.foundations.errors import GyrobenchError, MissingPackageError, RunFolderError
from gyrobench.bench.foundations.files import read_limited
from gyrobench.bench.foundations.text import hours_minutes
from gyrobench.bench.monitor.attitude_drawing import axes_drawing
from gyrobench.bench.monitor.charts import bias_charts, profile_chart, temperature_charts, window_charts
from gyrobench.bench.monitor.metrics import CONTENT_TYPE as METRICS_TYPE
from gyrobench.bench.monitor.metrics import metrics_text
from gyrobench.bench.monitor.page_content import (
    Freshness,
    ListRow,
    bin_tables,
    dwell_table,
    freshness_of,
    headline,
    list_row,
    reading_rows,
    unreadable_row,
)
from gyrobench.bench.monitor.run_list import (
    cached_by_files,
    is_run,
    pages_of,
    runs_in,
    snapshot_of,
    snapshot_of_unit,
    summarise,
    verdict_in,
)
from gyrobench.bench.monitor.server import HTML, RECORD_POLICY, Response, page_policy, refusal
from gyrobench.bench.monitor.snapshot import RunSnapshot
from gyrobench.bench.navigation.positions import POSITIONS, position_label
from gyrobench.bench.report.number_format import true_minus
from gyrobench.bench.report.page import page_templates
from gyrobench.bench.runs.folder import UNITS_FOLDER, RunFolder
from gyrobench.bench.runs.provenance import watermark_of


def run_fragment(
    snapshot: RunSnapshot,
    freshness: Freshness,
    pages: Mapping[str, str],
    home: str,
    verdict: str = "",
    is_of_unit: bool = False,
    watermark: str = "",
) -> str:
    """Content of the page of a run, which the browser refreshes.

    ``verdict``: on the unit, empty if it was not judged. ``pages``: titles of the pages in the run folder, by
    address. ``home``: address of the list of runs, empty if there is none; if the page ``is_of_unit``, one of
    several, address of the run. ``watermark``: SIMULATED, or empty.
    """
    dwell = snapshot.dwell
    dwell_unit, dwell_rows = dwell_table(snapshot.dwells)
    step_parts = snapshot.step.label.split(", ") if snapshot.step else []
    azimuth_deg = snapshot.attitude.azimuth_deg if snapshot.attitude else math.nan
    unit_text = f"unit {snapshot.unit}" if snapshot.unit else ""
    if snapshot.units and not is_of_unit:
        unit_text = "units " + ", ".join(unit.number for unit in snapshot.units)
    return _render(
        "run.html.j2",
        unit_text=unit_text,
        watermark=watermark,
        title=_title(snapshot, freshness),
        snapshot=snapshot,
        freshness=freshness,
        pages=pages,
        home=home,
        home_label="All units" if is_of_unit else "All runs",
        units_address="../" if is_of_unit else f"{UNITS_FOLDER}/",
        headline=headline(snapshot, verdict),
        step_label=", ".join(position_label(each) if each in POSITIONS else each for each in step_parts),
        profile=profile_chart(snapshot),
        drawing=axes_drawing(snapshot.attitude) if snapshot.attitude else None,
        azimuth="" if math.isnan(azimuth_deg) else true_minus(f"{azimuth_deg:zg}°"),
        readings=reading_rows(snapshot.bench) if snapshot.bench else [],
        windows=window_charts(dwell) if dwell else [],
        biases=bias_charts(dwell) if dwell else [],
        temperatures=temperature_charts(snapshot.bins),
        bins=bin_tables(snapshot.bins),
        dwells=dwell_rows,
        dwell_unit=dwell_unit,
    )


def full_page(fragment: str, nonce: str) -> str:
    """Page with style and script around a fragment."""
    return _render("page.html.j2", fragment=fragment, nonce=nonce)


@cache
def _environment() -> Environment:
    environment = page_templates("gyrobench.bench.monitor")
    environment.filters["position"] = position_label
    environment.filters["hours"] = hours_minutes
    return environment


def _render(template: str, **content: object) -> str:
    return _environment().get_template(template).render(**content)


def _title(snapshot: RunSnapshot, freshness: Freshness) -> str:
    """Title of the browser's tab, the most important information first."""
    if freshness.warning:
        return f"▲ silent: {snapshot.name}"
    if snapshot.alarms and not freshness.is_over:
        return f"▲ ALARM: {snapshot.name}"
    remaining = "" if freshness.is_over else f", {hours_minutes(snapshot.left_s)} h left"
    return f"{snapshot.state.value}{remaining}: {snapshot.name}"


_MAX_LISTED = 200
_MAX_SNAPSHOTS = 8
_MAX_PAGE_BYTES = 50_000_000
_FRAGMENT = "fragment"
_LIST_ADDRESS = "../../"


class Website:
    """Answers requests for pages of a run folder, or of a folder of runs.

    The folder ``root`` is read at each request, so a run may start in it later. ``utc`` returns the host's
    calendar time.
    """

    def __init__(self, root: Path, utc: Callable[[], datetime]) -> None:
        self._root = root
        self._utc = utc
        self._snapshot_of = cached_by_files(snapshot_of, _MAX_SNAPSHOTS)
        self._summarise = cached_by_files(summarise, _MAX_LISTED)

    def answer(self, target: str) -> Response:
        """Answer a request for an address such as ``/``, ``/runs/mine/``, ``/runs/mine/report.html``."""
        try:
            path = unquote(urlsplit(target).path, errors="strict")
        except ValueError:
            return refusal(HTTPStatus.BAD_REQUEST, "Invalid address.")
        if path == "/metrics":
            return self._metrics()
        if is_run(self._root):
            return self._answer_run(self._root, path.removeprefix("/"), "")
        match path.split("/", maxsplit=3):
            case ["", "" | "fragment" as name]:
                return _page_or_fragment(self._list_page(), name)
            case ["", "runs", name] if name:
                return refusal(
                    HTTPStatus.PERMANENT_REDIRECT, "Moved.", Location=f"/runs/{quote(name, safe='')}/"
                )
            case ["", "runs", name, rest]:
                for run in self._runs():
                    if run.name == name:
                        return self._answer_run(run, rest, _LIST_ADDRESS)
        return _not_found()

    def _runs(self) -> list[Path]:
        try:
            return runs_in(self._root)
        except RunFolderError:
            return []

    def _answer_run(self, run: Path, rest: str, home: str, unit: Path | None = None) -> Response:
        """Answer a request for a page of a run, or of one of its units; ``home``: as for the fragment."""
        if rest in ("", _FRAGMENT):
            return _page_or_fragment(self._run_page(run, home, unit), rest)
        if rest in pages_of(unit or run):
            return _page_file((unit or run) / rest)
        match rest.split("/", maxsplit=2):
            case [str(folder), number, within] if folder == UNITS_FOLDER and unit is None:
                for each in RunFolder(run).unit_folders:
                    if each.path.name == number:
                        return self._answer_run(run, within, _LIST_ADDRESS, each.path)
        return _not_found()

    def _run_page(self, run: Path, home: str, unit: Path | None = None) -> str:
        try:
            snapshot = self._snapshot_of(run)
            if unit is not None:
                snapshot = snapshot_of_unit(snapshot, RunFolder(unit))
        except GyrobenchError as error:
            return _render("problem.html.j2", title=run.absolute().name, problem=str(error), home=home)
        freshness = freshness_of(snapshot.state, snapshot.updated_utc, self._utc())
        target = unit or run
        verdict = verdict_in(target) if snapshot.state.is_over else ""
        is_of_unit, watermark = unit is not None, watermark_of(run)
        return run_fragment(snapshot, freshness, pages_of(target), home, verdict, is_of_unit, watermark)

    def _metrics(self) -> Response:
        """Metrics of the run, or of the newest runs of the folder; those that can't be read are left out."""
        runs = [self._root] if is_run(self._root) else self._runs()[:_MAX_SNAPSHOTS]
        metrics_input = []
        for run in runs:
            with contextlib.suppress(GyrobenchError):
                snapshot = self._snapshot_of(run)
                age_s = freshness_of(snapshot.state, snapshot.updated_utc, self._utc()).age_s
                metrics_input.append((run, snapshot, age_s))
        try:
            return Response(HTTPStatus.OK, metrics_text(metrics_input), METRICS_TYPE)
        except MissingPackageError as error:
            return refusal(HTTPStatus.NOT_IMPLEMENTED, str(error))

    def _list_page(self) -> str:
        try:
            runs = runs_in(self._root)
        except RunFolderError as error:
            return _render("problem.html.j2", title="Runs", problem=str(error), home="")
        rows, left_out = [self._list_row(run) for run in runs[:_MAX_LISTED]], max(0, len(runs) - _MAX_LISTED)
        folder = str(self._root.absolute())
        return _render("runs.html.j2", title="Runs", folder=folder, rows=rows, left_out=left_out)

    def _list_row(self, run: Path) -> ListRow:
        try:
            summary = self._summarise(run)
        except GyrobenchError as error:
            return unreadable_row(run.name, str(error))
        row = list_row(summary, freshness_of(summary.state, summary.updated_utc, self._utc()))
        watermark = watermark_of(run)
        return replace(row, facts=f"{watermark}, {row.facts}") if watermark else row


def _page_or_fragment(fragment: str, name: str) -> Response:
    if name == _FRAGMENT:
        return Response(HTTPStatus.OK, fragment.encode())
    nonce = secrets.token_urlsafe(16)
    return Response(HTTPStatus.OK, full_page(fragment, nonce).encode(), HTML, page_policy(nonce))


def _page_file(path: Path) -> Response:
    try:
        return Response(
            HTTPStatus.OK, read_limited(path, _MAX_PAGE_BYTES, RunFolderError), HTML, RECORD_POLICY
        )
    except RunFolderError as error:
        return refusal(HTTPStatus.SERVICE_UNAVAILABLE, str(error))


def _not_found() -> Response:
    return refusal(HTTPStatus.NOT_FOUND, "Page not found.")
