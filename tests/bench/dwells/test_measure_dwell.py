"""One dwell, from frames to a row."""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.dwells.dwell_output import decode_dwell, dwell_at_rest
from gyrobench.bench.dwells.measure_dwell import measure_dwell
from gyrobench.bench.dwells.measurement_setup import measurement_setup
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.station.station import Station
from tests.bench.dwells.conftest import with_wild_velocity


def has_no_numbers(row):
    return np.isnan([row.bias_dph, row.sigma_dph, row.paper_bias_dph, row.paper_sigma_dph]).all()


def halved(mark, gap_frames=0):
    """Two segments of one window, the table where it was, and some frames between them left out."""
    middle = (mark.first_frame + mark.end_frame) // 2
    return replace(mark, end_frame=middle), replace(mark, first_frame=middle + gap_frames)


def test_the_row_has_the_number_of_other_units_on(recorded):
    marks, frames, setup = recorded
    assert measure_dwell(marks, frames, setup).row.other == ()
    assert measure_dwell(replace(marks, neighbours_on=1.5), frames, setup).row.other == (
        ("neighbours_on", 1.5),
    )


def test_a_dwell_has_both_estimates_its_windows_and_temperatures(recorded):
    measured = measure_dwell(*recorded)
    row = measured.row
    assert row.flags == ()
    assert row.bias_dph == tuple(measured.estimate.bias_dph)
    assert row.sigma_dph == tuple(measured.estimate.sigma_dph)
    assert row.paper_bias_dph == pytest.approx(row.bias_dph, abs=0.05)
    assert row.fit_p_value == measured.estimate.fit.p_value
    # An epoch a second over 150 s, and over what the commands around them take.
    for window in measured.windows:
        assert np.diff(window.time_s) == pytest.approx(1.0)
        assert 150.0 <= window.time_s[-1] - window.time_s[0] < 152.0
    assert np.abs(np.subtract(row.gyro_c, 25.0)).max() < 5.0


def test_output_that_moves_in_finer_steps_than_its_coarsest_is_not_stuck(recorded):
    marks, frames, setup = recorded
    floating = replace(setup, heading_lsb_rad=np.deg2rad(1.5e-5))  # of 180 deg in single precision
    assert measure_dwell(marks, frames, floating).row.flags == ()


def test_a_dwell_whose_ins_fell_back_to_alignment_has_no_bias_and_says_why(recorded):
    marks, frames, setup = recorded
    early = replace(marks.windows[0], first_frame=0)
    row = measure_dwell(replace(marks, windows=(early, marks.windows[1])), frames, setup).row
    assert has_no_numbers(row)
    assert "left navigation" in str(row.flags)


def test_a_dwell_without_frames_has_no_bias_and_says_why(recorded):
    marks, frames, setup = recorded
    row = measure_dwell(marks, frames.take(slice(0, 0)), setup).row
    assert has_no_numbers(row)
    assert "no navigation frames" in str(row.flags)


def test_frames_that_stopped_flag_the_dwell(recorded):
    marks, frames, setup = recorded
    second = marks.windows[1]
    row = measure_dwell(marks, frames.take(slice(0, second.first_frame + 38 * 40)), setup).row
    assert has_no_numbers(row)
    assert "the window lasts 39.9 s" in str(row.flags)


def test_an_ins_that_uses_another_latitude_than_the_station_contradicts_the_set_up(recorded):
    marks, frames, setup = recorded
    measured = measure_dwell(marks, frames, replace(setup, site=Site(np.deg2rad(63.4), 60.0)))
    assert has_no_numbers(measured.row)
    assert (measured.setup_fault,) == measured.flags
    assert measured.flags[0].startswith("the INS uses a latitude of 36.4000 deg, location.latitude_deg is 6")
    near = replace(setup, site=Site(np.deg2rad(36.44), 60.0))  # shows in the data of several dwells
    assert measure_dwell(marks, frames, near).setup_fault == ""


def test_a_gap_of_some_seconds_flags_the_dwell(recorded):
    marks, frames, setup = recorded
    middle = (marks.windows[0].first_frame + marks.windows[0].end_frame) // 2
    gap = np.flatnonzero(frames.timestamp_s > frames.timestamp_s[middle] + 3.0)[0] - middle
    kept = np.ones(len(frames), dtype=bool)
    kept[middle : middle + gap] = False
    before = replace(marks.windows[0], end_frame=marks.windows[0].end_frame - gap)
    after = replace(
        marks.windows[1],
        first_frame=marks.windows[1].first_frame - gap,
        end_frame=marks.windows[1].end_frame - gap,
    )
    measured = measure_dwell(replace(marks, windows=(before, after)), frames.take(kept), setup)
    assert "nothing from the INS for 3" in str(measured.row.flags)
    assert measured.counts.lost in (29, 30, 31)


def test_three_windows_give_a_bias_that_is_not_the_papers(recorded):
    marks, frames, setup = recorded
    whole = measure_dwell(marks, frames, setup).estimate
    three = (marks.windows[0], *halved(marks.windows[1], gap_frames=37 * 5))
    measured = measure_dwell(replace(marks, windows=three), frames, setup)
    assert measured.row.flags == ()
    assert np.isnan([measured.row.paper_bias_dph, measured.row.paper_sigma_dph]).all()
    # A jump of the attitude between two windows costs a little of what they say.
    assert (measured.estimate.sigma_dph > whole.sigma_dph).all()
    assert (measured.estimate.sigma_dph < 1.5 * whole.sigma_dph).all()
    assert (np.abs(measured.estimate.bias_dph - whole.bias_dph) < measured.estimate.sigma_dph).all()


