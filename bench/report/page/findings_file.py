"""Findings kept as ``findings.json`` beside their page, so that the report of a run can take them in."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from gyrobench.bench.foundations.csv_tables import read_text
from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.files import parse_json, write_whole
from gyrobench.bench.report.page.findings import Findings
from gyrobench.bench.report.page.sections import Mark, Section, SectionFigure, SectionTable

#: Name of the file.
FINDINGS_FILE = "findings.json"


def write_findings_file(folder: Path, findings: Findings) -> None:
    """Write what a page says, without its pictures, which are in ``figures/`` beside it.

    Raises
    ------
    RunFolderError
        The file can't be written.
    """
    fields = {**vars(findings), "sections": [_section_model(each) for each in findings.sections]}
    text = _Findings.model_validate(fields).model_dump_json(indent=1)
    write_whole(folder / FINDINGS_FILE, f"{text}\n".encode())


def read_findings_file(folder: Path) -> Findings:
    """Read what a page says; a picture that is missing is left out.

    Raises
    ------
    DocumentError
        The file can't be read or holds something else.
    """
    path = folder / FINDINGS_FILE
    text = read_text(path)
    try:
        model = _Findings.model_validate(parse_json(text))
    except ValueError as error:
        raise DocumentError(f"{path}: holds no findings: {error}") from error
    return Findings(**{**dict(model), "sections": [_section(each, folder) for each in model.sections]})


class _Table(StrictModel):
    caption: str
    header: list[str]
    rows: list[list[str]]
    words: int
    marks: list[Mark]


class _Figure(StrictModel):
    name: str = Field(pattern="^[a-z0-9_]{1,80}$")
    caption: str


class _Section(StrictModel):
    title: str
    paragraphs: list[str]
    figures: list[_Figure]
    tables: list[_Table]


class _Findings(StrictModel):
    title: str
    source: str
    judgement: str
    colour: str = Field(pattern="^[a-z]+$")
    sentence: str
    facts: dict[str, str]
    sections: list[_Section]
    dwells_sha256: str


def _section_model(section: Section) -> _Section:
    return _Section(
        title=section.title,
        paragraphs=list(section.paragraphs),
        figures=[_Figure(name=each.name, caption=each.caption) for each in section.figures],
        tables=[
            _Table(
                caption=each.caption,
                header=list(each.header),
                rows=[list(row) for row in each.rows],
                words=each.words,
                marks=list(each.marks),
            )
            for each in section.tables
        ],
    )


def _section(model: _Section, folder: Path) -> Section:
    paths = [(each, folder / "figures" / f"{each.name}.png") for each in model.figures]
    return Section(
        model.title,
        model.paragraphs,
        [SectionFigure(each.name, each.caption, path) for each, path in paths if path.is_file()],
        [SectionTable(**dict(each)) for each in model.tables],
    )
