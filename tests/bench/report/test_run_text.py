"""Findings in words."""

from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.bias.bins import BiasBin, PositionComparison, bin_biases, compare_positions, paper_bins
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.report.run_text import (
    fit_sentence,
    paper_agreement_sentence,
    position_comparison_sentence,
    power_cycle_sentence,
    scatter_sentence,
    significant_differences,
)

COMPARISON = PositionComparison(
    gyro="x",
    bin_low_c=20.0,
    bin_high_c=25.0,
    p_value=0.004,
    largest_pair=("y_up", "z_up"),
    largest_difference_dph=0.0123,
    largest_difference_sigma_dph=0.0013,
    temperature_spread_c=0.1,
)


def a_bin(low_c, **changes):
    base = BiasBin("x", "z_up", low_c, low_c + 5.0, low_c + 2.0, 0.004, 0.0009, 2, 1.0, 0.4)
    return replace(base, **changes)


def test_each_bin_of_a_gyro_makes_the_test_stricter():
    assert significant_differences([COMPARISON]) == [COMPARISON]
    others = [replace(COMPARISON, bin_low_c=low, p_value=0.5) for low in (30.0, 40.0)]
    assert significant_differences([COMPARISON, *others]) == []
    assert significant_differences([COMPARISON, *(replace(other, gyro="y") for other in others)]) == [
        COMPARISON
    ]


def test_sentence_states_where_and_by_how_much():
    sentence = position_comparison_sentence([COMPARISON])
    assert "in 1 of 1 bins: from 20 to 25 °C (p < 0.01, one comparison)" in sentence
    assert "Y-Up above Z-Up by 0.0123 ± 0.0013 deg/h" in sentence


def test_sentence_counts_only_the_bins_that_differ():
    hotter = replace(COMPARISON, bin_low_c=25.0, bin_high_c=30.0, p_value=0.3)
    assert position_comparison_sentence([COMPARISON, hotter]) == (
        "The bias differs between positions in 1 of 2 bins: from 20 to 25 °C (p < 0.01, corrected for 2 "
        "comparisons). Largest difference from 20 to 25 °C: Y-Up above Z-Up by 0.0123 ± 0.0013 deg/h (k = 1)."
    )


def test_sentence_says_that_nothing_was_found_or_compared():
    hotter = replace(COMPARISON, bin_low_c=25.0, bin_high_c=30.0, p_value=0.3)
    assert position_comparison_sentence([replace(COMPARISON, p_value=0.3), hotter]) == (
        "No significant difference between positions from 20 to 30 °C (no p < 0.01, corrected for 2 "
        "comparisons)."
    )
    assert position_comparison_sentence([]).startswith("Nothing to compare")


def test_made_up_runs_are_judged_rightly(bins, equal_bins):
    for gyro in "xyz":
        parting = compare_positions([each for each in bins if each.gyro == gyro])
        assert {each.bin_low_c for each in significant_differences(parting)} >= {-25.0, 5.0, 15.0}
        assert all(each.bin_high_c <= 50.0 for each in significant_differences(parting))
        agreeing = compare_positions([each for each in equal_bins if each.gyro == gyro])
        assert position_comparison_sentence(agreeing).startswith(
            "No significant difference between positions from"
        )


def test_scatter_is_stated_only_where_uncertainties_do_not_explain_it():
    quiet = [a_bin(0.0), a_bin(5.0, count=1, spread_p_value=float("nan"))]
    assert scatter_sentence(quiet) == ""
    assert "Z-Up 10 to 15 °C." in scatter_sentence([*quiet, a_bin(10.0, spread_p_value=1e-6)])


def test_agreement_names_the_bins_that_the_estimators_judge_differently():
    hotter = replace(COMPARISON, bin_low_c=25.0, bin_high_c=30.0, p_value=0.3)
    equal = replace(COMPARISON, p_value=0.3)
    different = replace(hotter, p_value=1e-6)
    ours = [COMPARISON, hotter]
    assert paper_agreement_sentence(ours, ours) == "The paper's method agrees."
    assert paper_agreement_sentence(ours, [COMPARISON, different]).endswith(
        "disagrees: it also finds a difference from 25 to 30 °C."
    )
    assert paper_agreement_sentence(ours, [equal, different]).endswith(
        "a difference from 25 to 30 °C, and it finds none from 20 to 25 °C."
    )
    assert paper_agreement_sentence(ours, []) == ""


def test_leaks_of_the_papers_method_show_as_differences_of_equal_positions(equal_bins):
    own = [each for each in equal_bins if each.gyro == "y"]
    sentence = paper_agreement_sentence(compare_positions(own), compare_positions(paper_bins(own)))
    assert sentence.startswith("The paper's method disagrees: it also finds a difference from -25")


def test_fit_of_dwells_whose_noise_is_as_declared_is_no_surprise(dwells):
    sentence = fit_sentence(dwells)
    assert sentence.startswith("Residuals of 71 dwells are 0.")
    assert sentence.endswith("Error model and noise explain the data.")


@pytest.mark.parametrize(("power", "verdict"), [(4.0, "too small"), (0.2, "too large")])
def test_p_values_that_chance_does_not_give_are_stated(dwells, power, verdict):
    sentence = fit_sentence([replace(row, fit_p_value=row.fit_p_value**power) for row in dwells])
    assert f"p-values are {verdict} (" in sentence
    assert "explain" not in sentence
    assert "disturbed" not in sentence


def test_dwells_that_do_not_fit_are_named(dwells):
    bad = [replace(row, fit_p_value=1e-7) if row.dwell in (3, 5) else row for row in dwells]
    assert fit_sentence(bad).endswith("Outlying: dwells 3 and 5 (smallest p = 1e-7).")
    bad[9] = replace(dwells[9], fit_p_value=0.0)
    assert fit_sentence(bad).endswith("Outlying: dwells 3, 5 and 10 (smallest p < 1e-9).")


def test_single_dwell_and_none_have_their_sentences(dwells, old_dwells):
    only = replace(dwells[0], fit_ratio=1.04, fit_p_value=0.3)
    assert fit_sentence([only]) == (
        "Residuals of the only dwell tested are 1.04 times as large as expected (p = 0.300). "
        "Error model and noise explain the data."
    )
    assert "larger than assumed" in fit_sentence([replace(only, fit_p_value=1e-4)])
    assert fit_sentence(old_dwells) == ""


def test_verdict_seldom_blames_chance():
    random = np.random.default_rng(11)
    row = DwellRow("U", "1", 1, 1, "z_up", 0, 1, 0, (0,) * 3, (0,) * 3, (0,) * 3, (1,) * 3)
    runs = [[replace(row, fit_ratio=1.0, fit_p_value=p) for p in random.uniform(size=60)] for _ in range(300)]
    blamed = sum("explain the data" not in fit_sentence(run) for run in runs)
    assert blamed <= 9  # 3 are expected


def test_power_cycles_that_measured_different_positions_are_named(dwells):
    good = [row for row in dwells if not row.flags]
    assert power_cycle_sentence(bin_biases(good)) == ""
    apart = [replace(row, run=row.position[0]) for row in good if row.position in ("z_up", "y_up")]
    sentence = power_cycle_sentence(bin_biases(apart))
    assert sentence.endswith("Only positions of the same power cycle are compared there.")
