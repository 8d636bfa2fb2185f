"""Places in the code that pages and overviews name are there."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "CONTRIBUTING.md", ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
OVERVIEWS = [
    *sorted((ROOT / "bench").glob("*/**/__init__.py")),
    *sorted((ROOT / "drivers").rglob("__init__.py")),
]


def places_on(text):
    """Modules and folders that a page names by their paths."""
    return re.findall(
        r"`((?:bench|conformance|drivers|tests/(?:bench|docs|drivers))/[\w/]+(?:\.py|/))`", text
    )


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_files_named_on_a_page_exist(page):
    named = places_on(page.read_text(encoding="utf-8"))
    assert [place for place in named if not (ROOT / place).exists()] == []


@pytest.mark.parametrize("overview", OVERVIEWS, ids=lambda path: path.parent.relative_to(ROOT).as_posix())
def test_modules_named_in_the_overview_of_a_folder_exist(overview):
    text = ast.get_docstring(ast.parse(overview.read_text(encoding="utf-8"))) or ""
    modules = {path.stem for path in overview.parent.iterdir()}
    assert [name for name in re.findall(r"``([a-z][a-z_]+)``", text) if name not in modules] == []


@cache
def defined_in(module):
    """Names of the functions, classes, arguments and variables of a module, and its own."""
    names = {module.stem}
    for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
        match node:
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name) | ast.arg(arg=name):
                names.add(name)
            case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                names.add(name)
    return names


@pytest.mark.parametrize(
    "page", ["CONTRIBUTING", "docs/extend/dialect", "docs/extend/effect", "docs/extend/step"]
)
def test_names_on_a_page_for_contributors_are_defined_beside_the_files_that_it_names(page):
    text = (ROOT / f"{page}.md").read_text(encoding="utf-8")
    folders = {ROOT / place if place.endswith("/") else (ROOT / place).parent for place in places_on(text)}
    modules = [path for folder in {*folders, ROOT / "bench/cli"} for path in folder.glob("*.py")]
    files = [*(ROOT / "procedures").iterdir(), *(ROOT / "docs/examples/laboratory").iterdir()]
    defined = {path.stem for path in files}.union(*map(defined_in, modules))
    assert [name for name in re.findall(r"`(_?[A-Za-z]\w+)`", text) if name not in defined] == []
