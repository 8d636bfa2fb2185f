"""Self-contained HTML pages and their PDF: sections as data, one template, and findings.json.

Pages of findings (search, verification, batch) and the report of a run all consist of sections.
"""

from __future__ import annotations

import base64
import gc
import io
import logging
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup
from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter
from pydantic.dataclasses import dataclass

from gyrobench.bench.foundations.csv_tables import read_text
from gyrobench.bench.foundations.errors import DocumentError, GyrobenchError
from gyrobench.bench.foundations.files import file_sha256, make_folder, parse_json, write_whole
from gyrobench.bench.foundations.memory import free_memory
from gyrobench.bench.foundations.packages import require
from gyrobench.bench.foundations.text import capitalised, with_micro_sign
from gyrobench.bench.report.figures.style import draw_watermark, is_up_to_date, save_figure, save_vectors
from gyrobench.bench.runs.provenance import watermark_of

#: Name of the file with the findings of a page, in the folder of the page; the run report reads it.
FINDINGS_FILE = "findings.json"

#: Highlight of a row: an error, a warning, a sum.
Mark = Literal["", "bad", "doubtful", "sum"]

_STRICT_CONFIG = ConfigDict(extra="forbid", arbitrary_types_allowed=True)
_NOT_IN_FILE = Field(exclude=True)
_TEMPLATE_FILE = "page.html.j2"
#: Texts without the empty ones.
_Texts = Annotated[Sequence[str], AfterValidator(lambda texts: [each for each in texts if each])]


@dataclass(frozen=True, config=_STRICT_CONFIG)
class SectionTable:
    """A table of texts."""

    caption: str  #: Content of the table, with units.
    #: header, rows: One cell for each column; the last cell of a shorter row spans the remaining columns. The
    #: second line of a cell is grey.
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: int = 1  #: Number of text columns at the left; the others hold numbers.
    marks: Sequence[Mark] = ()  #: Highlight of each row; empty: no highlights.


@dataclass(frozen=True, eq=False, config=_STRICT_CONFIG)
class SectionFigure:
    """A figure with its caption: ``figure`` draws it or is its PNG file, ``name`` is the stem of the file."""

    name: Annotated[str, Field(pattern="^[a-z0-9_]{1,80}$")]
    caption: str
    figure: Annotated[Callable[[], Any] | Path | None, _NOT_IN_FILE] = None


@dataclass(frozen=True, config=_STRICT_CONFIG)
class Box:
    """A statement in a box: colour ("finished", "stopped", "failed", "open"), headline, text and notes.

    Empty notes are left out.
    """

    colour: str
    headline: str
    text: str
    notes: _Texts = ()


@dataclass(frozen=True, eq=False, config=_STRICT_CONFIG)
class Section:
    """One part of a page; its contents appear in the order of the attributes.

    Empty paragraphs are left out. Paths among items are links.
    """

    title: str
    boxes: Annotated[Sequence[Box], _NOT_IN_FILE] = Field(default=(), kw_only=True)
    paragraphs: _Texts = ()
    facts: Annotated[Mapping[str, str], _NOT_IN_FILE] = Field(default={}, kw_only=True)
    items: Annotated[Sequence[str | PurePosixPath], _NOT_IN_FILE] = Field(default=(), kw_only=True)
    figures: Sequence[SectionFigure] = ()
    tables: Sequence[SectionTable] = ()
    sections: Annotated[Sequence[Section], _NOT_IN_FILE] = Field(default=(), kw_only=True)


@dataclass(frozen=True, eq=False, config=_STRICT_CONFIG)
class Findings:
    """Result of an analysis, as a separate page and as a chapter of the report of its run."""

    title: str
    source: str  #: What was analysed.
    judgement: str  #: Verdict in a word or two.
    colour: Annotated[str, Field(pattern="^[a-z]+$")]  #: Colour of the verdict, as in :class:`Box`.
    sentence: str  #: The verdict in a sentence.
    facts: Mapping[str, str]  #: Names and values.
    sections: Sequence[Section]  #: The details.
    dwells_sha256: str = ""  #: Hash of the dwell table analysed; empty without one.
    watermark: str = ""  #: Word across the page and its figures; usually empty.

    @property
    def chapter(self) -> Section:
        """These findings as one section."""
        box = Box(self.colour, f"{capitalised(self.judgement)}.", self.sentence)
        return Section(self.title, boxes=[box], facts=self.facts, sections=self.sections)


_FINDINGS = TypeAdapter(Findings)


def render_page(
    page: Section, source: str, watermark: str, title: str = "", sign_off: str | None = None
) -> Iterator[str]:
    """Yield a page, whose figures are PNG files, as HTML text, part by part.

    Parameters
    ----------
    source : str
        Line below the title of the page.
    watermark : str
        Word across every page, or empty; a page with a watermark has no sign-off table.
    title : str
        Title of the browser window.
    sign_off : str, optional
        Name in the sign-off table, may be empty; None: neither sign-off table nor table of contents.
    """
    return _template().generate(
        page=page,
        source=source,
        title=title or f"{page.title}: {source}",
        sign_off=sign_off,
        watermark=watermark,
    )


