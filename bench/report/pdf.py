"""A report as PDF: the same page on A4, with page numbers, for signing and for the archive."""

from __future__ import annotations

import logging
from pathlib import Path

from gyrobench.bench.foundations.errors import GyrobenchError
from gyrobench.bench.foundations.files import write_whole

_LACKING = (
    "PDF needs the library Pango, which can't be loaded here: {}. Install it (Debian, Ubuntu: "
    "`apt-get install libpango-1.0-0 libpangoft2-1.0-0 libharfbuzz-subset0`; macOS: `brew install pango`), "
    "or print report.html in a browser."
)


def write_pdf(page: Path, pdf: Path) -> Path:
    """Lay a self-contained HTML page out as PDF.

    Parameters
    ----------
    page : Path
        What :func:`gyrobench.bench.report.html.write_report` wrote.
    pdf : Path
        Where to write.

    Raises
    ------
    GyrobenchError
        A library of the system is missing.
    RunFolderError
        The file can't be written.
    """
    try:
        from weasyprint import HTML
        from weasyprint.urls import URLFetcher
    except OSError as error:
        raise GyrobenchError(_LACKING.format(str(error).splitlines()[0])) from error
    for name in ("weasyprint", "fontTools"):
        logging.getLogger(name).setLevel(logging.ERROR)
    # Pictures are inside the page: nothing is fetched, whatever a file from elsewhere says.
    document = HTML(
        string=page.read_text(encoding="utf-8"), url_fetcher=URLFetcher(allowed_protocols=["data"])
    )
    write_whole(pdf, document.write_pdf())
    return pdf
