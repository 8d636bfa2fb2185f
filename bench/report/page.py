"""HTML pages that need nothing beside them: their parts as data, the template, and ``findings.json``."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from jinja2 import Environment, PackageLoader, StrictUndefined
from matplotlib.figure import Figure
from pydantic import Field

from gyrobench.bench.foundations.csv_tables import read_text
from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.files import make_folder, parse_json, write_whole
from gyrobench.bench.navigation.positions import position_label
from gyrobench.bench.report.figures.style import save_figure

#: What to make of a row.
Mark = Literal["", "bad", "doubtful"]


@dataclass(frozen=True)
class SectionTable:
    """A table of texts.

    Attributes
    ----------
    caption : str
        What it shows, with units.
    header, rows : sequence of str, sequence of sequences of str
        One cell for each column.
    words : int
        So many columns at the left hold words; those after them hold numbers.
    marks : sequence of str
        What to make of each row: "bad", "doubtful" or nothing; without any, nothing of all.
    """

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: int = 1
    marks: Sequence[Mark] = ()


@dataclass(frozen=True, eq=False)
class SectionFigure:
    """A figure, the name of its file without suffix, and what it shows.

    One that was drawn before is given by its PNG file.
    """

    name: str
    caption: str
    figure: Figure | Path


@dataclass(frozen=True, eq=False)
class Section:
    """One part of a report; paragraphs first, then figures, then tables."""

    title: str
    paragraphs: Sequence[str] = ()
    figures: Sequence[SectionFigure] = ()
    tables: Sequence[SectionTable] = ()


@dataclass(frozen=True, eq=False)
class Findings:
    """What such a page says.

    Attributes
    ----------
    title : str
        Of the page.
    source : str
        What was looked at, for people.
    judgement : str
        In a word or two.
    colour : str
        Of the box around it: a class of the template, "finished", "stopped" or "failed".
    sentence : str
        The judgement in a sentence.
    facts : mapping of str to str
        Names and values.
    sections : sequence of Section
        The rest.
    dwells_sha256 : str
        Hash of the dwell table that was looked at; empty where there is none.
    """

    title: str
    source: str
    judgement: str
    colour: str
    sentence: str
    facts: Mapping[str, str]
    sections: Sequence[Section]
    dwells_sha256: str = ""


def render_page(template: str, **content: object) -> str:
    """Fill a template of this package.

    Parameters
    ----------
    template : str
        Name of its file.
    **content
        What the template asks for.
    """
    environment = Environment(
        loader=PackageLoader("gyrobench.bench.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["data_uri"] = _data_uri
    environment.filters["position"] = position_label
    return environment.get_template(template).render(**content)


def _data_uri(path: Path) -> str:
    return f"data:image/png;base64,{base64.b64encode(path.read_bytes()).decode()}"


def with_figure_files(folder: Path, sections: Iterable[Section]) -> list[Section]:
    """Draw the figures of some sections into a folder that is there; those drawn before stay where they are.

    Returns
    -------
    list of Section
        The sections with PNG files as figures.

    Raises
    ------
    RunFolderError
        A file can't be written.
    """
    return [
        replace(section, figures=[_as_file(folder, each) for each in section.figures]) for section in sections
    ]


def _as_file(folder: Path, drawn: SectionFigure) -> SectionFigure:
    if isinstance(drawn.figure, Path):
        return drawn
    path = folder / f"{drawn.name}.png"
    save_figure(drawn.figure, path)
    return replace(drawn, figure=path)


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
    return Findings(
        **{**dict(model), "sections": [_section_of_model(each, folder) for each in model.sections]}
    )


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


def _section_of_model(model: _Section, folder: Path) -> Section:
    paths = [(each, folder / "figures" / f"{each.name}.png") for each in model.figures]
    return Section(
        model.title,
        model.paragraphs,
        [SectionFigure(each.name, each.caption, path) for each, path in paths if path.is_file()],
        [SectionTable(**dict(each)) for each in model.tables],
    )


_TEMPLATE = "findings.html.j2"


def write_findings(path: Path, findings: Findings) -> Path:
    """Write the page, its figures into ``figures/`` and ``findings.json`` beside it; its folder is there.

    Raises
    ------
    RunFolderError
        A file can't be written.
    """
    folder = path.parent
    make_folder(folder / "figures")
    sections = with_figure_files(folder / "figures", findings.sections)
    write_whole(path, render_page(_TEMPLATE, findings=replace(findings, sections=sections)).encode())
    write_findings_file(folder, findings)
    return path