def page_templates(package: str) -> Environment:
    """Template environment of a package: values are escaped, undefined variables raise an error."""
    return Environment(
        loader=PackageLoader(package),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


@cache
def _template() -> Template:
    environment = page_templates("gyrobench.bench.report")
    environment.filters["data_uri"] = _data_uri
    # HTML and figures that are safe are of another type, and stay as they are.
    environment.finalize = lambda value: with_micro_sign(value) if type(value) is str else value
    return environment.get_template(_TEMPLATE_FILE)


def with_figure_files(
    folder: Path, sections: Iterable[Section], watermark: str, key: str = "", vectors: Sequence[str] = ()
) -> list[Section]:
    """Draw the figures of sections into an existing folder; returns the sections with PNG files.

    ``watermark`` is a word across each figure, or empty. ``key`` is a hash of all that the figures show:
    files that contain it are not drawn again. ``vectors`` are further formats of all figures, ``svg`` and
    ``pdf``.

    Raises RunFolderError if a file can't be written.
    """
    gc.freeze()  # else each collection below scans all modules
    try:
        return [
            replace(
                section,
                figures=[
                    _with_figure_file(folder, each, key, watermark, vectors) for each in section.figures
                ],
            )
            for section in sections
        ]
    finally:
        gc.unfreeze()


def write_findings(
    path: Path, findings: Findings, sources: Iterable[Path] | None = None, dwells: Path | None = None
) -> Path:
    """Write the page, with ``figures/`` and ``findings.json`` beside it, into an existing folder.

    ``sources``: tables and runs that were analysed, which give the watermark. ``dwells``: the dwell table
    analysed, if a run report shall include the findings as long as the table is the same. Raises
    RunFolderError if a file can't be written.
    """
    folder = path.parent
    if sources is not None:
        findings = replace(findings, watermark=watermark_of(folder, *sources))
    if dwells is not None:
        findings = replace(findings, dwells_sha256=file_sha256(dwells))
    make_folder(folder / "figures")
    sections = with_figure_files(folder / "figures", findings.sections, findings.watermark)
    page = replace(findings, sections=sections).chapter
    write_whole(path, map(str.encode, render_page(page, findings.source, findings.watermark)))
    write_whole(folder / FINDINGS_FILE, _FINDINGS.dump_json(findings, indent=1) + b"\n")
    return path


def read_findings_file(folder: Path) -> Findings:
    """Read the findings of a page; figures whose files are missing are left out.

    Raises DocumentError if the file can't be read or is invalid.
    """
    path = folder / FINDINGS_FILE
    text = read_text(path)
    try:
        findings = _FINDINGS.validate_python(parse_json(text))
    except ValueError as error:
        raise DocumentError(f"{path}: not a file of findings: {error}") from error
    return replace(
        findings, sections=[_with_existing_figures(each, folder / "figures") for each in findings.sections]
    )


def _with_existing_figures(section: Section, folder: Path) -> Section:
    paths = [(each, folder / f"{each.name}.png") for each in section.figures]
    return replace(section, figures=[replace(each, figure=path) for each, path in paths if path.is_file()])


def _with_figure_file(
    folder: Path, section_figure: SectionFigure, key: str, watermark: str, vectors: Sequence[str]
) -> SectionFigure:
    if section_figure.figure is None or isinstance(section_figure.figure, Path):
        return section_figure
    path = folder / f"{section_figure.name}.png"
    if vectors or not is_up_to_date(path, key):
        figure = section_figure.figure()
        draw_watermark(figure, watermark)
        save_figure(figure, path, key)
        save_vectors(figure, path, vectors)
        del figure
        free_memory()
    return replace(section_figure, figure=path)


def _data_uri(path: Path) -> Markup:
    media_type = "svg+xml" if path.suffix == ".svg" else "png"
    content = base64.b64encode(path.read_bytes()).decode()
    return Markup(f"data:image/{media_type};base64,{content}")  # noqa: S704 - no character needs escaping


_PANGO_MISSING = (
    "can't load the library Pango, needed for PDF: {}. Install it (Debian, Ubuntu: "
    "`apt-get install libpango-1.0-0 libpangoft2-1.0-0 libharfbuzz-subset0`; macOS: `brew install pango`), "
    "or print report.html in a browser."
)


def write_pdf(page: Path, pdf: Path) -> Path:
    """Convert a page to a PDF file.

    Raises RunFolderError if the file can't be written, and the errors of :func:`pdf_of`.
    """
    write_whole(pdf, pdf_of(page.read_text(encoding="utf-8")))
    return pdf


def pdf_of(page: str, attachments: Mapping[str, bytes] | None = None, variant: str | None = None) -> bytes:
    """Convert a self-contained HTML page to tagged PDF.

    ``attachments``: content of files embedded in the PDF, by name. ``variant``: for instance "pdf/a-3a";
    default: plain PDF. Raises GyrobenchError if a system library is missing, and MissingPackageError if
    weasyprint is not installed.
    """
    try:
        html, urls = require("weasyprint"), require("weasyprint.urls")
    except OSError as error:
        raise GyrobenchError(_PANGO_MISSING.format(str(error).splitlines()[0])) from error
    for name in ("weasyprint", "fontTools"):
        logging.getLogger(name).setLevel(logging.ERROR)
    # Images are embedded as data URIs; no other address is fetched.
    document = html.HTML(string=page, url_fetcher=urls.URLFetcher(allowed_protocols=["data"]))
    embedded_files = [
        html.Attachment(file_obj=io.BytesIO(content), name=name, relationship="Source")
        for name, content in (attachments or {}).items()
    ]
    return document.write_pdf(pdf_variant=variant, pdf_tags=True, attachments=embedded_files)  # type: ignore[no-any-return]
