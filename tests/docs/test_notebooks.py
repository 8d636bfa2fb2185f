"""Notebooks run from top to bottom."""

import json
import os
import sys
from pathlib import Path

import matplotlib as mpl
import pytest

from tests.docs.pages import DOCS

NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))


def code_of(notebook):
    """Source of each code cell."""
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_holds_no_output(notebook):
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in cells)


@pytest.mark.long
def test_the_notebook_goes_from_a_run_folder_to_the_cause_and_the_budget(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    mpl.use("agg")
    names = {}
    for cell in code_of(DOCS / "notebooks/from_run_to_effect.ipynb"):
        exec(compile(cell, "notebook", "exec"), names)  # noqa: S102 - our own page
    shown = capsys.readouterr().out
    assert names["closure"].verdict in shown
    assert "thermal_hysteresis" in shown
    assert names["total"] == pytest.approx(names["stated"], rel=0.01)
    assert len(names["x"]) > 3
