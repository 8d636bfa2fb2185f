"""The search for effects on simulated benches with known effects, scored by their own scorer.

As a script it writes the table of docs/closure_cases.md::

    python -m tests.benchmarks.bench_closure CASES --table docs/closure_cases.md

CASES holds one folder a case (``dwells.csv``, ``truth.json``), with ``score.py`` above it.
"""

import argparse
import json
import re
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.files import write_closure
from gyrobench.bench.closure.loop import close_loop
from tests.benchmarks.stock_methods import METHODS
from tests.benchmarks.stock_methods import write_closure as write_stock_closure

CASES = Path(__file__).parents[3] / "shared" / "cases" / "dev"
LINE = re.compile(
    r"(?P<case>\S+) (?P<mark>right|tied|WRONG) +true=(?P<true>\S+) found=(?P<found>\S+) "
    r"verdict=(?P<verdict>\S+) before=(?P<before>\S+) after=(?P<after>\S+)"
)


@dataclass(frozen=True)
class Scored:
    """Score of one case, and the CPU time of the search."""

    case: str
    mark: str
    true: str
    found: str
    verdict: str
    before_dph: float
    after_dph: float
    shape_known_dph: float
    took_s: float

    @property
    def is_known(self):
        return self.shape_known_dph > 0.0 and self.true != "none" and self.verdict != "unexplained"


def score(results, cases):
    """Lines that the scorer prints."""
    command = [sys.executable, str(cases.parent / "score.py"), str(results), str(cases)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()


def run(cases, results):
    """Search all cases and score them: one entry a case, and the scorer's summary."""
    took_s = {}
    for case in sorted(path for path in cases.iterdir() if path.is_dir()):
        begin_s = time.process_time()
        closure = close_loop(campaign_of(read_dwells(case / "dwells.csv")))
        write_closure(results / case.name, closure)
        took_s[case.name] = time.process_time() - begin_s
    lines = score(results, cases)
    scored = []
    for found in filter(None, map(LINE.match, lines)):
        truth = json.loads((cases / found["case"] / "truth.json").read_text())
        scored.append(
            Scored(
                found["case"],
                found["mark"],
                found["true"],
                found["found"],
                found["verdict"],
                float(found["before"]),
                float(found["after"]),
                truth["held_out_rms_dph"]["shape_known"],
                took_s[found["case"]],
            )
        )
    return scored, lines[-3:]


def markdown(scored, summary):
    rows = [
        f"| {each.case} | {each.true} | {each.found} | {each.verdict} | {1e3 * each.before_dph:.2f} "
        f"| {1e3 * each.after_dph:.2f} | {each.after_dph / each.shape_known_dph:.2f} | {each.took_s:.1f} |"
        for each in scored
    ]
    head = "| case | in the data | found | verdict | error before | after | after/reference fit | CPU s |"
    rule = "|---|---|---|---|---|---|---|---|"
    return "\n".join([head, rule, *rows, "", *(f"    {each}" for each in summary)])


@pytest.mark.skipif(not CASES.exists(), reason="the simulated cases are not beside the checkout")
def test_search_on_simulated_benches(tmp_path):
    scored, summary = run(CASES, tmp_path / "ours")
    print("\n" + "\n".join(summary))
    print(f"CPU time a case: median {statistics.median(each.took_s for each in scored):.1f} s, "
          f"longest {max(each.took_s for each in scored):.1f} s")  # fmt: skip
    for name, method in METHODS.items():
        for case in sorted(path for path in CASES.iterdir() if path.is_dir()):
            rows = read_dwells(case / "dwells.csv")
            write_stock_closure(tmp_path / name / case.name, rows, method(rows))
        print(f"{name}\n" + "\n".join(score(tmp_path / name, CASES)[-3:]))
    assert sum(each.mark == "right" for each in scored) >= 0.9 * len(scored)
    assert all(each.found == "none" for each in scored if each.true == "none")
    assert all(each.after_dph <= 1.1 * each.before_dph for each in scored)
    assert max(each.took_s for each in scored) < 5.0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("cases", type=Path)
    parser.add_argument("--table", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        text = markdown(*run(arguments.cases.resolve(), Path(folder)))
    print(text)
    if arguments.table:
        lines = arguments.table.read_text().split("<!-- table -->")
        arguments.table.write_text(f"{lines[0]}<!-- table -->\n{text}\n<!-- table -->{lines[2]}")
