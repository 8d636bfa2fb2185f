"""The list of runs."""

from datetime import UTC, datetime

import pytest

from gyrobench.bench.report.terminal.runs import runs_table
from tests.bench.report.plain_terminal import printed, printed_lines


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
    assert printed_lines(runs_table(runs, 40))[-1] == last


def test_a_search_older_than_its_dwells_is_explained_below_the_list():
    common = dict.fromkeys(("unit", "batch", "station", "acceptance"))
    started = datetime(2026, 1, 1, tzinfo=UTC)
    run = {"ended": "finished", "started_utc": started, "path": "one", **common}
    stale, clean = (
        " ".join(printed(runs_table([{**run, "verdict": verdict}], 40)).split())
        for verdict in ("stale", "clean")
    )
    assert "stale: dwells were measured or re-evaluated after the search; search again." in stale
    assert "stale" not in clean
