import io
import re

import numpy as np
import pytest
from rich.console import Console

from gyrobench.bench.bias.acceptance import judge
from gyrobench.bench.bias.plateaus import PlannedDwell
from gyrobench.bench.bias.verdicts import Acceptance, AcceptanceLimits
from gyrobench.bench.report.bias_sections import acceptance_summary
from gyrobench.bench.report.terminal.tables import section_view


def printed(acceptance):
    stream = io.StringIO()
    Console(width=80, file=stream, force_terminal=False, color_system=None).print(
        section_view(acceptance_summary(acceptance))
    )
    lines = [line.rstrip() for line in stream.getvalue().splitlines()]
    assert all(len(line) <= 80 for line in lines)
    return lines


@pytest.mark.parametrize(
    ("limit_dph", "verdict"), [(0.1, "accepted"), (0.0165, "marginal"), (0.006, "rejected")]
)
def test_each_gyro_has_one_line_and_the_unit_a_verdict(dwells, limit_dph, verdict):
    lines = printed(judge(dwells, AcceptanceLimits(position_difference_dph=limit_dph)))
    assert [line[:6] for line in lines if line[1:6] == " gyro"] == ["X gyro", "Y gyro", "Z gyro"]
    assert " ".join(lines).count(f"Unit {verdict}.") == 1


def test_a_run_without_limits_says_so():
    assert printed(Acceptance()) == ["Unit not judged. The procedure has no acceptance limits."]


def test_what_was_not_measured_is_counted(dwells):
    limits = AcceptanceLimits(position_difference_dph=0.1)
    planned = [PlannedDwell(900 + i, 9, name, 99.0, (99.0,) * 3) for i, name in enumerate(("z_up", "z_down"))]
    lines = printed(judge(dwells, limits, planned))
    text = " ".join(lines)
    assert "Unit not judged. 2 planned dwells were not compared with the others of the plateau" in text
    assert "Measure all positions of cycle 9 at 99 °C in the chamber again in one power cycle." in text


def test_a_run_without_comparisons_says_so(dwells):
    assert printed(judge(dwells[:1], AcceptanceLimits(position_difference_dph=0.1))) == [
        "Unit not judged. No plateau has good dwells in two positions."
    ]


def test_a_marginal_unit_has_the_number_of_cycles_that_decide(dwells):
    text = " ".join(printed(judge(dwells, AcceptanceLimits(position_difference_dph=0.0165))))
    assert re.search(r"too large for a verdict. \d+ cycles in one run, instead of 2, give one", text), text


def test_a_marginal_unit_that_no_number_of_cycles_decides_has_the_reason(dwells):
    limits = AcceptanceLimits(position_difference_dph=0.0165)
    shared = {row.dwell: np.diag(row.sigma_dph) for row in dwells}
    of_positions = {row.dwell: shared[row.dwell] * (-1.0) ** row.dwell for row in dwells}
    text = " ".join(printed(judge(dwells, limits, shared=of_positions)))
    assert "More cycles do not decide, because 0.0" in text


def test_a_separate_limit_of_up_and_down_is_stated(dwells):
    limits = AcceptanceLimits(position_difference_dph=0.2, vertical_difference_dph=0.1)
    assert "0.2 deg/h between positions (0.1 with the gyro up and down)" in " ".join(
        printed(judge(dwells, limits))
    )
