import math
import shutil

import numpy as np
import pytest

from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.live.picture import Picture, RunState, read_picture
from gyrobench.bench.runs.folder import RunFolder
from tests.bench.live.conftest import recorded_run


def during(recorded, text):
    """Pictures of a step."""
    return [each for each in recorded.pictures if each.step and each.step.description.startswith(text)]


def test_it_begins_with_what_the_plan_expects(recorded):
    first = recorded.pictures[0]
    assert (first.procedure, first.station, first.state) == ("ten_minute_check", "emulated", RunState.RUNNING)
    assert first.dwell_count == 1
    assert first.planned.time_s[-1] == pytest.approx(first.planned_s)
    assert [span.position for span in first.planned.positions] == ["z_up"]


def test_time_goes_on_and_what_is_left_shrinks(recorded):
    now_s = [each.now_s for each in recorded.pictures]
    left_s = [each.left_s for each in recorded.pictures]
    assert now_s == sorted(now_s)
    assert left_s[0] == pytest.approx(recorded.pictures[0].planned_s, abs=15.0)
    assert left_s[-1] == pytest.approx(0.0, abs=1.0)


def test_the_measured_profile_grows_and_ends_with_the_newest_reading(recorded):
    counts = [len(each.measured.time_s) for each in recorded.pictures]
    assert counts == sorted(counts)
    last = recorded.pictures[-1].measured
    assert last.time_s == tuple(sorted(last.time_s))
    assert np.ptp(last.chamber_c) < 5.0


def test_the_windows_of_a_dwell_build_up_in_mm_per_s_and_arc_seconds(recorded):
    last = during(recorded, "navigate")[-1]
    first_window, second_window = last.dwell.windows
    assert first_window.planned_s == second_window.planned_s == 150.0
    assert len(first_window.time_s) >= 14
    assert 0.0 <= first_window.time_s[0] < first_window.time_s[-1] <= 155.0
    for window in (first_window, second_window):
        velocities = (*window.velocity_east_mps, *window.velocity_north_mps)
        assert 0.0 < max(map(abs, velocities)) < 0.01
        assert window.heading_change_deg[0] == 0.0
        assert max(map(abs, window.heading_change_deg)) < 0.01


def test_what_the_ins_says_in_the_turn_belongs_to_no_window(recorded):
    turning = during(recorded, "turn")
    assert turning
    assert all(len(each.dwell.windows) == 1 for each in turning)
    assert all(each.dwell.windows[0].time_s[-1] <= 152.0 for each in turning)


def test_the_bias_is_told_after_the_turn_and_becomes_better_known(recorded):
    assert all(each.live_bias is None for each in during(recorded, "align") + during(recorded, "turn"))
    estimates = during(recorded, "navigate")[-1].dwell.estimates
    assert len(estimates) >= 3
    assert max(estimates[-1].sigma_dph) < max(estimates[0].sigma_dph)


def test_position_and_azimuth_are_those_of_the_table(recorded):
    aligning, after = during(recorded, "align")[-1].attitude, during(recorded, "navigate")[-1].attitude
    assert (aligning.position, aligning.azimuth_deg) == ("z_up", 0.0)
    assert (after.position, after.azimuth_deg) == ("z_up", 180.0)
    np.testing.assert_allclose(aligning.body_in_enu, np.eye(3), atol=1e-4)
    np.testing.assert_allclose(after.body_in_enu, np.diag([-1.0, -1.0, 1.0]), atol=1e-4)


def test_present_values_are_those_of_the_instruments(recorded):
    bench = during(recorded, "navigate")[-1].bench
    assert bench.ins_mode == "navigate"
    assert abs(bench.outer_rate_dps) < 1e-3
    assert 15.0 < bench.chamber_c < 30.0
    assert math.isnan(bench.chamber_set_c)
    assert all(15.0 < each < 40.0 for each in (*bench.gyro_c, *bench.electronics_c, bench.case_c))
    assert all(0.0 <= age_s < 20.0 for age_s in (bench.table_age_s, bench.chamber_age_s, bench.ins_age_s))


def test_the_end_has_the_dwell_its_bins_and_the_unit(recorded):
    last = recorded.pictures[-1]
    (row,) = read_dwells(recorded.folder.dwells)
    assert (last.state, last.reason, last.alarms) == (RunState.FINISHED, "", ())
    assert (last.step, last.dwell) == (None, None)
    assert last.unit == row.unit
    assert last.dwells[0].bias_dph == pytest.approx(row.bias_dph, abs=1e-9)
    assert {each.gyro for each in last.bins if each.count} == {"x", "y", "z"}


def test_the_last_picture_is_in_the_run_folder(recorded):
    left = read_picture(recorded.folder.live)
    assert left.state is RunState.FINISHED
    assert left.dwells == recorded.pictures[-1].dwells
    assert not list(recorded.folder.path.glob(".live*"))


def test_every_picture_survives_json(recorded):
    for picture in recorded.pictures:
        assert Picture.from_json(picture.to_json()).to_json() == picture.to_json()


def test_a_picture_that_cant_be_written_ends_no_run(tmp_path, monkeypatch):
    monkeypatch.setattr(RunFolder, "live", property(lambda self: self.path / "missing" / "live.json"))
    recorded = recorded_run(tmp_path / "run")
    assert recorded.pictures[-1].state is RunState.FINISHED
    assert not list(tmp_path.rglob("live.json"))
    shutil.rmtree(tmp_path / "run")
