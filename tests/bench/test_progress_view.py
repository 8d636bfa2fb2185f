import io
import math

import pytest
from rich.console import Console

from bench.bias.dwell_table import DwellRow
from bench.engine.session import prepare_job
from bench.progress_view import ProgressView

ROW = DwellRow(
    unit="1000", run="1", dwell=1, cycle=1, position="z_down",
    start_s=0.0, end_s=1300.0, since_power_on_s=600.0,
    gyro_c=(-24.5, -24.0, -23.0), gyro_rate_c_per_h=(0.1, 0.1, 0.1),
    bias_dph=(-0.02587, 0.01234, 0.0), sigma_dph=(0.00146, 0.00146, 0.00114),
)  # fmt: skip


def printed(*rows):
    stream = io.StringIO()
    with ProgressView(
        Console(file=stream, width=80), prepare_job("ten_minute_check", "emulated").plan
    ) as view:
        for row in rows:
            view.dwell_measured(row)
    return stream.getvalue().splitlines()


def test_a_dwell_is_one_line_under_its_heads_within_80_columns():
    lines = printed(ROW)
    head, line = lines[-2:]
    assert max(map(len, lines)) <= 80
    assert line.split()[:4] == ["1/1", "1", "z_down", "-24.5"]
    assert "-25.87 ±1.46" in line
    assert line.index("z_down") == head.index("position")


def test_a_flagged_dwell_shows_its_reason_and_no_number():
    flagged = DwellRow(**{**ROW.__dict__, "bias_dph": (math.nan,) * 3, "flags": "the INS left navigation"})
    line = printed(flagged)[-1]
    assert "flagged: the INS left navigation" in line
    assert "nan" not in line


def test_nothing_but_text_goes_into_a_file():
    assert not any("\x1b" in line for line in printed(ROW))


@pytest.mark.parametrize("procedure", ["six_position_fig7", "three_temperature_shift"])
def test_the_plan_is_told_before_it_begins(procedure):
    stream = io.StringIO()
    with ProgressView(Console(file=stream, width=80), prepare_job(procedure, "emulated").plan):
        pass
    assert procedure in stream.getvalue()
    assert "dwells" in stream.getvalue()
