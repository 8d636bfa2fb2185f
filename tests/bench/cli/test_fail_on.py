"""`--fail-on`: exit codes for CI."""

import pytest

from gyrobench.bench.bias.verdicts import Acceptance
from gyrobench.bench.dwells.run_results import RunResults
from gyrobench.bench.engine.run_outcome import RunOutcome
from tests.bench.command_line import output_of


class Measured:
    def __init__(self, flags):
        self.row = type("Row", (), {"dwell": 7, "flags": flags})


@pytest.mark.parametrize(
    ("verdict", "flags", "fail_on", "reason"),
    [
        ("accepted", (), "flagged", ""),
        ("rejected", (), None, ""),
        ("rejected", (), "rejected", "The unit is rejected"),
        ("rejected", (), "flagged", "The unit is rejected"),
        ("accepted", ("moved",), "rejected", ""),
        ("accepted", ("moved",), "flagged", "1 of 2 dwells are flagged: dwell 7: moved."),
    ],
)
def test_a_finished_run_falls_short_of_what_its_caller_asks(verdict, flags, fail_on, reason):
    outcome = RunOutcome(
        dwells=[Measured(()), Measured(flags)], results=RunResults(acceptance=Acceptance(verdict=verdict))
    )
    assert outcome.shortcoming(fail_on).startswith(reason)
    assert bool(outcome.shortcoming(fail_on)) == bool(reason)


@pytest.mark.parametrize(("fail_on", "reason"), [("flagged", "not measured: dwells 2 and 4."), (None, "")])
def test_a_skipped_dwell_counts_as_missing_only_where_no_flag_is_allowed(fail_on, reason):
    outcome = RunOutcome(finished={1, 3}, skipped={4, 2})
    assert outcome.shortcoming(fail_on).endswith(reason)
    assert bool(outcome.shortcoming(fail_on)) == bool(reason)


def test_a_run_with_a_flagged_dwell_ends_with_1_where_it_must_not_have_one(tmp_path):
    (tmp_path / "stuck.yaml").write_text(
        "faults:\n  - {fault: stuck_output, at_s: 500, for_s: 20000, signals: [velocity_east]}\n"
    )
    arguments = ("run", "ten_minute_check", "--faults", "stuck.yaml", "--view", "lines")
    printed = output_of(*arguments, "--fail-on", "flagged", cwd=tmp_path, code=1)
    assert "1 of 1 dwells are flagged" in printed
    repeat = "Repeat   gyrobench resume runs/ten_minute_check-001 --repeat flagged --look"
    assert repeat in printed
