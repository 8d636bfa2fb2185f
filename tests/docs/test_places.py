"""Places in the code that pages and overviews name are there."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "CONTRIBUTING.md", ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
OVERVIEWS = [
    *sorted((ROOT / "bench").glob("*/**/__init__.py")),
    *sorted((ROOT / "drivers").rglob("__init__.py")),
]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_files_named_on_a_page_exist(page):
    named = re.findall(
        r"`((?:bench|drivers|tests/bench)/[\w/]+(?:\.py|/))`", page.read_text(encoding="utf-8")
    )
    assert [place for place in named if not (ROOT / place).exists()] == []


@pytest.mark.parametrize("overview", OVERVIEWS, ids=lambda path: path.parent.relative_to(ROOT).as_posix())
def test_modules_named_in_the_overview_of_a_folder_exist(overview):
    text = ast.get_docstring(ast.parse(overview.read_text(encoding="utf-8"))) or ""
    modules = {path.stem for path in overview.parent.iterdir()}
    assert [name for name in re.findall(r"``([a-z][a-z_]+)``", text) if name not in modules] == []


def defined_in(module):
    """Names of the functions, classes, arguments and variables of a module, and its own."""
    yield module.stem
    for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
        match node:
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name) | ast.arg(arg=name):
                yield name
            case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                yield name


@pytest.mark.parametrize(
    "page", [ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs/extend").glob("*.md"))], ids=str
)
def test_names_on_a_page_for_contributors_are_defined_beside_the_files_that_it_names(page):
    text = page.read_text(encoding="utf-8")
    places = re.findall(r"`((?:bench|drivers|tests)/[\w/]+(?:\.py|/))`", text)
    folders = {ROOT / place if place.endswith("/") else (ROOT / place).parent for place in places}
    modules = [path for folder in {*folders, ROOT / "bench/cli"} for path in folder.glob("*.py")]
    files = {
        path.stem
        for folder in ("procedures", "docs/examples/laboratory")
        for path in (ROOT / folder).iterdir()
    }
    defined = files.union(*map(defined_in, modules))
    assert [name for name in re.findall(r"`(_?[A-Za-z]\w+)`", text) if name not in defined] == []
