"""Names from files that try to become HTML."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import gyrobench.bench.report
from gyrobench.bench.bias.dwell_table import read_dwells, write_dwells
from gyrobench.bench.report.run_report import write_report
from gyrobench.bench.runs.folder import RunFolder

SCRIPT = "<script>alert(1)</script>"
IMAGE = "\"'><img src=x onerror=alert(1)>"


def test_what_comes_from_files_is_text_in_the_report(run_folder, tmp_path):
    folder = RunFolder(tmp_path / "run")
    shutil.copytree(run_folder.path, folder.path, ignore=shutil.ignore_patterns("seals"))
    hostile = json.dumps(SCRIPT + IMAGE)
    rows = read_dwells(folder.dwells)[:6]
    rows[0] = replace(rows[0], unit=SCRIPT + IMAGE, run=SCRIPT, flags=(SCRIPT + IMAGE,))
    write_dwells(folder.dwells, rows)
    for path in (folder.procedure, folder.station):
        path.write_text(f"{path.stem}: {hostile}\ndescription: {hostile}\nassumptions: [{hostile}]\n")
    provenance = json.loads(folder.provenance.read_text())
    provenance["instruments"] = {SCRIPT: IMAGE}
    folder.provenance.write_text(json.dumps(provenance))
    with folder.journal.open("a") as journal:
        entry = {
            "time_s": 1e9,
            "utc": SCRIPT,
            "event": "run_ended",
            "ended": SCRIPT,
            "reason": IMAGE,
            "safe_state": [],
        }
        journal.write(json.dumps(entry) + "\n")
    page = write_report(folder).path.read_text()
    assert "alert(1)" in page
    assert "<script" not in page
    assert not re.search(r"<img[^>]*onerror", page)


def test_templates_mark_nothing_but_their_own_words_as_safe():
    for path in (Path(gyrobench.bench.report.__file__).parent / "templates").glob("*.j2"):
        for expression in re.findall(r"{{(.*?)}}", path.read_text()):
            if "safe" in re.findall(r"\|\s*(\w+)", expression):
                assert re.match(r" '[^']*' \| safe ", expression), (path, expression)
        assert "autoescape" not in path.read_text()
