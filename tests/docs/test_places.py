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