def test_one_window_can_not_show_the_biases(recorded):
    marks, frames, setup = recorded
    row = measure_dwell(replace(marks, windows=marks.windows[:1]), frames, setup).row
    assert has_no_numbers(row)
    assert "no navigation after a turn" in str(row.flags)


def test_windows_that_overlap_flag_the_dwell(recorded):
    marks, frames, setup = recorded
    row = measure_dwell(replace(marks, windows=(*marks.windows, marks.windows[1])), frames, setup).row
    assert has_no_numbers(row)
    assert "before the previous one ends" in str(row.flags)


def test_a_table_that_stood_elsewhere_flags_the_dwell(recorded):
    marks, frames, setup = recorded
    turned = replace(marks.windows[1], inner_deg=marks.windows[1].inner_deg - 90.0)
    row = measure_dwell(replace(marks, windows=(marks.windows[0], turned)), frames, setup).row
    assert has_no_numbers(row)
    assert "INS and table in window 2 disagree by 90.0 deg" in str(row.flags)


@pytest.mark.parametrize(("away_deg", "is_flagged"), [(0.02, False), (0.1, True), (-0.1, True)])
def test_an_ins_that_turned_by_another_angle_than_the_table_flags_the_dwell(recorded, away_deg, is_flagged):
    marks, frames, setup = recorded
    first, second = marks.windows
    moved = replace(second, inner_deg=second.inner_deg + away_deg)
    measured = measure_dwell(replace(marks, windows=(first, moved)), frames, setup)
    assert ("aligned again or corrected its heading" in " ".join(measured.flags)) == is_flagged
    assert ("scale factors of gyros are 5" in " ".join(measured.flags)) == is_flagged
    assert np.isfinite(measured.row.bias_dph).all()


def test_a_disturbed_dwell_keeps_its_flag_and_its_numbers(recorded):
    marks, frames, setup = recorded
    row = measure_dwell(replace(marks, disturbances=("door opened",)), frames, setup).row
    assert row.flags == ("door opened",)
    assert np.isfinite(row.bias_dph).all()


def test_time_stamps_that_do_not_start_at_the_epoch_or_step_back_change_nothing(recorded):
    marks, frames, setup = recorded
    expected = measure_dwell(marks, frames, setup).row
    since_power_up = frames.timestamp_s - frames.timestamp_s[0] + 5.0
    stepped = np.where(np.arange(len(frames)) < len(frames) // 2, since_power_up, since_power_up - 30.0)
    for stamps in (since_power_up, stepped):
        row = measure_dwell(marks, frames.with_fields(time_s=stamps), setup).row
        assert repr(row) == repr(expected)  # NaN does not equal itself


def test_one_wild_velocity_flags_the_dwell(recorded):
    marks, frames, setup = recorded
    row = measure_dwell(marks, with_wild_velocity(marks, frames), setup).row
    assert "times as large as the noise explains" in str(row.flags)


@pytest.mark.parametrize(("factor", "ratio"), [(0.2, 1.0), (5.0, 0.2)])
def test_the_uncertainty_follows_noise_that_is_larger_than_declared_alone(recorded, factor, ratio):
    marks, frames, setup = recorded
    known = measure_dwell(marks, frames, setup).row
    declared = [factor * value for value in dataclasses.astuple(setup.noise)[:4]]
    row = measure_dwell(marks, frames, replace(setup, noise=type(setup.noise)(*declared))).row
    assert row.flags == ()
    assert row.fit_ratio == pytest.approx(ratio, rel=0.2)
    if factor < 1.0:
        assert row.sigma_dph == pytest.approx(known.sigma_dph, rel=0.1)


def test_noise_that_is_not_declared_is_estimated_but_never_below_the_resolution(recorded):
    marks, frames, setup = recorded
    coarse = replace(setup, noise=None, velocity_lsb_mps=0.01, heading_lsb_rad=1e-5)
    windows = dwell_at_rest(marks, decode_dwell(marks, frames, setup)[0], setup).windows
    noise = coarse.noise_in(windows)
    assert noise.angle_random_walk == pytest.approx(setup.noise.angle_random_walk, rel=0.2)
    assert noise.velocity_white == pytest.approx(0.01 / 12**0.5)
    assert noise.heading_white == pytest.approx(1e-5 / 12**0.5)
    assert setup.noise_in(windows) is setup.noise


SHIPPED = find_document("stations", "emulated")


def test_the_setup_has_place_noise_resolution_and_what_is_known_of_the_station():
    station = Station(SHIPPED)
    setup = measurement_setup(station)
    assert (setup.site, setup.prior, setup.table) == (station.site, station.prior(), station.table)
    assert setup.velocity_lsb_mps == pytest.approx(1e-4)
    assert np.degrees(setup.heading_lsb_rad) == pytest.approx(1e-6)
    assert setup.noise == station.noise(setup.velocity_lsb_mps, setup.heading_lsb_rad)
    assert all(limit.sufficient for limit in setup.resolution)


def test_a_signal_that_the_dbc_lacks_is_an_error(tmp_path):
    path = tmp_path / "station.yaml"
    path.write_text(SHIPPED.read_text().replace("VELOCITY_NE.VELOCITY_EAST", "VELOCITY_NE.VELOCITY_WEST"))
    with pytest.raises(DocumentError, match="VELOCITY_WEST"):
        measurement_setup(Station(path))
