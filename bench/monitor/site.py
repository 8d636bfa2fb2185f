"""The pages of the monitor by address: one run, or a folder of runs and each of them."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from datetime import datetime
from http import HTTPStatus
from pathlib import Path
from urllib.parse import quote, unquote, urlsplit

from gyrobench.bench.foundations.errors import GyrobenchError, RunFolderError
from gyrobench.bench.foundations.files import read_limited
from gyrobench.bench.live.from_folder import picture_of
from gyrobench.bench.monitor.answer import HTML, RECORD_POLICY, Answer, page_policy, refusal
from gyrobench.bench.monitor.list_rows import ListRow, list_row, unreadable_row
from gyrobench.bench.monitor.memory import FolderMemory
from gyrobench.bench.monitor.news import news_of
from gyrobench.bench.monitor.page import list_fragment, problem_fragment, run_fragment, whole_page
from gyrobench.bench.monitor.runs import is_run, records_of, runs_in, signature_of, summarise

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
