"""Temperature bins, and positions compared in them."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import count

import numpy as np
import pytest
from scipy.stats import chi2

from gyrobench.bench.bias.bins import (
    BIAS_BINS_TABLE,
    BiasBin,
    bin_biases,
    compare_positions,
    disconnected_bins,
    paper_bins,
    with_power_cycles,
)
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.position_differences import SLOPE_SIGMA_DPH_PER_C
from gyrobench.bench.foundations.errors import DocumentError, MeasurementError
from gyrobench.bench.navigation.positions import POSITIONS

numbers = count()


def row(
    position="z_up",
    gyro_c=(22.0, 22.0, 22.0),
    bias_dph=(0.0, 0.0, 0.0),
    sigma_dph=(0.001,) * 3,
    unit="U",
    run="R",
):
    return DwellRow(
        unit, run, next(numbers), 0, position, 0.0, 1.0, 0.0, gyro_c, (0.0,) * 3, bias_dph, sigma_dph
    )


def only(bins, gyro, position="z_up"):
    return [each for each in bins if each.gyro == gyro and each.position == position]


def test_weights_by_the_uncertainty():
    rows = [
        row(bias_dph=(0.010, 0, 0), sigma_dph=(0.001,) * 3, gyro_c=(21.0, 21.0, 21.0)),
        row(bias_dph=(0.020, 0, 0), sigma_dph=(0.002,) * 3, gyro_c=(24.0, 24.0, 24.0)),
    ]
    (each,) = only(bin_biases(rows), "x")
    assert each.bias_dph == pytest.approx(0.012)
    assert each.temperature_c == pytest.approx(21.6)
    assert each.sigma_dph == pytest.approx(1 / math.sqrt(1e6 + 0.25e6))
    assert each.count == 2
    (each,) = only(bin_biases([replace(dwell, gyro_c=(21.6,) * 3) for dwell in rows]), "x")
    assert each.bias_dph == pytest.approx(0.012)
    assert each.chi2_reduced == pytest.approx(2.0**2 + 4.0**2)
    assert each.spread_p_value == pytest.approx(math.erfc(math.sqrt(20.0 / 2.0)))


def rows_on_a_slope(random, extra_dph=0.0, plateaus_c=(-22.0, 8.0, 38.0, 68.0), curvature=0.0):
    """Dwells of six positions in a row at each plateau, with gyros that settle, and a bias of 0.002 deg/h/K.

    ``extra_dph``: more in z_down; ``curvature``: of the bias, deg/h/K^2.
    """
    rows = []
    for final_c in plateaus_c:
        for side in (-1.0, 1.0):
            for number, position in enumerate(POSITION_NAMES[::-1] if side > 0.0 else POSITION_NAMES):
                gyro_c = final_c + side * 4.0 * math.exp(-0.67 * number)
                bias_dph = 0.002 * gyro_c + curvature * gyro_c**2 + 0.001 * random.normal()
                bias_dph += extra_dph * (position == "z_down")
                rows.append(row(position, (gyro_c,) * 3, (bias_dph, 0.0, 0.0)))
    return rows


def test_a_bias_that_follows_the_temperature_is_no_difference_of_positions_and_no_scatter():
    random = np.random.default_rng(5)
    bins = [[each for each in bin_biases(rows_on_a_slope(random)) if each.gyro == "x"] for _ in range(20)]
    spreads = [each.spread_p_value for run in bins for each in run if each.count > 1]
    assert len(spreads) > 100
    assert min(spreads) > 0.01 / len(spreads)
    p_values = [each.p_value for run in bins for each in compare_positions(run)]
    assert min(p_values) > 0.01 / len(p_values)


def test_a_curvature_that_two_plateaus_do_not_show_is_no_difference_of_positions():
    random = np.random.default_rng(5)
    for _ in range(20):
        bins = bin_biases(rows_on_a_slope(random, plateaus_c=(8.0, 68.0), curvature=2e-5), 20.0)
        assert min(each.p_value for each in compare_positions(bins) if each.gyro == "x") > 1e-3


@pytest.mark.parametrize("plateaus_c", [(8.0, 38.0), (-22.0, 8.0, 38.0), (-22.0, 8.0, 38.0, 68.0)])
def test_positions_that_differ_are_found_beside_a_slope_over_any_number_of_plateaus(plateaus_c):
    rows = rows_on_a_slope(np.random.default_rng(5), 0.01, plateaus_c)
    found = compare_positions(bin_biases(rows))
    assert min(each.p_value for each in found if each.gyro == "x") < 1e-9


def test_bins_by_the_temperature_of_the_gyro_itself():
    bins = bin_biases([row(gyro_c=(-0.1, 4.9, 5.0))])
    ranges = [(each.gyro, each.bin_low_c, each.bin_high_c) for each in bins]
    assert ranges == [("x", -5.0, 0.0), ("y", 0.0, 5.0), ("z", 5.0, 10.0)]


def test_width_is_a_choice():
    (each,) = only(bin_biases([row(gyro_c=(23.0,) * 3)], width_c=10.0), "x")
    assert (each.bin_low_c, each.bin_high_c) == (20.0, 30.0)


def test_a_bin_that_no_dwell_measured_is_there_and_empty():
    bins = bin_biases([row(gyro_c=(11.0,) * 3), row(gyro_c=(26.0,) * 3), row("y_up", gyro_c=(16.0,) * 3)])
    assert [each.count for each in only(bins, "x")] == [1, 0, 0, 1]
    assert [each.count for each in only(bins, "x", "y_up")] == [0, 1, 0, 0]
    empty = only(bins, "x")[1]
    assert empty.is_empty
    assert all(
        math.isnan(v) for v in (empty.bias_dph, empty.sigma_dph, empty.temperature_c, empty.chi2_reduced)
    )


def test_one_dwell_has_no_spread():
    each = bin_biases([row()])[0]
    assert math.isnan(each.chi2_reduced)
    assert math.isnan(each.spread_p_value)


def test_spread_of_true_uncertainties_is_seldom_called_large():
    rng = np.random.default_rng(5)
    rows = [
        row(gyro_c=(5.0 * k + 1.0,) * 3, bias_dph=tuple(0.002 * rng.normal(size=3)), sigma_dph=(0.002,) * 3)
        for k in range(500)
        for _ in range(4)
    ]
    p_values = np.array([each.spread_p_value for each in bin_biases(rows)])
    assert 0.03 < (p_values < 0.05).mean() < 0.07
    assert np.mean([each.chi2_reduced for each in bin_biases(rows)]) == pytest.approx(1.0, abs=0.07)


def test_refuses_dwells_of_several_units_and_too_small_a_width():
    with pytest.raises(MeasurementError, match=r"several units \(A, B\)"):
        bin_biases([row(unit="A"), row(unit="B")])
    for width_c in (0.0, -5.0, 1e-9, math.nan, math.inf):
        with pytest.raises(MeasurementError, match=r"width of 0\.01 K or more"):
            bin_biases([row()], width_c=width_c)


def test_dwells_without_result_are_left_out():
    nan = (math.nan,) * 3
    bins = bin_biases([row(), row(bias_dph=(math.nan, 0.0, 0.0)), row(gyro_c=nan), row(sigma_dph=nan)])
    assert [each.count for each in bins] == [1, 2, 2]
    assert bin_biases([row(bias_dph=nan)]) == []


def test_bins_hold_the_papers_mean_over_the_dwells_that_have_one():
    by_paper = {"paper_bias_dph": (0.02, 0.0, 0.0), "paper_sigma_dph": (0.002,) * 3}
    rows = [
        replace(row(bias_dph=(0.01, 0.0, 0.0)), **by_paper),
        replace(row(), **{**by_paper, "paper_bias_dph": (0.05, 0.0, 0.0), "paper_sigma_dph": (0.004,) * 3}),
        row(),
    ]
    (each,) = only(bin_biases(rows), "x")
    assert each.count == 3
    assert each.paper_bias_dph == pytest.approx((4 * 0.02 + 0.05) / 5)
    assert each.paper_sigma_dph == pytest.approx(1 / math.sqrt(0.002**-2 + 0.004**-2))
    (exchanged,) = paper_bins([each])
    assert (exchanged.bias_dph, exchanged.sigma_dph) == (each.paper_bias_dph, each.paper_sigma_dph)
    assert (exchanged.temperature_c, exchanged.count) == (each.temperature_c, 3)
    assert math.isnan(exchanged.chi2_reduced)


def test_bins_that_the_papers_method_does_not_apply_to_are_empty_for_it():
    (each,) = only(bin_biases([row()]), "x")
    assert math.isnan(each.paper_bias_dph)
    (exchanged,) = paper_bins([each])
    assert exchanged.is_empty


def test_a_table_without_the_papers_columns_is_read(tmp_path):
    path = tmp_path / "bias_bins.csv"
    BIAS_BINS_TABLE.write(path, bin_biases([row()]))
    lines = [line.rsplit(",", 2)[0] for line in path.read_text(encoding="utf-8").splitlines()]
    path.write_text("\n".join(lines), encoding="utf-8")
    assert "paper" not in lines[0]
    assert math.isnan(BIAS_BINS_TABLE.read(path)[0].paper_sigma_dph)


def test_no_dwells_give_no_bins():
    assert bin_biases([]) == []


def test_reading_and_writing_again_gives_the_same_file(tmp_path):
    rng = np.random.default_rng(6)
    rows = [
        row(position, tuple(30.0 + 20.0 * rng.normal(size=3)), tuple(0.01 * rng.normal(size=3)))
        for position in ("x_down", "z_up")
        for _ in range(20)
    ]
    bins = bin_biases(rows, width_c=0.7)
    first, second = tmp_path / "first.csv", tmp_path / "second.csv"
    BIAS_BINS_TABLE.write(first, bins)
    BIAS_BINS_TABLE.write(second, BIAS_BINS_TABLE.read(first))
    assert first.read_bytes() == second.read_bytes()
    read = BIAS_BINS_TABLE.read(first)
    assert [each.count for each in read] == [each.count for each in bins]
    np.testing.assert_allclose([e.bias_dph for e in read], [e.bias_dph for e in bins], rtol=1e-8)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"temperature_c": 1500.0}, "column temperature_c: 1500 degC is not a gyro temperature"),
        ({"sigma_dph": 0.0}, "column sigma_dph: an uncertainty must be above zero; found 0"),
        ({"paper_sigma_dph": -1.0}, "column paper_sigma_dph: an uncertainty must be above zero; found -1"),
    ],
)
def test_numbers_that_no_bin_can_have_are_refused(tmp_path, change, message):
    path = tmp_path / "bias_bins.csv"
    BIAS_BINS_TABLE.write(path, [replace(bin_biases([row()])[0], **change)])
    with pytest.raises(DocumentError, match=rf"bias_bins\.csv:2: {message}"):
        BIAS_BINS_TABLE.read(path)


def test_says_which_cell_is_wrong(tmp_path):
    path = tmp_path / "bias_bins.csv"
    BIAS_BINS_TABLE.write(path, bin_biases([row()]))
    path.write_text(path.read_text().replace("\ny,", "\nw,"))
    with pytest.raises(
        DocumentError, match=r"bias_bins\.csv:3: column gyro: expected one of x, y, z; found 'w'"
    ):
        BIAS_BINS_TABLE.read(path)


def position_bin(position, bias_dph, sigma_dph=0.001, low_c=20.0, temperature_c=22.0, gyro="x", count=3):
    return BiasBin(
        gyro, position, low_c, low_c + 5.0, temperature_c, bias_dph, sigma_dph, count, math.nan, math.nan
    )


def test_two_positions_by_hand():
    (result,) = compare_positions([position_bin("z_up", 0.010, 0.001), position_bin("y_up", 0.015, 0.002)])
    assert result.p_value == pytest.approx(math.erfc(math.sqrt(5.0 / 2.0)))
    assert result.largest_pair == ("y_up", "z_up")
    assert result.largest_difference_dph == pytest.approx(0.005)
    assert result.largest_difference_sigma_dph == pytest.approx(math.hypot(0.001, 0.002))


def test_with_one_temperature_only_the_slope_of_the_bias_is_uncertain():
    (result,) = compare_positions(
        [
            position_bin("z_up", 0.010, 0.001, temperature_c=22.0),
            position_bin("y_up", 0.015, 0.002, temperature_c=23.5),
        ]
    )
    assert result.temperature_spread_c == pytest.approx(1.5)
    assert result.largest_difference_dph == pytest.approx(0.005, rel=1e-3)
    assert result.largest_difference_sigma_dph == pytest.approx(
        math.hypot(0.001, 0.002, SLOPE_SIGMA_DPH_PER_C * 1.5), rel=1e-3
    )


def test_the_papers_method_is_compared_in_the_same_way():
    bins = [
        replace(position_bin(p, 0.0), paper_bias_dph=b, paper_sigma_dph=0.002)
        for p, b in (("z_up", 0.01), ("y_up", 0.0))
    ]
    (result,) = compare_positions(paper_bins([*bins, position_bin("x_up", 0.5)]))
    assert result.largest_pair == ("z_up", "y_up")
    assert result.largest_difference_dph == pytest.approx(0.01)
    assert result.p_value == pytest.approx(math.erfc(math.sqrt(12.5 / 2.0)))


def test_freedom_is_one_less_than_the_positions():
    biases = [0.001, 0.002, 0.003, 0.004]
    (result,) = compare_positions([position_bin(p, b) for p, b in zip(POSITIONS, biases, strict=False)])
    assert result.p_value == pytest.approx(chi2.sf(5.0, 3))
    assert result.largest_pair == ("y_down", "z_up")


def test_positions_that_are_equal_are_seldom_called_different():
    rng = np.random.default_rng(7)
    p_values = np.array(
        [
            result.p_value
            for _ in range(40)
            for result in compare_positions(
                position_bin(p, 0.002 * rng.normal(), 0.002, 5.0 * k) for k in range(50) for p in POSITIONS
            )
        ]
    )
    assert len(p_values) == 2000
    assert 0.035 < (p_values < 0.05).mean() < 0.065


def test_a_position_apart_is_found():
    bins = [position_bin(p, 0.02 if p == "y_up" else 0.0, 0.002) for p in POSITIONS]
    (result,) = compare_positions(bins)
    assert result.p_value < 1e-12
    assert result.largest_pair[0] == "y_up"


def test_gyros_and_bins_are_kept_apart():
    bins = [
        position_bin(p, 0.0, low_c=low, gyro=gyro)
        for gyro in "zx"
        for low in (25.0, 20.0)
        for p in ("z_up", "y_up")
    ]
    results = compare_positions(bins)
    assert [(r.gyro, r.bin_low_c, r.bin_high_c) for r in results] == [
        ("x", 20.0, 25.0),
        ("x", 25.0, 30.0),
        ("z", 20.0, 25.0),
        ("z", 25.0, 30.0),
    ]


def test_positions_of_a_plateau_that_a_border_divides_are_compared_over_both_bins():
    settling = [position_bin(p, 0.0, temperature_c=24.0 + 0.1 * n) for n, p in enumerate(POSITIONS)]
    first = position_bin("z_up", 0.02, low_c=25.0, temperature_c=25.3)
    (result,) = compare_positions([first, *(each for each in settling if each.position != "z_up")])
    assert (result.bin_low_c, result.bin_high_c) == (20.0, 30.0)
    assert result.largest_pair[0] == "z_up"
    assert result.p_value < 1e-9
    assert result.temperature_spread_c == pytest.approx(1.2)


@pytest.mark.parametrize(
    "upper",
    [
        [position_bin("y_up", 0.0, low_c=25.0, temperature_c=26.0)],  # as of another cycle
        [position_bin("x_up", 0.0, low_c=25.0, temperature_c=27.5)],  # as of another plateau
        [position_bin("x_up", 0.0, low_c=25.0, temperature_c=26.0, gyro="y")],
    ],
)
def test_other_bins_are_compared_each_for_itself(upper):
    lower = [position_bin(p, 0.0, temperature_c=22.0) for p in ("z_up", "y_up")]
    (result,) = compare_positions([*lower, *upper])
    assert (result.bin_low_c, result.bin_high_c) == (20.0, 25.0)


def test_needs_two_positions_that_were_measured():
    empty = position_bin("y_up", math.nan, math.nan, temperature_c=math.nan, count=0)
    assert compare_positions([position_bin("z_up", 0.0), empty]) == []


def rows_of_power_cycles(runs, random=None, differences=(0.0,) * 6, turn_on_dph=0.03):
    """One dwell for each power cycle and position in ``runs``; each power-on has another bias."""
    constants = {run: turn_on_dph * number for number, run in enumerate(runs)}
    return [
        row(
            name,
            bias_dph=(
                constants[run]
                + differences[list(POSITIONS).index(name)]
                + (0.001 * random.standard_normal() if random else 0.0),
            )
            * 3,
            run=run,
        )
        for run, names in runs.items()
        for name in names
    ]


POSITION_NAMES = list(POSITIONS)


def test_another_bias_after_a_power_cycle_in_mid_plateau_is_no_difference_of_positions():
    bins = bin_biases(rows_of_power_cycles({"1": POSITION_NAMES[:3], "2": POSITION_NAMES[3:]}))
    results = compare_positions(bins)
    assert [each.p_value for each in results] == pytest.approx([1.0] * 3)
    assert max(abs(each.largest_difference_dph) for each in results) < 1e-12


def test_a_difference_within_a_power_cycle_is_found_beside_another_power_cycle():
    rows = rows_of_power_cycles(
        {"1": POSITION_NAMES[:3], "2": POSITION_NAMES[3:]}, differences=(0.0, 0.02, 0, 0, 0, 0)
    )
    result = compare_positions(bin_biases(rows))[0]
    assert result.largest_pair == (POSITION_NAMES[1], POSITION_NAMES[0])
    assert result.largest_difference_dph == pytest.approx(0.02)
    assert result.largest_difference_sigma_dph == pytest.approx(math.sqrt(2.0) * 0.001)
    assert result.p_value == pytest.approx(chi2.sf(400.0 * 2.0 / 3.0, 4))


def test_positions_of_two_power_cycles_are_compared_through_one_that_both_measured():
    rows = rows_of_power_cycles(
        {"1": ["z_up", "y_up"], "2": ["y_up", "x_up"]}, differences=(0, 0, 0, 0, 0.02, 0)
    )
    result = compare_positions(bin_biases(rows))[0]
    assert set(result.largest_pair) <= {"x_up", "z_up", "y_up"}
    assert result.largest_pair[0] == "x_up"
    assert result.largest_difference_dph == pytest.approx(0.02)
    assert disconnected_bins(bin_biases(rows)) == []


def test_positions_each_of_another_power_cycle_are_not_compared_and_named():
    bins = bin_biases(rows_of_power_cycles({"1": ["z_up"], "2": ["y_up"]}))
    assert compare_positions(bins) == []
    assert [(each.gyro, each.bin_low_c) for each in disconnected_bins(bins)] == [(g, 20.0) for g in "xyz"]


@pytest.mark.long
@pytest.mark.parametrize(
    "runs", [{"1": POSITION_NAMES[:3], "2": POSITION_NAMES[2:]}, {"1": POSITION_NAMES, "2": POSITION_NAMES}]
)
def test_p_values_of_equal_positions_over_power_cycles_are_uniform(runs):
    random = np.random.default_rng(2)
    p_values = np.array(
        [compare_positions(bin_biases(rows_of_power_cycles(runs, random)))[0].p_value for _ in range(2000)]
    )
    assert 0.035 < (p_values < 0.05).mean() < 0.065
    assert 0.45 < (p_values < 0.5).mean() < 0.55


def test_the_papers_biases_are_compared_over_power_cycles_too():
    rows = [
        replace(each, paper_bias_dph=each.bias_dph, paper_sigma_dph=(0.002,) * 3)
        for each in rows_of_power_cycles({"1": POSITION_NAMES[:3], "2": POSITION_NAMES[3:]})
    ]
    assert compare_positions(paper_bins(bin_biases(rows)))[0].p_value == pytest.approx(1.0)


def test_bins_from_a_file_have_the_means_of_power_cycles_of_the_dwells_without_flags(tmp_path):
    path = tmp_path / "bias_bins.csv"
    rows = rows_of_power_cycles({"1": ["z_up", "y_up"], "2": ["y_up"]})
    bins = bin_biases(rows, 0.1)
    BIAS_BINS_TABLE.write(path, bins)
    flagged = replace(rows[0], run="3", flags=("moved",))
    assert any(each.by_power_cycle for each in bins)
    means = [each.by_power_cycle for each in with_power_cycles(BIAS_BINS_TABLE.read(path), [*rows, flagged])]
    assert repr(means) == repr([each.by_power_cycle for each in bins])  # NaN does not equal itself
    assert with_power_cycles([], []) == []


def test_a_file_with_means_of_power_cycles_as_text_is_readable(tmp_path):
    path = tmp_path / "bias_bins.csv"
    bins = bin_biases(rows_of_power_cycles({"1": ["z_up"]}))
    BIAS_BINS_TABLE.write(path, bins)
    header, *lines = path.read_text().splitlines()
    path.write_text("\n".join([f"{header},by_power_cycle", *(f"{each},1 0.2 0.1 nan nan" for each in lines)]))
    assert repr(BIAS_BINS_TABLE.read(path)) == repr(bins)  # NaN does not equal itself
