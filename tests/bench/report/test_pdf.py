import sys

import pytest

from gyrobench.bench.foundations.errors import GyrobenchError
from gyrobench.bench.report.page import write_pdf
from gyrobench.bench.report.run_report import write_report
from gyrobench.bench.runs.folder import RunFolder


def test_a_report_becomes_a_pdf(empty_folder: RunFolder, journal_writer):
    journal_writer(empty_folder)
    pdf = write_pdf(write_report(empty_folder).path, empty_folder.path / "report.pdf")
    content = pdf.read_bytes()
    assert content.startswith(b"%PDF-")
    assert len(content) > 5000


def test_the_contents_stay_on_one_page(empty_folder: RunFolder, journal_writer):
    journal_writer(empty_folder)
    text = write_report(empty_folder).path.read_text()
    low = text.replace("<nav>", '<div style="break-before: page; height: 23cm"></div><nav>', 1)
    pages = pytest.importorskip("weasyprint").HTML(string=low).render().pages
    assert sum(any("part-" in target for _, target, *_ in page.links) for page in pages) == 1


def test_nothing_is_fetched_from_outside(tmp_path):
    (tmp_path / "secret.png").write_bytes(b"not to be read")
    page = tmp_path / "page.html"
    page.write_text(f'<img src="file://{tmp_path}/secret.png"><img src="http://127.0.0.1:9/x.png">')
    assert write_pdf(page, tmp_path / "page.pdf").stat().st_size < 5000


def test_a_missing_library_of_the_system_is_stated_with_what_to_install(tmp_path, monkeypatch):
    class Missing:
        def find_spec(self, name, path=None, target=None):
            if name == "weasyprint":
                raise OSError("cannot load library 'libpango-1.0-0'")

    (tmp_path / "report.html").write_text("<p>A page.</p>")
    for name in [name for name in sys.modules if name.split(".")[0] == "weasyprint"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(sys, "meta_path", [Missing(), *sys.meta_path])
    with pytest.raises(GyrobenchError, match=r"libpango-1\.0-0.*apt-get install"):
        write_pdf(tmp_path / "report.html", tmp_path / "report.pdf")
