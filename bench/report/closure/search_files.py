"""All that a search for effects leaves: its tables, its page, and the report of the run that it was in."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gyrobench.bench.closure.files import write_closure
from gyrobench.bench.closure.loop import Closure
from gyrobench.bench.report.closure.page import write_closure_page
from gyrobench.bench.report.run_report import write_report
from gyrobench.bench.runs.folder import RunFolder


@dataclass(frozen=True)
class SearchFiles:
    """What was written.

    Attributes
    ----------
    page : Path
        The page of the search.
    report : Path or None
        The run's report, written anew; None where the search is not the one in a run folder.
    """

    page: Path
    report: Path | None


def write_search(closure: Closure, campaign: Path, folder: Path | None = None) -> SearchFiles:
    """Write what a search found; the report of its run takes it in.

    Parameters
    ----------
    closure : Closure
        Outcome of the search.
    campaign : Path
        The run folder or dwell table that was searched.
    folder : Path, optional
        Where to write; by default ``closure``, in the run folder or beside the table.

    Raises
    ------
    RunFolderError
        A file can't be written.
    """
    run = RunFolder(campaign) if campaign.is_dir() else None
    folder = folder or (run or RunFolder(campaign.parent)).closure
    write_closure(folder, closure)
    page = write_closure_page(folder, closure, str(campaign), run.dwells if run else campaign)
    return SearchFiles(page, write_report(run) if run and folder == run.closure else None)
