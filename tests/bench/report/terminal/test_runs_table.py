"""The list of runs."""

import io
from datetime import UTC, datetime

import pytest
from rich.console import Console

from gyrobench.bench.report.terminal.runs import runs_table


@pytest.mark.parametrize(
    ("units", "last"),
    [(["1001", None], "2 runs of 1 unit."), ([None], "1 run."), (["1", "2"], "2 runs of 2 units.")],
)
def test_a_run_that_ended_before_the_unit_was_known_is_not_a_unit(units, last):
    common = dict.fromkeys(("batch", "station", "verdict", "acceptance"))
    runs = [
        {
            "ended": "finished",
            "started_utc": datetime(2026, 1, 1, tzinfo=UTC),
            "path": "one",
            "unit": unit,
            **common,
        }
        for unit in units
    ]
    printed = io.StringIO()
    Console(file=printed, width=80).print(runs_table(runs, 40))
    assert printed.getvalue().splitlines()[-1] == last


def test_a_search_older_than_its_dwells_is_explained_below_the_list():
    common = dict.fromkeys(("unit", "batch", "station", "acceptance"))
    started = datetime(2026, 1, 1, tzinfo=UTC)
    run = {"ended": "finished", "started_utc": started, "path": "one", "verdict": "stale", **common}
    stale, clean = io.StringIO(), io.StringIO()
    Console(file=stale, width=80).print(runs_table([run], 40))
    Console(file=clean, width=80).print(runs_table([{**run, "verdict": "clean"}], 40))
    assert "stale: dwells were measured or re-evaluated after the search; search again." in " ".join(
        stale.getvalue().split()
    )
    assert "stale" not in clean.getvalue()
